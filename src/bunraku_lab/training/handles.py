"""Training of the Mesh Handle Predictor (Eq. 5 of TapMo), and the mesh features of many characters afterwards."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from bunraku.anatomy.handles.networks import PredictorConfig
from bunraku.anatomy.joints import PRESENT
from bunraku.core.body.layout import HANDLE_MIRROR, HANDLE_NAMES
from bunraku.core.body.reference import handle_positions
from bunraku.core.files import atomic_write
from bunraku.core.geometry.rotations import nearest_rotation
from bunraku.errors import OptionError
from bunraku_lab.datasets.characters.training_character import (
    UPRIGHT,
    AugmentConfig,
    TrainingCharacter,
    TrainingMesh,
    augment,
    folder_chances,
    plain_mesh,
)
from bunraku_lab.nn.checkpoints import TrainingState
from bunraku_lab.nn.graph import MeshGraph, mesh_graph
from bunraku_lab.nn.handles import HandlePredictor, grow_predictor
from bunraku_lab.training.losses import handles as losses
from bunraku_lab.training.losses.handles import LossConfig
from bunraku_lab.training.runs.run import AveragedRun, Progress, Report, TrainingNote, TrainingSettings


@dataclass(frozen=True)
class MeshAugmentation:
    """How often and how much examples are damaged.

    Args:
        slide_rate: Share of the examples whose vertices slide along the surface.
        slide: Largest way towards a neighbour, as a share of the edge.
        coarse_rate: Share of the examples that lose vertices.
        coarse: Largest share of the vertices that merge with a neighbour.
        hole_rate: Share of the examples with holes.
        hole: Largest radius of a hole, in units of the largest extent.
        split_rate: Share of the examples that are cut into loose parts.
        noise: Largest standard deviation of the noise on positions, in units of the largest extent.
        normal_noise: Largest standard deviation of the noise on normals.
        fuse_rate: Share of the examples whose limbs are one skin with what they touch.
        base_rate: Share of the examples that are one skin with a plinth or a plate below them.
        prop_rate: Share of the examples with a rod or a disc in a hand.
    """

    slide_rate: float = 0.5
    slide: float = 0.4
    coarse_rate: float = 0.4
    coarse: float = 0.45
    hole_rate: float = 0.2
    hole: float = 0.1
    split_rate: float = 0.25
    noise: float = 0.004
    normal_noise: float = 0.12
    fuse_rate: float = 0.15
    base_rate: float = 0.1
    prop_rate: float = 0.1


_ROWS = ("vertices", "normals", "weights", "target")


def _random_neighbour(edges: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """A neighbour of each vertex, itself where it has none, shape (V,)."""
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[rng.permutation(len(both))]
    chosen = np.arange(count)
    chosen[both[:, 0]] = both[:, 1]  # of repeated indices the last one counts, and the order is random
    return chosen


def slid(mesh: TrainingMesh, rng: np.random.Generator, most: float) -> TrainingMesh:
    """Every vertex goes up to `most` of the way to one of its neighbours."""
    count = len(mesh.vertices)
    neighbour = _random_neighbour(mesh.edges, count, rng)
    share = (most * rng.random(count)).astype(np.float32)[:, None]
    moved = {name: (1 - share) * getattr(mesh, name) + share * getattr(mesh, name)[neighbour] for name in _ROWS}
    posed = (1 - share) * mesh.posed + share * mesh.posed[:, neighbour]
    return replace(mesh, **moved, posed=posed)


def coarser(mesh: TrainingMesh, rng: np.random.Generator, share: float) -> TrainingMesh:
    """About a share of the vertices merge with a neighbour; rows become means by area."""
    count = len(mesh.vertices)
    gone = rng.random(count) < share
    neighbour = _random_neighbour(mesh.edges, count, rng)
    into = np.where(gone & ~gone[neighbour], neighbour, np.arange(count))
    kept, label = np.unique(into, return_inverse=True)
    label = label.reshape(-1)
    areas = np.bincount(label, mesh.areas, len(kept)).astype(np.float32)
    even = mesh.areas + 1e-9
    mean = csr_matrix((even / np.bincount(label, even)[label], (label, np.arange(count))), shape=(len(kept), count))
    rows: dict[str, Any] = {name: np.asarray(mean @ getattr(mesh, name), np.float32) for name in _ROWS}
    frames = len(mesh.posed)
    flat = np.ascontiguousarray(mesh.posed.transpose(1, 0, 2)).reshape(count, -1)
    posed = np.asarray(mean @ flat, np.float32).reshape(len(kept), frames, 3).transpose(1, 0, 2)
    return replace(
        mesh, **rows, areas=areas, edges=_relabelled(mesh.edges, label, len(kept)), posed=np.ascontiguousarray(posed)
    )


def _relabelled(edges: np.ndarray, label: np.ndarray, count: int) -> np.ndarray:
    ends = np.sort(label[edges], axis=1)
    ends = ends[ends[:, 0] != ends[:, 1]]
    keys = np.unique(ends[:, 0] * count + ends[:, 1])
    return np.stack([keys // count, keys % count], axis=1)


def pierced(mesh: TrainingMesh, rng: np.random.Generator, radius: float, holes: int = 3) -> TrainingMesh:
    """Balls around random vertices are cut out, a tenth of the vertices at most."""
    keep = np.ones(len(mesh.vertices), bool)
    for _ in range(int(rng.integers(1, holes + 1))):
        middle = mesh.vertices[rng.integers(len(keep))]
        hole = np.linalg.norm(mesh.vertices - middle, axis=1) < radius * rng.uniform(0.3, 1)
        if (~(keep & ~hole)).mean() < 0.1:
            keep &= ~hole
    index = np.cumsum(keep) - 1
    edges = index[mesh.edges[keep[mesh.edges].all(axis=1)]]
    rows = {name: getattr(mesh, name)[keep] for name in (*_ROWS, "areas")}
    return replace(mesh, **rows, edges=edges, posed=np.ascontiguousarray(mesh.posed[:, keep]))


def split(mesh: TrainingMesh, rng: np.random.Generator) -> TrainingMesh:
    """Cut the edges between parts, but for a few that stand for the bridges of network meshes.

    The parts are those of the rig, or what a random plane parts.
    """
    if rng.random() < 0.6:
        side = mesh.weights.argmax(axis=1)
    else:
        normal = rng.normal(size=3)
        along = mesh.vertices @ (normal / np.linalg.norm(normal))
        side = (along > np.quantile(along, rng.uniform(0.15, 0.85))).astype(np.int64)
    cut = side[mesh.edges[:, 0]] != side[mesh.edges[:, 1]]
    cut &= rng.random(len(cut)) > 0.05
    return replace(mesh, edges=mesh.edges[~cut])


def noisy(mesh: TrainingMesh, rng: np.random.Generator, positions: float, normals: float) -> TrainingMesh:
    """Noise on the positions, the same in all poses, and on the normals, whose lengths stay near theirs."""
    shift = rng.normal(0, positions, mesh.vertices.shape).astype(np.float32)
    turn = rng.normal(0, normals, mesh.normals.shape).astype(np.float32)
    return replace(mesh, vertices=mesh.vertices + shift, normals=mesh.normals + turn, posed=mesh.posed + shift)


def fused(mesh: TrainingMesh, rng: np.random.Generator) -> TrainingMesh:
    """What nearly touches is one skin, as in figures for print: hands on hips, arms along a robe, thighs."""
    lengths = np.linalg.norm(mesh.vertices[mesh.edges[:, 0]] - mesh.vertices[mesh.edges[:, 1]], axis=1)
    pairs = cKDTree(mesh.vertices).query_pairs(float(np.median(lengths) * rng.uniform(0.8, 1.6)), output_type="ndarray")
    return replace(mesh, edges=np.unique(np.concatenate([mesh.edges, np.sort(pairs, axis=1)]), axis=0))


def _sheet(rings: int, around: int) -> tuple[np.ndarray, np.ndarray]:
    """Radius and angle of points on rings, shape (R, 2), and the edges between them."""
    radius, angle = np.meshgrid(np.arange(rings), np.linspace(0, 2 * np.pi, around, endpoint=False), indexing="ij")
    number = np.arange(rings * around).reshape(rings, around)
    edges = [np.stack([number, np.roll(number, 1, axis=1)], -1), np.stack([number[1:], number[:-1]], -1)]
    edges = [pairs.reshape(-1, 2) for pairs in edges]
    return np.stack([radius.ravel(), angle.ravel()], axis=1), np.concatenate(edges)


def _joined(
    mesh: TrainingMesh, points: np.ndarray, edges: np.ndarray, posed: np.ndarray, like: tuple[np.ndarray, np.ndarray],
    rng: np.random.Generator,
) -> TrainingMesh:  # fmt: skip
    """The example with a further piece, one skin with it half of the time, and brought back to its unit.

    Args:
        mesh: The example.
        points, edges, posed: Of the piece, shapes (R, 3), (E, 2) and (N, R, 3).
        like: Row of joint weights (J,) and of handle shares (30,) of all its points.
        rng: Source of randomness.
    """
    count, added = len(mesh.vertices), len(points)
    normals = points - points.mean(axis=0)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    ends = points[edges]
    step = float(np.median(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)))
    bridges = np.zeros((0, 2), np.int64)
    if rng.random() < 0.5:
        gap, near = cKDTree(mesh.vertices).query(points)
        close = np.flatnonzero(gap < max(1.5 * step, float(gap.min()) + 1e-6))
        bridges = np.stack([near[close], count + close], axis=1)
    whole = np.concatenate([mesh.vertices, points])
    low, high = whole.min(axis=0), whole.max(axis=0)
    middle, scale = 0.5 * (low + high), max(float((high - low).max()), 1e-9)
    return replace(
        mesh, vertices=((whole - middle) / scale).astype(np.float32),
        normals=np.concatenate([mesh.normals, normals]).astype(np.float32),
        areas=np.concatenate([mesh.areas, np.full(added, step * step)]).astype(np.float32) / np.float32(scale**2),
        edges=np.concatenate([mesh.edges, edges + count, bridges]),
        weights=np.concatenate([mesh.weights, np.tile(like[0], (added, 1)).astype(np.float32)]),
        target=np.concatenate([mesh.target, np.tile(like[1], (added, 1)).astype(np.float32)]),
        root=((mesh.root - middle) / scale).astype(np.float32), height=float((high - low)[1] / scale),
        posed=((np.concatenate([mesh.posed, posed], axis=1) - middle) / scale).astype(np.float32),
    )  # fmt: skip


def on_base(mesh: TrainingMesh, rng: np.random.Generator) -> TrainingMesh:
    """The example on a plinth, a plate or a column, which goes with the root."""
    roots = np.flatnonzero(mesh.handles == 0)
    low = float(mesh.vertices[:, 1].min())
    feet = mesh.vertices[mesh.vertices[:, 1] < low + 0.03]
    if not len(roots) or len(feet) < 3:
        return mesh
    middle, wide = feet.mean(axis=0), float(np.ptp(feet[:, [0, 2]], axis=0).max())
    sheet, edges = _sheet(7, 20)
    high, radius = rng.choice([0.02, 0.1, 0.3]) * rng.uniform(0.5, 1.5), (0.5 * wide + 0.02) * rng.uniform(1.05, 2.5)
    # From the middle of the top outwards, down the side, and back below.
    along = np.array([0.15, 0.6, 1, 1, 1, 0.6, 0.15])[sheet[:, 0].astype(int)] * radius
    down = np.array([0, 0, 0, 0.5, 1, 1, 1])[sheet[:, 0].astype(int)] * high
    points = middle * [1, 0, 1] + np.stack([along * np.cos(sheet[:, 1]), low - down, along * np.sin(sheet[:, 1])], 1)
    points += rng.normal(0, 0.1 * high * rng.random(), points.shape) * [1, 0, 1]
    weights, target = np.eye(mesh.weights.shape[1])[roots[0]], np.eye(mesh.target.shape[1])[0]
    posed = np.tile(points, (len(mesh.posed), 1, 1))
    return _joined(mesh, points, edges, posed, (weights, target), rng)


_HANDS = [HANDLE_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("wrist", "fingers")]


def with_prop(mesh: TrainingMesh, rng: np.random.Generator) -> TrainingMesh:
    """The example with a rod or a disc in a hand, which goes with it."""
    hands = np.flatnonzero(mesh.target[:, _HANDS].sum(axis=1) > 0.8)
    if len(hands) < 3:
        return mesh
    grip = int(rng.choice(hands))
    long, thick = rng.uniform(0.2, 0.9), rng.uniform(0.004, 0.02)
    if rng.random() < 0.3:
        long, thick = thick, rng.uniform(0.05, 0.2)
    sheet, edges = _sheet(12, 6)
    along = (sheet[:, 0] / 11 - rng.random()) * long
    points = np.stack([thick * np.cos(sheet[:, 1]), along, thick * np.sin(sheet[:, 1])], axis=1)
    points = points @ np.linalg.qr(rng.normal(size=(3, 3)))[0].T + mesh.vertices[grip]
    beside = hands[np.argsort(np.linalg.norm(mesh.vertices[hands] - mesh.vertices[grip], axis=1))[:24]]
    own, posed = mesh.vertices[beside].astype(np.float64), []
    for frame in mesh.posed[:, beside].astype(np.float64):
        turn = nearest_rotation((frame - frame.mean(axis=0)).T @ (own - own.mean(axis=0)))
        posed.append((points - own.mean(axis=0)) @ turn.T + frame.mean(axis=0))
    rows = np.array(posed).reshape(len(mesh.posed), len(points), 3)
    return _joined(mesh, points, edges, rows, (mesh.weights[grip], mesh.target[grip]), rng)


def augment_mesh(mesh: TrainingMesh, rng: np.random.Generator, config: MeshAugmentation | None = None) -> TrainingMesh:
    """The example with its surface changed at random."""
    config = config or MeshAugmentation()
    for rate, change in ((config.fuse_rate, fused), (config.base_rate, on_base), (config.prop_rate, with_prop)):
        if rng.random() < rate:
            mesh = change(mesh, rng)
    if rng.random() < config.split_rate:
        mesh = split(mesh, rng)
    if rng.random() < config.coarse_rate:
        mesh = coarser(mesh, rng, config.coarse * rng.random())
    if rng.random() < config.hole_rate:
        mesh = pierced(mesh, rng, config.hole)
    if rng.random() < config.slide_rate:
        mesh = slid(mesh, rng, config.slide)
    if config.noise > 0 or config.normal_noise > 0:
        mesh = noisy(mesh, rng, config.noise * rng.random(), config.normal_noise * rng.random())
    return mesh


_LIMBS = [
    HANDLE_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("shoulder", "elbow", "hip", "knee")
]


def has_human_shape(character: TrainingCharacter) -> bool:
    """Whether a character is an upright body with two arms and two legs, so that a person's motion fits it."""
    mass = character.target * (character.areas / character.areas.sum())[:, None]
    share = mass.sum(axis=0)
    head = HANDLE_NAMES.index("head")
    if (share[[*_LIMBS, head]] < PRESENT).any():
        return False
    positions = handle_positions(character.vertices, character.target, character.areas)
    hips = positions[[HANDLE_NAMES.index("left_hip"), HANDLE_NAMES.index("right_hip")]].mean(axis=0)
    spine = positions[head] - (positions[0] if share[0] >= PRESENT else hips)
    return bool(spine[1] > UPRIGHT * np.linalg.norm(spine))


@torch.no_grad()
def write_mesh_bank(
    model: HandlePredictor, characters: Iterable[TrainingCharacter] | Sequence[TrainingCharacter], path: str | Path,
    variants: int = 3, seed: int = 0, held_out: Collection[str] = (), progress: Callable[[int], None] | None = None,
) -> Path:  # fmt: skip
    """Write f_phi of each character, as it is and in some other poses and proportions.

    Args:
        model: The trained predictor.
        characters: All of them; what follows a "~" in a name says which variant of a character it is.
        path: NPZ to write: `features` (C, 448), `names`, `split` ("train" or "test") and `humanoid`, each (C,).
        variants: Changed forms of each character beside its own; those held out have none.
        seed: Of the changes.
        held_out: Names of the characters that no training may see: their rows are "test", for evaluation only.
        progress: Called with the number of characters done.
    """
    model.eval()
    device = next(model.parameters()).device
    config = AugmentConfig(poses=0)
    features, names, split, humanoid = [], [], [], []
    for number, character in enumerate(characters):
        rng = np.random.default_rng([seed, number])
        held, upright = character.name.partition("~")[0] in held_out, has_human_shape(character)
        meshes = [plain_mesh(character, rng, config)] + [
            augment(character, rng, config) for _ in range(0 if held else variants)
        ]
        for mesh in meshes:
            graph = mesh_graph(mesh.vertices, mesh.normals, mesh.edges, mesh.areas, model.config.anchors).to(device)
            features.append(model(graph).features.float().cpu().numpy())
            names.append(character.name)
            split.append("test" if held else "train")
            humanoid.append(upright)
        if progress:
            progress(number + 1)
    path = Path(path)
    with atomic_write(path) as file:
        np.savez(
            file, features=np.stack(features).astype(np.float32), names=np.array(names), split=np.array(split),
            humanoid=np.array(humanoid),
        )  # fmt: skip
    return path


@dataclass(frozen=True, kw_only=True)
class HandleTrainConfig(TrainingSettings):
    """Settings of a training run.

    Args:
        cache: Folder of cached characters (`bunraku_lab.datasets.characters.build.build_characters`).
        epochs: Stop after so many epochs; with no limit of minutes the learning rate follows these.
        device: Where to train.
        bf16: Matrix products in bfloat16, where the processor has it.
        rate: Peak learning rate of Adam. A.2 has 1e-4 over 500 epochs; five times that suits a short run.
        validate_every: Epochs between validations.
        reference_share: Share of the examples that are the reference body.
        start: Checkpoint of kind "handles" to start a new run from, for example the shipped one, to go on with it on
            other characters; a deeper network begins as the one in the checkpoint.
    """

    cache: Path = Path("runs/data/characters")
    out: Path = Path("runs/handles")
    minutes: float = 40.0
    epochs: int = 500
    device: str = "cpu"
    bf16: bool = False
    rate: float = 5e-4
    decay: float = 0.998
    reference_share: float = 0.12
    validate_every: int = 3
    start: Path | None = None
    predictor: PredictorConfig = field(default_factory=PredictorConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    mesh_augmentation: MeshAugmentation = field(default_factory=MeshAugmentation)


_COLUMNS = (
    "epoch", "step", "seconds", "rate", "total", "semantic", "skinning", "pose", "root", "sparsity", "smoothness",
    "mirror", "feature", "held_accuracy", "held_purity", "held_root", "held_pose", "varied_accuracy", "varied_purity",
    "varied_root", "varied_pose",
)  # fmt: skip


def _graph(
    mesh: TrainingMesh, config: PredictorConfig, device: str, rng: np.random.Generator | None = None
) -> MeshGraph:
    return mesh_graph(mesh.vertices, mesh.normals, mesh.edges, mesh.areas, config.anchors, rng).to(device)


class HandleTrainer(AveragedRun[HandlePredictor]):
    """One training run in memory: the network, its optimiser, and the characters."""

    kind = "handles"
    columns = None
    log_columns = _COLUMNS
    every_row = True

    def __init__(
        self, config: HandleTrainConfig, characters: Sequence[TrainingCharacter], held_out: Sequence[TrainingCharacter],
        reference: Sequence[TrainingCharacter] = (),
    ):  # fmt: skip
        if not characters:
            raise OptionError("there are no characters to train on; build the cache first")
        self.config, self.epoch = config, 0
        self.characters, self.held_out, self.reference = list(characters), list(held_out), list(reference)
        torch.manual_seed(config.seed)
        model = HandlePredictor(config.predictor).to(config.device)
        self.before: HandlePredictor | None = None
        if config.start is not None:
            grow_predictor(model, config.start)
            if config.loss.feature > 0:
                self.before = HandlePredictor.load(config.start).to(config.device).eval().requires_grad_(False)
        average = HandlePredictor(config.predictor).to(config.device)
        super().__init__(config.out, model, average, torch.optim.Adam(model.parameters(), lr=config.rate))
        self.rng = np.random.default_rng(config.seed)
        self.generator = torch.Generator().manual_seed(config.seed)
        self.swap = torch.tensor(HANDLE_MIRROR)
        self.chances = folder_chances([c.name for c in self.characters])

    def progress(self) -> float:
        """How far the run is through its limits, 0 to 1."""
        parts = [self.epoch / max(self.config.epochs, 1)]
        if self.config.minutes > 0:
            parts.append(self.seconds / (60 * self.config.minutes))
        return min(max(parts), 1.0)

    def example_loss(self, mesh: TrainingMesh) -> tuple[torch.Tensor, dict[str, float]]:
        """L_s + nu_p L_p + nu_r L_r [TapMo 5] and further losses for one mesh; and each before its weight."""
        config, device = self.config.loss, self.config.device
        graph = _graph(mesh, self.config.predictor, device, self.rng)
        with torch.autocast(device.split(":")[0], torch.bfloat16, enabled=self.config.bf16):
            predicted = self.model(graph)
        logits, weights = predicted.logits.float(), predicted.weights.float()
        positions = graph.inputs[:, :3]
        parts = {
            "semantic": losses.semantic_loss(logits, torch.from_numpy(mesh.target).to(device), graph.areas),
            "root": config.root_unit
            * losses.root_loss(positions, weights, torch.from_numpy(mesh.root).to(device), graph.areas),
            "smoothness": losses.smoothness_loss(weights, torch.from_numpy(mesh.edges).to(device)),
            "sparsity": losses.sparsity_loss(weights),
        }
        i, j, gamma = losses.skinning_pairs(
            torch.from_numpy(mesh.weights), config.skinning_pairs, self.generator,
            torch.from_numpy(np.ascontiguousarray(mesh.handles)),
        )  # fmt: skip
        parts["skinning"] = losses.skinning_loss(logits, i.to(device), j.to(device), gamma.to(device), config.apart)
        if len(mesh.posed):
            parts["pose"] = config.pose_unit * losses.pose_loss(
                positions, torch.from_numpy(mesh.posed).to(device), weights
            )
        if self.rng.random() < config.mirror_rate:
            again = _graph(
                mesh, self.config.predictor, device, self.rng
            ).mirrored()  # other anchors, so they must not matter either
            with torch.autocast(device.split(":")[0], torch.bfloat16, enabled=self.config.bf16):
                mirrored = self.model(again).logits.float()
            parts["mirror"] = losses.mirror_loss(logits, mirrored, self.swap.to(device))
        if self.before is not None and self.rng.random() < config.feature_rate:
            with torch.autocast(device.split(":")[0], torch.bfloat16, enabled=self.config.bf16):
                before = self.before(graph).features
            parts["feature"] = losses.feature_loss(predicted.features.float(), before.float())
        total = sum((getattr(config, name) * value for name, value in parts.items()), start=logits.sum() * 0)
        return total, {name: float(value.detach()) for name, value in parts.items()}

    def train_epoch(self, stop: Callable[[], bool] = lambda: False) -> dict[str, float]:
        """As many examples as there are characters; the mean of each loss, before its weight."""
        self.model.train()
        start, sums = time.process_time(), {"total": 0.0}
        counts = dict.fromkeys(sums, 0)
        before = self.seconds
        for _ in range(math.ceil(len(self.characters) / self.config.batch)):
            self.set_rate(self.config.rate, self.config.warmup, self.progress())
            for _ in range(self.config.batch):
                known = self.reference and self.rng.random() < self.config.reference_share
                if known:
                    character = self.reference[self.rng.integers(len(self.reference))]
                else:
                    character = self.characters[self.rng.choice(len(self.characters), p=self.chances)]
                mesh = augment_mesh(
                    augment(character, self.rng, self.config.augment), self.rng, self.config.mesh_augmentation
                )
                loss, parts = self.example_loss(mesh)
                (loss / self.config.batch).backward()
                for name, value in {"total": float(loss.detach()), **parts}.items():
                    sums[name], counts[name] = sums.get(name, 0.0) + value, counts.get(name, 0) + 1
            self.update(self.config.decay)
            self.seconds = before + time.process_time() - start
            if stop() or self.progress() >= 1:
                break
        self.epoch += 1
        return {name: value / max(counts[name], 1) for name, value in sums.items()}

    @property
    def ticks(self) -> int:
        """Epochs."""
        return self.epoch

    def due(self) -> bool:
        """Whether it is time to validate and save."""
        return self.epoch == 1 or super().due()

    def train_step(self) -> dict[str, float]:
        """An epoch, which ends early where the run is asked to stop."""
        return self.train_epoch(lambda: self.stop.asked)

    def begun(self) -> dict[str, float]:
        rate = self.optimizer.param_groups[0]["lr"]
        return {"epoch": self.epoch, "step": self.step, "seconds": round(self.seconds, 1), "rate": rate}

    def validate(self) -> dict[str, float]:
        """`validate_handles` on what was held out, as it is and varied."""
        plain = validate_handles(self.average, self.held_out)
        varied = validate_handles(self.average, self.held_out, varied=True)
        return {f"held_{name}": value for name, value in plain.items()} | {
            f"varied_{name}": value for name, value in varied.items()
        }

    def write(self, note: TrainingNote) -> Path:
        return self.average.save(self.checkpoint, note | {"epochs": self.epoch})

    def extras(self) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
        """What the state has besides networks and time."""
        return {"epoch": self.epoch, **super().extras()[0]}, {"pairs": self.generator.get_state()}

    def take_extras(self, state: TrainingState) -> None:
        """Go on with what `extras` said."""
        super().take_extras(state)
        self.generator.set_state(state.generators["pairs"])
        self.epoch = int(state.values["epoch"])


@torch.no_grad()
def validate_handles(
    model: HandlePredictor, characters: Sequence[TrainingCharacter], varied: bool = False, seed: int = 0
) -> dict[str, float]:
    """How good the predictor is on characters with known handles.

    Returns:
        accuracy: Share of the labelled surface whose largest weight is the right handle's. purity: of the surface that
        one joint moves (weight over 0.9), the share on the main handle of that joint's part. root: distance of handle 0
        from the root joint, over the height. pose: mean distance between posed vertices and those that the handles
        rebuild, over the height. outside: share of the weights outside the four largest.
    """
    model.eval()
    device = next(model.parameters()).device
    accuracy, purity, root, pose, outside = [], [], [], [], []
    for number, character in enumerate(characters):
        rng = np.random.default_rng([seed, number])
        mesh = augment(character, rng) if varied else plain_mesh(character, rng)
        graph = _graph(mesh, model.config, str(device))
        weights = model(graph).weights
        positions, target = graph.inputs[:, :3], torch.from_numpy(mesh.target).to(device)
        known = (target.sum(1) > 0.5) * graph.areas
        if float(known.sum()) > 0:
            accuracy.append(float((known * (weights.argmax(1) == target.argmax(1))).sum() / known.sum()))
        parts = torch.from_numpy(mesh.weights * (mesh.weights > 0.9)).to(device) * graph.areas[:, None]
        shares = parts.T @ torch.nn.functional.one_hot(weights.argmax(1), weights.shape[1]).float()
        if float(shares.sum()) > 0:
            purity.append(float(shares.amax(1).sum() / shares.sum()))
        outside.append(float(losses.sparsity_loss(weights)))
        if (character.handles == 0).any():
            root.append(
                float(losses.root_loss(positions, weights, torch.from_numpy(mesh.root).to(device), graph.areas).sqrt())
                / mesh.height
            )
        posed = torch.from_numpy(mesh.posed).to(device)
        moved = losses.drive_local(positions, weights, *losses.register_torch(positions, posed, weights))
        pose.append(float((moved - posed).norm(dim=-1).mean()) / mesh.height)
    results = {"accuracy": accuracy, "purity": purity, "root": root, "pose": pose, "outside": outside}
    return {name: float(np.mean(values)) if values else math.nan for name, values in results.items()}


def train_handles(config: HandleTrainConfig, report: Report | None = None, progress: Progress | None = None) -> Path:
    """Train the predictor, or go on where the run in `config.out` stopped; then write `mesh_features.npz`.

    Raises:
        BunrakuError: No cache, the folder cannot be written, or the checkpoint to start from does not fit.
    """
    from bunraku_lab.datasets.characters.build import load_characters, reference_characters

    config.prepare()
    characters, held_out = load_characters(config.cache)
    trainer = HandleTrainer(config, characters, held_out, reference_characters(config.predictor.mesh_vertices))
    checkpoint = trainer.learn(report, progress)
    bank = config.out / "mesh_features.npz"
    if not bank.is_file() or bank.stat().st_mtime < checkpoint.stat().st_mtime:  # older where a run was killed here
        write_mesh_bank(trainer.average, [*trainer.characters, *trainer.reference], bank)
    return checkpoint
