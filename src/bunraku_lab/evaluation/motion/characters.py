"""What `bunraku evaluate motion` measures on characters: distortion with and without the adaptation, and feet that
slide.

The characters are those of a folder by fixed rules, so the same folder always gives the same ones: of the archive, the
unseen are those that no training sees (`HELD_OUT`), the seen are spread evenly over the others.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import numpy as np

from bunraku.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.diffusion.features import decode
from bunraku.errors import BunrakuError
from bunraku.handles.predict import mesh_feature, predict_handles
from bunraku_lab.datasets.characters.build import HELD_OUT
from bunraku_lab.evaluation.handles.subjects import find_files, load_subject, subject_name
from bunraku_lab.evaluation.motion.arap import ARAP_PROMPTS, measure_adaptation
from bunraku_lab.evaluation.motion.quality import stage_effects

__all__ = ["Named", "arap_figures", "chosen_files", "foot_figures", "load_named", "mesh_features"]

_log = logging.getLogger(__name__)

Named = tuple[str, Character, Handles]
Progress = Callable[[float], None]


def chosen_files(folder: Path, unseen: bool, count: int) -> list[Path]:
    """At most `count` character files of a folder, evenly over their sorted names: those that no training sees, or the
    others.

    Raises:
        FormatError: There are no characters.
    """
    files = [file for file in find_files(folder, everything=True) if (subject_name(folder, file) in HELD_OUT) == unseen]
    if len(files) <= count:
        return files
    return [files[index] for index in np.linspace(0, len(files) - 1, count).round().astype(int)]


def load_named(
    files: Sequence[Path], folder: Path, humanoids: bool = False, progress: Progress | None = None
) -> list[Named]:
    """Characters facing +Z with the handles that the predictor gives them; files that cannot be used are left out with
    a warning.

    Args:
        files: Their files.
        folder: What their names are relative to.
        humanoids: Leave out all that are not.
        progress: Called with the share done.
    """
    found: list[Named] = []
    for done, file in enumerate(files, 1):
        try:
            subject = load_subject(file, subject_name(folder, file))
            if subject.humanoid or not humanoids:
                found.append((subject.name, subject.character, predict_handles(subject.character).top(4)))
        except BunrakuError as error:
            _log.warning("%s is left out: %s", file, error)
        if progress is not None:
            progress(done / len(files))
    return found


def mesh_features(folder: Path, names: Collection[str]) -> dict[str, np.ndarray]:
    """f_phi of the characters of these names under a folder, by name; those that are not there are left out.

    Raises:
        FormatError: There are no characters.
    """
    files = {subject_name(folder, file): file for file in find_files(folder, everything=True)}
    return {name: mesh_feature(load_subject(files[name], name).character) for name in sorted(names) if name in files}


def arap_figures(
    characters: Sequence[Named], checkpoint: Path | None, prompts: int, steps: int | None, seed: int, progress: Progress
) -> dict[str, float | None]:
    """ARAP-Loss of generated motions with the adaptation, without, and the ratio of both, on seen and on unseen
    characters.
    """
    table = measure_adaptation(
        characters,
        ARAP_PROMPTS[:prompts],
        steps=steps,
        seed=seed,
        checkpoint=checkpoint,
        progress=lambda stage, done: progress(done),
    )
    out: dict[str, float | None] = {}
    for unseen, word in ((False, "seen"), (True, "unseen")):
        means = table.means(unseen)
        out[f"arap_ratio_{word}"] = table.ratio(unseen) if means else None
        out[f"arap_ratio_learned_{word}"] = table.ratio(unseen, "learned") if means else None
        out |= {f"arap_{word}_{kind}": value for kind, value in means.items()}
        out[f"arap_characters_{word}"] = float(sum(row.unseen == unseen for row in table.rows))
    return out


def foot_figures(features: Sequence[np.ndarray], characters: Sequence[Named], progress: Progress) -> dict[str, float]:
    """Sliding, sinking and jitter of generated motions on the reference body and on characters, with all stages and
    without them.

    Args:
        features: Motions of the reference body, each of shape (N, 271).
        characters: Further characters.
        progress: Called with the share done.
    """
    body = reference_body()
    everyone: list[Named] = [("reference", body.character(), body.handles), *characters]
    motions = [decode(values) for values in features]
    rows = []
    for done, (name, character, handles) in enumerate(everyone, 1):
        found = stage_effects(motions, {name: (character, handles)})
        rows.append({str(row["without"]): row for row in found if row["character"] == "all"})
        progress(done / len(everyone))
    weights = np.array([float(row["nothing"]["down"]) for row in rows])
    weights = weights if weights.sum() else np.ones(len(rows))

    def mean(case: str, key: str, weight: np.ndarray | None = None) -> float:
        return float(np.average([float(row[case][key]) for row in rows], weights=weight))

    out = {
        "foot_sliding_cm": mean("nothing", "sliding", weights),
        "foot_sliding_without_cm": mean("feet", "sliding", weights),
    }
    out |= {"sunk_percent": mean("nothing", "sunk"), "sunk_without_percent": mean("floor", "sunk")}
    out |= {"jitter_cm": mean("nothing", "jitter"), "jitter_without_cm": mean("smooth", "jitter")}
    return out | {"foot_characters": float(len(everyone)), "foot_motions": float(len(motions))}
