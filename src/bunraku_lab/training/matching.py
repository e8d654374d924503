"""A run that trains a network of `diffusion.matching`, which the judge of the tables and the ranker both are.

A run folder holds `state.safetensors` (all that is needed to go on), a checkpoint (the averaged weights), `log.csv` and
the encoded captions. The same command goes on where a run stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bunraku.diffusion.features import FeatureStatistics
from bunraku.diffusion.matching import Extractor, ExtractorConfig, save_extractor
from bunraku.language.encoders import TextEncoder
from bunraku_lab.training.diffusion.text_bank import TextBank
from bunraku_lab.training.runs.averaged_run import AveragedRun, share_done
from bunraku_lab.training.runs.runs import append_row, plain_settings

__all__ = ["MatchingRun", "MatchingTrainConfig", "captions_of", "for_encoder"]


@dataclass(frozen=True)
class MatchingTrainConfig:
    """Settings of a training run.

    Args:
        data: Folder that `bunraku data motions` wrote.
        out: Folder of the run; the same folder goes on with the same run.
        minutes: Stop after this much processor time, over all sittings; the learning rate falls to nothing by then. 0
            counts steps instead.
        steps: Stop after so many steps, where `minutes` is 0.
        threads: CPU threads.
        device: Where to train.
        batch: Pairs a step.
        rate: Peak learning rate of AdamW.
        warmup: Steps until the peak.
        weight_decay: Of AdamW.
        ema: Decay of the running mean of the weights, which is what is validated and saved.
        bf16: Compute in bfloat16 where torch says it is safe and the device has it in hardware.
        validate_every: Steps between validations and saved states.
        seed: Of everything random.
    """

    data: Path = Path("runs/data/motions")
    out: Path = Path("runs/matching")
    minutes: float = 25.0
    steps: int = 3000
    threads: int = 1
    device: str = "cpu"
    batch: int = 96
    rate: float = 6e-4
    warmup: int = 100
    weight_decay: float = 0.05
    ema: float = 0.998
    bf16: bool = True
    validate_every: int = 200
    seed: int = 0


def for_encoder(network: ExtractorConfig, encoder: TextEncoder) -> ExtractorConfig:
    """The network that reads what a text encoder says."""
    return replace(
        network, text_encoder=encoder.name, text_size=encoder.token_size, pooled_size=encoder.pooled_size
    )  # fmt: skip


class MatchingRun(AveragedRun[Extractor]):
    """One training run in memory.

    Args:
        config: Settings.
        network: The network.
        statistics: Of the training motions; the network's units.
        bank: Their sentences, encoded.
        clips: How many they are, for the notes.
        kind: Of the checkpoint, and its name.
    """

    def __init__(
        self,
        config: MatchingTrainConfig,
        network: ExtractorConfig,
        statistics: FeatureStatistics,
        bank: TextBank,
        clips: int,
        kind: str,
    ):
        self.settings, self.bank, self.clip_count, self.kind = config, bank, clips, kind
        torch.manual_seed(config.seed)
        model = Extractor(network).to(config.device)
        model.mean.copy_(torch.from_numpy(statistics.mean))
        model.std.copy_(torch.from_numpy(statistics.std))
        average = Extractor(network).to(config.device)
        adam = torch.optim.AdamW(
            model.parameters(), lr=config.rate, betas=(0.9, 0.98), weight_decay=config.weight_decay
        )  # fmt: skip
        super().__init__(config.out, model, average, adam)

    @property
    def checkpoint(self) -> Path:
        """The averaged weights."""
        return self.out / f"{self.kind}.safetensors"

    def progress(self) -> float:
        """How far the run is through its limits, 0 to 1."""
        return share_done(self.seconds, self.settings.minutes, self.step, self.settings.steps)

    def step_loss(self) -> tuple[Tensor, dict[str, float]]:
        """The loss of the batch of this step, and what the log says of it besides."""
        raise NotImplementedError

    def train_step(self) -> dict[str, float]:
        """One step of the optimiser."""
        config = self.settings
        with self.timed():
            self.model.train()
            torch.manual_seed(1_000_003 * config.seed + self.step)  # dropout; a run that goes on draws the same
            rate = self.set_rate(config.rate, config.warmup, self.progress(), least=0.01)
            loss, figures = self.step_loss()
            loss.backward()  # type: ignore[no-untyped-call]
            self.update(config.ema)
        return {"loss": float(loss.detach()), **figures, "rate": rate}

    def save(self, results: dict[str, float]) -> Path:
        """Write the checkpoint, then the training state: who is killed between comes to both again."""
        notes = {"steps": self.step, "minutes": round(self.seconds / 60, 1), "clips": self.clip_count, **results}
        path = save_extractor(self.checkpoint, self.average, notes, self.kind)
        self.save_state(plain_settings(asdict(self.settings)), {})
        return path

    def run(
        self,
        validate: Callable[[], dict[str, float]],
        log: Callable[[dict[str, float]], None] | None,
        progress: Callable[[str, float], None],
    ) -> Path:
        """Go on from the folder's state to the end of the run, and return the path of the averaged weights.

        Args:
            validate: Figures of the running mean, for the log and the notes.
            log: Called with a row of the log at each validation.
            progress: Called with a stage's name and the share done.

        Raises:
            OptionError: The run was started with another network.
        """
        self.restore_state()
        if not self.step:
            self.save({})
        torch.set_flush_denormal(True)
        rows: list[dict[str, float]] = []
        try:
            while self.progress() < 1:
                rows.append(self.train_step())
                if self.step % self.settings.validate_every == 0 or self.progress() >= 1:
                    means = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
                    results, rows = validate(), []
                    line = {"step": self.step, "minutes": self.seconds / 60, **means, **results}
                    append_row(self.out / "log.csv", line)
                    self.save(results)
                    if log is not None:
                        log(line)
                progress("training", self.progress())
        finally:
            torch.set_flush_denormal(False)
        return self.checkpoint


def captions_of(
    config: MatchingTrainConfig,
    encoder: TextEncoder,
    sentences: Collection[str],
    progress: Callable[[str, float], None],
) -> TextBank:
    """The sentences of a run, encoded once and kept in its folder."""
    path = config.out / "captions.safetensors"
    return TextBank(encoder, sorted(sentences), path, lambda done, total: progress("captions", done / total))
