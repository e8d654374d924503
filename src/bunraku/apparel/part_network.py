"""The part network: a mesh as points with neighbours, whatever its resolution and loose parts, and what the network
says of each point.

The network is a hierarchy of points (PointNet++, Qi et al. 2017) with a transformer over the coarsest. The first
`centres` of the config cover the surface evenly, and its first `tokens` cover it coarsely. Points gather from their
neighbours on the way up, and answers come back down by interpolation. Here it runs without torch.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges
from bunraku.core.nn.checkpoints import config_of, load_network
from bunraku.core.nn.layers import Norm, Weights, brought, gelu, through

PARTS = ("body", "hair", "skirt", "cape", "sleeve", "tail", "prop", "accessory", "ground")
"""Kinds of parts. A skirt is also a robe or the tails of a coat, a tail also an ear; ground is what a figure stands on
and what lies about it.
"""
CARRIERS = ("head", "chest", "pelvis", "left arm", "right arm", "left leg", "right leg")
"""What a part goes with."""
# Numbers of a point: its position as waves, the shape about it, and all that the shipped network was trained with.
WAVES = 3 + 2 * 9
SHAPE = 6
FEATURES = 3 + 3 + 4 + 7 + SHAPE


@dataclass(frozen=True)
class PartConfig:
    """Shape of the part network."""

    fine: int = 64  # channels of points
    middle: int = 112  # channels of centres
    coarse: int = 128  # channels of tokens
    layers: int = 4  # transformer layers over the tokens
    heads: int = 4  # of their attention
    # before, after: blocks over the centres before and after the transformer
    before: int = 2
    after: int = 2
    # points, centres, tokens: how many there are
    points: int = 4096
    centres: int = 1024
    tokens: int = 256
    gathered: int = 12  # points that a centre gathers from the level below
    beside: int = 8  # centres beside it that it looks at
    # what positions from a centre are multiplied by, from the finest level up
    scales: tuple[float, float, float] = (20.0, 12.0, 6.0)
    local: int = 24  # points whose spread says how flat the surface is and whether another side is near
    thick: float = 0.1  # over the largest extent: another side farther off is not looked for
    # points of a loose part go with its area to the power of one less this, so that small parts get some
    small_parts: float = 0.3


@dataclass(frozen=True, eq=False)
class Surface:
    """Points on a mesh."""

    points: np.ndarray  # in units of the largest extent, from the middle of the bounding box, shape (S, 3)
    normals: np.ndarray  # shape (S, 3)
    colors: np.ndarray | None  # sRGB from 0 to 1, shape (S, 3), or None
    part: np.ndarray  # loose part of each, shape (S,)
    shape: np.ndarray  # local shape (`_local_shape`), shape (S, SHAPE)


@dataclass(frozen=True, eq=False)
class PartPoints:
    """A mesh as the part network sees it."""

    surface: Surface  # its points
    vertex: np.ndarray  # the vertex of the mesh nearest to each point within its face, shape (S,)
    gather: np.ndarray  # for each centre, points near it, shape (centres, gathered)
    beside: np.ndarray  # for each centre, centres near it, shape (centres, beside)
    gather_up: np.ndarray  # for each token, centres near it, shape (tokens, gathered)
    down: np.ndarray  # for each centre, the nearest tokens, shape (centres, 3), and their shares
    down_shares: np.ndarray  # as said
    fine: np.ndarray  # for each point, the nearest centres, shape (points, 3), and their shares
    fine_shares: np.ndarray  # as said


def loose_parts(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Number of the loose part that each face is of, shape (F,), by a mesh whose seams are closed. CharacterError if
    the mesh is broken.
    """
    clean = clean_mesh(vertices, faces)
    piece = mesh_parts(unique_edges(clean.faces, len(clean.vertices)), len(clean.vertices))
    return np.asarray(piece[clean.index[np.asarray(faces)[:, 0]]], np.int64)


def part_points(
    vertices: np.ndarray, faces: np.ndarray, own: np.ndarray, colors: np.ndarray | None = None, seed: int = 0,
    how: PartConfig | None = None,
) -> PartPoints:  # fmt: skip
    """Sample a mesh by area.

    Args:
        vertices: Rest mesh [m], +Y up, shape (V, 3).
        faces: Shape (F, 3).
        own: Loose part of each face (`loose_parts`), shape (F,).
        colors: sRGB from 0 to 1 of each vertex, shape (V, 3), or None.
        seed: Of what is taken.
        how: How many points, and how they lie; of a new network when None.
    """
    how = how or PartConfig()
    rng = np.random.default_rng(seed)
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    whole = np.bincount(own, area)
    chance = area * np.maximum(whole, 1e-12 * whole.sum())[own] ** -how.small_parts
    chosen = np.searchsorted(np.cumsum(chance), rng.random(how.points) * chance.sum()).clip(0, len(faces) - 1)
    r, s = np.sqrt(rng.random(how.points)), rng.random(how.points)
    shares = np.stack([1 - r, r * (1 - s), r * s], axis=1)
    points = np.einsum("pc,pcx->px", shares, vertices[faces[chosen]])
    normals = cross[chosen] / np.maximum(area[chosen], 1e-30)[:, None]
    used = vertices[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    points = (points - 0.5 * (low + high)) / max(float((high - low).max()), 1e-12)
    order = _spread_order(points, how.centres, int(rng.integers(how.points)))
    points, normals, chosen, shares = points[order], normals[order], chosen[order], shares[order]
    tint = None if colors is None else np.einsum("pc,pcx->px", shares, np.asarray(colors, np.float64)[faces[chosen]])
    tree, centres = cKDTree(points), cKDTree(points[: how.centres])
    near = tree.query(points, how.local)[1]
    fine, fine_shares = _nearest(centres, points)
    down, down_shares = _nearest(cKDTree(points[: how.tokens]), points[: how.centres])
    return PartPoints(
        Surface(points, normals, tint, own[chosen], _local_shape(points, normals, near, how.thick)),
        faces[chosen, shares.argmax(axis=1)],
        near[: how.centres, : how.gathered],
        centres.query(points[: how.centres], how.beside)[1],
        centres.query(points[: how.tokens], how.gathered)[1],
        down,
        down_shares,
        fine,
        fine_shares,
    )


def point_features(surface: Surface) -> np.ndarray:
    """Input of the network, shape (S, FEATURES), float32: position, normal, colour and whether there is one, extent of
    the loose part, its share of the points, the position within it, and the local shape.
    """
    points, part = surface.points, surface.part
    order = np.argsort(part, kind="stable")
    _, starts, count = np.unique(part[order], return_index=True, return_counts=True)
    back = np.unique(part, return_inverse=True)[1]
    low, high = (step.reduceat(points[order], starts, axis=0)[back] for step in (np.minimum, np.maximum))
    color = np.zeros((len(points), 4))
    if surface.colors is not None:
        color[:, :3], color[:, 3] = 2 * surface.colors - 1, 1
    share = np.log10(count[back] / len(points))[:, None]
    return np.concatenate(
        [3 * points, surface.normals, color, 2 * (high - low), share, 2 * (points - low), surface.shape], axis=1
    ).astype(np.float32)


def _spread_order(points: np.ndarray, count: int, first: int) -> np.ndarray:
    """An order of points whose first `count` are each the farthest from those before it, shape (S,)."""
    x = np.ascontiguousarray(points.T, np.float32)
    chosen, gap, last = np.empty(count, np.int64), np.full(x.shape[1], np.inf, np.float32), first
    for number in range(count):
        chosen[number] = last
        away = x - x[:, last, None]
        np.minimum(gap, np.einsum("xp,xp->p", away, away), out=gap)
        last = int(gap.argmax())
    rest = np.ones(len(points), bool)
    rest[chosen] = False
    return np.concatenate([chosen, np.flatnonzero(rest)])


def _nearest(tree: cKDTree, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The three nearest points of a tree and their shares, by one over the distance, shape (P, 3) each."""
    gap, found = tree.query(points, 3)
    weight = 1 / (gap + 1e-3)
    return found, weight / weight.sum(axis=1, keepdims=True)


def _local_shape(points: np.ndarray, normals: np.ndarray, near: np.ndarray, thick: float) -> np.ndarray:
    """How points lie about each: as a line, a plane or all around; how alike their normals are; whether they lie before
    or behind it; how near another side of the surface is, of `thick`. Shape (S, SHAPE).
    """
    away = points[near] - points[:, None]
    spread = np.einsum("pkx,pky->pxy", away, away)
    high = np.maximum(np.linalg.eigvalsh(spread)[:, ::-1], 1e-12)
    flat = np.stack([1 - high[:, 1] / high[:, 0], (high[:, 1] - high[:, 2]) / high[:, 0]], axis=1)
    other = np.einsum("pkx,px->pk", normals[near], normals)
    ahead = np.einsum("pkx,px->pk", away, normals)
    size = np.sqrt(high[:, 0] / near.shape[1])
    length = np.linalg.norm(away, axis=2)
    side = np.where(other < -0.3, length, thick).min(axis=1).clip(max=thick) / thick
    return np.stack(
        [flat[:, 0], flat[:, 1], other.mean(axis=1), ahead.mean(axis=1) / size, side, 10 * size.clip(max=0.1)], axis=1
    )


class _Near:
    """The most of linear features of neighbours and of where they are from a centre."""

    def __init__(self, width: int, out: int, scale: float, weights: Weights):
        self._value = weights.linear("value", width, out)
        self._place = weights.linear("place", 3, out, bias=False)
        self._scale = np.float32(scale)

    def __call__(self, x: np.ndarray, points: np.ndarray, index: np.ndarray) -> np.ndarray:
        place = self._place(self._scale * points)
        value = self._value(x)
        value += place
        most = largest_of(value, index)
        most -= place[: len(index)]
        return gelu(most)


class _Gather:
    def __init__(self, width: int, out: int, scale: float, weights: Weights):
        self._near = _Near(width, out, scale, weights.part("near"))
        self._mix = weights.perceptron("mix leave", width + out, out, out)

    def __call__(self, x: np.ndarray, points: np.ndarray, index: np.ndarray) -> np.ndarray:
        near = self._near(x, points, index)
        return self._mix(np.concatenate([x[: len(index)], near], axis=1))


class _Beside:
    def __init__(self, width: int, scale: float, weights: Weights):
        self._norm: Norm = weights.norm("norm", width)
        self._near = _Near(width, width, scale, weights.part("near"))
        self._mix = weights.perceptron("mix leave", 2 * width, width, width)

    def __call__(self, x: np.ndarray, points: np.ndarray, index: np.ndarray) -> np.ndarray:
        own = self._norm(x)
        near = self._near(own, points, index)
        out: np.ndarray = x + self._mix(np.concatenate([own, near], axis=1))
        return out


class PartNetwork:
    """The network. ValueError if the weights have other sizes.

    Args:
        config: Its shape.
        weights: Of a checkpoint.
    """

    def __init__(self, config: PartConfig, weights: Weights):
        self.config = config
        fine, middle, coarse = config.fine, config.middle, config.coarse
        self._enter = weights.perceptron("enter.0 enter.2", FEATURES, fine, fine)
        self._piece = weights.linear("piece", 2 * fine, fine)
        self._to_centres = _Gather(fine, middle, config.scales[0], weights.part("to_centres"))
        self._before = [
            _Beside(middle, config.scales[1], weights.part(f"before.{number}")) for number in range(config.before)
        ]
        self._to_tokens = _Gather(middle, coarse, config.scales[2], weights.part("to_tokens"))
        self._where = weights.linear("where", WAVES, coarse)
        names = "enter leave norm_a wide narrow norm_b"
        layers = weights.pre_norms("layers", config.layers, names, coarse, config.heads, 3 * coarse)
        self._layers = [weights.norm("norm_tokens", coarse), *layers, weights.norm("norm", coarse)]
        self._down = weights.linear("down", middle + coarse, middle)
        self._after = [
            _Beside(middle, config.scales[1], weights.part(f"after.{number}")) for number in range(config.after)
        ]
        self._last = weights.linear("last", fine + middle, middle)
        self._whole = weights.linear("whole", 2 * middle, middle)
        out = len(PARTS) + 1 + len(CARRIERS)
        self._decoder = weights.norm("decoder.0", middle), weights.linear("decoder.1", middle, out)

    def scores(self, seen: PartPoints) -> np.ndarray:
        """[MMDMC 2] Scores of the parts, of hanging and of the carriers, shape (S, parts + 1 + carriers)."""
        points = seen.surface.points.astype(np.float32)
        piece = np.unique(seen.surface.part, return_inverse=True)[1]
        return self.answer(point_features(seen.surface), points, piece, seen)

    def answer(
        self, features: np.ndarray, points: np.ndarray, piece: np.ndarray, near: PartPoints,
        chosen: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Scores from what the network reads. Several meshes may be one block: all their tokens first, then their other
        centres, then their other points.

        Args:
            features: As of `point_features`.
            points: Shape (S, 3).
            piece: Loose part of each, shape (S,).
            near: Neighbours and shares.
            chosen: Points that are asked for, which `fine` is of; all where None.
        """
        centres, beside = points[: len(near.gather)], near.beside[:, : self.config.beside]
        x = self._enter(features)
        x += gelu(self._piece(np.concatenate([x, piece_mean(gelu(x.copy()), piece)], axis=1)))
        y = self._to_centres(x, points, near.gather[:, : self.config.gathered])
        for block in self._before:
            y = block(y, centres, beside)
        z = self._to_tokens(y, centres, near.gather_up[:, : self.config.gathered])
        z = z + self._where(waves(points[: len(near.gather_up)]))
        z = through(self._layers, z.reshape(-1, self.config.tokens, self.config.coarse)).reshape(-1, self.config.coarse)
        z = blended(z, near.down, near.down_shares)
        y += self._down(np.concatenate([y, z], axis=1))
        for block in self._after:
            y = block(y, centres, beside)
        y = blended(y, near.fine, near.fine_shares)
        if chosen is not None:
            x, piece = x[chosen], piece[chosen]
        y = gelu(self._last(np.concatenate([x, y], axis=1)))
        y += gelu(self._whole(np.concatenate([y, piece_mean(y, piece)], axis=1)))
        return through(self._decoder, y)


def waves(points: np.ndarray) -> np.ndarray:
    """Positions as the tokens know them: as they are, and as sines and cosines, shape (M, 3) -> (M, WAVES)."""
    turns = np.concatenate([factor * points for factor in np.array([3, 6, 12], np.float32)], axis=1)
    return np.concatenate([2 * points, np.sin(turns), np.cos(turns)], axis=1)


def largest_of(values: np.ndarray, index: np.ndarray) -> np.ndarray:
    """The largest value of each channel among some rows, (N, C) and (M, K) -> (M, C)."""
    if not isinstance(values, np.ndarray):
        return brought(largest_of, values, index)
    most: np.ndarray = values.take(index[:, 0], axis=0)  # half the time of `values[...]`
    for column in range(1, index.shape[1]):
        np.maximum(most, values.take(index[:, column], axis=0), out=most)
    return most


def piece_mean(x: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """The mean of each channel over the loose part of each row, shape (N, C)."""
    if not isinstance(x, np.ndarray):
        return brought(piece_mean, x, piece)
    order = np.argsort(piece, kind="stable")
    starts = np.flatnonzero(np.diff(piece[order], prepend=-1))
    count = np.diff(starts, append=len(piece))
    return np.asarray((np.add.reduceat(x[order], starts, axis=0) / count[:, None].astype(np.float32))[piece])


def blended(x: np.ndarray, index: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Sums of three rows by shares, (N, C), (M, 3) and (M, 3) -> (M, C)."""
    if not isinstance(x, np.ndarray):
        return brought(blended, x, index, shares)
    shares = shares.astype(np.float32)
    out: np.ndarray = x.take(index[:, 0], axis=0) * shares[:, :1]
    for column in (1, 2):
        out += x.take(index[:, column], axis=0) * shares[:, column : column + 1]
    return out


def load_parts(path: str | Path) -> PartNetwork:
    """Read a checkpoint of kind "parts", ready to use. WeightsError if the file is missing, damaged, of another kind,
    or its weights do not fit its config.
    """
    return load_network(path, "parts", lambda shape, weights: PartNetwork(config_of(PartConfig, shape), weights))
