"""Training of the feature extractor: a motion and its sentence are drawn together, all other pairs of the batch apart.

The loss is the cross-entropy of finding the sentence among the batch's and the motion among the batch's (InfoNCE, as in
TMR, Petrovich et al. 2023). Pairs that mean the same do not count as wrong. Batches hold motions of about one length,
so that length tells nothing. Only clips of the training split are seen, and of these only captured motions of people.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from bunraku.errors import OptionError
from bunraku.generation.extractor import KIND, RADIUS, Extractor, ExtractorConfig, embed_motions
from bunraku.generation.features import FeatureStatistics
from bunraku.language.encoders import TextEncoder, text_encoder
from bunraku_lab.description.captions import caption_variants
from bunraku_lab.evaluation.motion.metrics import r_precision
from bunraku_lab.evaluation.motion.samples import Window, candidate_sentences, draw_windows, window_features
from bunraku_lab.nn.text import embed_sentences, running_extractor
from bunraku_lab.training.matching import MatchingRun, MatchingTrainConfig, captions_of, for_encoder
from bunraku_lab.training.rows.banks import TextBank
from bunraku_lab.training.rows.clips import ClipEntry, load_people
from bunraku_lab.training.runs.run import bf16_is_fast


@dataclass(frozen=True, kw_only=True)
class ExtractorTrainConfig(MatchingTrainConfig):
    """Settings of a training run: those of `MatchingTrainConfig`, and these.

    Args:
        shortest: Frames; clips with fewer are left out.
        extractor: The network.
    """

    out: Path = Path("runs/extractor")
    shortest: int = 24
    extractor: ExtractorConfig = field(default_factory=ExtractorConfig)


def retrieval_of(
    model: Extractor, encoder: TextEncoder, clips: Mapping[str, ClipEntry], windows: Sequence[Window],
    candidates: int = 32, seed: int = 0,
) -> tuple[float, float, float]:  # fmt: skip
    """Top-1, top-2 and top-3 R-Precision of real windows."""
    random = np.random.default_rng([seed, 3])
    rows = candidate_sentences(list(windows), clips, candidates, random)
    text = embed_sentences(model, encoder, [sentence for row in rows for sentence in row])
    vectors = embed_motions(model, [window_features(clips, window) for window in windows])
    return r_precision(vectors, np.stack([[text[sentence] for sentence in row] for row in rows]))


class ExtractorTrainer(MatchingRun):
    """One training run in memory."""

    config: ExtractorTrainConfig
    held: Mapping[str, ClipEntry]
    candidates: int
    encoder: TextEncoder

    def __init__(self, config: ExtractorTrainConfig, clips: Mapping[str, ClipEntry], bank: TextBank):
        self.clips = clips
        statistics = FeatureStatistics.measure([entry["features"] for entry in clips.values()])
        super().__init__(config, config.extractor, statistics, bank, len(clips), KIND)

    def batch(self, number: int) -> list[Window]:
        """Batch `number` of the endless series of the seed: a quarter of four batches' windows, sorted by length."""
        size = self.config.batch
        random = np.random.default_rng([self.config.seed, number // 4])
        windows = draw_windows(self.clips, 4 * size, random, self.config.shortest)
        windows.sort(key=lambda window: window.frames)
        index = int(random.permutation(4)[number % 4])
        return windows[index * size : (index + 1) * size]

    def loss(self, windows: Sequence[Window]) -> tuple[Tensor, float]:
        """The loss of a batch and the share of motions that find their sentence first."""
        device = self.config.device
        lengths = torch.tensor([window.frames for window in windows])
        values = torch.zeros(len(windows), int(lengths.max()), self.model.config.features)
        for row, window in zip(values, windows, strict=True):
            row[: window.frames] = torch.from_numpy(
                np.ascontiguousarray(window_features(self.clips, window), np.float32)
            )
        bf16 = self.config.bf16 and bf16_is_fast(device)
        with torch.autocast(torch.device(device).type, torch.bfloat16, enabled=bf16):
            motion = self.model.motion(values.to(device), lengths.to(device))
            text = self.model.text(self.bank([window.sentence for window in windows]).to(device))
        logits = self.model.log_scale.exp().clamp(max=50) * (motion @ text.T) / RADIUS**2
        meanings = [window.meaning for window in windows]
        same = torch.tensor([[a == b for b in meanings] for a in meanings], device=device) & ~torch.eye(
            len(windows), dtype=torch.bool, device=device
        )
        logits = logits.masked_fill(same, -1e4)
        target = torch.arange(len(windows), device=device)
        loss = 0.5 * (F.cross_entropy(logits, target) + F.cross_entropy(logits.T, target))
        return loss, float((logits.argmax(1) == target).float().mean())

    def step_loss(self) -> tuple[Tensor, dict[str, float]]:
        """The loss of the batch of this step, and the share of motions that find their sentence first."""
        loss, won = self.loss(self.batch(self.step))
        return loss, {"won": won}

    def validate(self) -> dict[str, float]:
        """R-Precision of the windows that are held out."""
        tops = retrieval_of(running_extractor(self.average), self.encoder, self.held, self.held_out, self.candidates)
        return {"validation_candidates": self.candidates, "validation_top1": tops[0], "validation_top3": tops[2]}


def _sentences(clips: Mapping[str, ClipEntry]) -> set[str]:
    texts = {text for entry in clips.values() for text in entry["texts"]}
    return {sentence for text in texts for mirrored in (False, True) for sentence in caption_variants(text, mirrored)}


def train_extractor(
    config: ExtractorTrainConfig, report: Callable[[dict[str, float]], None] | None = None,
    encoder: TextEncoder | None = None, progress: Callable[[str, float], None] | None = None,
) -> Path:  # fmt: skip
    """Train, or go on training, and return the path of the averaged weights.

    Raises:
        OptionError: A setting is out of range, or the run folder belongs to another network.
        FormatError: The data are missing or damaged.
    """
    progress = progress or (lambda stage, done: None)
    config.prepare()
    train, held = load_people(config.data, progress, labelled=False)
    encoder = encoder or text_encoder(config.extractor.text_encoder)
    config = replace(config, extractor=for_encoder(config.extractor, encoder))
    trainer = ExtractorTrainer(config, train, captions_of(config, encoder, _sentences(train), progress))
    trainer.held, (trainer.held_out, trainer.candidates), trainer.encoder = held, _validation(held), encoder
    return trainer.learn(report, progress)


def _validation(clips: Mapping[str, ClipEntry]) -> tuple[list[Window], int]:
    """Fixed windows of the validation clips, and how many candidates their meanings allow, at most 32."""
    try:
        windows = draw_windows(clips, 256, np.random.default_rng(5), 24)
    except OptionError:
        return [], 0
    most = max(len(set(clips[window.clip]["texts"])) for window in windows)
    candidates = min(32, len({window.meaning for window in windows}) - most)
    return (windows, candidates) if candidates >= 2 else ([], 0)
