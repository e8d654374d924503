"""The joint refinement f_j of section 4.4 of MMDMC, which merges what both modules say, and its training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra
from torch import nn

from bunraku.apparel.body import eq4_transforms
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.learned.network import DisplacementNetwork, load_displacement
from bunraku.core.geometry.graph import clean_mesh, unique_edges
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.core.skinning import skin
from bunraku.errors import FormatError, OptionError
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.nn.checkpoints import SavedNetwork
from bunraku_lab.training.apparel.body import clothed_by_mask, tiled
from bunraku_lab.training.apparel.displacement import truly_clothed
from bunraku_lab.training.losses.motion import edge_loss, refinement_loss, vertex_loss
from bunraku_lab.training.rows.banks import kept_arrays
from bunraku_lab.training.runs.run import AveragedRun, Progress, Report, StepSettings

# The kept network was trained with these.
REACH = 0.12
"""How far from apparel the body is refined too, along the edges, over the character's size [m]."""
HOPS = (1, 4, 12)
"""Edges over which what surrounds a vertex is averaged."""
BASIS = len(HOPS) + 2
"""Vectors that a refinement may be made of: the ways to the means around a vertex, what would even out its edges, and
the way back to where the body alone has it."""
INPUTS = 3 * BASIS + len(HOPS) + 2
_SPREAD = 0.02  # of the vectors, over the character's size


@dataclass(frozen=True, eq=False)
class SeamFrame:
    """One frame of S vertices.

    Args:
        vectors: In the frames of the carrying joints, over the size, shape (S, BASIS, 3), float32.
        inputs: Input of the network, shape (S, INPUTS), float32.
        turns: Frames of the carrying joints, shape (S, 3, 3), float32.
    """

    vectors: np.ndarray
    inputs: np.ndarray
    turns: np.ndarray


@dataclass(frozen=True, eq=False)
class Seam:
    """Apparel and the body about it, of one clothed character.

    Args:
        vertices: One of each position on the mesh, shape (S,).
        copies: All vertices of these positions, shape (C,), and the row of each.
        rows: As said.
        edges: Between them, rows, shape (E, 2).
        lengths: Of the edges at rest [m], shape (E,).
        weights: Skinning weights that the body alone would have there, shape (S, 22).
        rest: [m], shape (S, 3).
        joint: Joint that carries each, by these weights, shape (S,).
        still: Inputs that never change: apparel, its means around, and the number of edges, shape (S, len(HOPS) + 2).
        around: Mean over the neighbours and the vertex itself, sparse (S, S).
        scale: The clothed's size.
    """

    vertices: np.ndarray
    copies: np.ndarray
    rows: np.ndarray
    edges: np.ndarray
    lengths: np.ndarray
    weights: np.ndarray
    rest: np.ndarray
    joint: np.ndarray
    still: np.ndarray
    around: csr_matrix
    scale: float

    def frame(self, positions: np.ndarray, affine: np.ndarray) -> SeamFrame:
        """Features of one frame.

        Args:
            positions: Both modules' results tiled, of all vertices of the mesh [m], shape (V, 3).
            affine: Affine transforms of the joints, shape (22, 3, 4).
        """
        now = np.asarray(positions[self.vertices], np.float32)
        body = np.asarray(skin(self.rest, self.weights, affine[None])[0], np.float32)
        away = now - body
        means, smooth, done = [], away, 0
        for hops in HOPS:
            for _ in range(hops - done):
                smooth = self.around @ smooth
            means.append(smooth - away)
            done = hops
        world = np.stack([*means, self._evened(now), -away], axis=1) / np.float32(self.scale)
        turns = np.asarray(affine[self.joint, :, :3], np.float32)
        vectors = np.einsum("sba,skb->ska", turns, world)
        inputs = np.concatenate([np.clip(vectors.reshape(len(now), -1) / _SPREAD, -6, 6), self.still], axis=1)
        return SeamFrame(vectors, inputs.astype(np.float32), turns)

    def _evened(self, now: np.ndarray) -> np.ndarray:
        """Half of what edges are too long or too short by, along them, mean over those of a vertex, shape (S, 3)."""
        a, b = self.edges.T
        way = now[b] - now[a]
        length = np.linalg.norm(way, axis=1)
        step = way * (0.5 * (1 - self.lengths / np.maximum(length, 1e-9)))[:, None]
        count = np.maximum(np.bincount(self.edges.reshape(-1), minlength=len(now)), 1)[:, None]
        total = [np.bincount(a, column, len(now)) - np.bincount(b, column, len(now)) for column in step.T]
        return np.asarray(np.stack(total, axis=1) / count, np.float32)


def seam_of(clothed: ClothedCharacter, weights: np.ndarray) -> Seam:
    """The seam of a clothed character.

    Args:
        clothed: The character.
        weights: Skinning weights that the body alone would give all vertices, shape (V, 22).
    """
    clean = clean_mesh(clothed.rest, clothed.faces)
    count, size = len(clean.vertices), clothed.scale
    cloth = np.zeros(count, bool)
    cloth[clean.index[clothed.apparel]] = True
    edges = unique_edges(clean.faces, count)
    points = clean.vertices * clean.scale
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    graph = coo_matrix((lengths + 1e-9, (edges[:, 0], edges[:, 1])), shape=(count, count)).tocsr()
    starts = np.flatnonzero(cloth)
    if len(starts):
        near = dijkstra(graph, directed=False, indices=starts, min_only=True, limit=REACH * size)
        kept = np.flatnonzero(np.isfinite(near))
    else:
        kept = starts
    index = np.full(count, -1)
    index[kept] = np.arange(len(kept))
    inside = (index[edges] >= 0).all(axis=1)
    edges, lengths = index[edges[inside]], lengths[inside]
    first = np.zeros(count, np.int64)
    first[clean.index[::-1]] = np.arange(len(clean.index))[::-1]
    vertices = first[kept]
    rows = index[clean.index]
    copies = np.flatnonzero(rows >= 0)
    here = np.arange(len(kept))
    pairs = np.concatenate([edges, edges[:, ::-1], np.stack([here, here], axis=1)])
    around = coo_matrix((np.ones(len(pairs), np.float32), pairs.T), shape=(len(kept),) * 2).tocsr()
    degree = np.asarray(around.sum(axis=1)).reshape(-1)
    around = csr_matrix(around.multiply(1 / np.maximum(degree, 1)[:, None]), dtype=np.float32)
    mask = cloth[kept].astype(np.float32)
    still, smooth, done = [mask], mask, 0
    for hops in HOPS:
        for _ in range(hops - done):
            smooth = around @ smooth
        still.append(smooth)
        done = hops
    still.append(np.asarray(degree / 8, np.float32))
    own = np.asarray(weights[vertices], np.float32)
    return Seam(
        vertices, copies, rows[copies], edges, lengths.astype(np.float32), own, np.asarray(clothed.rest[vertices]),
        own.argmax(axis=1) if len(own) else np.zeros(0, np.int64), np.stack(still, axis=1), around, size,
    )  # fmt: skip


MOST = 1.0  # largest weight of a basis vector
FREE = 0.01  # largest refinement beside them, over the character's size; the kept network was trained so


@dataclass(frozen=True)
class RefinementConfig:
    """Shape of the network.

    Args:
        width: Channels.
    """

    width: int = 48


class RefinementNetwork(SavedNetwork):
    """The network."""

    kind = "apparel-refinement"
    shape = RefinementConfig

    def __init__(self, config: RefinementConfig | None = None):
        super().__init__()
        self.config = config = config or RefinementConfig()
        last = nn.Linear(config.width, BASIS + 3)
        self.layers = nn.Sequential(
            nn.Linear(INPUTS, config.width), nn.GELU(), nn.Linear(config.width, config.width), nn.GELU(), last
        )
        nn.init.zeros_(last.weight)  # it begins with both modules' results as they are
        nn.init.zeros_(last.bias)

    def forward(self, inputs: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        """Change of each vertex, which is added to tile(A, B) [MMDMC 16], shape (S, 3).

        In the frame of the joint that carries the vertex and over the character's size, as what it is made of. The
        paper's MLP reads the positions; ours reads how a vertex lies to those around it, so that it fits any mesh.

        Args:
            inputs: `SeamFrame.inputs`, shape (S, INPUTS).
            vectors: `SeamFrame.vectors`, shape (S, BASIS, 3).
        """
        out = self.layers(inputs)
        mixed: torch.Tensor = torch.einsum("sk,ska->sa", MOST * torch.tanh(out[:, :BASIS]), vectors)
        return mixed + FREE * torch.tanh(out[:, BASIS:])


@torch.no_grad()
def refined(network: RefinementNetwork, seam: Seam, positions: np.ndarray, affine: np.ndarray) -> np.ndarray:
    """A frame after the refinement, all vertices of the mesh [m], shape (V, 3).

    Args:
        network: The network.
        seam: Of the clothed.
        positions: Both modules' results tiled [m], shape (V, 3).
        affine: Affine transforms of the joints, shape (22, 3, 4).
    """
    out = np.array(positions, np.float32)
    if len(seam.vertices):
        frame = seam.frame(positions, affine)
        change = network(torch.from_numpy(frame.inputs), torch.from_numpy(frame.vectors)).numpy()
        world = np.einsum("sab,sb->sa", frame.turns, change) * np.float32(seam.scale)
        out[seam.copies] += world[seam.rows]
    return out


FRAMES = (8, 16, 28, 40)
"""Frames of a clip that are learned from."""


@dataclass(frozen=True, kw_only=True)
class RefinementTrainConfig(StepSettings):
    """Settings of `bunraku train apparel-refinement`.

    Args:
        data: Folder that `bunraku data apparel` wrote.
        weights: Displacement network; the shipped one when not given.
        masks: Part network; the shipped one when not given.
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
    """One run in memory."""

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


def _samples(config: RefinementTrainConfig, split: str, most: int, folder: Path) -> list[SeamSample]:
    """One clip of each character, computed once."""
    data = ApparelData(config.data, split)  # type: ignore[arg-type]
    network = load_displacement(config.weights or shipped_checkpoint("apparel-guessed"))

    def arrays(name: str) -> dict[str, np.ndarray]:
        clip = next(clip for clip in data.clips if clip.character == name)
        frames = np.array([frame for frame in FRAMES if frame < clip.frames])
        if not len(frames):
            raise FormatError(config.data, f"the first clip of {name} is too short")
        last = int(frames[-1]) + 1
        guessed, weights = clothed_by_mask(truly_clothed(data.character(clip)), config.masks, config.body)
        transforms = data.shard(clip.shard).frames("transforms", clip.first, clip.first + last)
        return vars(
            seam_sample(guessed, weights, transforms, data.window(clip, 0, last).vertices[frames], frames, network)
        )

    found = kept_arrays(folder, {name: partial(arrays, name) for name in data.characters})
    return [SeamSample(**stored) for _, stored in islice(found, most)]


def train_refinement(
    config: RefinementTrainConfig, report: Report | None = None, progress: Progress | None = None
) -> Path:
    """Train the joint refinement, or go on where the run in `config.out` stopped.

    Raises:
        BunrakuError: No data, a network is missing, or the folder cannot be written.
    """
    config.prepare()
    bank = config.out.with_name(f"{config.out.name}-seams")
    held_out = _samples(config, "val", max(config.characters // 8, 1), bank / "val")
    characters = _samples(config, "train", config.characters, bank / "train")
    return RefinementTrainer(config, characters, held_out).learn(report, progress)
