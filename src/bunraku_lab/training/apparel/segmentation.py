"""Training of the segmentation network (section 4.1 of MMDMC), and the meshes that it and the body network use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from bunraku.apparel.learned.segmentation import (
    SampledMesh,
    SegmentationConfig,
    point_features,
    sampled_mesh,
)
from bunraku.apparel.nodes import part_neighbours
from bunraku.apparel.physics.clothed_from_file import clothed_from_file
from bunraku.core.body.layout import JOINT_COUNT
from bunraku.core.character import Character
from bunraku.core.geometry.graph import bridge_edges, clean_mesh, mesh_parts, unique_edges
from bunraku.errors import OptionError
from bunraku_lab.datasets.apparel.plan import character_split
from bunraku_lab.nn.apparel import SegmentationNetwork, mesh_block
from bunraku_lab.training.losses.motion import mask_loss
from bunraku_lab.training.rows.banks import kept_arrays
from bunraku_lab.training.runs.run import AveragedRun, Progress, Report, StepSettings

# The shipped mask network was trained with this.
TOUCH = 0.03
"""How near vertices of loose parts are that lie on one another and may be welded, over the height."""
REACH = 5.0
"""How far from a joint it begins to be the surface, over the distance of the nearest vertex."""
_SIDES = np.array([side for side in np.ndindex(3, 3, 3) if side != (1, 1, 1)], np.float64) - 1
_SIDES /= np.linalg.norm(_SIDES, axis=1, keepdims=True)

_MESH = ("clean", "points", "joints", "features", "part", "neighbours")


@dataclass(frozen=True, eq=False)
class MeshSample:
    """A character of the wardrobe.

    Args:
        name: Its name.
        mesh: Its points.
        apparel: Which are apparel, shape (S,), bool.
        stiffness: Of apparel points (`part_stiffness`), shape (S,); NaN where it is unknown.
        damping: log10 of what a second leaves of their velocity, shape (S,).
        weights: True skinning weights, shape (S, 22).
        geodesics: G, shape (S, 22).
    """

    name: str
    mesh: SampledMesh
    apparel: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    weights: np.ndarray
    geodesics: np.ndarray


def mesh_sample(character: Character, name: str, seed: int = 0) -> MeshSample:
    """Sample a character whose file has physics.

    Raises:
        BunrakuError: It cannot be used.
    """
    clothed = clothed_from_file(character)
    mesh = sampled_mesh(clothed.rest, clothed.faces, clothed.joints, seed=seed)
    first = np.zeros(mesh.index.max() + 1, np.int64)
    first[mesh.index] = np.arange(len(mesh.index))
    cloth = np.zeros(len(first), bool)
    cloth[mesh.index[clothed.apparel]] = True
    part = np.full(len(first), -1)
    part[mesh.index[clothed.apparel]] = clothed.part[clothed.apparel]
    own = part[mesh.clean]
    stiffness = np.where(own >= 0, clothed.stiffness[own], 0)
    damping = np.where(own >= 0, np.log10(1 - np.clip(clothed.damping, 0, 0.999))[own], 0)
    return MeshSample(
        name, mesh, cloth[mesh.clean], stiffness.astype(np.float32), damping.astype(np.float32),
        clothed.weights[first[mesh.clean]].astype(np.float32),
        joint_distances(clothed.rest, clothed.faces, clothed.joints, mesh.clean),
    )  # fmt: skip


def build_meshes(
    folder: Path, count: int, first: int = 10_000, progress: Callable[[float], None] | None = None
) -> dict[str, list[MeshSample]]:
    """Samples of wardrobe characters by split, computed once.

    Args:
        folder: Where they are kept.
        count: How many characters.
        first: Seed of the first.

    Raises:
        FormatError: A file of the folder is damaged.
    """
    makers = {f"wardrobe_{seed:06d}": partial(_arrays, seed) for seed in range(first, first + count)}
    out: dict[str, list[MeshSample]] = {"train": [], "val": [], "test": []}
    empty = np.zeros(0, np.int64)
    for name, arrays in kept_arrays(folder, makers, progress):
        mesh = SampledMesh(**{key: arrays.pop(key) for key in _MESH}, index=empty, nearest=empty, shares=empty)
        out[character_split(name)].append(MeshSample(name, mesh, **arrays))
    return out


def _arrays(seed: int) -> dict[str, np.ndarray]:
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    sample = mesh_sample(wardrobe_character(seed), "", seed)
    arrays = {key: value for key, value in vars(sample).items() if key not in ("name", "mesh")}
    return {key: getattr(sample.mesh, key) for key in _MESH} | arrays


# The shipped mask network was trained with these.
WIDTH = 0.08  # of the logarithm of what widths are multiplied by
FEWEST = 0.5  # least share of the points that is kept
LEAST = 3  # points of a part that are kept


def welded_parts(
    points: np.ndarray, part: np.ndarray, share: float, random: np.random.Generator, body: bool = False,
    apparel: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Parts after some pairs that touch have become one, numbered from 0, shape (S,).

    Args:
        points: In units of the height, shape (S, 3).
        part: Loose part of each, shape (S,).
        share: Pairs that are welded, over the number of parts.
        random: Which.
        body: Whether the part with the most points may be welded too.
        apparel: Which points are apparel, where parts that have some are welded first, shape (S,).
    """
    numbers, own = np.unique(part, return_inverse=True)
    near = cKDTree(points).query_pairs(TOUCH, output_type="ndarray")
    pairs = np.sort(own[near], axis=1)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    if not body:
        pairs = pairs[(pairs != np.bincount(own).argmax()).all(axis=1)]
    pairs = np.stack(np.divmod(np.unique(pairs @ [len(numbers), 1]), len(numbers)), axis=1)
    pairs = random.permutation(pairs)
    if apparel is not None:
        dressed = np.bincount(own, apparel) > 0
        pairs = pairs[np.argsort(~dressed[pairs].all(axis=1), kind="stable")]
    root = np.arange(len(numbers))
    for one, other in pairs[: round(share * len(numbers))]:
        root[root == root[other]] = root[one]
    return np.asarray(np.unique(root[own], return_inverse=True)[1], np.int64)


def varied(sample: MeshSample, random: np.random.Generator) -> MeshSample:
    """A variation of a character, for the segmentation network: its weights and geodesic distances are not changed."""
    mesh = sample.mesh
    part = mesh.part
    if random.random() < 0.6:
        first = sample.apparel if random.random() < 0.7 else None
        part = welded_parts(mesh.points, part, 1.5 * random.random() ** 2, random, random.random() < 0.3, first)
    _, own, sizes = np.unique(part, return_inverse=True, return_counts=True)
    kept = random.random(len(part)) < random.uniform(FEWEST, 1, len(sizes))[own]
    rank = np.empty(len(part), np.int64)
    order = np.argsort(own, kind="stable")
    rank[order] = np.arange(len(part)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    rows = np.flatnonzero(kept | (rank < LEAST))
    width = np.exp(random.normal(0, WIDTH, 3) * [1, 0, 1])
    points, joints, part = mesh.points[rows] * width, mesh.joints * width, own[rows]
    normals = mesh.features[rows, 3:6] / width
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    other = replace(
        mesh, clean=mesh.clean[rows], points=points.astype(np.float32), joints=joints.astype(np.float32),
        features=point_features(points, normals, joints, part), part=part, neighbours=part_neighbours(points, part),
    )  # fmt: skip
    return MeshSample(
        sample.name, other, sample.apparel[rows], sample.stiffness[rows], sample.damping[rows], sample.weights[rows],
        sample.geodesics[rows],
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SegmentationTrainConfig(StepSettings):
    """Settings of `bunraku train apparel-mask`.

    Args:
        characters: How many characters of the wardrobe.
        overlap: Weight of 1 - (soft intersection over union) beside the cross entropy.
        stiffness: Weight of the error of stiffness and damping.
        varied: Share of the characters that are varied (`mesh_variation`).
        start: Checkpoint to begin with, whose shape counts.
        network: Its shape.
    """

    out: Path = Path("runs/apparel-mask")
    characters: int = 1500
    steps: int = 6000
    batch: int = 6
    overlap: float = 0.5
    stiffness: float = 0.05
    varied: float = 0.7
    start: Path | None = None
    weight_decay: float = 0.02
    network: SegmentationConfig = field(default_factory=SegmentationConfig)


class SegmentationTrainer(AveragedRun[SegmentationNetwork]):
    """One run in memory."""

    kind = "apparel-mask"

    def __init__(
        self, config: SegmentationTrainConfig, characters: Sequence[MeshSample], held_out: Sequence[MeshSample] = ()
    ):
        if not characters:
            raise OptionError("there are no characters to train on; ask for more with --characters")
        self.config, self.characters, self.held_out = config, list(characters), list(held_out)
        shape = config.network if config.start is None else SegmentationNetwork.load(config.start).config
        self.set_up(lambda: SegmentationNetwork(shape), self._units)

    def _units(self, model: SegmentationNetwork) -> None:
        if self.config.start is not None:
            model.load_state_dict(SegmentationNetwork.load(self.config.start).state_dict())
            return
        features = torch.from_numpy(np.concatenate([one.mesh.features for one in self.characters[:64]]))
        model.mean[:], model.std[:] = features.mean(dim=0), features.std(dim=0).clamp(min=1e-3)

    def step_loss(self) -> tuple[torch.Tensor, dict[str, float]]:
        """Cross entropy, overlap, and the error of stiffness and damping."""
        config = self.config
        chosen = [self.characters[number] for number in self.rng.integers(len(self.characters), size=config.batch)]
        chosen = [varied(one, self.rng) if self.rng.random() < config.varied else one for one in chosen]
        features, graph = mesh_block([one.mesh for one in chosen])
        noise = torch.from_numpy(self.rng.normal(0, 0.003, (len(features), 3)).astype(np.float32))
        features[:, :3] += noise
        if self.rng.random() < 0.5:  # the mirror image; distances to bones change sides but slightly
            features[:, [0, 3, 6]] *= -1
            features[:, 10:31] = features[:, 10:31][:, _MIRRORED_BONES]
        truth = torch.from_numpy(np.concatenate([one.apparel for one in chosen])).float()
        own = torch.from_numpy(np.concatenate([np.stack([one.stiffness, one.damping], 1) for one in chosen]))
        scores = self.model.scores(features, graph)
        loss = mask_loss(scores[:, 0], truth)
        likely = torch.sigmoid(scores[:, 0])
        both, any_ = (likely * truth).sum(), (likely + truth - likely * truth).sum()
        loss = loss + config.overlap * (1 - both / any_.clamp(min=1))
        known = (truth > 0) & own.isfinite().all(dim=1)
        if bool(known.any()):
            loss = loss + config.stiffness * (scores[:, 1:] - own)[known].abs().mean()
        return loss, {}

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Intersection over union on characters that were not learned from, and the error of log10 stiffness."""
        found, errors = [], []
        for one in self.held_out:
            scores = self.average.scores(*mesh_block([one.mesh])).numpy()
            found.append(mask_iou(scores[:, 0] > 0, one.apparel))
            if one.apparel.any():
                errors.append(float(np.abs(scores[:, 1] - one.stiffness)[one.apparel].mean()))
        return {
            "iou": float(np.mean(found)), "least_iou": float(np.min(found)), "stiffness": float(np.mean(errors)),
        }  # fmt: skip


def _mirrored_bones() -> list[int]:
    from bunraku.core.body.layout import JOINT_COUNT, JOINT_MIRROR

    return [JOINT_MIRROR[joint] - 1 for joint in range(1, JOINT_COUNT)]


_MIRRORED_BONES = _mirrored_bones()


def mask_iou(mask: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union of two masks, shape (N,) each; 1 where both are empty."""
    union = int((mask | truth).sum())
    return float((mask & truth).sum() / union) if union else 1.0


def train_segmentation(
    config: SegmentationTrainConfig, report: Report | None = None, progress: Progress | None = None
) -> Path:
    """Train the segmentation network, or go on where the run in `config.out` stopped.

    Raises:
        BunrakuError: The folder cannot be written.
    """
    config.prepare()
    meshes = build_meshes(config.out.with_name(f"{config.out.name}-meshes"), config.characters)
    return SegmentationTrainer(config, meshes["train"], meshes["val"]).learn(report, progress)


def joint_distances(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, clean_vertices: np.ndarray
) -> np.ndarray:
    """Geodesic distances G of section 4.2 from points to joints, over the height, shape (S, 22), float32.

    The paper lets each joint stand for the vertex nearest to it. Characters are layers of loose parts, so that this may
    be one of a belt or a tooth, and the way from there a long one; and even on a closed limb it is near to one side
    only. Ours begins in the joint itself, goes straight to the nearest vertices on all sides of it, and along the edges
    from there; loose parts are joined wherever they lie on one another, and at least where they are nearest, so that
    all distances are finite.

    Args:
        vertices: Rest mesh [m], shape (V, 3).
        faces: Shape (F, 3).
        joints: J [m], shape (22, 3).
        clean_vertices: The clean vertices that are asked for (`SampledMesh.clean`), shape (S,).
    """
    clean = clean_mesh(vertices, faces)
    count = len(clean.vertices)
    edges = unique_edges(clean.faces, count)
    part = mesh_parts(edges, count)
    height = max(float(np.ptp(clean.vertices[:, 1])), 1e-9)
    touching = _touching(clean.vertices, part, TOUCH * height)
    edges = np.unique(np.concatenate([edges, bridge_edges(clean.vertices, part), touching]), axis=0)
    lengths = np.linalg.norm(clean.vertices[edges[:, 0]] - clean.vertices[edges[:, 1]], axis=1) + 1e-9
    starts = _starts(clean.vertices, (np.asarray(joints) - clean.center) / clean.scale)
    rows = np.concatenate([edges[:, 0], edges[:, 1], count + starts[0]])
    columns = np.concatenate([edges[:, 1], edges[:, 0], starts[1]])
    ways = np.concatenate([lengths, lengths, starts[2] + 1e-9])  # out of a joint only: no way leads through one
    graph = coo_matrix((ways, (rows, columns)), shape=(count + JOINT_COUNT,) * 2).tocsr()
    found = dijkstra(graph, indices=count + np.arange(JOINT_COUNT))[:, clean_vertices].T
    return np.asarray(found / height, np.float32)


def _touching(vertices: np.ndarray, part: np.ndarray, most: float) -> np.ndarray:
    """Pairs of vertices of different loose parts that lie together, smaller one first, shape (T, 2)."""
    near = min(10, len(vertices))
    gap, other = (found.reshape(len(vertices), near) for found in cKDTree(vertices).query(vertices, near))
    own, rank = np.nonzero((part[other] != part[:, None]) & (gap < most))
    return np.sort(np.stack([own, other[own, rank]], axis=1), axis=1)


def _starts(vertices: np.ndarray, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nearest vertices on all sides of each joint, none much farther off than the nearest of all: numbers of joint
    and vertex, and the distance.
    """
    owners, ends, lengths = [], [], []
    for joint, index in enumerate(joints):
        offset = vertices - index
        gap = np.linalg.norm(offset, axis=1)
        near = np.flatnonzero(gap < REACH * gap.min() + 0.01)
        near = near[np.argsort(gap[near], kind="stable")]
        first = near[np.unique((offset[near] @ _SIDES.T).argmax(axis=1), return_index=True)[1]]
        owners.append(np.full(len(first), joint))
        ends.append(first)
        lengths.append(gap[first])
    return np.concatenate(owners), np.concatenate(ends), np.concatenate(lengths)
