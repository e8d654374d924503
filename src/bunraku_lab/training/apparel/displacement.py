"""Training of the displacement network (section 4.3 of MMDMC): the head first, then the recurrent part."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bunraku.apparel.clothed import NORMAL_DAMPING, NORMAL_STIFFNESS, ClothedCharacter, Swing
from bunraku.apparel.learned.features import static_features
from bunraku.apparel.learned.network import DisplacementConfig
from bunraku.apparel.nodes import apparel_nodes, clothed_with_springs, part_neighbours
from bunraku.core.files import remove_leftovers
from bunraku.errors import BunrakuError, FormatError, OptionError
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.datasets.apparel.checks import standing_out
from bunraku_lab.datasets.apparel.shards import ApparelCharacter, ApparelClip
from bunraku_lab.nn.apparel import (
    DisplacementNetwork,
    Inputs,
    clip_features,
    mirror_global,
    normalize_inputs,
    past_of_states,
)
from bunraku_lab.nn.graph import NodeGraph, node_graph
from bunraku_lab.training.losses.motion import edge_loss, vertex_loss
from bunraku_lab.training.runs.run import AveragedRun, Progress, Report, StepSettings, TrainingNote

BANK_NODES = 128
HEADS = (48, 72, 128)
"""Numbers of nodes that are trained on: heads of the same order, each with neighbours of its own."""
GUESSED_EVERY = 2
"""One of so many characters for training is seen once more as bare meshes are: what holds its parts is guessed."""
STANDS_OUT = 0.1
"""Share of its calm frames in which the hem of a clip may stand out for the clip to be trained on."""
_FORMAT = 6


def truly_clothed(character: ApparelCharacter) -> ClothedCharacter:
    """A character of the data set as the networks see it, with all that its file says."""
    limp = np.zeros(len(character.spring), np.float32)
    clothed = ClothedCharacter(
        character.rest, character.faces, character.joints, character.weights, character.apparel, character.part, limp,
        character.damping,
    )  # fmt: skip
    swing = None if character.swing is None else Swing.of_rows(character.swing)
    return clothed_with_springs(clothed, character.spring, character.mass, character.limit, swing=swing)


@dataclass(frozen=True, eq=False)
class BankCharacter:
    """The nodes of one character in all of its clips."""

    path: Path
    name: str

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """Small arrays, by name."""
        with np.load(self.path / "static.npz", allow_pickle=False) as file:
            return {name: file[name] for name in file.files}

    @cached_property
    def moving(self) -> dict[str, np.ndarray]:
        """Mapped arrays of all frames: vectors (N, M, VECTORS, 3), scalars (N, M, SCALARS), whole (N, GLOBAL), truth
        (N, M, 3), turns (N, M, 3, 3), positions (N, M, 3) and root (N, 3) in the world [m].
        """
        names = ("vectors", "scalars", "whole", "truth", "turns", "positions", "root")
        return {name: np.load(self.path / f"{name}.npy", mmap_mode="r", allow_pickle=False) for name in names}

    @cached_property
    def swings(self) -> float:
        """Mean displacement of its nodes in all frames, over its size."""
        some = self.moving["truth"][:: max(1, len(self) // 64)].astype(np.float32)
        return float(np.linalg.norm(some, axis=-1).mean())

    def __len__(self) -> int:
        return int(self.arrays["frames"])

    def head(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Neighbours and parts of the first nodes."""
        parts = self.arrays["part"][:count]
        count = len(parts)
        key = next((size for size in HEADS if size >= count), HEADS[-1])
        near = self.arrays.get(f"neighbours_{key}")
        if near is None or len(near) != count:
            near = part_neighbours(self.arrays["rest"][:count].astype(np.float64), parts)
        return near, parts


def build_bank(
    data: ApparelData, folder: Path, progress: Callable[[float], None] | None = None, nodes: int = BANK_NODES
) -> list[BankCharacter]:
    """Compute what is not there yet; characters that cannot be used are left out.

    Args:
        data: The data set, of one split.
        folder: Where it is kept.
        nodes: Most nodes of a character.
    """
    out = []
    for number, (name, clips) in enumerate(_by_character(data)):
        frames = sum(clip.frames for clip in clips)
        twice = clips[0].split == "train" and zlib.crc32(name.encode()) % GUESSED_EVERY == 0
        for known in (True, False) if twice else (True,):
            path = folder / (name if known else f"{name}-guessed")
            found = BankCharacter(path, name)
            if not _complete(found, frames):
                try:
                    _write(data, clips, path, nodes, known)
                except BunrakuError:
                    continue
                found = BankCharacter(path, name)
            out.append(found)
        if progress:
            progress((number + 1) / max(len(data.characters), 1))
    return out


def _by_character(data: ApparelData) -> Iterator[tuple[str, list[ApparelClip]]]:
    for name in data.characters:
        yield name, [clip for clip in data.clips if clip.character == name]


def _complete(found: BankCharacter, frames: int) -> bool:
    try:
        return int(found.arrays["format"]) == _FORMAT and int(found.arrays["of_frames"]) == frames
    except (OSError, ValueError, KeyError):
        return False


def guessed_clothed(clothed: ClothedCharacter) -> ClothedCharacter:
    """A character whose stiffness and damping are those of bare meshes."""
    flat = np.ones(len(clothed.stiffness), np.float32)
    return replace(clothed, stiffness=NORMAL_STIFFNESS * flat, damping=NORMAL_DAMPING * flat, limit=None, swing=None)  # type: ignore[arg-type]


def _write(data: ApparelData, clips: list[ApparelClip], path: Path, most: int, known: bool = True) -> None:
    character = data.character(clips[0])
    clothed = truly_clothed(character)
    if not known:
        clothed = guessed_clothed(clothed)
    nodes = apparel_nodes(clothed, most)
    if not len(nodes):
        raise FormatError(path, "the character has no apparel")
    path.mkdir(parents=True, exist_ok=True)
    remove_leftovers(path)
    index = np.full(len(character.rest), -1)
    index[character.loose] = np.arange(len(character.loose))
    rows = index[nodes.vertex]
    columns: dict[str, list[np.ndarray]] = {
        name: [] for name in ("vectors", "scalars", "whole", "truth", "turns", "positions", "root")
    }
    kept = []
    for clip in clips:
        shard = data.shard(clip.shard)
        transforms = shard.frames("transforms", clip.first, clip.first + clip.frames)
        loose = shard.frames("offsets", clip.first, clip.first + clip.frames)
        if standing_out(clothed, transforms, character.loose, loose) > STANDS_OUT:
            continue
        kept.append(clip.frames)
        offsets = loose[:, rows].astype(np.float32)
        offsets[:, rows < 0] = 0
        frames = clip_features(clothed, nodes, transforms)
        turns = np.stack([frame.turns for frame in frames])
        columns["truth"].append(np.einsum("nmba,nmb->nma", turns, offsets) / clothed.scale)
        columns["turns"].append(turns)
        columns["root"].append(transforms[:, 0, :, 3])
        for name in ("vectors", "scalars", "whole", "positions"):
            columns[name].append(np.stack([getattr(frame, name) for frame in frames]))
    if not kept:
        raise FormatError(path, "the hem of the character stands out in all of its clips")
    for name, values in columns.items():
        kind = np.float32 if name in ("positions", "root") else np.float16
        np.save(path / f"{name}.npy", np.concatenate(values).astype(kind))
    vectors, scalars = static_features(clothed, nodes)
    heads = {
        f"neighbours_{size}": part_neighbours(nodes.rest[:size].astype(np.float64), nodes.part[:size]) for size in HEADS
    }
    still: dict[str, Any] = {
        "format": _FORMAT, "frames": sum(kept), "of_frames": sum(clip.frames for clip in clips),
        "scale": clothed.scale, "starts": np.cumsum([0, *kept]), "static_vectors": vectors,
        "static_scalars": scalars, "rest": nodes.rest, "part": nodes.part, "vertex": nodes.vertex, **heads,
    }  # fmt: skip
    np.savez(path / "static.npz", **still)


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
    """Put the head of a checkpoint in place of a network's own, and its recurrent part if the shapes agree.

    Raises:
        OptionError: The checkpoint's head has another shape.
        WeightsError: It is missing or broken.
    """
    start = DisplacementNetwork.load(path)
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
    """One run in memory."""

    kind = "apparel"
    columns = ("head_loss", "recurrent_loss", "rate")

    def __init__(
        self, config: DisplacementTrainConfig, characters: Sequence[BankCharacter],
        held_out: Sequence[BankCharacter] = (),
    ):  # fmt: skip
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
        whole = self.average
        if self.progress() <= self.config.head:  # what has not learned is not handed on
            whole = DisplacementNetwork(replace(self.config.network, recurrent=0))
            whole.anchor.load_state_dict(self.average.anchor.state_dict())
        return whole.save(self.checkpoint, note, half=True)


def train_displacement(
    config: DisplacementTrainConfig, report: Report | None = None, progress: Progress | None = None
) -> Path:
    """Train the displacement network, or go on where the run in `config.out` stopped.

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
