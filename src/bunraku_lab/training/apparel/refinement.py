"""Training of the joint refinement (section 4.4) on what the other networks say of the data set's characters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.displacement.weights import DisplacementNetwork, load_displacement
from bunraku.apparel.skinning import eq4_transforms
from bunraku.errors import BunrakuError, FormatError, OptionError
from bunraku.formats.files import atomic_write, sweep
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.training.apparel.networks.refinement import RefinementConfig, RefinementNetwork, save_refinement
from bunraku_lab.training.apparel.networks.seam import seam_of
from bunraku_lab.training.apparel.networks.tiled import clothed_by_mask, tiled
from bunraku_lab.training.apparel.node_bank import truly_clothed
from bunraku_lab.training.losses.apparel_losses import edge_loss, refinement_loss, vertex_loss
from bunraku_lab.training.runs.averaged_run import AveragedRun, TrainingNote
from bunraku_lab.training.runs.settings import StepSettings
from bunraku_lab.training.runs.training_run import Progress, Report

__all__ = ["RefinementTrainConfig", "RefinementTrainer", "SeamSample", "seam_sample", "train_refinement"]

FRAMES = (8, 16, 28, 40)
"""Frames of a clip that are learned from."""


@dataclass(frozen=True, kw_only=True)
class RefinementTrainConfig(StepSettings):
    """Settings of `bunraku train apparel-refinement`.

    Args:
        data: Folder that `bunraku data apparel` wrote.
        weights: Displacement network; the shipped one when not given.
        masks: Segmentation network; the shipped one when not given.
        body: Body network; the shipped one when not given.
        characters: How many characters of the data set.
        edges: Weight of the edge loss against the vertex loss; the paper's is 100, in its units.
        small: Weight of the refinement's own size.
        network: Its shape.
    """

    data: Path = Path("data/apparel")
    out: Path = Path("runs/apparel-refinement")
    weights: Path | None = None
    masks: Path | None = None
    body: Path | None = None
    characters: int = 60
    minutes: float = 5.0
    batch: int = 3
    edges: float = 2.0
    small: float = 0.01
    warmup: int = 50
    decay: float = 0.99
    validate_every: int = 200
    network: RefinementConfig = field(default_factory=RefinementConfig)


@dataclass(frozen=True, eq=False)
class SeamSample:
    """A character's seam in F frames; lengths over its size.

    Args:
        inputs: Shape (F, S, INPUTS).
        vectors: Shape (F, S, BASIS, 3).
        turns: Frames of the carrying joints, shape (F, S, 3, 3).
        positions: Both modules' results, from the pelvis, shape (F, S, 3).
        truth: Where the vertices are, from the pelvis, shape (F, S, 3).
        edges: Rows, shape (E, 2).
    """

    inputs: np.ndarray
    vectors: np.ndarray
    turns: np.ndarray
    positions: np.ndarray
    truth: np.ndarray
    edges: np.ndarray


def seam_sample(
    clothed: ClothedCharacter, weights: np.ndarray, transforms: np.ndarray, truth: np.ndarray, frames: np.ndarray,
    network: DisplacementNetwork,
) -> SeamSample:  # fmt: skip
    """What is learned from a clip.

    Args:
        clothed: The character as the networks see it.
        weights: What the body alone gives all vertices, shape (V, 22).
        transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
        truth: All vertices in the frames [m], shape (F, V, 3).
        frames: Which frames, rising, shape (F,).
        network: Of the displacement.

    Raises:
        FormatError: Nothing of the mesh is apparel.
    """
    seam = seam_of(clothed, weights)
    if not len(seam.vertices):
        raise FormatError(Path("mesh"), "nothing of it is apparel")
    moved = tiled(clothed, transforms, network, frames)
    affine = eq4_transforms(transforms[frames], clothed.joints)
    found = [seam.frame(positions, pose) for positions, pose in zip(moved, affine, strict=True)]
    pelvis, size = transforms[frames, 0, :, 3][:, None], np.float32(clothed.scale)
    return SeamSample(
        np.stack([one.inputs for one in found]).astype(np.float16),
        np.stack([one.vectors for one in found]).astype(np.float16),
        np.stack([one.turns for one in found]).astype(np.float16),
        ((moved[:, seam.vertices] - pelvis) / size).astype(np.float32),
        ((truth[:, seam.vertices] - pelvis) / size).astype(np.float32), seam.edges,
    )  # fmt: skip


class RefinementTrainer(AveragedRun[RefinementNetwork]):
    """One run in memory.

    Args:
        config: Settings.
        characters: To learn from.
        held_out: To validate on.
    """

    kind = "apparel-refinement"

    def __init__(
        self, config: RefinementTrainConfig, characters: Sequence[SeamSample], held_out: Sequence[SeamSample] = ()
    ):
        if not characters:
            raise OptionError("there are no characters to train on; build more of `bunraku data apparel`")
        self.config, self.characters, self.held_out = config, list(characters), list(held_out)
        self.set_up(lambda: RefinementNetwork(config.network))

    def losses(self, model: RefinementNetwork, sample: SeamSample, frame: int) -> torch.Tensor:
        """The vertex, the edge and the regularisation loss of a frame, shape (3,)."""
        inputs, vectors, turns, positions, truth = (
            torch.from_numpy(np.asarray(getattr(sample, name)[frame], np.float32))
            for name in ("inputs", "vectors", "turns", "positions", "truth")
        )
        change = model(inputs, vectors)
        moved = positions + torch.einsum("sab,sb->sa", turns, change)
        edges = torch.from_numpy(sample.edges.astype(np.int64))
        return torch.stack([vertex_loss(moved, truth), edge_loss(moved, truth, edges), refinement_loss(change)])

    def step_loss(self) -> tuple[torch.Tensor, dict[str, float]]:
        """The loss L_v + lambda L_e + lambda L_r."""
        config = self.config
        parts = torch.zeros(3)
        for number in self.rng.integers(len(self.characters), size=config.batch):
            one = self.characters[number]
            parts = parts + self.losses(self.model, one, int(self.rng.integers(len(one.positions)))) / config.batch
        loss = parts[0] + config.edges * parts[1] + config.small * parts[2]
        return loss, {}

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Vertex and edge error on characters that were not learned from, over those without the refinement."""
        found = np.zeros((2, 3))
        for one in self.held_out:
            for frame in range(len(one.positions)):
                found[0] += self.losses(self.average, one, frame).numpy()
                found[1] += self.losses(RefinementNetwork(self.config.network), one, frame).numpy()
        return {"vertices": float(found[0, 0] / found[1, 0]), "edges": float(found[0, 1] / found[1, 1])}

    def write(self, note: TrainingNote) -> Path:
        """Write the checkpoint."""
        return save_refinement(self.checkpoint, self.average, note, half=True)


def _samples(config: RefinementTrainConfig, split: str, most: int, folder: Path) -> list[SeamSample]:
    """One clip of each character, computed once."""
    data = ApparelData(config.data, split)  # type: ignore[arg-type]
    network = load_displacement(config.weights or shipped_checkpoint("apparel-guessed"))
    folder.mkdir(parents=True, exist_ok=True)
    sweep(folder)
    out: list[SeamSample] = []
    names = ("inputs", "vectors", "turns", "positions", "truth", "edges")
    for name in data.characters:
        if len(out) == most:
            break
        path = folder / f"{name}.npz"
        clip = next(clip for clip in data.clips if clip.character == name)
        frames = np.array([frame for frame in FRAMES if frame < clip.frames])
        if not path.is_file() and len(frames):
            try:
                true = truly_clothed(data.character(clip))
                transforms = data.shard(clip.shard).frames("transforms", clip.first, clip.first + int(frames[-1]) + 1)
                moved = data.window(clip, 0, int(frames[-1]) + 1).vertices[frames]
                guessed, weights = clothed_by_mask(true, config.masks, config.body)
                sample = seam_sample(guessed, weights, transforms, moved, frames, network)
            except BunrakuError:
                continue
            with atomic_write(path) as file:
                np.savez(file, **{key: getattr(sample, key) for key in names})  # type: ignore[arg-type]
        if path.is_file():
            with np.load(path, allow_pickle=False) as stored:
                out.append(SeamSample(**{key: stored[key] for key in names}))
    return out


def train_refinement(
    config: RefinementTrainConfig, report: Report | None = None, progress: Progress | None = None
) -> Path:
    """Train the joint refinement, or go on where the run in `config.out` stopped.

    Args:
        config: Settings.
        report: Called at each validation with its figures (the row of log.csv).
        progress: Called with a stage's name and the share done.

    Returns:
        The checkpoint.

    Raises:
        BunrakuError: No data, a network is missing, or the folder cannot be written.
    """
    config.prepare()
    bank = config.out.with_name(f"{config.out.name}-seams")
    held_out = _samples(config, "val", max(config.characters // 8, 1), bank / "val")
    characters = _samples(config, "train", config.characters, bank / "train")
    return RefinementTrainer(config, characters, held_out).learn(report, progress)
