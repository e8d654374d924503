"""The networks of handles (section 3.1 of TapMo) and of orientation in numpy, and the mesh as they see it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from bunraku.core.body.layout import HANDLE_COUNT
from bunraku.core.geometry.axes import right_angle_rotations
from bunraku.core.nn.checkpoints import config_of, load_network
from bunraku.core.nn.layers import Linear, Weights, gelu, mean_and_most, softmax, through, through_parts

_NEAR = 3  # anchors that each vertex listens to


@dataclass
class MeshGraph:
    """A mesh as arrays, its vertices by falling degree: what is said of vertex i stands in row `position[i]`."""

    inputs: np.ndarray  # position and normal of each vertex, shape (V, 6)
    areas: np.ndarray  # share of the surface that each vertex stands for, shape (V,), sums to 1
    # The n-th neighbours of the vertices that have so many; every vertex is its own first neighbour. Shapes (V,),
    # (V_1,), (V_2,) ...
    ranks: tuple[np.ndarray, ...]
    position: np.ndarray  # where each vertex is in that order, shape (V,)
    spread: csr_matrix  # weights from anchors to vertices, rows sum to 1, shape (V, M)
    gather: csr_matrix  # weights from vertices to anchors, rows sum to 1, shape (M, V)
    anchors: np.ndarray  # positions of the anchors, shape (M, 3)

    def mirrored(self) -> MeshGraph:
        """The mirror image in the plane x = 0, with the same vertices in the same order."""
        flip = np.array([-1, 1, 1, -1, 1, 1], np.float32)
        return MeshGraph(**{**vars(self), "inputs": self.inputs * flip, "anchors": self.anchors * flip[:3]})

    def largest_neighbour(self, values: np.ndarray) -> np.ndarray:
        """The largest of each channel among the neighbours of each vertex, shape (V, C) -> (V, C).

        With the vertices in order of falling degree, the n-th neighbours of all vertices that have one are a prefix: no
        padding, and all work is in whole slices.
        """
        best, room = np.empty_like(values), np.empty_like(values)
        seen = values
        for neighbours in self.ranks[1:]:
            count = len(neighbours)
            other = values.take(neighbours, axis=0, out=room[:count], mode="clip")
            np.maximum(seen[:count], other, out=best[:count])
            if seen is values:
                seen, best[count:] = best, values[count:]
        return values.copy() if seen is values else best


def farthest_points(positions: np.ndarray, count: int) -> np.ndarray:
    """Indices of points spread evenly by farthest-point sampling, starting with the point farthest from the middle."""
    x = np.ascontiguousarray(positions.T, dtype=np.float32)
    distance = ((x - x.mean(axis=1, keepdims=True)) ** 2).sum(axis=0)
    chosen = np.empty(count, np.int64)
    chosen[0] = int(distance.argmax())
    distance = np.full(len(positions), np.inf, np.float32)
    for n in range(1, count):
        gap = x - x[:, chosen[n - 1], None]
        np.minimum(distance, np.einsum("iv,iv->v", gap, gap), out=distance)
        chosen[n] = int(distance.argmax())
    return chosen


def neighbour_ranks(edges: np.ndarray, count: int) -> tuple[list[np.ndarray], np.ndarray]:
    """The n-th neighbours of the vertices that have so many, vertices in order of falling degree, and where each vertex
    is in that order, of undirected edges (E, 2).
    """
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    degrees = np.bincount(both[:, 0], minlength=count)
    order = np.argsort(-degrees, kind="stable")
    index = np.empty(count, np.int64)
    index[order] = np.arange(count)
    starts = np.cumsum(degrees) - degrees
    ranks = [order]
    for n in range(int(degrees.max(initial=0))):
        rows = order[: int((degrees > n).sum())]
        ranks.append(both[starts[rows] + n, 1])
    return ranks, index


def mesh_graph(
    positions: np.ndarray, normals: np.ndarray, edges: np.ndarray, areas: np.ndarray, anchors: int = 128
) -> MeshGraph:
    """The graph of a normalised mesh.

    Args:
        positions: Vertices, centred, largest extent 1, shape (V, 3).
        normals: Vertex normals, shape (V, 3).
        edges: Undirected edges, each once, bridges between loose parts included, shape (E, 2).
        areas: Surface that each vertex stands for, any unit, shape (V,).
        anchors: Most anchors, M.
    """
    count = len(positions)
    chosen, index, weight = anchored(positions, anchors)
    ranks, number = neighbour_ranks(np.asarray(edges, np.int64), count)
    order = ranks[0]
    columns, values, share = index[order].reshape(-1), weight[order], area_shares(areas)[order]
    rows = np.arange(0, len(columns) + 1, index.shape[1])
    heard = (values * share[:, None]).reshape(-1)
    heard /= np.maximum(np.bincount(columns, heard, len(chosen)), 1e-20).astype(np.float32)[columns]
    shape = count, len(chosen)
    return MeshGraph(
        inputs=np.concatenate([positions, normals], axis=1).astype(np.float32)[order],
        areas=share,
        ranks=tuple(number[rank] for rank in ranks),
        position=number,
        spread=csr_matrix((values.reshape(-1), columns, rows), shape=shape),
        gather=csr_matrix(csr_matrix((heard, columns, rows), shape=shape).T),
        anchors=positions[chosen].astype(np.float32),
    )


def anchored(
    positions: np.ndarray, anchors: int, rng: np.random.Generator | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which vertices are anchors, shape (M,); the anchors that each vertex listens to, shape (V, n), and how much."""
    seen = positions if rng is None else positions + rng.normal(0, 0.02, positions.shape)
    chosen = farthest_points(seen, min(anchors, len(positions)))
    points = positions[chosen].astype(np.float32)
    squared = ((positions**2).sum(axis=1)[:, None] - 2 * positions @ points.T + (points**2).sum(axis=1)).astype(
        np.float32
    )
    near = min(_NEAR, len(chosen))
    index = np.argpartition(squared, near - 1, axis=1)[:, :near]
    weight = 1 / (np.maximum(np.take_along_axis(squared, index, axis=1), 0) + 1e-4)
    return chosen, index, (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)


def area_shares(areas: np.ndarray) -> np.ndarray:
    """Share of the surface that each vertex stands for, shape (V,), not 0."""
    share = np.maximum(np.asarray(areas, np.float64), 0)
    share = (share + 1e-3 * max(share.mean(), 1e-12)).astype(np.float32)
    return np.asarray(share / share.sum())


LEAST_VERTICES = 100
"""Of a network mesh that has room for all handles."""


@dataclass(frozen=True)
class PredictorConfig:
    """Shape of the network."""

    # channels of the three graph layers; their sum is the length of f_phi
    levels: tuple[int, int, int] = (64, 128, 256)
    hidden: tuple[int, int] = (256, 128)  # channels inside the MLP
    handles: int = HANDLE_COUNT  # K
    heads: int = 4  # attention heads among the anchors
    anchors: int = 128  # anchors of the coarse term
    depth: int = 3  # rounds in which the anchors of a layer pass messages to one another
    # most vertices of the network mesh it was trained on, for `bunraku.core.geometry.simplify.network_mesh`
    mesh_vertices: int = 2400


class HandlePrediction(NamedTuple):
    """What the predictor says of one mesh."""

    weights: np.ndarray  # skinning weights s, rows sum to 1, shape (V, K)
    features: np.ndarray  # the mesh deformation feature f_phi, shape (448,)


class _GraphLayer:
    """`LayerNorm(EdgeConv(x) + spread(blocks(gather(x))))`, then GELU, shape (V, width_in) -> (V, width_out)."""

    def __init__(self, width_in: int, width_out: int, heads: int, depth: int, weights: Weights):
        itself = weights.linear("fine.own", width_in, width_out)
        self.neighbour = weights.linear("fine.neighbour", width_in, width_out, bias=False)
        # what a vertex says of itself, less what its neighbours would hear of it
        self.own = Linear(itself.matrix - self.neighbour.matrix, itself.bias)
        self.enter = weights.linear("enter", width_in + 3, width_out)
        names = "attention merge norm_attention mix.0 mix.2 norm_mix"
        # rounds in which the anchors pass messages to one another
        self.blocks = weights.pre_norms("blocks", depth, names, width_out, heads, 2 * width_out)
        self.norm = weights.norm("norm", width_out)

    def __call__(self, x: np.ndarray, graph: MeshGraph) -> np.ndarray:
        tokens = through((self.enter, *self.blocks), np.concatenate([graph.gather @ x, graph.anchors], axis=-1)[None])
        both = self.own(x)
        both += graph.largest_neighbour(self.neighbour(x))
        both += graph.spread @ tokens[0]
        return through((self.norm, gelu), both)


class HandlePredictor:
    """Three graph layers and a three-layer MLP with softmax (A.2). ValueError if the weights have other sizes.

    Args:
        config: Its shape.
        weights: Of a checkpoint.
    """

    def __init__(self, config: PredictorConfig, weights: Weights):
        self.config = config
        widths = (6, *config.levels)
        self._layers = [
            _GraphLayer(*pair, config.heads, config.depth, weights.part(f"layers.{index}"))
            for index, pair in enumerate(zip(widths, widths[1:], strict=False))
        ]
        length, (first, second) = sum(config.levels), config.hidden
        self._local = weights.linear("local", length + 6, first)
        self._overall = weights.linear("overall", length, first, bias=False)
        head = weights.perceptron("head.2 head.4", first, second, config.handles)
        self._head = weights.norm("head.0", first), gelu, head

    def __call__(self, graph: MeshGraph) -> HandlePrediction:
        """What it says of a mesh."""
        logits, features = self.logits(graph)
        return HandlePrediction(softmax(logits), features)

    def logits(self, graph: MeshGraph) -> tuple[np.ndarray, np.ndarray]:
        """The weights before their softmax, shape (V, K), and the features."""
        x, levels, pooled = graph.inputs, [], []
        for layer in self._layers:
            x = layer(x, graph)
            half = x.shape[1] // 2
            pooled += [x[:, :half].max(axis=0), graph.areas @ x[:, half:]]
            levels.append(x)
        features = np.concatenate(pooled)
        hidden = self._local(np.concatenate([*levels, graph.inputs], axis=-1))
        hidden += self._overall(features[None])
        return through(self._head, hidden), features


def predictor_config(shape: dict[str, object]) -> PredictorConfig:
    """The config of a predictor of a character's handles. OptionError if a value is missing, unknown, or no size that a
    network has; ValueError if it is of other handles, or of meshes that have no room for them.

    Args:
        shape: As a checkpoint carries it.
    """
    config = config_of(PredictorConfig, shape)
    if config.handles != HANDLE_COUNT or config.mesh_vertices < LEAST_VERTICES or config.anchors < 1:
        raise ValueError(
            f"it is of {config.handles} handles on meshes of {config.mesh_vertices} vertices with {config.anchors} "
            f"anchors, not of {HANDLE_COUNT} on {LEAST_VERTICES} or more"
        )
    return config


def load_predictor(path: str | Path) -> HandlePredictor:
    """Read a checkpoint of kind "handles", ready to predict. WeightsError if the file is missing, damaged, of another
    kind, or its weights do not fit its config.
    """
    return load_network(
        path, "handles", lambda shape, weights: HandlePredictor(predictor_config(shape), weights), key="predictor"
    )


TOKEN = 10
"""Numbers a token has: mean position 3, mean normal 3, extent along each axis 3, share of the surface 1."""


@dataclass(frozen=True)
class OrientationConfig:
    """Shape of the network."""

    width: int = 64  # channels
    layers: int = 3  # transformer layers
    heads: int = 4  # attention heads
    anchors: int = 128  # tokens of a mesh, M
    temperature: float = 1.0  # of the softmax over the 24 scores, fitted on characters that training did not see


def shape_tokens(points: np.ndarray, normals: np.ndarray, areas: np.ndarray, anchors: int = 128) -> np.ndarray:
    """A surface as a few tokens: points spread over it, each with what is nearest to it.

    Args:
        points: Anywhere on the surface, any unit, shape (N, 3).
        normals: Their normals, shape (N, 3); shorter ones mean a bent surface.
        areas: Share of the surface that each stands for, any unit, shape (N,).
        anchors: How many tokens, M; fewer where there are fewer points.

    Returns:
        Mean position, mean normal, standard deviation along each axis and log of the share times M of each token, in
        units of the largest extent, the bounding box centred on 0, shape (M, 10), float32.
    """
    points = np.asarray(points, np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    points = (points - (low + high) / 2) / max(float((high - low).max()), 1e-300)
    chosen = points[farthest_points(points, min(anchors, len(points)))]
    squared = ((points[:, None, 0] - chosen[:, 0]) ** 2 + (points[:, None, 1] - chosen[:, 1]) ** 2) + (
        points[:, None, 2] - chosen[:, 2]
    ) ** 2
    owner = squared.argmin(axis=1)
    share = np.maximum(np.asarray(areas, np.float64), 0)
    share = share + 1e-3 * max(float(share.mean()), 1e-300)
    share = share / share.sum()
    mass = np.bincount(owner, share, len(chosen))
    safe = np.maximum(mass, 1e-12)[:, None]

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(owner, share * column, len(chosen)) for column in values.T], axis=1) / safe

    middle = mean(points)
    spread = np.sqrt(np.maximum(mean(points**2) - middle**2, 0))
    weight = np.log(np.maximum(mass * len(chosen), 1e-3))[:, None]
    return np.concatenate([middle, mean(np.asarray(normals, np.float64)), spread, weight], axis=1).astype(np.float32)


def turned_tokens(tokens: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Tokens of meshes turned by each of some rotations by right angles, shapes (..., M, 10), (R, 3, 3) -> (..., R, M,
    10).
    """
    parts, back = tokens[..., None, :, :], rotations.swapaxes(-1, -2)
    shares = np.broadcast_to(parts[..., 9:], (*tokens.shape[:-2], len(rotations), tokens.shape[-2], 1))
    return np.concatenate([parts[..., :3] @ back, parts[..., 3:6] @ back, parts[..., 6:9] @ np.abs(back), shares], -1)


class OrientationPredictor:
    """A transformer over the tokens of a mesh, and one number at its end: how upright and forward the mesh stands.
    ValueError if the weights have other sizes.

    Args:
        config: Its shape.
        weights: Of a checkpoint.
    """

    def __init__(self, config: OrientationConfig, weights: Weights):
        self.config = config
        width = config.width
        names = "attention merge norm mix.1 mix.3 mix.0"
        layers = weights.pre_norms("layers", config.layers, names, width, config.heads, 2 * width)
        self.layers = [
            weights.perceptron("enter.0 enter.2", TOKEN, width, width), *layers, weights.norm("norm", width),
            mean_and_most, weights.perceptron("head.0 head.2", 2 * width, width, 1),
        ]  # fmt: skip
        self._rotations = right_angle_rotations().astype(np.float32)

    def probabilities(self, tokens: np.ndarray) -> np.ndarray:
        """How likely each of `geometry.axes.ORIENTATIONS` is the right one, from the mesh and its mirror image, shape
        (M, 10) -> (24,), float64.
        """
        mirror = np.array([-1, 1, 1, -1, 1, 1, 1, 1, 1, 1], np.float32)
        turned = turned_tokens(tokens, self._rotations)
        scores = through_parts(self.layers, (*np.split(turned, 4), *np.split(turned * mirror, 4)))[:, 0]
        return softmax(scores.astype(np.float64).reshape(2, -1).mean(axis=0) / self.config.temperature)


def load_orientation_predictor(path: str | Path) -> OrientationPredictor:
    """Read a checkpoint of kind "orientation", ready to predict. WeightsError if the file is missing, damaged, of
    another kind, or its weights do not fit its config.
    """
    return load_network(
        path,
        "orientation",
        lambda shape, weights: OrientationPredictor(config_of(OrientationConfig, shape), weights),
        key="predictor",
    )
