"""`bunraku train`: the networks. Their options are the dataclasses of their training modules."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from bunraku.cli.output.progress import stages

__all__ = [
    "adaptation",
    "apparel",
    "apparel_body",
    "apparel_mask",
    "apparel_refinement",
    "diffusion",
    "extractor",
    "handles",
    "orientation",
    "ranker",
]


def handles() -> tuple[type, Callable[[Any], None]]:
    """Train the Mesh Handle Predictor (section 3.1 of TapMo).

    The same command goes on where a run stopped.

    Example: bunraku train handles --cache data/characters --out runs/handles
    """
    from bunraku_lab.training.handles.train import HandleTrainConfig, train_handles

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
    from bunraku_lab.training.orientation.train import OrientationTrainConfig, train_orientation

    def log(row: dict[str, float]) -> None:
        print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), file=sys.stderr, flush=True)

    return OrientationTrainConfig, lambda config: print(f"wrote {train_orientation(config, log)}")


def diffusion() -> tuple[type, Callable[[Any], None]]:
    """Train the Shape-aware Motion Diffusion (section 3.2 of TapMo).

    The same command goes on where a run stopped. The preset "small" trains on a processor in hours. Several GPUs or
    processes train together under `accelerate launch -m bunraku train diffusion ...`.

    Example: bunraku train diffusion --data data/motions --out runs/diffusion --minutes 240
    """
    from bunraku_lab.training.diffusion.train import TrainingConfig, train_diffusion

    return TrainingConfig, lambda config: print(f"wrote {train_diffusion(config)}")


def adaptation() -> tuple[type, Callable[[Any], None]]:
    """Fine-tune the adaptation of motions to meshes on ARAP pseudo-labels (Eq. 10 and 11 of TapMo).

    Only the linear layer of the adaptation learns. The same command goes on where a run stopped.

    Example: bunraku train adaptation --diffusion runs/diffusion/diffusion.safetensors --cache data/characters.npz --out
    runs/adaptation
    """
    from bunraku_lab.training.adaptation.train import AdaptationConfig, train_adaptation

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
    from bunraku_lab.evaluation.motion.train_extractor import ExtractorTrainConfig, train_extractor

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
    from bunraku_lab.training.ranker.train import RankerTrainConfig, train_ranker

    def run(config: RankerTrainConfig) -> None:
        def log(row: dict[str, float]) -> None:
            print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), file=sys.stderr, flush=True)

        with stages() as report:
            path = train_ranker(config, log, progress=report)
        print(f"wrote {path}")

    return RankerTrainConfig, run


def apparel_mask() -> tuple[type, Callable[[Any], None]]:
    """Train the apparel segmentation network (section 4.1 of MMDMC) on characters of the wardrobe.

    The same command goes on where a run stopped. No motion and no physics are needed.

    Example: bunraku train apparel-mask --out runs/apparel-mask
    """
    from bunraku_lab.training.apparel.segmentation import SegmentationTrainConfig, train_segmentation

    return SegmentationTrainConfig, lambda config: print(f"wrote {train_segmentation(config, _told)}")


def apparel_body() -> tuple[type, Callable[[Any], None]]:
    """Train the body network: skinning weights by geodesic attention (section 4.2 of MMDMC).

    The same command goes on where a run stopped. Its variants without geodesic distances and sorted by them are
    --network.geodesics none and sorted.

    Example: bunraku train apparel-body --data data/apparel --meshes runs/apparel-mask-meshes --out runs/apparel-body
    """
    from bunraku_lab.training.apparel.body import BodyTrainConfig, train_body

    return BodyTrainConfig, lambda config: print(f"wrote {train_body(config, _told)}")


def apparel_refinement() -> tuple[type, Callable[[Any], None]]:
    """Train the joint refinement (section 4.4 of MMDMC), which merges what the body and the apparel network say.

    The same command goes on where a run stopped. The other networks are the shipped ones, or those that are named.

    Example: bunraku train apparel-refinement --data data/apparel --out runs/apparel-refinement
    """
    from bunraku_lab.training.apparel.refinement import RefinementTrainConfig, train_refinement

    return RefinementTrainConfig, lambda config: print(f"wrote {train_refinement(config, _told)}")


def apparel() -> tuple[type, Callable[[Any], None]]:
    """Train the apparel displacement network (section 4.3 of MMDMC): the head that cannot drift, then what remembers.

    The same command goes on where a run stopped. The paper's form is --network.frame world --head 0.

    Example: bunraku train apparel --data data/apparel --out runs/apparel
    """
    from bunraku_lab.training.apparel.displacement import DisplacementTrainConfig, train_displacement

    return DisplacementTrainConfig, lambda config: print(f"wrote {train_displacement(config, _told)}")


def _told(row: dict[str, float]) -> None:
    print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), file=sys.stderr, flush=True)
