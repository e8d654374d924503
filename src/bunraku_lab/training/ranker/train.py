"""Training of the ranker, which chooses among the candidates that `animate` makes.

It is the network of `nn.diffusion.matching`, trained on the rows that the denoiser trains on, apart from the judge of
the tables. A motion finds its sentence among the batch's and the same with left and right exchanged; a sentence finds
its motion among the batch's and spoilt ones: mirrored, played backwards, too small, trembling, done twice. Those are
what generators do wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from bunraku.diffusion.extractor_config import RADIUS, RANKER, ExtractorConfig
from bunraku.diffusion.features import FeatureStatistics, mirror
from bunraku.language.captions.phrases import mirror_words
from bunraku.language.encoders import TextEncoder, text_encoder
from bunraku.language.lexicon.reading import actions_of
from bunraku_lab.nn.diffusion.matching import Extractor
from bunraku_lab.training.matching import MatchingRun, MatchingTrainConfig, captions_of, for_encoder
from bunraku_lab.training.rows.clip_data import load_people
from bunraku_lab.training.rows.clip_rows import ClipSet, Mixture, MotionBatch
from bunraku_lab.training.rows.text_bank import TextBank
from bunraku_lab.training.runs.half_precision import bf16_is_fast

__all__ = ["RankerTrainConfig", "RankerTrainer", "spoilt", "train_ranker"]

_SHORT = 7
"""Words up to which sentences that say the same actions mean the same."""


@dataclass(frozen=True, kw_only=True)
class RankerTrainConfig(MatchingTrainConfig):
    """Settings of a training run: those of `MatchingTrainConfig`, and `network`."""

    out: Path = Path("runs/ranker")
    batch: int = 80
    network: ExtractorConfig = field(default_factory=ExtractorConfig)


def spoilt(values: np.ndarray, random: np.random.Generator, sided: bool) -> np.ndarray:
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
    """One training run in memory.

    Args:
        config: Settings.
        rows: Training rows; their statistics are the network's units.
        bank: Their sentences, encoded.
        held: Rows of clips that no training sees.
    """

    config: RankerTrainConfig

    def __init__(self, config: RankerTrainConfig, rows: ClipSet, bank: TextBank, held: ClipSet | None = None):
        self.rows, self.held = rows, held
        self.held_out = held.clips if held is not None and len(held.clips) > 1 else []
        super().__init__(config, config.network, rows.statistics, bank, len(rows.clips), RANKER)

    def losses(self, model: Extractor, batch: MotionBatch, random: np.random.Generator) -> tuple[Tensor, float, float]:
        """The loss of a batch, the share of motions that find their sentence first, and of sentences that find their
        motion first.
        """
        size, device = len(batch.lengths), self.config.device
        turned = [mirror_words(sentence) for sentence in batch.sentences]
        sided = np.array([a != b for a, b in zip(batch.sentences, turned, strict=True)])
        wrong = [
            spoilt(batch.values[row, :length], random, bool(sided[row])) for row, length in enumerate(batch.lengths)
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
    config: RankerTrainConfig,
    report: Callable[[dict[str, float]], None] | None = None,
    encoder: TextEncoder | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Path:
    """Train, or go on training, and return the path of the averaged weights.

    Args:
        config: The run.
        report: Called with a row of the log at each validation.
        encoder: In place of the built-in text encoder.
        progress: Called with a stage's name and the share done.

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
