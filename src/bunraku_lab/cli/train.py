"""`bunraku train`: the networks. Their options are the dataclasses of their training modules."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bunraku.cli.outputs import stages

__all__ = [
    "adaptation",
    "apparel",
    "apparel_body",
    "apparel_mask",
    "apparel_refinement",
    "diffusion",
    "extractor",
    "few_steps",
    "handles",
    "nbs",
    "orientation",
    "ranker",
    "tagger",
    "transfer_baseline",
]

Verb = tuple[type, Callable[[Any], None]]


def handles() -> Verb:
    """Train the Mesh Handle Predictor (section 3.1 of TapMo).

    The same command goes on where a run stopped.

    Example: bunraku train handles --cache data/characters --out runs/handles
    """
    from bunraku_lab.training.handles import HandleTrainConfig, train_handles

    return _verb(HandleTrainConfig, train_handles)


def orientation() -> Verb:
    """Train the network that knows which way up a character belongs and which way it faces.

    The same command goes on where a run stopped.

    Example: bunraku train orientation --cache data/characters --out runs/orientation
    """
    from bunraku_lab.training.orientation import OrientationTrainConfig, train_orientation

    return _verb(OrientationTrainConfig, train_orientation)


def diffusion() -> Verb:
    """Train the Shape-aware Motion Diffusion (section 3.2 of TapMo).

    The same command goes on where a run stopped. The preset "small" trains on a processor in hours.

    Example: bunraku train diffusion --data data/motions --out runs/diffusion --minutes 240
    """
    from bunraku_lab.training.diffusion.train import TrainingConfig, train_diffusion

    return TrainingConfig, lambda config: print(f"wrote {train_diffusion(config)}")


def few_steps() -> Verb:
    """Distil the denoiser into four steps, with guidance by sentences and by the critic in the weights.

    What is learned is a small file beside the denoiser, which keeps its many steps. The same command goes on where a
    run stopped.

    Example: bunraku train few-steps --data data/motions --mesh-bank data/mesh_bank.npz --out runs/few-steps
    """
    from bunraku_lab.training.few_steps.train import FewStepsConfig, train_few_steps

    return _verb(FewStepsConfig, train_few_steps)


def adaptation() -> Verb:
    """Fine-tune the adaptation of motions to meshes on ARAP pseudo-labels (Eq. 10 and 11 of TapMo).

    Only the linear layer of the adaptation learns. The same command goes on where a run stopped.

    Example: bunraku train adaptation --diffusion runs/diffusion/diffusion.safetensors --cache data/characters.npz --out
    runs/adaptation
    """
    from bunraku_lab.training.adaptation.train import AdaptationConfig, train_adaptation

    return _verb(AdaptationConfig, train_adaptation)


def extractor() -> Verb:
    """Train the feature extractor that `bunraku evaluate motion` measures with (section A.2 of TapMo).

    The same command goes on where a run stopped. A processor takes half an hour.

    Example: bunraku train extractor --data data/motions --out runs/extractor
    """
    from bunraku_lab.evaluation.motion.train_extractor import ExtractorTrainConfig, train_extractor

    return _verb(ExtractorTrainConfig, train_extractor)


def ranker() -> Verb:
    """Train the ranker, which chooses among the candidates that `bunraku animate` makes.

    The same command goes on where a run stopped. A processor takes half an hour.

    Example: bunraku train ranker --data data/motions --out runs/ranker
    """
    from bunraku_lab.training.matching import RankerTrainConfig, train_ranker

    return _verb(RankerTrainConfig, train_ranker)


def tagger() -> Verb:
    """Train the tagger, which reads the words of other languages that the table of words does not have.

    The same command goes on where a run stopped. A processor takes a quarter of an hour, most of it for the vectors of
    the English sentences.

    Example: bunraku train tagger --pairs data/pairs --out runs/tagger
    """
    from bunraku_lab.training.language import TaggerTrainConfig, train_tagger

    return _verb(TaggerTrainConfig, train_tagger)


def apparel_mask() -> Verb:
    """Train the apparel segmentation network (section 4.1 of MMDMC) on characters of the wardrobe.

    The same command goes on where a run stopped. No motion and no physics are needed.

    Example: bunraku train apparel-mask --out runs/apparel-mask
    """
    from bunraku_lab.training.apparel.segmentation import SegmentationTrainConfig, train_segmentation

    return _verb(SegmentationTrainConfig, train_segmentation)


def apparel_body() -> Verb:
    """Train the body network: skinning weights by geodesic attention (section 4.2 of MMDMC).

    The same command goes on where a run stopped. Its variants without geodesic distances and sorted by them are
    --network.geodesics none and sorted.

    Example: bunraku train apparel-body --data data/apparel --meshes runs/apparel-mask-meshes --out runs/apparel-body
    """
    from bunraku_lab.training.apparel.body import BodyTrainConfig, train_body

    return _verb(BodyTrainConfig, train_body)


def apparel_refinement() -> Verb:
    """Train the joint refinement (section 4.4 of MMDMC), which merges what the body and the apparel network say.

    The same command goes on where a run stopped. The other networks are the shipped ones, or those that are named.

    Example: bunraku train apparel-refinement --data data/apparel --out runs/apparel-refinement
    """
    from bunraku_lab.training.apparel.refinement import RefinementTrainConfig, train_refinement

    return _verb(RefinementTrainConfig, train_refinement)


def apparel() -> Verb:
    """Train the apparel displacement network (section 4.3 of MMDMC): the head that cannot drift, then what remembers.

    The same command goes on where a run stopped. The paper's form is --network.frame world --head 0.

    Example: bunraku train apparel --data data/apparel --out runs/apparel
    """
    from bunraku_lab.training.apparel.displacement import DisplacementTrainConfig, train_displacement

    return _verb(DisplacementTrainConfig, train_displacement)


def nbs() -> Verb:
    """Train Neural Blend Shapes (Li et al. 2021) with given joints, a row of MMDMC's table 2.

    The same command goes on where a run stopped. The skinning branch is trained first; --start SKINNING
    --network.shapes 9 trains the blend shapes on top of it.

    Example: bunraku train nbs --data data/apparel --out runs/nbs
    """
    from bunraku_lab.training.baselines.nbs import NbsTrainConfig, train_nbs

    return _verb(NbsTrainConfig, train_nbs)


def transfer_baseline() -> Verb:
    """Train Skeleton-free Pose Transfer (Liao et al. 2022), a row of both papers' tables.

    The same command goes on where a run stopped. --preset sfpt is the whole recipe, for a GPU.

    Example: bunraku train transfer-baseline --preset sfpt-small --data data/motions --characters archive --out
    runs/sfpt
    """
    from bunraku_lab.training.baselines.transfer import TransferTrainConfig, train_transfer

    return _verb(TransferTrainConfig, train_transfer)


def _verb(settings: type, train: Callable[..., Path]) -> Verb:
    """Settings, and what trains by them, prints the rows of its log and shows how far it is."""

    def shown(row: dict[str, float]) -> None:
        print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), file=sys.stderr, flush=True)

    def run(config: Any) -> None:
        with stages() as report:
            path = train(config, report=shown, progress=report)
        print(f"wrote {path}")

    return settings, run
