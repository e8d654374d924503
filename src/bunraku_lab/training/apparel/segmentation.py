"""Training of the segmentation network (section 4.1 of MMDMC), on characters in other makes: welded parts, other
widths, fewer points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from bunraku.apparel.learned.segmentation import SegmentationConfig, point_features
from bunraku.apparel.nodes import part_neighbours
from bunraku.errors import OptionError
from bunraku_lab.nn.apparel import SegmentationNetwork, mesh_block
from bunraku_lab.training.apparel.mesh_bank import MeshSample, build_meshes
from bunraku_lab.training.losses.motion import mask_loss
from bunraku_lab.training.runs.run import AveragedRun, Progress, Report, StepSettings

__all__ = ["SegmentationTrainConfig", "SegmentationTrainer", "mask_iou", "train_segmentation", "varied", "welded_parts"]


TOUCHING = 0.03  # over the height: points of two parts as near may be welded
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
    near = cKDTree(points).query_pairs(TOUCHING, output_type="ndarray")
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
    """A variation of a character, for the segmentation network: its weights and geodesic distances are not changed.

    Args:
        sample: The character.
        random: Of what is changed.
    """
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
    """One run in memory.

    Args:
        config: Settings.
        characters: To learn from.
        held_out: To validate on.
    """

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
        told = (truth > 0) & own.isfinite().all(dim=1)
        if bool(told.any()):
            loss = loss + config.stiffness * (scores[:, 1:] - own)[told].abs().mean()
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

    Args:
        config: Settings.
        report: Called at each validation with its figures (the row of log.csv).
        progress: Called with a stage's name and the share done.

    Returns:
        The checkpoint.

    Raises:
        BunrakuError: The folder cannot be written.
    """
    config.prepare()
    meshes = build_meshes(config.out.with_name(f"{config.out.name}-meshes"), config.characters)
    return SegmentationTrainer(config, meshes["train"], meshes["val"]).learn(report, progress)
