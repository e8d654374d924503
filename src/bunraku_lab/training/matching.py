"""A run that trains a network of `nn.diffusion.matching`, which the judge of the tables and the ranker both are.

A run folder holds `state.safetensors` (all that is needed to go on), a checkpoint (the averaged weights), `log.csv` and
the encoded captions. The same command goes on where a run stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import torch
import tyro

from bunraku.diffusion.extractor_config import ExtractorConfig
from bunraku.diffusion.features import FeatureStatistics
from bunraku.errors import OptionError
from bunraku.language.encoders import TextEncoder
from bunraku_lab.nn.diffusion.matching import Extractor, load_extractor, save_extractor
from bunraku_lab.training.rows.text_bank import TextBank
from bunraku_lab.training.runs.averaged_run import AveragedRun, TrainingNote
from bunraku_lab.training.runs.settings import StepSettings

__all__ = ["MatchingRun", "MatchingTrainConfig", "captions_of", "for_encoder", "start_from"]


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
        """See `TrainingSettings.prepare`."""
        if self.batch < 2 or self.threads < 1:
            raise OptionError("batch must be 2 or more, threads 1 or more")
        super().prepare()


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

    columns = None
    least = 0.01
    flush = True

    def __init__(
        self,
        config: MatchingTrainConfig,
        network: ExtractorConfig,
        statistics: FeatureStatistics,
        bank: TextBank,
        clips: int,
        kind: str,
    ):
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
        """The first columns of a row of the log."""
        return {"step": self.step, "minutes": self.seconds / 60}

    def write(self, note: TrainingNote) -> Path:
        """Write the checkpoint."""
        notes = {"steps": self.step, "minutes": round(self.seconds / 60, 1), "clips": self.clip_count}
        return save_extractor(self.checkpoint, self.average, notes | note["results"], self.kind)


def start_from(path: Path, model: Extractor, kind: str) -> None:
    """Give a new network the weights and the units of a checkpoint.

    Args:
        path: The checkpoint.
        model: The new network.
        kind: Of the checkpoint.

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
    config: MatchingTrainConfig,
    encoder: TextEncoder,
    sentences: Collection[str],
    progress: Callable[[str, float], None],
) -> TextBank:
    """The sentences of a run, encoded once and kept in its folder."""
    path = config.out / "captions.safetensors"
    return TextBank(encoder, sorted(sentences), path, lambda done, total: progress("captions", done / total))
