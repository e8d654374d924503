"""`bunraku train`: the networks. Their options are the dataclasses of their training modules."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class Training:
    """A network that can be trained.

    Args:
        module: Under `bunraku_lab`.
        settings: The class of its settings.
        function: Trains by them; takes `report` and `progress`.
        network: What is trained.
        example: Options of an example.
        note: What else its help says.
    """

    module: str
    settings: str
    function: str
    network: str
    example: str
    note: str = ""

    def load(self) -> tuple[type, Callable[[Any], None]]:
        """The settings, and what trains by them, prints the rows of its log and shows how far it is."""
        module = import_module(f"bunraku_lab.{self.module}")
        train = getattr(module, self.function)

        def print_row(row: dict[str, float]) -> None:
            print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), file=sys.stderr, flush=True)

        def run(config: Any) -> None:
            from bunraku.cli.shared import stages  # loads what draws bars

            with stages() as report:
                path = train(config, report=print_row, progress=report)
            print(f"wrote {path}")

        return getattr(module, self.settings), run


TRAININGS: dict[str, Training] = {
    "handles": Training(
        "training.handles", "HandleTrainConfig", "train_handles", "the Mesh Handle Predictor (section 3.1 of TapMo)",
        "--cache data/characters --out runs/handles",
    ),
    "orientation": Training(
        "training.orientation", "OrientationTrainConfig", "train_orientation",
        "the network that knows which way up a character belongs and which way it faces",
        "--cache data/characters --out runs/orientation",
    ),
    "diffusion": Training(
        "training.diffusion.train", "TrainingConfig", "train_diffusion",
        "the Shape-aware Motion Diffusion (section 3.2 of TapMo)",
        "--data data/motions --out runs/diffusion --minutes 240",
        "The preset \"small\" trains on a processor in hours.",
    ),
    "few-steps": Training(
        "training.few_steps.train", "FewStepsConfig", "train_few_steps",
        "four steps that do what the denoiser does in many, guided by sentences and by the critic",
        "--data data/motions --mesh-bank data/mesh_bank.npz --out runs/few-steps",
        "What is learned is a small file beside the denoiser, which keeps its many steps.",
    ),
    "adaptation": Training(
        "training.adaptation.train", "AdaptationConfig", "train_adaptation",
        "the adaptation of motions to meshes on ARAP pseudo-labels (Eq. 10 and 11 of TapMo)",
        "--diffusion runs/diffusion/diffusion.safetensors --cache data/characters.npz --out runs/adaptation",
        "Only the linear layer of the adaptation learns.",
    ),
    "extractor": Training(
        "evaluation.motion.train_extractor", "ExtractorTrainConfig", "train_extractor",
        "the feature extractor that `bunraku evaluate motion` measures with (section A.2 of TapMo)",
        "--data data/motions --out runs/extractor", "A processor takes half an hour.",
    ),
    "ranker": Training(
        "training.matching", "RankerTrainConfig", "train_ranker",
        "the ranker, which chooses among the candidates that `bunraku animate` makes",
        "--data data/motions --out runs/ranker", "A processor takes half an hour.",
    ),
    "tagger": Training(
        "training.language", "TaggerTrainConfig", "train_tagger",
        "the tagger, which reads the words of other languages that the table of words does not have",
        "--pairs data/pairs --out runs/tagger",
        "A processor takes a quarter of an hour, most of it for the vectors of the English sentences.",
    ),
    "apparel-body": Training(
        "training.apparel.body", "BodyTrainConfig", "train_body",
        "the body network: skinning weights by geodesic attention (section 4.2 of MMDMC)",
        "--data data/apparel --meshes runs/apparel-meshes --out runs/apparel-body",
        "Its variants without geodesic distances and sorted by them are --network.geodesics none and sorted.",
    ),
    "apparel-refinement": Training(
        "training.apparel.refinement", "RefinementTrainConfig", "train_refinement",
        "the joint refinement (section 4.4 of MMDMC), which merges what the body and the apparel network say",
        "--data data/apparel --out runs/apparel-refinement",
        "The other networks are the shipped ones, or those that are named.",
    ),
    "apparel": Training(
        "training.apparel.displacement", "DisplacementTrainConfig", "train_displacement",
        "the apparel displacement network (section 4.3 of MMDMC): the head that cannot drift, then what remembers",
        "--data data/apparel --out runs/apparel", "The paper's form is --network.frame world --head 0.",
    ),
    "nbs": Training(
        "training.baselines.nbs", "NbsTrainConfig", "train_nbs",
        "the skinning of Neural Blend Shapes (Li et al. 2021) with given joints, a row of MMDMC's table 2",
        "--data data/apparel --out runs/nbs",
    ),
    "transfer-baseline": Training(
        "training.baselines.transfer", "TransferTrainConfig", "train_transfer",
        "Skeleton-free Pose Transfer (Liao et al. 2022), a row of both papers' tables",
        "--preset sfpt --data data/motions --characters archive --out runs/sfpt",
    ),
}  # fmt: skip


def __getattr__(name: str) -> Callable[[], tuple[type, Callable[[Any], None]]]:
    """The verb of a training: a function that gives its settings and what trains by them; its help is the docstring."""
    if name not in TRAININGS:
        raise AttributeError(name)
    training = TRAININGS[name]

    def verb() -> tuple[type, Callable[[Any], None]]:
        return training.load()

    verb.__doc__ = (
        f"Train {training.network}.\n\nThe same command goes on where a run stopped. {training.note}\n\n"
        f"Example: bunraku train {name} {training.example}"
    )
    return verb
