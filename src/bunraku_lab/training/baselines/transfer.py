"""Training of Skeleton-free Pose Transfer: how the parts of a target move with those of a posed source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from bunraku.errors import OptionError
from bunraku_lab.baselines.pose_transfer import graph_of, part_transforms
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.nn.blend_shapes import moved_by
from bunraku_lab.nn.pose_transfer import TransferConfig, TransferNetwork, affine_of, part_centres
from bunraku_lab.training.baselines.banks import (
    BankPlan,
    Pair,
    Target,
    build_clothed_bank,
    build_posed_bank,
    clothed_target,
    drawn_pairs,
)
from bunraku_lab.training.runs.run import AveragedRun, Progress, Report, StepSettings

QUATERNION = 0.5
"""Weight of quaternions against translations. As in the published code of the method."""


def transform_loss(transforms: Tensor, truth: Tensor) -> Tensor:
    """L1 of translations and half the L1 of quaternions, whose sign says nothing, mean over the parts.

    Args:
        transforms: Translation and unit quaternion of each part, shape (..., K, 7).
        truth: The same of the truth, shape (..., K, 7).
    """
    shift = (transforms[..., :3] - truth[..., :3]).abs().sum(-1)
    own, true = transforms[..., 3:], truth[..., 3:]
    turn = torch.minimum((own - true).abs().sum(-1), (own + true).abs().sum(-1))
    return (shift + QUATERNION * turn).mean()


@dataclass(frozen=True, kw_only=True)
class TransferTrainConfig(StepSettings):
    """Settings of `bunraku train transfer-baseline`.

    Args:
        preset: "sfpt" learns from people's motions on rigged characters, "spt" from MMDMC's data set.
        data: Folder that `bunraku data motions` wrote.
        characters: Folder of rigged characters.
        apparel: Folder that `bunraku data apparel` wrote, of "spt".
        meshes: Folder that keeps characters as meshes of network size.
        wardrobe: Characters of the wardrobe beside the rigged ones.
        most: Characters of MMDMC's data set.
        poses: Of each character.
        vertices: Of a mesh, about.
        transforms: Weight of the parts' transforms.
        edges: Weight of the squared change of the edges' lengths.
        device: Where to train.
        network: Its shape.
    """

    preset: Literal["sfpt", "spt"] = "sfpt"
    data: Path = Path("data/motions")
    characters: Path = Path("data/characters")
    apparel: Path = Path("data/apparel")
    out: Path = Path("runs/transfer-baseline")
    meshes: Path | None = None
    wardrobe: int = 40
    most: int = 200
    poses: int = 96
    vertices: int = 1000
    batch: int = 2
    rate: float = 1e-3
    transforms: float = 1.0
    edges: float = 100.0
    validate_every: int = 500
    device: str = "cpu"
    network: TransferConfig = field(default_factory=TransferConfig)


class TransferTrainer(AveragedRun[TransferNetwork]):
    """One run in memory."""

    kind = "transfer"

    def __init__(self, config: TransferTrainConfig, characters: Sequence[Target], held_out: Sequence[Target] = ()):
        if not characters:
            raise OptionError("there are no characters to train on; give more of them")
        self.config, self.characters, self.held_out = config, list(characters), list(held_out)
        self.set_up(lambda: TransferNetwork(config.network).to(config.device))

    def update(self, decay: float) -> None:
        """See `AveragedRun.update`; the means and variances of the norms are the network's own."""
        super().update(decay)
        for own, other in zip(self.average.buffers(), self.model.buffers(), strict=True):
            own.copy_(other)

    def _put(self, values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.asarray(values, np.float32)).to(self.config.device)

    def moved(
        self, model: TransferNetwork, pairs: Sequence[Pair]
    ) -> tuple[list[torch.Tensor], list[torch.Tensor], torch.Tensor]:
        """The targets' vertices (M, 3), the weights of their parts (M, K), and the parts' transforms (B, K, 7)."""
        same = all(pair.source is pairs[0].source for pair in pairs)
        once = same and all(pair.posed is pairs[0].posed for pair in pairs)
        sources = pairs[:1] if same else pairs
        poses = pairs[:1] if once else pairs
        rest = graph_of([pair.source for pair in sources]).to(self.config.device)
        posed = graph_of([pair.source for pair in poses], [pair.posed for pair in poses]).to(self.config.device)
        target = graph_of([pair.target.mesh for pair in pairs]).to(self.config.device)
        source_weights = self._put(np.concatenate([pair.source.weights for pair in sources]))
        weights = self._put(np.concatenate([pair.target.mesh.weights for pair in pairs]))
        own = self._put(np.stack([part_transforms(p.source.rest, p.posed[None], p.source.weights)[0] for p in poses]))
        transforms = model(rest, posed, target, (source_weights, weights), own)
        each = list(weights.split(list(target.sizes)))
        return [
            self._driven(pair, own_weights, said)
            for pair, own_weights, said in zip(pairs, each, transforms.expand(len(pairs), -1, -1), strict=True)
        ], each, transforms.expand(len(pairs), -1, -1)  # fmt: skip

    def _driven(self, pair: Pair, weights: torch.Tensor, transforms: torch.Tensor) -> torch.Tensor:
        points = self._put(pair.target.mesh.rest)
        return moved_by(points, weights, affine_of(part_centres(points, weights), transforms)[None])[0]

    def step_loss(self) -> tuple[torch.Tensor, dict[str, float]]:
        """The weighted losses of some pairs, mean over them [% of the height for vertices]."""
        pairs = drawn_pairs(self.characters, self.config.batch, self.rng)
        moved, weights, transforms = self.moved(self.model, pairs)
        losses = [self._pair_loss(*each) for each in zip(pairs, moved, weights, transforms, strict=True)]
        return torch.stack(losses).mean(), {}

    def _pair_loss(
        self, pair: Pair, moved: torch.Tensor, weights: torch.Tensor, transforms: torch.Tensor
    ) -> torch.Tensor:
        truth, points = self._put(pair.truth), self._put(pair.target.mesh.rest)
        loss = (moved - truth).abs().sum(1).mean()
        loss = loss + self.config.edges * _stretch(moved, points, pair.target.mesh.edges)
        true = part_transforms(pair.target.mesh.rest, pair.truth[None], weights.detach().cpu().numpy())
        return 100 * (loss + self.config.transforms * transform_loss(transforms, self._put(true[0])))

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Mean distance from the truth on held-out characters [%], by the network and by the source's transforms."""
        random = np.random.default_rng(7)
        shapes = [one for one in self.characters if one.name.startswith("reference_average")]
        found = []
        for target in self.held_out:
            for _ in range(4):
                (pair,) = drawn_pairs([target], 1, random)
                if shapes and target.turns is None:
                    source = shapes[0]
                    pair = Pair(source.mesh, source.skinning, source.truth[pair.pose], target, pair.pose)
                (moved,), (weights,), _ = self.moved(self.average, [pair])
                own = self._put(part_transforms(pair.source.rest, pair.posed[None], pair.source.weights))
                floor = self._driven(pair, weights, own[0])
                truth = self._put(pair.truth)
                found.append([float((one - truth).norm(dim=1).mean()) for one in (moved, floor)])
        own, plain = 100 * np.mean(found, axis=0)
        return {"pmd": float(own), "pmd_floor": float(plain)}


def _stretch(moved: torch.Tensor, rest: torch.Tensor, edges: np.ndarray) -> torch.Tensor:
    """Mean squared change of the lengths of edges."""
    pairs = torch.from_numpy(edges).to(moved.device)
    now, before = (
        (points[pairs[:, 0]] - points[pairs[:, 1]]).square().sum(1).add(1e-12).sqrt() for points in (moved, rest)
    )
    return (now - before).square().mean()


def train_transfer(config: TransferTrainConfig, report: Report | None = None, progress: Progress | None = None) -> Path:
    """Train the pose transfer, or go on where the run in `config.out` stopped.

    Raises:
        BunrakuError: No data, or the folder cannot be written.
    """
    config.prepare()
    folder = config.meshes or config.out.with_name(f"{config.out.name}-meshes")
    show_progress = None if progress is None else (lambda done: progress("meshes", done))
    if config.preset == "spt":
        found = {}
        for split, most in (("val", 12), ("train", config.most)):
            data = ApparelData(config.apparel, split)  # type: ignore[arg-type]
            samples = build_clothed_bank(data, folder / split, config.vertices, progress=show_progress, most=most)
            found[split] = [clothed_target(one) for one in samples]
    else:
        plan = BankPlan(config.data, config.characters, config.wardrobe, config.poses, config.vertices, config.seed)
        found = build_posed_bank(plan, folder, show_progress)
    return TransferTrainer(config, found["train"], found["val"]).learn(report, progress)
