"""Training of the displacement network (section 4.3): the head that cannot drift first, then the recurrent part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch

from bunraku.apparel.displacement.features import mirror_global
from bunraku.apparel.displacement.weights import DisplacementConfig
from bunraku.errors import OptionError
from bunraku_lab.nn.apparel.anchor import Inputs
from bunraku_lab.nn.apparel.graph import NodeGraph, node_graph
from bunraku_lab.nn.apparel.network import (
    DisplacementNetwork,
    load_displacement,
    normalize_inputs,
    save_displacement,
)
from bunraku_lab.nn.apparel.recurrent import past_of_states
from bunraku_lab.training.apparel.node_bank import HEADS, BankCharacter, build_bank
from bunraku_lab.training.losses.apparel_losses import edge_loss, vertex_loss
from bunraku_lab.training.runs.averaged_run import AveragedRun, TrainingNote
from bunraku_lab.training.runs.settings import StepSettings
from bunraku_lab.training.runs.training_run import Progress, Report

__all__ = ["DisplacementTrainConfig", "DisplacementTrainer", "train_displacement"]


@dataclass(frozen=True, kw_only=True)
class DisplacementTrainConfig(StepSettings):
    """Settings of `bunraku train apparel`.

    Args:
        data: Folder that `bunraku data apparel` wrote.
        start: Checkpoint whose head a new run takes over, and its recurrent part where that has the same shape; with
            `head` 0 the recurrent part alone is trained about it.
        head: Share of the run in which only the head learns.
        clips: Windows in a step of the recurrent part.
        shortest, longest: Frames of a window, at the beginning of its training and at the end.
        known: Share of the windows that go on from true states.
        calm: A character counts by one over its mean displacement and this, over its size: what a real file's quiet
            apparel is worth is measured against its own motion.
        edges: Weight of Eq. 15 against Eq. 14; the paper's is 100, with clips that begin at the truth.
        network: Its shape.
    """

    data: Path = Path("data/apparel")
    out: Path = Path("runs/apparel")
    start: Path | None = None
    minutes: float = 120.0
    steps: int = 60000
    head: float = 0.65
    batch: int = 16
    clips: int = 6
    shortest: int = 8
    longest: int = 24
    known: float = 0.4
    edges: float = 1.0
    calm: float = 0.004
    rate: float = 1.5e-3
    warmup: int = 200
    decay: float = 0.998
    validate_every: int = 1000
    network: DisplacementConfig = field(default_factory=DisplacementConfig)


def take_head(model: DisplacementNetwork, path: Path) -> None:
    """Put the head of a checkpoint in the place of a network's own, and its recurrent part where that has the same
    shape.

    Raises:
        OptionError: The checkpoint's head has another shape.
        WeightsError: It is missing or broken.
    """
    start = load_displacement(path)
    try:
        model.anchor.load_state_dict(start.anchor.state_dict())
    except RuntimeError as error:
        raise OptionError(f"{path}: its head has another shape; give the --network settings that it has") from error
    if start.recurrent is not None and model.recurrent is not None:
        own, other = model.recurrent.state_dict(), start.recurrent.state_dict()
        if own.keys() == other.keys() and all(own[name].shape == other[name].shape for name in own):
            model.recurrent.load_state_dict(other)


@dataclass
class _Block:
    """Windows of several characters: everything of F frames; `share` is how much each node counts, shape (M,)."""

    inputs: list[Inputs]
    share: torch.Tensor
    truth: torch.Tensor
    turns: torch.Tensor
    positions: torch.Tensor
    rest: torch.Tensor
    graph: NodeGraph


class DisplacementTrainer(AveragedRun[DisplacementNetwork]):
    """One run in memory.

    Args:
        config: Settings.
        characters: To learn from.
        held_out: To validate on.
    """

    kind = "apparel"
    columns = ("head_loss", "recurrent_loss", "rate")

    def __init__(
        self,
        config: DisplacementTrainConfig,
        characters: Sequence[BankCharacter],
        held_out: Sequence[BankCharacter] = (),
    ):
        self.config, self.characters, self.held_out = config, list(characters), list(held_out)
        self.set_up(lambda: DisplacementNetwork(config.network), self._units)

    def _units(self, model: DisplacementNetwork) -> None:
        nodes = torch.cat([self._block(self._draw(16), 1).inputs[0].nodes() for _ in range(12)])
        normalize_inputs(model, nodes)
        if self.config.start is not None:
            take_head(model, self.config.start)

    def _draw(self, count: int) -> list[BankCharacter]:
        return [self.characters[number] for number in self.rng.integers(len(self.characters), size=count)]

    def _block(self, characters: Sequence[BankCharacter], frames: int, mirror: bool = True) -> _Block:
        """A window of each character, some of them mirrored, with as many nodes as chance says."""
        count = int(self.rng.choice(HEADS))
        heads = [character.head(count) for character in characters]
        graph = node_graph([near for near, _ in heads], [part for _, part in heads])
        columns: dict[str, list[np.ndarray]] = {}
        for character, (near, _) in zip(characters, heads, strict=True):
            own, moving, m = character.arrays, character.moving, len(near)
            starts = own["starts"]
            clip = int(self.rng.integers(len(starts) - 1))
            first = int(starts[clip] + self.rng.integers(max(1, starts[clip + 1] - starts[clip] - frames + 1)))
            flip = np.array([-1, 1, 1], np.float32) if mirror and self.rng.random() < 0.5 else np.ones(3, np.float32)
            rows = slice(first, first + frames)
            whole = moving["whole"][rows].astype(np.float32)
            size = float(own["scale"])
            root = moving["root"][rows][:, None]  # where on the ground a clip is does not count
            root = root if self.config.network.frame == "world" else root[:1]
            turn = flip[:, None] * flip
            values = {
                "static_vectors": own["static_vectors"][:m] * flip,
                "static_scalars": own["static_scalars"][:m],
                "rest": own["rest"][:m] * flip / size,
                "vectors": moving["vectors"][rows, :m].astype(np.float32) * flip,
                "scalars": moving["scalars"][rows, :m].astype(np.float32),
                "whole": (mirror_global(whole) if flip[0] < 0 else whole)[:, None],
                "truth": moving["truth"][rows, :m].astype(np.float32) * flip,
                "turns": moving["turns"][rows, :m].astype(np.float32) * turn,
                "positions": (moving["positions"][rows, :m] - root) * flip / size,
            }
            columns.setdefault("share", []).append(np.full(m, 1 / (character.swings + self.config.calm), np.float32))
            for name, value in values.items():
                columns.setdefault(name, []).append(value)
        still = {
            name: torch.from_numpy(np.concatenate(columns.pop(name)))
            for name in ("static_vectors", "static_scalars", "rest", "share")
        }
        share = still["share"] / still["share"].mean()
        moved = {
            name: torch.from_numpy(np.ascontiguousarray(np.concatenate(values, axis=1), np.float32))
            for name, values in columns.items()
        }
        inputs = [
            Inputs(
                still["static_vectors"].float(), still["static_scalars"].float(), moved["vectors"][frame],
                moved["scalars"][frame], moved["whole"][frame], graph,
            )
            for frame in range(frames)
        ]  # fmt: skip
        return _Block(inputs, share, moved["truth"], moved["turns"], moved["positions"], still["rest"].float(), graph)

    def losses(self, moved: torch.Tensor, truth: torch.Tensor, block: _Block) -> torch.Tensor:
        """L_va + lambda L_ea of frames; edges in the frame of the joint that carries both ends, over the true ones."""
        share = block.share[:, None]
        vertex = vertex_loss(share * moved, share * truth)
        bent, true = share * (block.rest + moved), share * (block.rest + truth)  # the ends of an edge count alike
        edge = edge_loss(bent, true, block.graph.edges)
        return vertex + self.config.edges * edge

    def step_loss(self) -> tuple[torch.Tensor, dict[str, float]]:
        """The loss of the head or of the recurrent part."""
        config, done = self.config, self.progress()
        both = done >= config.head and self.model.recurrent is not None
        if both:
            share = (done - config.head) / max(1 - config.head, 1e-9)
            frames = round(config.shortest + share * (config.longest - config.shortest))
            block = self._block(self._draw(config.clips), frames)
            known = bool(self.rng.random() < config.known)
            loss = self.losses(self.rollout(self.model, block, known), block.truth[3:], block)
        else:
            block = self._block(self._draw(config.batch), 1)
            loss = self.losses(self.model.anchor(block.inputs[0]), block.truth[0], block)
        return loss, {"recurrent_loss" if both else "head_loss": float(loss.detach())}

    def rollout(self, model: DisplacementNetwork, block: _Block, known: bool = False) -> torch.Tensor:
        """Displacements of all frames of a window but the first three, shape (F - 3, M, 3); gradients go to the
        recurrent part alone.

        Args:
            model: The network.
            block: The window.
            known: Whether it goes on from the true states of the first three frames (the paper's protocol), or from
                where the head puts the apparel. The paper's form, which has no head, always does the first.
        """
        assert model.recurrent is not None
        with torch.no_grad():
            heads = torch.stack([model.anchor(inputs) for inputs in block.inputs])
        start = block.truth[:3] if known or model.recurrent.world else heads[:3]
        past = past_of_states(model.recurrent, start, heads[:3], block.turns[:3], block.positions[:3])
        out = []
        for frame in range(3, len(block.inputs)):
            moved, past = model.recurrent(
                block.inputs[frame], past, heads[frame], block.turns[frame], block.positions[frame]
            )
            out.append(moved)
        return torch.stack(out)

    @torch.no_grad()
    def validate(self, windows: int = 48, frames: int = 30) -> dict[str, float]:
        """Errors on characters and motions that were not learned from, over the truth's own displacement."""
        state, self.rng = self.rng, np.random.default_rng(7)
        sums = np.zeros(3)
        model = self.average
        for _ in range(windows // 4):
            chosen = [self.held_out[number] for number in self.rng.integers(len(self.held_out), size=4)]
            block = self._block(chosen, frames, mirror=False)
            last = block.truth[-1]
            sums[0] += float(last.norm(dim=1).mean())
            sums[1] += float((model.anchor(block.inputs[-1]) - last).norm(dim=1).mean())
            if model.recurrent is not None and self.progress() > self.config.head:
                sums[2] += float((self.rollout(model, block)[-1] - last).norm(dim=1).mean())
        self.rng = state
        return {"rigid": sums[0] / (windows // 4), "head_over_rigid": sums[1] / sums[0],
                "both_over_rigid": sums[2] / sums[0]}  # fmt: skip

    def write(self, note: TrainingNote) -> Path:
        """Write the checkpoint."""
        whole = self.average
        if self.progress() <= self.config.head:  # what has not learned is not handed on
            whole = DisplacementNetwork(replace(self.config.network, recurrent=0))
            whole.anchor.load_state_dict(self.average.anchor.state_dict())
        return save_displacement(self.checkpoint, whole, note, half=True)


def train_displacement(
    config: DisplacementTrainConfig, report: Report | None = None, progress: Progress | None = None
) -> Path:
    """Train the displacement network, or go on where the run in `config.out` stopped.

    Args:
        config: Settings.
        report: Called at each validation with its figures (the row of log.csv).
        progress: Called with a stage's name and the share done.

    Returns:
        The checkpoint.

    Raises:
        BunrakuError: No data, or the folder cannot be written.
    """
    from bunraku_lab.datasets.apparel import ApparelData

    config.prepare()
    bank = Path(config.data).with_name(f"{Path(config.data).name}-nodes")
    characters, held_out = (
        build_bank(ApparelData(config.data, split), bank / split)
        for split in ("train", "val")  # type: ignore[arg-type]
    )
    trainer = DisplacementTrainer(config, characters, held_out)
    return trainer.learn(report, progress)
