"""An automatic stand-in for TapMo's table 3, the user study, until people answer.

For each character and sentence the methods are ranked by measures, 1 being the best and equal ones sharing their ranks:

| column | by |
| --- | --- |
| geometry | how far edges change their lengths (Eq. 12) |
| text | whether a classifier of captured clips names the action of the sentence |
| overall | the mean of these two ranks, and of those by floating or sinking and by jitter |

It sees what it measures and nothing else: no person has looked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.from_handles import skeleton_from_handles
from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.core.motion import HandleMotion
from bunraku.diffusion.generation.drawing import GUIDANCE, STEPS
from bunraku.diffusion.generation.generate import generate_motion
from bunraku.errors import CharacterError
from bunraku.geometry.graph import unique_edges
from bunraku.language.lexicon.reading import main_actions
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.baselines.skeletal_retarget import copied_motion, rig_by_embedding
from bunraku_lab.baselines.transfer_target import SourceMotion, source_motion
from bunraku_lab.evaluation.motion.arap import ARAP_PROMPTS, arap_loss
from bunraku_lab.evaluation.motion.characters import Named, chosen_files, load_named
from bunraku_lab.evaluation.motion.viewer.action_test import action_clips, captured_classifier
from bunraku_lab.evaluation.parts import Parts, at_once
from bunraku_lab.evaluation.tables.distortion import NO_STAGES, SFR, transferred_motion, transfers_of
from bunraku_lab.evaluation.tables.paper_table import EITHER_WAY, half_interval
from bunraku_lab.evaluation.tables.tapmo import FLOOR, METHODS
from bunraku_lab.nn.baselines.pose_transfer import TransferNetwork

__all__ = ["StandInConfig", "faults", "measure_stand_in", "ranks"]

COLUMNS = ("overall", "text", "geometry")


@dataclass(frozen=True)
class StandInConfig:
    """What is measured.

    Args:
        characters: Folder of rigged characters; those that no training saw are taken.
        mdm: Weights of the encoder-only network.
        data: Folder that `bunraku data motions` wrote, of whose clips the classifier is.
        transfer: Weights of Skeleton-free Pose Transfer, for MDM-SFR; its floor without training when None.
        count: Characters.
        prompts: Of `ARAP_PROMPTS`, so many.
        seconds: Length of each motion [s].
        seed: Of the motions.
    """

    characters: Path
    mdm: Path
    data: Path
    transfer: Path | None = None
    count: int = 15
    prompts: int = 6
    seconds: float = 3.0
    seed: int = 0


def measure_stand_in(
    config: StandInConfig, progress: Callable[[str, float], None] | None = None, parts: Parts = at_once
) -> dict[str, dict[str, float]]:
    """Mean ranks of each method over characters and sentences, and how many there were.

    Raises:
        FormatError: There are no characters, or no captured clips.
    """
    report = progress or (lambda stage, done: None)
    prompts, network = ARAP_PROMPTS[: config.prompts], transfers_of(config.transfer).get(SFR)
    drawn = {
        "ours": _drawn(config, prompts, None),
        "theirs": _drawn(config, prompts, config.mdm),
    }
    sources = [] if network is None else [source_motion(network, skeleton_from_handles(one)) for one in drawn["theirs"]]
    said = parts("actions", partial(_said, config, prompts, drawn))
    files = chosen_files(config.characters, True, config.count)
    characters = load_named(files, config.characters, progress=lambda done: report("handles", done))
    rows: list[dict[str, dict[str, float]]] = []
    for number, named in enumerate(characters):
        report("stand-in", number / len(characters))
        for sentence, shown in enumerate(parts(named[0], partial(_faults_of, named, drawn, network, sources))):
            texts = {name: said["ours" if name == "ours" else "theirs"][sentence] for name in shown}
            rows.append(ranks({name: {**values, "text": texts[name]} for name, values in shown.items()}))
    report("stand-in", 1.0)
    out: dict[str, dict[str, float]] = {}
    for name in METHODS:
        own = [row[name] for row in rows if name in row]
        if own:
            out[name] = {column: float(np.mean([row[column] for row in own])) for column in COLUMNS}
            out[name] |= {f"{column} {EITHER_WAY}": half_interval([row[column] for row in own]) for column in COLUMNS}
    return out | {"counts": {"characters": len(characters), "comparisons": len(rows)}}


def ranks(measured: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """The ranks of methods in one comparison.

    Args:
        measured: Of each method "edges", "ground" and "jitter", of which less is better, and "text", of which more is.
    """
    names = list(measured)
    by = {
        key: rankdata([(-1 if key == "text" else 1) * measured[name][key] for name in names])
        for key in ("edges", "text", "ground", "jitter")
    }
    overall = np.mean(list(by.values()), axis=0)
    return {
        name: {"overall": float(overall[row]), "text": float(by["text"][row]), "geometry": float(by["edges"][row])}
        for row, name in enumerate(names)
    }


def faults(vertices: np.ndarray, character: Character) -> dict[str, float]:
    """What is wrong with a moving mesh: its edges' loss (Eq. 12); how far its lowest vertex is off the ground that it
    rests on, and the third difference of its vertices from frame to frame, both in the mean and over the height.

    Args:
        vertices: In N frames [m], shape (N, V, 3).
        character: In its rest pose.
    """
    edges = unique_edges(character.faces, len(character.vertices))
    floor = float(character.vertices[character.surface, 1].min())
    lowest = vertices[:, character.surface, 1].min(axis=1) - floor
    rough = np.linalg.norm(np.diff(vertices, 3, axis=0), axis=-1) if len(vertices) > 3 else np.zeros(1)
    return {
        "edges": float(arap_loss(vertices, character.vertices, edges).mean()),
        "ground": float(np.abs(lowest).mean() / character.height),
        "jitter": float(rough.mean() / character.height),
    }


def _drawn(config: StandInConfig, prompts: Sequence[str], checkpoint: Path | None) -> list[HandleMotion]:
    """One motion of the reference body for each sentence: one sample of the network alone, by its own steps."""
    how: dict[str, Any] = {"steps": STEPS, "guidance": GUIDANCE, "checkpoint": checkpoint}
    return [
        generate_motion(prompt, config.seconds, seed=config.seed + number, **how)
        for number, prompt in enumerate(prompts)
    ]


def _said(
    config: StandInConfig, prompts: Sequence[str], drawn: Mapping[str, Sequence[HandleMotion]]
) -> dict[str, list[float]]:
    """Whether each motion is named the action of its sentence, 1 or 0."""
    classifier = captured_classifier(action_clips(config.data))
    wanted = [main_actions((prompt,)) for prompt in prompts]
    return {
        name: [float(answer in own) for answer, own in zip(classifier.predict(motions), wanted, strict=True)]
        for name, motions in drawn.items()
    }


def _faults_of(
    named: Named, drawn: Mapping[str, Sequence[HandleMotion]], network: TransferNetwork | None,
    sources: Sequence[SourceMotion],
) -> list[dict[str, Any]]:  # fmt: skip
    """Of each sentence the faults of each method on a character; without MDM-SR where it cannot be embedded."""
    _, character, handles = named
    anatomy = Anatomy.of(character, handles)
    try:
        rigged = rig_by_embedding(character.vertices, character.faces)
    except CharacterError:
        rigged = None
    out = []
    for number, (ours, theirs) in enumerate(zip(drawn["ours"], drawn["theirs"], strict=True)):
        fitted = {"ours": fit_motion(ours, anatomy, Stages(shape=True))}
        if network is None:
            fitted[FLOOR] = fit_motion(theirs, anatomy, NO_STAGES)
        shown = {name: Animation(character, handles, motion).vertices() for name, motion in fitted.items()}
        if network is not None:
            shown[SFR] = transferred_motion(network, character, handles, sources[number])
        if rigged is not None:
            shown["MDM-SR"] = copied_motion(rigged, skeleton_from_handles(theirs))
        out.append({name: faults(vertices, character) for name, vertices in shown.items()})
    return out
