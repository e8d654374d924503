"""The rows of TapMo's table 2: how far edges change their lengths, by method, on characters that training saw and on
those that it never saw.

| row | motion | onto the character |
| --- | --- | --- |
| MDM-SR | ours, drawn for no mesh | the human skeleton embedded, rotations copied, bone heat |
| MDM-SR, limbs aligned first | the same | the same, limbs turned to the T-pose first |
| MDM-SFR | the same | Skeleton-free Pose Transfer, trained here |
| MDM-SFR, untrained | the same | the same networks before they learned |
| MDM-SFR, floor without training | the same | the body's part transforms on the predicted weights, as they are |
| without adaptation | ours | all stages but the adaptation |
| with an adaptation | ours, as its last layer was trained | the same |
| ours | ours | all stages, the last step of the adaptation on the very mesh |

All rows show motion of our network, so they differ in nothing but how it moves the mesh. The other methods' motion is
drawn for no mesh in particular, ours for the character, whose mesh feature the network sees. A character that the human
skeleton cannot be embedded in counts in the other rows, and the counts name it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.from_handles import skeleton_from_handles
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.errors import CharacterError
from bunraku.geometry.graph import unique_edges
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.baselines.skeletal_retarget import copied_motion, rig_by_embedding
from bunraku_lab.baselines.transfer_target import SourceMotion, TransferTarget, source_motion
from bunraku_lab.datasets.characters.build import HELD_OUT
from bunraku_lab.evaluation.motion.arap import ARAP_PROMPTS, STRIDE, animation_arap, arap_loss
from bunraku_lab.evaluation.motion.characters import Named, chosen_files, load_named
from bunraku_lab.evaluation.parts import Parts, at_once
from bunraku_lab.evaluation.tables.paper_table import EITHER_WAY, half_interval
from bunraku_lab.nn.baselines.pose_transfer import TransferConfig, TransferNetwork, load_transfer
from bunraku_lab.nn.diffusion.adapter import adapted_denoiser

if TYPE_CHECKING:
    from bunraku.diffusion.generation.networks import Networks

__all__ = [
    "NO_STAGES", "SFR", "DistortionConfig", "adapted_weights", "measure_distortion", "transferred_motion",
    "transfers_of",
]  # fmt: skip

SFR = "MDM-SFR"

NO_STAGES = Stages(**{each.name: False for each in fields(Stages)})
SEEN, UNSEEN = "A-L, seen", "A-L, unseen"


@dataclass(frozen=True)
class DistortionConfig:
    """What is measured.

    Args:
        characters: Folder of rigged characters.
        checkpoint: Weights of ours; None takes the shipped ones.
        adapters: Last layers of the adaptation (`nn.diffusion.adapter`) by the names of their rows.
        transfer: Weights of Skeleton-free Pose Transfer, for MDM-SFR.
        work: Folder for our weights with each of the last layers.
        count: Characters that training saw, and as many that it did not.
        prompts: Of `ARAP_PROMPTS`, so many.
        seconds: Length of each motion [s].
        seed: Of the motions.
    """

    characters: Path
    checkpoint: Path | None = None
    adapters: Mapping[str, Path] = field(default_factory=dict)
    transfer: Path | None = None
    work: Path = Path("runs/tables")
    count: int = 15
    prompts: int = 6
    seconds: float = 3.0
    seed: int = 0


def measure_distortion(
    config: DistortionConfig, progress: Callable[[str, float], None] | None = None, parts: Parts = at_once
) -> dict[str, dict[str, float]]:
    """Mean ARAP-Loss (Eq. 12) of each row, and how many characters could not be rigged.

    Raises:
        FormatError: There are no characters.
    """
    report = progress or (lambda stage, done: None)
    files = [file for unseen in (False, True) for file in chosen_files(config.characters, unseen, config.count)]
    characters = load_named(files, config.characters, progress=lambda done: report("handles", done))
    theirs = drawn_motions(config, config.checkpoint)
    found: dict[str, dict[bool, list[float]]] = {}
    failed = {False: 0, True: 0}
    for number, named in enumerate(characters):
        report("distortion", number / len(characters))
        unseen = named[0].partition("~")[0] in HELD_OUT
        losses = parts(named[0], partial(_losses, config, named, theirs))
        failed[unseen] += "MDM-SR" not in losses
        for row, value in losses.items():
            found.setdefault(row, {}).setdefault(unseen, []).append(value)
    for row, which, measure in _trained(config, theirs):
        for number, named in enumerate(characters):
            report(row, number / len(characters))
            unseen = named[0].partition("~")[0] in HELD_OUT
            value = parts(f"{named[0]} {row} {which}", partial(measure, named))
            found.setdefault(row, {}).setdefault(unseen, []).append(value)
    report("distortion", 1.0)
    kinds = ((False, SEEN), (True, UNSEEN))
    out: dict[str, dict[str, float]] = {}
    for row, losses in found.items():
        out[row] = {title: float(np.mean(losses[kind])) for kind, title in kinds if kind in losses}
        out[row] |= {f"{title} {EITHER_WAY}": half_interval(losses[kind]) for kind, title in kinds if kind in losses}
    counts = [sum(name.partition("~")[0] in HELD_OUT for name, *_ in characters), len(characters)]
    out["counts"] = {
        "seen": counts[1] - counts[0], "unseen": counts[0],
        "not embedded, seen": failed[False], "not embedded, unseen": failed[True],
    }  # fmt: skip
    return out


def _losses(config: DistortionConfig, named: Named, theirs: Sequence[HandleMotion]) -> dict[str, float]:
    """Mean ARAP-Loss of each row on one character, but for those of trained baselines and adaptations; without those of
    MDM-SR where it cannot be embedded.
    """
    _, character, handles = named
    anatomy = Anatomy.of(character, handles)
    ours = drawn_motions(config, config.checkpoint, handles.features)
    rows = (
        ("ours", ours, Stages(shape=True)),
        ("ours, without adaptation", ours, Stages(shape=False)),
        ("MDM-SFR, floor without training", theirs, NO_STAGES),
    )
    out = {row: float(np.mean([_fitted(motion, named, anatomy, how) for motion in own])) for row, own, how in rows}
    try:
        rigged = rig_by_embedding(character.vertices, character.faces)
    except CharacterError:
        return out
    for row, aligned in (("MDM-SR", False), ("MDM-SR, limbs aligned first", True)):
        copied = [_posed(copied_motion(rigged, _skeletal(motion), aligned), character) for motion in theirs]
        out[row] = float(np.mean(copied))
    return out


def _trained(
    config: DistortionConfig, theirs: Sequence[HandleMotion]
) -> Iterator[tuple[str, str, Callable[[Named], float]]]:
    """The rows of trained adaptations and pose transfers: name, what tells its weights from others, and what measures a
    character. One network is held at a time.
    """
    from bunraku.diffusion.generation.networks import Networks

    for row, adapter in config.adapters.items():
        yield row, _digest(adapter), partial(_of_adapter, config, Networks(adapted_weights(config, row, adapter)))
    for row, network in transfers_of(config.transfer).items():
        motions = [source_motion(network, _skeletal(motion)) for motion in theirs]
        yield row, _digest(config.transfer), partial(_of_transfer, network, motions)


def _of_adapter(config: DistortionConfig, networks: Networks, named: Named) -> float:
    _, character, handles = named
    anatomy, motions = Anatomy.of(character, handles), drawn_motions(config, None, handles.features, networks)
    return float(np.mean([_fitted(motion, named, anatomy, Stages(shape=False)) for motion in motions]))


def _of_transfer(network: TransferNetwork, motions: Sequence[SourceMotion], named: Named) -> float:
    _, character, handles = named
    shown = [transferred_motion(network, character, handles, motion) for motion in motions]
    return float(np.mean([_posed(vertices, character) for vertices in shown]))


def _digest(path: Path | None) -> str:
    return "" if path is None else hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def transfers_of(weights: Path | None) -> dict[str, TransferNetwork]:
    """Pose transfers by the names of their rows: the trained one, and an untrained one beside it; none without weights.

    Raises:
        WeightsError: The file is missing or damaged.
    """
    if weights is None:
        return {}
    torch.manual_seed(0)
    return {SFR: load_transfer(weights), f"{SFR}, untrained": TransferNetwork(TransferConfig()).eval()}


def transferred_motion(
    network: TransferNetwork, character: Character, handles: Handles, motion: SourceMotion
) -> np.ndarray:
    """A character as Skeleton-free Pose Transfer moves it after the reference body [m], shape (N, V, 3)."""
    parts = None if network.config.predictor else handles.weights
    root = handles.positions[0]
    target = TransferTarget.of(character.vertices, character.faces, parts, root, network)
    return target.with_motion(motion, root)


def drawn_motions(
    config: DistortionConfig, checkpoint: Path | None, feature: np.ndarray | None = None, held: Networks | None = None
) -> list[HandleMotion]:
    """One motion of the reference body for each sentence: one sample of the network alone, by its own steps and
    guidance and not by what it was distilled into, which other weights have not been.

    Args:
        config: Sentences, length and seed.
        checkpoint: Weights; None takes the shipped ones.
        feature: f_phi of the character, where the motion is for one.
        held: The networks of the weights, where they are loaded already.
    """
    from bunraku.diffusion.generation.drawing import GUIDANCE, STEPS
    from bunraku.diffusion.generation.generate import generate_motions
    from bunraku.language.parse import clauses_of

    prompts = ARAP_PROMPTS[: config.prompts]
    seeds = [config.seed + number for number in range(len(prompts))]
    return generate_motions(
        [clauses_of([(prompt, config.seconds)]) for prompt in prompts], seeds=seeds, checkpoint=checkpoint,
        mesh_feature=feature, steps=STEPS, guidance=GUIDANCE, held=held,
    )  # fmt: skip


def adapted_weights(config: DistortionConfig, row: str, adapter: Path) -> Path:
    """Our weights with a last layer, written once."""
    name = hashlib.sha256(row.encode() + adapter.read_bytes()).hexdigest()[:16]
    path = config.work / f"adapted-{name}.safetensors"
    if not path.is_file():
        config.work.mkdir(parents=True, exist_ok=True)
        adapted_denoiser(adapter, config.checkpoint or shipped_checkpoint("diffusion"), path)
    return path


def _thinned(motion: HandleMotion) -> HandleMotion:
    return replace(motion.take(slice(None, None, STRIDE)), fps=motion.fps / STRIDE)


def _fitted(motion: HandleMotion, named: Named, anatomy: Anatomy, stages: Stages) -> float:
    _, character, handles = named
    return animation_arap(Animation(character, handles, _thinned(fit_motion(motion, anatomy, stages))))


def _skeletal(motion: HandleMotion) -> SkeletalMotion:
    return skeleton_from_handles(_thinned(motion))


def _posed(vertices: np.ndarray, character: Character) -> float:
    edges = unique_edges(character.faces, len(character.vertices))
    return float(arap_loss(vertices, character.vertices, edges).mean())
