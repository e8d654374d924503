"""The table of the Mesh Handle Predictor: `bunraku evaluate handles`. Definitions are in `docs/evaluation.md`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.errors import BunrakuError, OptionError
from bunraku.handles.predict import predict_handles
from bunraku.nn.spread import spread
from bunraku_lab.evaluation.handles.orientation import measure_orientation
from bunraku_lab.evaluation.handles.subjects import Subject, find_files, load_subject, subject, subject_name
from bunraku_lab.evaluation.handles.trials import (
    Predict,
    Reference,
    measure_subject,
    prediction_seconds,
    purity_of,
    resolution_differences,
)
from bunraku_lab.evaluation.report import Bar, measured_in, percent, reached_bars

__all__ = ["BARS", "code_made_subjects", "evaluate_handles", "folder_subjects"]

RESAMPLED = 30
"""Characters on which resolutions are compared, evenly over the list."""
SPEEDS = {"seconds_5k": 5_000, "seconds_200k": 200_000}

Load = Callable[[], Subject]


BARS: dict[str, Bar] = {
    "root_error": Bar("root: first handle to the root joint, over the height", most=0.03, show=percent(2)),
    "part_purity": Bar("part purity: vertices of a part that share its main handle", least=0.9, show=percent(1)),
    "part_purity_detailed": Bar("part purity of detailed people", least=0.9, show=percent(1)),
    "same_meaning": Bar(
        "same meaning: named parts whose main handle is the reference body's", least=0.9, show=percent(1)
    ),
    "same_meaning_vertices": Bar("  the same, vertex by vertex", show=percent(1)),
    "pose_error": Bar("pose error: random poses, over the height", most=0.015, show=percent(2)),
    "pose_error_creatures": Bar("pose error of non-humanoids", most=0.015, show=percent(2)),
    "pose_error_clusters": Bar("  of 30 geodesic k-means clusters", show=percent(2)),
    "pose_error_bone_heat": Bar("  of bone heat on an embedded skeleton", show=percent(2)),
    "pose_error_together": Bar("  of the handles, their motions fitted to one another", show=percent(2)),
    "pose_error_bone_heat_together": Bar("  of bone heat, fitted so", show=percent(2)),
    "resolution_l1": Bar(
        "resolution: L1 difference of weights at 1k, 5k and 50k vertices",
        most=0.05,
        show=measured_in("", 3),
    ),
    "rest_pose_agreement": Bar(
        "rest pose: main handle unchanged in A, arms down and sitting", least=0.9, show=percent(1)
    ),
    "orientation_creatures": Bar("orientation: non-humanoids set up from all 24", least=0.9, show=percent(1)),
    "orientation_humanoids": Bar("  of humanoids", show=percent(1)),
    "orientation_up": Bar("  up alone, of all", show=percent(1)),
    "orientation_front": Bar("  front given up, of all", show=percent(1)),
    "orientation_upright": Bar("orientation: left alone as a glTF that stands", least=0.98, show=percent(1)),
    "orientation_warned": Bar("orientation: wrong ones that are called a guess", least=1.0, show=percent(1)),
    "top4_error": Bar("top 4: error of four weights a vertex in motion, over the height", most=0.001, show=percent(2)),
    "stretched_edges": Bar("stretch: edges longer than twice their length in a walk", most=0.001, show=percent(2)),
    "whole_in_walks": Bar("stretch: characters with no edge over four times its length", least=0.95, show=percent(1)),
    "seconds_5k": Bar("speed: 5,000 vertices [s]", most=0.3, show=measured_in(" s", 2)),
    "seconds_200k": Bar("speed: 200,000 vertices [s]", most=4.0, show=measured_in(" s", 2)),
}
"""The measures in the order of the table."""


def folder_subjects(folder: Path, everything: bool = False) -> dict[str, Load]:
    """How to load each character of a folder (see `bunraku_lab.evaluation.handles.subjects.find_files`), by name."""
    return {
        subject_name(folder, file): partial(load_subject, file, subject_name(folder, file))
        for file in find_files(folder, everything)
    }


def code_made_subjects(count: int = 30) -> dict[str, Load]:
    """How to make each of the characters made by code that no training sees, by name."""
    from bunraku_lab.synthetic.families import EVALUATION_SEED, code_made_names

    return {
        f"code_made/{family}_{seed}": partial(_code_made, family, seed)
        for family, seed in code_made_names(count, EVALUATION_SEED)
    }


def _code_made(family: str, seed: int) -> Subject:
    from bunraku_lab.synthetic.families import code_made_character

    return subject(code_made_character(family, seed), f"code_made/{family}_{seed}")


def _measured(
    predict: Predict, reference: Reference, baselines: bool, seed: int, subjects: list[tuple[str, Load]]
) -> list[dict[str, Any] | str]:
    """The row of each character, or why there is none."""
    out: list[dict[str, Any] | str] = []
    for _, load in subjects:
        try:
            one = load()
            out.append(measure_subject(one, predict, reference, baselines, seed) | measure_orientation(one))
        except BunrakuError as error:
            out.append(str(error))
    return out


def _lost(reason: str) -> dict[str, Any] | str:
    return reason


def _evenly(names: list[str], count: int) -> set[str]:
    return {names[i] for i in np.unique(np.linspace(0, len(names) - 1, count).round().astype(int))}


def _mean(rows: Iterable[Mapping[str, float | None]], key: str) -> float | None:
    values = [value for row in rows if (value := row.get(key)) is not None]
    return float(np.mean(values)) if values else None


def evaluate_handles(
    subjects: dict[str, Load],
    *,
    detailed: dict[str, Load] | None = None,
    checkpoint: str | Path | None = None,
    baselines: bool = True,
    speed: bool = True,
    seed: int = 0,
    jobs: int | str = 1,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Any]:
    """Measure the predictor on characters.

    Args:
        subjects: How to load each character, by name (`folder_subjects`, `code_made_subjects`).
        detailed: Detailed people, of whom only the purity of parts is taken (`detailed_subjects`).
        checkpoint: Weights of the predictor; the shipped ones when None.
        baselines: Also pose the characters by clusters and by bone heat.
        speed: Also take the time of predictions.
        seed: Of the random poses and of the clusters.
        jobs: How many processes share the characters, or "ray" for a cluster whose machines see the same files.
        progress: Called with a stage's name and the share done.

    Returns:
        Numbers and lists that JSON can say: the measures of `BARS` (shares, or seconds; None where no character fits
        one), "bars", "reached", "counts", "left_out" (name: reason), "characters" with a row for each, and "detailed"
        with the part purity of each detailed person.

    Raises:
        OptionError: None of the characters can be measured.
        WeightsError: The checkpoint is missing or does not fit.
        MissingExtraError: ray is not installed.
    """
    report = progress or (lambda stage, share: None)
    predict: Predict = partial(predict_handles, checkpoint=checkpoint)
    reference = Reference.of(predict)
    work = partial(_measured, predict, reference, baselines, seed)
    batches = [[(name, load)] for name, load in subjects.items()]
    alone = ((batch[0], work(batch)[0]) for batch in batches)
    found: dict[str, dict[str, Any] | str] = {}
    for (name, _), result_of in alone if jobs == 1 else spread(work, batches, jobs, _lost):
        found[name] = result_of
        report("characters", len(found) / len(subjects))
    rows_by_name = {name: found[name] for name in subjects}
    rows = [row for row in rows_by_name.values() if isinstance(row, dict)]
    left_out = {name: reason for name, reason in rows_by_name.items() if isinstance(reason, str)}
    if not rows:
        raise OptionError(
            f"none of the {len(subjects)} characters can be measured "
            f"({next(iter(left_out.values()), 'there are none')})"
        )
    chosen = _evenly([row["name"] for row in rows], RESAMPLED)
    for number, row in enumerate(row for row in rows if row["name"] in chosen):
        row["resolutions"] = resolution_differences(subjects[row["name"]](), predict)
        row["resolution_l1"] = float(np.mean(list(row["resolutions"].values())))
        report("resolutions", (number + 1) / len(chosen))
    fine = _detailed(detailed or {}, {row["name"]: row["part_purity"] for row in rows}, predict, left_out, report)
    result: dict[str, Any] = {key: _mean(rows, key) for key in BARS if key not in SPEEDS}
    result["part_purity_detailed"] = float(np.mean(list(fine.values()))) if fine else None
    result["pose_error_creatures"] = _mean((row for row in rows if not row["humanoid"]), "pose_error")
    for number, (key, count) in enumerate(SPEEDS.items()):
        result[key] = prediction_seconds(count, predict) if speed else None
        report("speed", (number + 1) / len(SPEEDS))
    parts = [right for row in rows for right in row.get("parts", {}).values()]
    result["same_meaning"] = float(np.mean(parts)) if parts else None
    result["bars"] = {key: bar.bar for key, bar in BARS.items() if bar.bar is not None}
    result["reached"] = reached_bars(BARS, result)
    rivals = [result[key] for key in ("pose_error_clusters", "pose_error_bone_heat") if result[key] is not None]
    if rivals and result["reached"]["pose_error"]:
        result["reached"]["pose_error"] = bool(result["pose_error"] < min(rivals))
    result["counts"] = {
        "characters": len(rows),
        "humanoids": sum(row["humanoid"] for row in rows),
        "resampled": len(chosen),
        "detailed": len(fine),
    }
    return result | {"left_out": left_out, "characters": rows, "detailed": fine}


def _detailed(
    people: dict[str, Load],
    known: dict[str, float | None],
    predict: Predict,
    left_out: dict[str, str],
    report: Callable[[str, float], None],
) -> dict[str, float]:
    """Part purity of each detailed person by name; those that are measured already are not looked at again."""
    out: dict[str, float] = {}
    for number, (name, load) in enumerate(people.items()):
        try:
            value = known[name] if name in known else purity_of(load(), predict)
            if value is not None:
                out[name] = value
        except BunrakuError as error:
            left_out[name] = str(error)
        report("detailed people", (number + 1) / len(people))
    return out
