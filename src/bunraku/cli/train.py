"""`bunraku train`: the networks. Their options are the dataclasses of their training modules."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from bunraku.cli.progress import stages

__all__ = ["adaptation", "diffusion", "extractor", "handles", "orientation", "ranker"]


def handles() -> tuple[type, Callable[[Any], None]]:
    """Train the Mesh Handle Predictor (section 3.1 of TapMo).

    The same command goes on where a run stopped.

    Example: bunraku train handles --cache data/characters --out runs/handles
    """
    from bunraku.training.handles.train import HandleTrainConfig, train_handles

    def run(config: HandleTrainConfig) -> None:
        with stages() as report:

            def log(row: dict[str, float]) -> None:
                print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), file=sys.stderr, flush=True)
                spent = row["seconds"] / (60 * config.minutes) if config.minutes > 0 else 0.0
                report("training", min(max(spent, row["epoch"] / config.epochs), 1.0))

            path = train_handles(config, log)
        print(f"wrote {path}")

    return HandleTrainConfig, run


def orientation() -> tuple[type, Callable[[Any], None]]:
    """Train the network that knows which way up a character belongs and which way it faces.

    The same command goes on where a run stopped.

    Example: bunraku train orientation --cache data/characters --out runs/orientation
    """
    from bunraku.training.orientation.train import OrientationTrainConfig, train_orientation

    def log(row: dict[str, float]) -> None:
        print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), file=sys.stderr, flush=True)

    return OrientationTrainConfig, lambda config: print(f"wrote {train_orientation(config, log)}")


def diffusion() -> tuple[type, Callable[[Any], None]]:
    """Train the Shape-aware Motion Diffusion (section 3.2 of TapMo).

    The same command goes on where a run stopped. The preset "small" trains on a processor in hours. Several GPUs or
    processes train together under `accelerate launch -m bunraku train diffusion ...`.

    Example: bunraku train diffusion --data data/motions --out runs/diffusion --minutes 240
    """
    from bunraku.training.diffusion.train import TrainingConfig, train_diffusion

    return TrainingConfig, lambda config: print(f"wrote {train_diffusion(config)}")


def adaptation() -> tuple[type, Callable[[Any], None]]:
    """Fine-tune the adaptation of motions to meshes on ARAP pseudo-labels (Eq. 10 and 11 of TapMo).

    Only the linear layer of the adaptation learns. The same command goes on where a run stopped.

    Example: bunraku train adaptation --diffusion runs/diffusion/diffusion.safetensors --cache data/characters.npz --out
    runs/adaptation
    """
    from bunraku.training.adaptation.train import AdaptationConfig, train_adaptation

    def run(config: AdaptationConfig) -> None:
        with stages() as report:

            def log(row: dict[str, float]) -> None:
                print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), file=sys.stderr, flush=True)

            path = train_adaptation(config, log, report)
        print(f"wrote {path}")

    return AdaptationConfig, run


def extractor() -> tuple[type, Callable[[Any], None]]:
    """Train the feature extractor that `bunraku evaluate motion` measures with (section A.2 of TapMo).

    The same command goes on where a run stopped. A processor takes half an hour.

    Example: bunraku train extractor --data data/motions --out runs/extractor
    """
    from bunraku.evaluation.motion.train_extractor import ExtractorTrainConfig, train_extractor

    def run(config: ExtractorTrainConfig) -> None:
        with stages() as report:

            def log(row: dict[str, float]) -> None:
                print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), file=sys.stderr, flush=True)

            path = train_extractor(config, log, report=report)
        print(f"wrote {path}")

    return ExtractorTrainConfig, run


def ranker() -> tuple[type, Callable[[Any], None]]:
    """Train the ranker, which chooses among the candidates that `bunraku animate` makes.

    The same command goes on where a run stopped. A processor takes half an hour.

    Example: bunraku train ranker --data data/motions --out runs/ranker
    """
    from bunraku.training.ranker.train import RankerTrainConfig, train_ranker

    def run(config: RankerTrainConfig) -> None:
        def log(row: dict[str, float]) -> None:
            print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), file=sys.stderr, flush=True)

        with stages() as report:
            path = train_ranker(config, log, progress=report)
        print(f"wrote {path}")

    return RankerTrainConfig, run
