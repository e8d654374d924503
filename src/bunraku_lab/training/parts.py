"""Training of the part network (`bunraku_lab.nn.parts`) on shards of labelled figures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch.nn import functional as F

from bunraku.apparel.part_network import CARRIERS, PARTS, PartConfig, Surface, point_features
from bunraku.errors import OptionError
from bunraku_lab.nn.parts import PartNetwork, point_batch
from bunraku_lab.training.parts_data import SOURCES, PartData
from bunraku_lab.training.runs.run import AveragedRun, StepSettings, logged_columns

_MIRRORED = [
    CARRIERS.index(name.replace("left", "#").replace("right", "left").replace("#", "right")) for name in CARRIERS
]


@dataclass(frozen=True, kw_only=True)
class PartTrainConfig(StepSettings):
    """Settings of the part network's training.

    Args:
        shards: Folder of the shards.
        refresh: Steps between looks for new shards.
        overlap: Weight of 1 - (soft intersection over union) of what hangs, beside the cross entropies.
        hanging: Weight of the cross entropy of what hangs.
        carried: Weight of that of the carriers.
        smoothing: Of the labels of parts.
        judged: Share of the points that a step's loss is of.
        network: Its shape.
    """

    out: Path = Path("runs/parts")
    shards: Path = Path("runs/parts/data")
    minutes: float = 60.0
    rate: float = 6e-4
    batch: int = 8
    warmup: int = 150
    decay: float = 0.996
    validate_every: int = 400
    weight_decay: float = 0.02
    refresh: int = 50
    overlap: float = 0.5
    hanging: float = 1.0
    carried: float = 0.25
    smoothing: float = 0.02
    judged: float = 0.4
    network: PartConfig = field(default_factory=PartConfig)


def _warp(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A smooth bend of space, the same on both sides half of the time."""
    wave, phase = rng.normal(size=(3, 3)) * 3, rng.uniform(0, 6.28, 3)
    shift = rng.normal(size=(3, 3)) * 0.015
    position = np.abs(points) if rng.random() < 0.5 else points
    return np.asarray(points + np.sin(position @ wave.T + phase) @ shift)


def _colors(surface: Surface, rng: np.random.Generator) -> np.ndarray | None:
    """Other colours, or none."""
    kind = rng.random()
    if kind < 0.4:
        return None
    count = int(surface.part.max()) + 1
    if surface.colors is None or kind < 0.55:
        if rng.random() < 0.5:
            return None
        colors = rng.uniform(0.05, 0.95, (count, 3))[surface.part]
    else:
        colors = surface.colors[:, rng.permutation(3)] if rng.random() < 0.3 else surface.colors
        colors = (colors - 0.5) * rng.uniform(0.5, 1.3) + 0.5 + rng.normal(0, 0.1, 3)
    for _ in range(int(rng.integers(1, 5)) if rng.random() < 0.35 else 0):  # patches and marks that mean nothing
        away = np.linalg.norm(surface.points - surface.points[rng.integers(len(surface.points))], axis=1)
        colors = np.where((away < rng.uniform(0.02, 0.15))[:, None], rng.uniform(0.05, 0.95, 3), colors)
    shade = rng.uniform(0, 0.35) * (surface.normals @ np.array([0.3, 0.8, 0.5]) - 0.5)
    return np.asarray((colors + shade[:, None] + rng.normal(0, rng.uniform(0, 0.08), colors.shape)).clip(0, 1))


def _pieces(surface: Surface, rng: np.random.Generator) -> np.ndarray:
    """Loose parts after some, or all, were welded, or the largest was cut: a dress may be sewn or lie in pieces."""
    kind, part = rng.random(), surface.part
    count = int(part.max()) + 1
    if kind < 0.15:
        return np.zeros_like(part)
    if kind < 0.3:
        return np.asarray(rng.integers(max(1, round(count * rng.uniform(0.2, 0.9))), size=count)[part])
    if kind < 0.5:
        out, sizes = part.copy(), np.bincount(part).astype(float)
        for number in rng.choice(count, min(count, 3), replace=False, p=(sizes + 1) / (sizes + 1).sum()):
            rows = np.flatnonzero(part == number)
            seams = surface.points[rng.choice(rows, min(len(rows), int(rng.integers(2, 9))))]
            squeezed = rng.choice([0.3, 1.0], 3)  # pieces may be long or flat
            away = np.square((surface.points[rows][:, None] - seams) * squeezed).sum(axis=2)
            out[rows] = int(out.max()) + 1 + away.argmin(axis=1)
        return np.unique(out, return_inverse=True)[1]
    return part


def seen_row(
    row: dict[str, np.ndarray], rng: np.random.Generator | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Features, positions, carriers and loose parts of a row of a shard: as it is or, with `rng`, varied."""
    points, normals = row["points"].astype(np.float64), row["normals"].astype(np.float64)
    colors = row["colors"] / 255 if row["colored"] else None
    surface = Surface(points, normals, colors, row["piece"].astype(np.int64), row["shape"].astype(np.float64))
    carrier = row["carrier"]
    if rng is not None:
        if rng.random() < 0.5:
            points, normals = points * [-1, 1, 1], normals * [-1, 1, 1]
            carrier = np.append(_MIRRORED, -1)[carrier].astype(np.int8)
        if rng.random() < 0.5:
            points = _warp(points, rng)
        kind = rng.random()
        angle = rng.uniform(-np.pi, np.pi) if kind < 0.06 else rng.normal(0, 0.2) if kind < 0.7 else 0.0
        tilt = rng.normal(0, 0.06, 2) if rng.random() < 0.5 else np.zeros(2)
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ (
            np.eye(3) + np.array([[0, -tilt[0], 0], [tilt[0], 0, -tilt[1]], [0, tilt[1], 0]])
        )
        width = np.exp(rng.normal(0, [0.1, 0.1, 0.1]) + rng.normal(0, 0.08))
        points = (points @ turn.T) * width
        normals = (normals @ turn.T) / width
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        points = points + rng.normal(0, 0.02, 3) + rng.normal(0, rng.choice([0.0005, 0.003]), points.shape)
        if rng.random() < 0.03:
            normals = -normals
        surface = replace(surface, points=points, normals=normals)
        surface = replace(surface, colors=_colors(surface, rng), part=_pieces(surface, rng))
    return point_features(surface), surface.points, carrier, surface.part


class PartTrainer(AveragedRun[PartNetwork]):
    """One run in memory.

    Args:
        config: Settings.
    """

    kind = "parts"
    columns: ClassVar[tuple[str, ...] | None] = ("loss", "parts", "hangs", "rows", "rate")

    def __init__(self, config: PartTrainConfig):
        self.config = config
        self.data, self.held_out = PartData(config.shards, "train"), list(PartData(config.shards, "val"))  # type: ignore[assignment]
        if not len(self.data):
            raise OptionError(f"{config.shards}: there are no shards to train on; make some first")
        log = config.out / "log.csv"
        self.log_columns = tuple(logged_columns(log)) or None if log.is_file() else None
        self.held_out = self.held_out[::2]  # one view of each figure
        self.set_up(lambda: PartNetwork(config.network))
        counts = np.bincount(
            np.concatenate([self.data.row(i)["part"] for i in range(0, len(self.data), 3)]).astype(np.int64) + 1,
            minlength=len(PARTS) + 1,
        )[1:]
        weight = (counts.sum() / np.maximum(counts, 1)) ** 0.35
        self.weight = torch.from_numpy((weight / weight[0]).clip(1, 4).astype(np.float32))

    def step_loss(self) -> tuple[torch.Tensor, dict[str, float]]:
        """Cross entropies of parts, hanging and carriers, and the overlap of what hangs."""
        config = self.config
        if self.step % config.refresh == 0:
            self.data.refresh()
        rows = self.data.drawn(config.batch, self.rng)
        seen = [seen_row(row, self.rng) for row in rows]
        every = config.batch * config.network.points
        chosen = np.sort(self.rng.choice(every, round(config.judged * every), replace=False))
        batch = point_batch(rows, [one[0] for one in seen], [one[1] for one in seen], [one[3] for one in seen])
        out = self.model(batch, torch.from_numpy(chosen))
        truths = ([row["part"] for row in rows], [row["hangs"] for row in rows], [one[2] for one in seen])
        part, hangs, carrier = (torch.from_numpy(np.concatenate(truth).astype(np.int64)[chosen]) for truth in truths)
        count = len(PARTS)
        parts = F.cross_entropy(out[:, :count], part, self.weight, ignore_index=-1, label_smoothing=config.smoothing)
        known = hangs >= 0
        score, truth = out[:, count][known], hangs[known].float()
        hang = F.binary_cross_entropy_with_logits(score, truth, pos_weight=torch.tensor(1.5))
        likely = torch.sigmoid(score)
        both, any_ = (likely * truth).sum(), (likely + truth - likely * truth).sum()
        overlap = 1 - both / any_.clamp(min=1)
        carried = (
            F.cross_entropy(out[:, count + 1 :], carrier, ignore_index=-1)
            if bool((carrier >= 0).any())
            else out.sum() * 0
        )
        loss = parts + config.hanging * hang + config.overlap * overlap + config.carried * carried
        return loss, {"parts": float(parts.detach()), "hangs": float(hang.detach()), "rows": len(self.data)}

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Share of points with the right part, mean intersection over union of parts and of what hangs, on held-out
        figures, and the hanging share of those on whom nothing hangs.
        """
        table = np.zeros((len(PARTS), len(PARTS)))
        found, nothing = [], []
        by_source: dict[int, list[float]] = {}
        for row in self.held_out:
            features, points, _, pieces = seen_row(row)
            out = self.average(point_batch([row], [features], [points], [pieces])).numpy()
            chosen, truth = out[:, : len(PARTS)].argmax(axis=1), row["part"]
            known = truth >= 0
            np.add.at(table, (truth[known], chosen[known]), 1)
            by_source.setdefault(int(row["kind"]), []).append(
                float((chosen == truth)[known].mean()) if known.any() else 1.0
            )
            hangs, known = out[:, len(PARTS)] > 0, row["hangs"] >= 0
            if (row["hangs"] == 1).any():
                true = row["hangs"] == 1
                found.append(float((hangs & true).sum() / max(((hangs | true) & known).sum(), 1)))
            elif known.all():
                nothing.append(float(hangs.mean()))
        union = table.sum(0) + table.sum(1) - np.diag(table)
        iou = {
            f"iou_{name}": float(table[i, i] / union[i]) if table[i].sum() else float("nan")
            for i, name in enumerate(PARTS)
        }
        return {
            "right": float(np.trace(table) / table.sum()),
            "hang_iou": _mean(found),
            "nothing": _mean(nothing),
            **{f"right_{name}": _mean(by_source.get(i, [])) for i, name in enumerate(SOURCES)},
            **iou,
        }


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def main() -> None:
    """Train, or go on with the run in the folder: `python -m bunraku_lab.training.parts OUT SHARDS --minutes 60`."""
    import argparse

    parser = argparse.ArgumentParser(description="Train the part network on shards of labelled figures.")
    parser.add_argument("out", type=Path)
    parser.add_argument("shards", type=Path)
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--rate", type=float, default=6e-4)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--begin", type=Path, help="weights to begin from, in place of random ones")
    asked = parser.parse_args()
    config = PartTrainConfig(
        out=asked.out, shards=asked.shards, minutes=asked.minutes, rate=asked.rate, batch=asked.batch
    )
    config.prepare()
    trainer = PartTrainer(config)
    if not trainer.resume() and asked.begin:
        for network in (trainer.model, trainer.average):
            network.load_state_dict(PartNetwork.load(asked.begin).state_dict())
    trainer.learn(lambda row: print({name: round(value, 4) for name, value in row.items()}, flush=True))


if __name__ == "__main__":
    main()
