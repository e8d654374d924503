"""The rows of TapMo's table 2: how far edges change their lengths, by method, on characters that training saw and on
those that it never saw.

| row | motion | onto the character |
| --- | --- | --- |
| MDM-SR | the encoder-only network | the human skeleton embedded, rotations copied, bone heat |
| MDM-SR, limbs aligned first | the same | the same, limbs turned to the T-pose first |
| MDM-SFR, floor without training | the same | the body's part transforms on the predicted weights, as they are |
| without adaptation | ours | all stages but the adaptation |
| ours | ours | all stages, the last step of the adaptation on the very mesh |

A character that the human skeleton cannot be embedded in counts in the other rows, and is told.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.from_handles import skeleton_from_handles
from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.errors import CharacterError
from bunraku.geometry.graph import unique_edges
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.baselines.skeletal_retarget import copied_motion, rig_by_embedding
from bunraku_lab.datasets.characters.build import HELD_OUT
from bunraku_lab.evaluation.motion.arap import ARAP_PROMPTS, STRIDE, animation_arap, arap_loss
from bunraku_lab.evaluation.motion.characters import Named, chosen_files, load_named
from bunraku_lab.evaluation.parts import Parts, at_once
from bunraku_lab.evaluation.tables.paper_table import EITHER_WAY, half_interval

__all__ = ["DistortionConfig", "measure_distortion"]

NO_STAGES = Stages(**{each.name: False for each in fields(Stages)})
SEEN, UNSEEN = "A-L, seen", "A-L, unseen"


@dataclass(frozen=True)
class DistortionConfig:
    """What is measured.

    Args:
        characters: Folder of rigged characters.
        mdm: Weights of the encoder-only network.
        checkpoint: Weights of ours; None takes the shipped ones.
        count: Characters that training saw, and as many that it did not.
        prompts: Of `ARAP_PROMPTS`, so many.
        seconds: Length of each motion [s].
        seed: Of the motions.
    """

    characters: Path
    mdm: Path
    checkpoint: Path | None = None
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
    ours = _motions(config, config.checkpoint)
    theirs = _motions(config, config.mdm)
    found: dict[str, dict[bool, list[float]]] = {}
    failed = {False: 0, True: 0}
    for number, named in enumerate(characters):
        report("distortion", number / len(characters))
        unseen = named[0].partition("~")[0] in HELD_OUT
        losses = parts(named[0], partial(_losses, named, ours, theirs))
        failed[unseen] += "MDM-SR" not in losses
        for row, value in losses.items():
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


def _losses(named: Named, ours: Sequence[HandleMotion], theirs: Sequence[HandleMotion]) -> dict[str, float]:
    """Mean ARAP-Loss of each row on one character; without those of MDM-SR where it cannot be embedded."""
    _, character, handles = named
    anatomy = Anatomy.of(character, handles)
    out = {}
    for row, motions, stages in (
        ("ours", ours, Stages(shape=True)),
        ("ours, without adaptation", ours, Stages(shape=False)),
        ("MDM-SFR, floor without training", theirs, NO_STAGES),
    ):
        out[row] = float(np.mean([_fitted(motion, named, anatomy, stages) for motion in motions]))
    try:
        rigged = rig_by_embedding(character.vertices, character.faces)
    except CharacterError:
        return out
    for row, aligned in (("MDM-SR", False), ("MDM-SR, limbs aligned first", True)):
        shown = [_posed(copied_motion(rigged, _skeletal(motion), aligned), character) for motion in theirs]
        out[row] = float(np.mean(shown))
    return out


def _motions(config: DistortionConfig, checkpoint: Path | None) -> list[HandleMotion]:
    """One motion of the reference body for each sentence: one sample of the network alone."""
    from bunraku.diffusion.generation.generate import generate_motion

    return [
        generate_motion(prompt, config.seconds, seed=config.seed + number, candidates=1, checkpoint=checkpoint)
        for number, prompt in enumerate(ARAP_PROMPTS[: config.prompts])
    ]


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
