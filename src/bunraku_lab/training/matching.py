"""Training of networks that match motions and sentences: the shared run, and the ranker."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import torch.nn.functional as F
import tyro
from torch import Tensor

from bunraku.errors import OptionError
from bunraku.generation.extractor import RADIUS, RANKER, ExtractorConfig
from bunraku.generation.features import FeatureStatistics, mirror
from bunraku.language.captions import mirror_words
from bunraku.language.encoders import TextEncoder, text_encoder
from bunraku.language.lexicon import actions_of
from bunraku_lab.nn.text import Extractor, load_extractor, save_extractor
from bunraku_lab.training.rows.banks import TextBank
from bunraku_lab.training.rows.clip_rows import ClipSet, Mixture, MotionBatch
from bunraku_lab.training.rows.clips import load_people
from bunraku_lab.training.runs.run import AveragedRun, StepSettings, TrainingNote, bf16_is_fast


@dataclass(frozen=True, kw_only=True)
class MatchingTrainConfig(StepSettings):
    """Settings of a training run: those of `StepSettings`, whose `decay` is --ema, and these.

    Args:
        data: Folder that `bunraku data motions` wrote.
        start: Weights to start a new run from, of the same network, whose units it keeps.
        device: Where to train.
        bf16: Compute in bfloat16 where torch says it is safe and the device has it in hardware.
    """

    data: Path = Path("runs/data/motions")
    start: Path | None = None
    out: Path = Path("runs/matching")
    minutes: float = 25.0
    steps: int = 3000
    device: str = "cpu"
    batch: int = 96
    rate: float = 6e-4
    weight_decay: float = 0.05
    decay: Annotated[float, tyro.conf.arg(name="ema")] = 0.998
    bf16: bool = True
    validate_every: int = 200
    seed: int = 0

    def prepare(self) -> None:
        if self.batch < 2 or self.threads < 1:
            raise OptionError("batch must be 2 or more, threads 1 or more")
        super().prepare()


def for_encoder(network: ExtractorConfig, encoder: TextEncoder) -> ExtractorConfig:
    """The network that reads what a text encoder says."""
    return replace(
        network, text_encoder=encoder.name, text_size=encoder.token_size, pooled_size=encoder.pooled_size
    )  # fmt: skip


class MatchingRun(AveragedRun[Extractor]):
    """One training run in memory."""

    columns = None
    least = 0.01
    flush = True

    def __init__(
        self, config: MatchingTrainConfig, network: ExtractorConfig, statistics: FeatureStatistics, bank: TextBank,
        clips: int, kind: str,
    ):  # fmt: skip
        self.config, self.bank, self.clip_count, self.kind = config, bank, clips, kind

        def begin(model: Extractor) -> None:
            if config.start is not None:
                return start_from(config.start, model, kind)
            model.mean.copy_(torch.from_numpy(statistics.mean))
            model.std.copy_(torch.from_numpy(statistics.std))

        self.set_up(lambda: Extractor(network).to(config.device), begin, betas=(0.9, 0.98))

    def train_step(self) -> dict[str, float]:
        """One step; a run that goes on draws the same dropout."""
        torch.manual_seed(1_000_003 * self.config.seed + self.step)
        return super().train_step()

    def begun(self) -> dict[str, float]:
        return {"step": self.step, "minutes": self.seconds / 60}

    def write(self, note: TrainingNote) -> Path:
        notes = {"steps": self.step, "minutes": round(self.seconds / 60, 1), "clips": self.clip_count}
        return save_extractor(self.checkpoint, self.average, notes | note["results"], self.kind)


def start_from(path: Path, model: Extractor, kind: str) -> None:
    """Give a new network the weights and the units of a checkpoint.

    Raises:
        OptionError: The checkpoint is of another network.
        WeightsError: It is missing, damaged or of another kind.
    """
    old = load_extractor(path, kind=kind)
    other = [name for name, value in asdict(model.config).items() if getattr(old.config, name) != value]
    if other:
        raise OptionError(
            f"{path}: a run cannot start from this network, whose {', '.join(other)} differ; give the settings that it "
            "was trained with"
        )
    model.load_state_dict(old.state_dict())


def captions_of(
    config: MatchingTrainConfig, encoder: TextEncoder, sentences: Collection[str],
    progress: Callable[[str, float], None],
) -> TextBank:  # fmt: skip
    """The sentences of a run, encoded once and kept in its folder."""
    path = config.out / "captions.safetensors"
    return TextBank(encoder, sorted(sentences), path, lambda done, total: progress("captions", done / total))


_SHORT = 7
"""Words up to which sentences that say the same actions mean the same."""


@dataclass(frozen=True, kw_only=True)
class RankerTrainConfig(MatchingTrainConfig):
    """Settings of a training run: those of `MatchingTrainConfig`, and `network`."""

    out: Path = Path("runs/ranker")
    batch: int = 80
    network: ExtractorConfig = field(default_factory=ExtractorConfig)


def corrupted(values: np.ndarray, random: np.random.Generator, sided: bool) -> np.ndarray:
    """A motion as generators get it wrong.

    Args:
        values: Normalised features, shape (N, D).
        random: Chooses how.
        sided: Whether its mirror image would be wrong too.

    Returns:
        Shape (M, D), with M at most N.
    """
    way = int(random.integers(0 if sided else 1, 5))
    if way == 0:
        return mirror(values)
    if way == 1:  # backwards, its velocities too
        out = values[::-1].copy()
        out[:, :3] *= -1
        return out
    if way == 2:  # too small
        middle = values.mean(axis=0)
        return np.asarray(middle + (values - middle) * random.uniform(0.25, 0.6), np.float32)
    if way == 3:  # trembling: noise of which only the fast part is left
        noise = random.normal(0, 1, values.shape).astype(np.float32)
        noise -= 0.5 * (np.roll(noise, 1, axis=0) + np.roll(noise, -1, axis=0))
        noise[:, :4] = 0
        return values + np.float32(random.uniform(0.08, 0.25)) * noise
    half = values[:: 2 if len(values) >= 24 else 1]  # twice as fast, and again
    return np.concatenate([half, half])[: len(values)]


class RankerTrainer(MatchingRun):
    """One training run in memory."""

    config: RankerTrainConfig

    def __init__(self, config: RankerTrainConfig, rows: ClipSet, bank: TextBank, held: ClipSet | None = None):
        self.rows, self.held = rows, held
        self.held_out = held.clips if held is not None and len(held.clips) > 1 else []
        super().__init__(config, config.network, rows.statistics, bank, len(rows.clips), RANKER)

    def losses(self, model: Extractor, batch: MotionBatch, random: np.random.Generator) -> tuple[Tensor, float, float]:
        """The loss of a batch, and the shares of motions and of sentences that find their partner first."""
        size, device = len(batch.lengths), self.config.device
        turned = [mirror_words(sentence) for sentence in batch.sentences]
        sided = np.array([a != b for a, b in zip(batch.sentences, turned, strict=True)])
        wrong = [
            corrupted(batch.values[row, :length], random, bool(sided[row])) for row, length in enumerate(batch.lengths)
        ]
        values = np.zeros((2 * size, *batch.values.shape[1:]), np.float32)
        values[:size] = batch.values
        for row, other in enumerate(wrong, size):
            values[row, : len(other)] = other
        lengths = torch.from_numpy(np.concatenate([batch.lengths, [len(other) for other in wrong]]))
        features = torch.from_numpy(values) * model.std.cpu() + model.mean.cpu()
        bf16 = self.config.bf16 and bf16_is_fast(device)
        with torch.autocast(torch.device(device).type, torch.bfloat16, enabled=bf16):
            motion = model.motion(features.to(device), lengths.to(device))
            text = model.text(self.bank([*batch.sentences, *turned]).to(device))
        scale = model.log_scale.exp().clamp(max=50) / RADIUS**2
        same = torch.from_numpy(alike(batch.sentences)).to(device)
        target = torch.arange(size, device=device)
        right, spoils = motion[:size], motion[size:]
        between = (scale * (right @ text[:size].T)).masked_fill(same, -1e4)
        mirrored = scale * (right * text[size:]).sum(1)
        mirrored = mirrored.masked_fill(~torch.from_numpy(sided).to(device), -1e4)
        found = torch.cat([between, mirrored[:, None]], dim=1)
        matched = torch.cat([between.T, scale * (text[:size] * spoils).sum(1)[:, None]], dim=1)
        loss = 0.5 * (F.cross_entropy(found, target) + F.cross_entropy(matched, target))
        won = [float((logits.argmax(1) == target).float().mean()) for logits in (found, matched)]
        return loss, won[0], won[1]

    def step_loss(self) -> tuple[Tensor, dict[str, float]]:
        """The loss of the batch of this step, and how often each side found its own."""
        config = self.config
        batch = self.rows.batch(config.seed, self.step, config.batch)
        loss, found, matched = self.losses(self.model, batch, np.random.default_rng([config.seed, self.step, 5]))
        return loss, {"motion_to_text": found, "text_to_motion": matched}

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Losses on fixed rows of what was held out."""
        assert self.held is not None
        found = []
        for number in range(4):
            batch = self.held.batch(991, number, min(self.config.batch, 64))
            found.append(self.losses(self.average, batch, np.random.default_rng(number)))
        names = ("validation", "validation_motion_to_text", "validation_text_to_motion")
        return {name: float(np.mean([float(one[index]) for one in found])) for index, name in enumerate(names)}


def alike(sentences: Sequence[str]) -> np.ndarray:
    """Pairs of different rows whose sentences mean the same, shape (B, B), bool: they are not wrong for each other."""
    meanings = []
    for sentence in sentences:
        sides = tuple(side for side in ("left", "right") if side in sentence)
        short = len(sentence.split()) <= _SHORT
        meanings.append((actions_of(sentence), sides) if short and actions_of(sentence) else (sentence, ()))
    out = np.array([[a == b for b in meanings] for a in meanings])
    np.fill_diagonal(out, False)
    return out


def train_ranker(
    config: RankerTrainConfig, report: Callable[[dict[str, float]], None] | None = None,
    encoder: TextEncoder | None = None, progress: Callable[[str, float], None] | None = None,
) -> Path:  # fmt: skip
    """Train, or go on training, and return the path of the averaged weights.

    Raises:
        OptionError: A setting is out of range, or the run folder belongs to another network.
        FormatError: The data are missing or damaged.
    """
    progress = progress or (lambda stage, done: None)
    config.prepare()
    clips = load_people(config.data, progress)
    statistics = FeatureStatistics.measure([entry["features"] for entry in clips[0].values()])
    mixture = Mixture(creatures=0.0, borrowed=0.0)
    train, held = (
        ClipSet(some, statistics, split, mixture=mixture) for some, split in zip(clips, ("train", "val"), strict=True)
    )
    encoder = encoder or text_encoder(config.network.text_encoder)
    config = replace(config, network=for_encoder(config.network, encoder))
    bank = captions_of(config, encoder, {*train.sentences(), *held.sentences()}, progress)
    return RankerTrainer(config, train, bank, held).learn(report, progress)
