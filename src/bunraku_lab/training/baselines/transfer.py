"""Training of Skeleton-free Pose Transfer: how the parts of a target move with those of a posed source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from bunraku.errors import OptionError
from bunraku_lab.baselines.pose_transfer import graph_of, part_transforms
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.nn.blend_shapes import moved_by
from bunraku_lab.nn.pose_transfer import PartGraph, TransferConfig, TransferNetwork, affine_of, part_centres
from bunraku_lab.training.baselines.banks import (
    BankPlan,
    Pair,
    Target,
    build_clothed_bank,
    build_posed_bank,
    clothed_targets,
    drawn_pairs,
)
from bunraku_lab.training.losses.handles import skinning_loss, skinning_pairs
from bunraku_lab.training.runs.run import AveragedRun, Progress, Report, StepSettings

__all__ = [
    "PRESETS", "TransferTrainConfig", "TransferTrainer", "chamfer_loss", "far_points", "train_transfer",
    "transform_loss", "weight_divergence",
]  # fmt: skip

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


def far_points(points: Tensor, count: int) -> Tensor:
    """Rows of farthest-point samples, shape (count,), of which the first is the farthest from the mean.

    Args:
        points: Shape (M, 3).
        count: At most M are taken.
    """
    away = (points - points.mean(0)).square().sum(1)
    chosen: list[Tensor] = []
    gap = torch.full_like(away, torch.inf)
    for _ in range(min(count, len(points))):
        row = away.argmax() if not chosen else gap.argmax()
        chosen.append(row)
        gap = torch.minimum(gap, (points - points[row]).square().sum(1))
    return torch.stack(chosen)


def chamfer_loss(centres: Tensor, points: Tensor) -> Tensor:
    """The Chamfer distance of centres and points: mean squared distance to the nearest of the other set, both ways.

    Args:
        centres: Shape (K, 3).
        points: Shape (P, 3).
    """
    squares = (centres[:, None] - points[None]).square().sum(-1)
    return squares.amin(1).mean() + squares.amin(0).mean()


def weight_divergence(logits: Tensor, other: Tensor) -> Tensor:
    """Mean Kullback-Leibler divergence of two predictions for the same vertices, the second being held.

    Args:
        logits: Of the first before the softmax, shape (M, K).
        other: Of the second, shape (M, K).
    """
    log, held = logits.log_softmax(-1), other.detach().log_softmax(-1)
    return (held.exp() * (held - log)).sum(-1).mean()


TURN = 0.35
"""Most that a copy is turned about +Y, whose parts should be the same [rad]."""
PAIRS = 2000
APART = float("inf")


@dataclass(frozen=True, kw_only=True)
class TransferTrainConfig(StepSettings):
    """Settings of `bunraku train transfer-baseline`.

    Args:
        preset: "sfpt" is the paper's recipe, for a GPU; "sfpt-small" has the parts of the Mesh Handle Predictor, small
            meshes and no cycle; "spt" and "spt-joints" are of MMDMC's data set, the second with parts that are tied to
            the given joints and ten free ones.
        data: Folder that `bunraku data motions` wrote.
        characters: Folder of rigged characters.
        apparel: Folder that `bunraku data apparel` wrote, of "spt" and "spt-joints".
        meshes: Folder that keeps characters as meshes of network size.
        wardrobe: Characters of the wardrobe beside the rigged ones.
        most: Characters of MMDMC's data set.
        poses: Of each character.
        vertices: Of a mesh, about.
        transforms: Weight of the parts' transforms.
        edges: Weight of the squared change of the edges' lengths.
        alone: Share of the run in which parts that are predicted learn alone, moved by their joints' and their own true
            transforms: many poses of a mesh for one look at it.
        several: Poses of each mesh meanwhile.
        cycle: Share of the run after which pairs go through a third character and back; 1 for never.
        through: Weight of the third character's own loss.
        chamfer: Weight of the parts' centres, where parts are predicted.
        skinning: Weight of Eq. 13 of TapMo, where parts are predicted.
        alike: Weight of the parts of turned copies, where parts are predicted.
        device: Where to train.
        network: Its shape.
    """

    preset: Literal["sfpt-small", "sfpt", "spt", "spt-joints"] = "sfpt-small"
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
    alone: float = 0.0
    several: int = 16
    cycle: float = 1.0
    through: float = 0.3
    chamfer: float = 1.0
    skinning: float = 0.03
    alike: float = 1.0
    validate_every: int = 500
    device: str = "cpu"
    network: TransferConfig = field(default_factory=TransferConfig)

    def resolved(self) -> TransferTrainConfig:
        """The settings with what the preset says."""
        return replace(self, **PRESETS[self.preset])  # type: ignore[arg-type]


# "sfpt" has the rate and the batch of the published code of the method.
PRESETS: dict[str, dict[str, object]] = {
    "sfpt-small": {},
    "sfpt": {
        "vertices": 2500, "batch": 4, "rate": 1e-4, "cycle": 0.5,
        "network": TransferConfig(parts=40, predictor=True, correction=False),
    },
    "spt": {},
    "spt-joints": {"alone": 0.5, "network": TransferConfig(parts=32, predictor=True, tied=22)},
}  # fmt: skip


class TransferTrainer(AveragedRun[TransferNetwork]):
    """One run in memory."""

    kind = "transfer"

    def __init__(self, config: TransferTrainConfig, characters: Sequence[Target], held_out: Sequence[Target] = ()):
        if not characters:
            raise OptionError("there are no characters to train on; give more of them")
        self.config, self.characters, self.held_out = config, list(characters), list(held_out)
        self.generator = torch.Generator().manual_seed(config.seed)
        self.set_up(lambda: TransferNetwork(config.network).to(config.device))

    def update(self, decay: float) -> None:
        """See `AveragedRun.update`; the means and variances of the norms are the network's own."""
        super().update(decay)
        for own, other in zip(self.average.buffers(), self.model.buffers(), strict=True):
            own.copy_(other)

    def _put(self, values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.asarray(values, np.float32)).to(self.config.device)

    def _weights(self, model: TransferNetwork, graph: PartGraph, known: Sequence[np.ndarray]) -> torch.Tensor:
        return model.weights(graph) if model.config.predictor else self._put(np.concatenate(known))

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
        source_weights = self._weights(model, rest, [pair.source.weights for pair in sources])
        weights = self._weights(model, target, [pair.target.mesh.weights for pair in pairs])
        parts = [own.detach().cpu().numpy() for own in source_weights.split(list(rest.sizes))]
        parts = parts if not same else parts * len(poses)
        own = self._put(
            np.stack([part_transforms(pair.source.rest, pair.posed[None], part)[0] for pair, part in zip(poses, parts,
            strict=True)])
        )  # fmt: skip
        transforms = model(rest, posed, target, (source_weights, weights), own)
        each = list(weights.split(list(target.sizes)))
        return [
            self._driven(model, pair, own_weights, said)
            for pair, own_weights, said in zip(pairs, each, transforms.expand(len(pairs), -1, -1), strict=True)
        ], each, transforms.expand(len(pairs), -1, -1)  # fmt: skip

    def _driven(
        self, model: TransferNetwork, pair: Pair, weights: torch.Tensor, transforms: torch.Tensor
    ) -> torch.Tensor:
        points = self._put(pair.target.mesh.rest)
        affine = affine_of(part_centres(points, weights), transforms)
        if model.config.tied:
            assert pair.target.affine is not None
            joints = self._put(pair.target.affine[pair.pose, : model.config.tied])
            affine = torch.cat([joints, affine[model.config.tied :]])
        return moved_by(points, weights, affine[None])[0]

    def step_loss(self) -> tuple[torch.Tensor, dict[str, float]]:
        """The weighted losses of some pairs, mean over them [% of the height for vertices]."""
        config, model = self.config, self.model
        if self.progress() < config.alone:
            return self._alone_loss(), {}
        pairs = drawn_pairs(self.characters, config.batch, self.rng)
        moved, weights, transforms = self.moved(model, pairs)
        total = torch.zeros((), device=config.device)
        for pair, own, part, said in zip(pairs, moved, weights, transforms, strict=True):
            total = total + self._pair_loss(pair, own, part, said)
        total = total / len(pairs)
        if self.progress() >= config.cycle:
            total = total + self._cycle_loss(pairs[0])
        return total, {}

    def _pair_loss(
        self, pair: Pair, moved: torch.Tensor, weights: torch.Tensor, transforms: torch.Tensor
    ) -> torch.Tensor:
        config, tied = self.config, self.config.network.tied
        truth, points = self._put(pair.truth), self._put(pair.target.mesh.rest)
        loss = (moved - truth).abs().sum(1).mean()
        loss = loss + config.edges * _stretch(moved, points, pair.target.mesh.edges)
        known = part_transforms(pair.target.mesh.rest, pair.truth[None], weights.detach().cpu().numpy())
        true = self._put(known[0])
        if tied < len(true):
            loss = loss + config.transforms * transform_loss(transforms[tied:], true[tied:])
        if config.network.predictor:
            loss = loss + self._part_loss(pair.target, points, weights, true[None], truth[None])
        return 100 * loss

    def _part_loss(
        self, target: Target, points: torch.Tensor, weights: torch.Tensor, true: torch.Tensor, truth: torch.Tensor
    ) -> torch.Tensor:
        """The predictor's losses: true transforms, centres all over the mesh, Eq. 13 of TapMo, and rotated copies."""
        config, model = self.config, self.model
        assert model.predictor is not None
        centres = part_centres(points, weights)
        loss = torch.zeros((), device=config.device)
        if not config.network.tied:
            moved = moved_by(points, weights, affine_of(centres, true))
            loss = loss + (moved - truth).abs().sum(2).mean()
            far = far_points(points, 4 * config.network.parts)
            loss = loss + config.chamfer * chamfer_loss(centres, points[far])
        i, j, gamma = skinning_pairs(torch.from_numpy(target.skinning), PAIRS, self.generator)
        logits = weights.clamp(min=1e-9).log()
        loss = loss + config.skinning * skinning_loss(
            logits, i.to(points.device), j.to(points.device), gamma.to(points.device)
        )
        angle = float(self.rng.uniform(-TURN, TURN))
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        copy = graph_of([target.mesh], [target.mesh.rest @ turn.T.astype(np.float32)]).to(config.device)
        return loss + config.alike * weight_divergence(model.predictor(copy), logits)

    def _alone_loss(self) -> torch.Tensor:
        """The weighted losses of some characters' parts without a transfer, mean over them [% of the height]."""
        config, model, total = self.config, self.model, torch.zeros((), device=self.config.device)
        targets = [self.characters[number] for number in self.rng.integers(len(self.characters), size=config.batch)]
        seen = model.weights(graph_of([one.mesh for one in targets]).to(config.device))
        for target, weights in zip(targets, seen.split([len(one.mesh.rest) for one in targets]), strict=True):
            poses = self.rng.permutation(len(target.truth))[: config.several]
            points, truth = self._put(target.mesh.rest), self._put(target.truth[poses])
            known = part_transforms(target.mesh.rest, target.truth[poses], weights.detach().cpu().numpy())
            true, tied = self._put(known), config.network.tied
            loss = self._part_loss(target, points, weights, true, truth)
            if tied:
                assert target.affine is not None
                own = affine_of(part_centres(points, weights), true)[:, tied:]
                affine = torch.cat([self._put(target.affine[poses, :tied]), own], dim=1)
                moved = moved_by(points, weights, affine)
                loss = loss + (moved - truth).abs().sum(2).mean()
                stretches = [_stretch(one, points, target.mesh.edges) for one in moved]
                loss = loss + config.edges * torch.stack(stretches).mean()
            total = total + 100 * loss
        return total / len(targets)

    def _cycle_loss(self, pair: Pair) -> torch.Tensor:
        """From the source to a third character and back: where the source and the third character are."""
        config, model = self.config, self.model
        third = self.characters[int(self.rng.integers(len(self.characters)))]
        back = Target("source", pair.source, pair.source_skinning, pair.posed[None])
        (there,), (weights,), _ = self.moved(model, [replace(pair, target=third)])
        own = part_transforms(pair.source.rest, pair.posed[None], self._parts_of(model, pair))[0]
        points = self._put(third.mesh.rest)
        plain = moved_by(points, weights, affine_of(part_centres(points, weights), self._put(own))[None])[0]
        near = (there - plain.detach()).abs().sum(1).mean()
        again = Pair(third.mesh, third.skinning, there.detach().cpu().numpy(), back, 0)
        (home,), *_ = self.moved(model, [again])
        return 100 * ((home - self._put(pair.posed)).abs().sum(1).mean() + config.through * near)

    def _parts_of(self, model: TransferNetwork, pair: Pair) -> np.ndarray:
        with torch.no_grad():
            return self._weights(model, graph_of([pair.source]).to(self.config.device), [pair.source.weights]).cpu(
            ).numpy()  # fmt: skip

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
                own = self._put(part_transforms(pair.source.rest, pair.posed[None], self._parts_of(self.average, pair)))
                floor = self._driven(self.average, pair, weights, own[0])
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
    config = config.resolved()
    config.prepare()
    folder = config.meshes or config.out.with_name(f"{config.out.name}-meshes")
    show_progress = None if progress is None else (lambda done: progress("meshes", done))
    if config.preset in ("spt", "spt-joints"):
        found = {}
        for split, most in (("val", 12), ("train", config.most)):
            data = ApparelData(config.apparel, split)  # type: ignore[arg-type]
            samples = build_clothed_bank(data, folder / split, config.vertices, progress=show_progress, most=most)
            found[split] = clothed_targets(samples, config.network.predictor)
    else:
        plan = BankPlan(config.data, config.characters, config.wardrobe, config.poses, config.vertices, config.seed)
        found = build_posed_bank(plan, folder, show_progress)
    return TransferTrainer(config, found["train"], found["val"]).learn(report, progress)
