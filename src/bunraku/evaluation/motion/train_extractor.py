"""Training of the feature extractor: a motion and its sentence are drawn together, all other pairs of the batch apart.

The loss is the cross-entropy of finding the sentence among the batch's and the motion among the batch's (InfoNCE, as in
TMR, Petrovich et al. 2023). Pairs that mean the same do not count as wrong. Batches hold motions of about one length,
so that length tells nothing. Only clips of the training split are seen, and of these only captured motions of people.

A run folder holds `state.safetensors` (all that is needed to go on), `extractor.safetensors` (the averaged weights),
`log.csv` and the encoded captions. The same command goes on where a run stopped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from bunraku.diffusion.features import FeatureStatistics
from bunraku.diffusion.matching import (
    RADIUS,
    Extractor,
    ExtractorConfig,
    embed_motions,
    embed_sentences,
    save_extractor,
)
from bunraku.errors import OptionError
from bunraku.evaluation.motion.metrics import r_precision
from bunraku.evaluation.motion.windows import Window, candidate_sentences, draw_windows, window_features
from bunraku.language.captions import caption_variants
from bunraku.language.encoders import TextEncoder, text_encoder
from bunraku.nn.checkpoints import TrainingState, save_training_state
from bunraku.nn.runs import append_row, careful_step, follow_weights, learning_rate, plain_settings, resumed
from bunraku.training.diffusion.clip_data import load_clips
from bunraku.training.diffusion.text_bank import TextBank

__all__ = ["ExtractorTrainConfig", "ExtractorTrainer", "people", "retrieval_of", "train_extractor"]


@dataclass(frozen=True)
class ExtractorTrainConfig:
    """Settings of a training run.

    Args:
        data: Folder that `bunraku data motions` wrote.
        out: Folder of the run; the same folder goes on with the same run.
        minutes: Stop after this much processor time, over all sittings; the learning rate falls to nothing by then.
        steps: Stop after so many steps, where `minutes` is 0.
        threads: CPU threads.
        device: Where to train.
        batch: Pairs a step.
        rate: Peak learning rate of AdamW.
        warmup: Steps until the peak.
        weight_decay: Of AdamW.
        ema: Decay of the running mean of the weights, which is what is validated and saved.
        shortest: Frames; clips with fewer are left out.
        bf16: Compute in bfloat16 where torch says it is safe.
        validate_every: Steps between validations and saved states.
        seed: Of everything random.
    """

    data: Path = Path("runs/data/motions")
    out: Path = Path("runs/extractor")
    minutes: float = 25.0
    steps: int = 3000
    threads: int = 1
    device: str = "cpu"
    batch: int = 96
    rate: float = 6e-4
    warmup: int = 100
    weight_decay: float = 0.05
    ema: float = 0.998
    shortest: int = 24
    bf16: bool = True
    validate_every: int = 200
    seed: int = 0
    extractor: ExtractorConfig = field(default_factory=ExtractorConfig)


def people(clips: Mapping[str, dict[str, Any]], split: str) -> dict[str, dict[str, Any]]:
    """Captured motions of people of one split: no creature, and no labelled action of a game character, of which each
    has many captions that mean the same.
    """
    others = ("species", "character", "action")
    return {
        name: entry
        for name, entry in clips.items()
        if entry.get("split", "train") == split and not any(entry.get(key) for key in others)
    }


def retrieval_of(
    model: Extractor,
    encoder: TextEncoder,
    clips: Mapping[str, Mapping[str, Any]],
    windows: Sequence[Window],
    candidates: int = 32,
    seed: int = 0,
) -> tuple[float, float, float]:
    """Top-1, top-2 and top-3 R-Precision of real windows."""
    random = np.random.default_rng([seed, 3])
    rows = candidate_sentences(list(windows), clips, candidates, random)
    text = embed_sentences(model, encoder, [sentence for row in rows for sentence in row])
    vectors = embed_motions(model, [window_features(clips, window) for window in windows])
    return r_precision(vectors, np.stack([[text[sentence] for sentence in row] for row in rows]))


class ExtractorTrainer:
    """One training run in memory.

    Args:
        config: Settings.
        clips: To train on.
        bank: Their sentences, encoded.
    """

    def __init__(self, config: ExtractorTrainConfig, clips: Mapping[str, dict[str, Any]], bank: TextBank):
        self.config, self.clips, self.bank = config, clips, bank
        torch.manual_seed(config.seed)
        self.model = Extractor(config.extractor).to(config.device)
        statistics = FeatureStatistics.measure([entry["features"] for entry in clips.values()])
        self.model.mean.copy_(torch.from_numpy(statistics.mean))
        self.model.std.copy_(torch.from_numpy(statistics.std))
        self.average = Extractor(config.extractor).to(config.device).eval()
        self.average.load_state_dict(self.model.state_dict())
        self.optimizer = torch.optim.AdamW(
            self.model.parameters(), lr=config.rate, betas=(0.9, 0.98), weight_decay=config.weight_decay
        )
        self.step, self.seconds = 0, 0.0

    def progress(self) -> float:
        """How far the run is through its limits, 0 to 1."""
        done = (
            self.seconds / (60 * self.config.minutes)
            if self.config.minutes > 0
            else self.step / max(self.config.steps, 1)
        )
        return min(done, 1.0)

    def batch(self, number: int) -> list[Window]:
        """Batch `number` of the endless series of the seed: a quarter of four batches' windows, sorted by length."""
        size = self.config.batch
        random = np.random.default_rng([self.config.seed, number // 4])
        windows = draw_windows(self.clips, 4 * size, random, self.config.shortest)
        windows.sort(key=lambda window: window.frames)
        place = int(random.permutation(4)[number % 4])
        return windows[place * size : (place + 1) * size]

    def loss(self, windows: Sequence[Window]) -> tuple[Tensor, float]:
        """The loss of a batch and the share of motions that find their sentence first."""
        device = self.config.device
        lengths = torch.tensor([window.frames for window in windows])
        values = torch.zeros(len(windows), int(lengths.max()), self.model.config.features)
        for row, window in zip(values, windows, strict=True):
            row[: window.frames] = torch.from_numpy(
                np.ascontiguousarray(window_features(self.clips, window), np.float32)
            )
        with torch.autocast(torch.device(device).type, torch.bfloat16, enabled=self.config.bf16):
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

    def train_step(self) -> dict[str, float]:
        """One step of the optimiser."""
        start, config = time.process_time(), self.config
        self.model.train()
        rate = learning_rate(config.rate, self.step, config.warmup, self.progress(), least=0.01)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        loss, won = self.loss(self.batch(self.step))
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        careful_step(self.model, self.optimizer)
        self.step += 1
        follow_weights(self.average, self.model, min(config.ema, self.step / (self.step + 10)))
        self.seconds += time.process_time() - start
        return {"loss": float(loss.detach()), "won": won, "rate": rate}

    def save(self, results: dict[str, float]) -> Path:
        """Write the training state and the checkpoint; a kill leaves the last ones."""
        out, settings = Path(self.config.out), plain_settings(asdict(self.config))
        models = {"model": self.model.state_dict(), "average": self.average.state_dict()}
        state = TrainingState(
            self.step, models, {"adam": self.optimizer.state_dict()}, settings, {"seconds": self.seconds}
        )
        save_training_state(out / "state.safetensors", state)
        notes = {"steps": self.step, "minutes": round(self.seconds / 60, 1), "clips": len(self.clips), **results}
        return save_extractor(out / "extractor.safetensors", self.average, notes)

    def restore(self) -> bool:
        """Go on from the run folder's state where there is one.

        Raises:
            OptionError: The run was started with another network.
        """
        try:
            state = resumed(Path(self.config.out), self.model, self.average, self.optimizer)
        except (RuntimeError, ValueError) as error:
            raise OptionError(
                f"{self.config.out}: this run was started with another network; give the same settings, or another "
                "folder"
            ) from error
        if state is None:
            return False
        self.step, self.seconds = state.step, float(state.values["seconds"])
        return True


def _sentences(clips: Mapping[str, Mapping[str, Any]]) -> list[str]:
    texts = {text for entry in clips.values() for text in entry["texts"]}
    return sorted(
        {sentence for text in texts for mirrored in (False, True) for sentence in caption_variants(text, mirrored)}
    )


def train_extractor(
    config: ExtractorTrainConfig,
    tell: Callable[[dict[str, float]], None] | None = None,
    encoder: TextEncoder | None = None,
    report: Callable[[str, float], None] | None = None,
) -> Path:
    """Train, or go on training, and return the path of the averaged weights.

    Args:
        config: The run.
        tell: Called with a row of the log at each validation.
        encoder: In place of the built-in text encoder.
        report: Called with a stage's name and the share done.

    Raises:
        OptionError: A setting is out of range, or the run folder belongs to another network.
        FormatError: The data are missing or damaged.
    """
    if config.batch < 2 or config.threads < 1 or config.minutes < 0 or config.steps < 1 or config.validate_every < 1:
        raise OptionError("batch must be 2 or more, threads, steps and validate-every 1 or more, minutes 0 or more")
    torch.set_num_threads(config.threads)
    report = report or (lambda stage, done: None)
    config.out.mkdir(parents=True, exist_ok=True)
    clips = load_clips(config.data, lambda done, total: report("clips", done / total), splits={"train", "val"})
    train, held = people(clips, "train"), people(clips, "val")
    if not train:
        raise OptionError(
            f"{config.data}: there are no training clips of people; build the data again with 'bunraku data motions'"
        )
    encoder = encoder or text_encoder()
    network = replace(
        config.extractor, text_encoder=encoder.name, text_size=encoder.token_size, pooled_size=encoder.pooled_size
    )
    config = replace(config, extractor=network)
    bank = TextBank(
        encoder,
        _sentences(train),
        config.out / "captions.safetensors",
        lambda done, total: report("captions", done / total),
    )
    trainer = ExtractorTrainer(config, train, bank)
    trainer.restore()
    windows, candidates = _validation(held)
    torch.set_flush_denormal(True)
    rows: list[dict[str, float]] = []
    path = trainer.save({}) if not trainer.step else config.out / "extractor.safetensors"
    try:
        while trainer.progress() < 1:
            rows.append(trainer.train_step())
            if trainer.step % config.validate_every == 0 or trainer.progress() >= 1:
                row = {
                    "step": trainer.step,
                    "minutes": trainer.seconds / 60,
                    **{key: float(np.mean([r[key] for r in rows])) for key in rows[0]},
                }
                results = {}
                if windows:
                    tops = retrieval_of(trainer.average, encoder, held, windows, candidates)
                    results = {
                        "validation_candidates": candidates,
                        "validation_top1": tops[0],
                        "validation_top3": tops[2],
                    }
                row |= results
                append_row(config.out / "log.csv", row)
                path, rows = trainer.save(results), []
                if tell is not None:
                    tell(row)
            report("training", trainer.progress())
    finally:
        torch.set_flush_denormal(False)
    return path


def _validation(clips: Mapping[str, dict[str, Any]]) -> tuple[list[Window], int]:
    """Fixed windows of the validation clips, and how many candidates their meanings allow, at most 32."""
    try:
        windows = draw_windows(clips, 256, np.random.default_rng(5), 24)
    except OptionError:
        return [], 0
    most = max(len(set(clips[window.clip]["texts"])) for window in windows)
    candidates = min(32, len({window.meaning for window in windows}) - most)
    return (windows, candidates) if candidates >= 2 else ([], 0)
