"""What learned apparel is worth: the tables of `bunraku evaluate apparel`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.apparel.learned.network import DisplacementNetwork, load_displacement
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.errors import BunrakuError, FormatError, WeightsError
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.evaluation.apparel.chains import chain_row, chain_summary
from bunraku_lab.evaluation.apparel.clips import (
    TrueClip,
    clip_row,
    data_clips,
    drift_row,
    file_clips,
    long_clip,
    made_clips,
)
from bunraku_lab.evaluation.apparel.rivals import body_table, mask_scores, module_row, rival_rows, rivals_of
from bunraku_lab.evaluation.report import Bar, Parts, at_once, figure, measured_in, reached_bars
from bunraku_lab.nn.checkpoints import lab_checkpoint
from bunraku_lab.training.apparel.refinement import RefinementNetwork

Progress = Callable[[str, float], None]
FILE_MOTIONS = ("walk", "dance")
LONG = 3  # characters in clips of a minute
# Goals, set before anything was measured.
_BARS = {
    "mask_iou": Bar("apparel found, intersection over union, wardrobe", least=0.9),
    "mask_iou_files": Bar("the same, files", least=0.45),
    "pmd_apparel_rest_6s_over_rigid": Bar("PMD_a from rest, 6 s, over parent-rigid skinning", most=0.4),
    "els_minus_truth": Bar("ELS of apparel, less the truth's", least=-0.02),
    "drift_60s": Bar("60 s: error of the last second over that of the second one", most=1.2),
    "inside_over_truth": Bar("apparel deeper than 1 cm in the body, over the truth's", most=1.2),
    "inside_over_rigid": Bar("the same over rigid apparel's", most=1 / 3),
    "real_over_rigid": Bar("files: PMD_a over parent-rigid, the worst", most=1.0),
    "chains_over_rigid": Bar("chains from shape: PMD_a from rest, 6 s, over parent-rigid", most=0.5),
    "chains_els_minus_truth": Bar("chains: ELS of apparel, less the truth's", least=-0.02),
    "chains_fly_aways": Bar("chains: clips in which something flies away", most=0.0),
    "chains_inside_over_rigid": Bar("chains: deeper than 1 cm in the body, over rigid apparel's", most=1 / 3),
    "body_attention_first": Bar("body: geodesic attention before both variants", least=1.0),
}
APPAREL_BARS = {key: replace(bar, show=measured_in("", 3), show_limit=figure) for key, bar in _BARS.items()}


@dataclass(frozen=True)
class ApparelEvalConfig:
    """What is measured.

    Args:
        data: Folder of the data set; its split "test" is measured. None measures files alone, or where `quick` is set
            and there are none, clips that are simulated for it.
        motions: Folder of motions for clips of a minute.
        files: PMX, PMD or VRM files with physics.
        clips: Most clips of the data set.
        whole: Of those, how many have all their vertices measured, by each module and beside other methods.
        least: Characters; where the data set has fewer, one clip of each counts, and others are simulated.
        weights: Displacement network, of files with parameters and of those whose parameters are guessed.
        masks: Part network.
        bodies: Body networks; Table 3 takes the first.
        refinement: Joint refinement of Table 3.
        baselines: Folder of the weights of Neural Blend Shapes and SPT, for their rows beside ours.
        quick: Leave out what takes long: 60 s and insides.
        whole_only: Measure whole meshes alone, by each module and beside other methods: the paper's tables 2 to 4.
        chains: Measure chains from shape alone, on the splits "val" and "test".
    """

    data: Path | None = None
    motions: Path | None = None
    files: Sequence[Path] = ()
    clips: int = 24
    whole: int = 8
    least: int = 0
    weights: Path | None = None
    masks: Path | None = None
    bodies: Sequence[Path] = ()
    refinement: Path | None = None
    baselines: Path | None = None
    quick: bool = False
    whole_only: bool = False
    chains: bool = False


def evaluate_apparel(
    config: ApparelEvalConfig, progress: Progress | None = None, parts: Parts = at_once
) -> dict[str, Any]:
    """Measure all rows.

    Returns:
        The keys of `APPAREL_BARS` and whether they are reached, the tables, and a row for each clip.

    Raises:
        FormatError: The data set has no test clips.
        WeightsError: A network is missing or broken.
    """
    progress = progress or (lambda stage, done: None)
    if config.chains:
        return _chains(config, progress)
    masks, bodies, quick = config.masks, config.bodies, config.quick
    network = load_displacement(config.weights or shipped_checkpoint("apparel"))
    guessing = load_displacement(config.weights or shipped_checkpoint("apparel-guessed"))
    found: list[TrueClip] = []
    if config.data is not None:
        found = list(data_clips(ApparelData(config.data, "test"), config.clips))
        known = len({clip.name for clip in found})
        if found and known < config.least:
            progress("simulate", 0.0)
            found = list({clip.name: clip for clip in reversed(found)}.values()) + list(
                made_clips(config.least - known)
            )
    elif quick and not config.files:
        progress("simulate", 0.0)
        found = list(made_clips(config.clips))
    if not found and config.data is not None:
        raise FormatError(config.data, "there are no test clips of 6 s; build more of `bunraku data apparel`")
    body = bodies[0] if bodies else None
    known_body = body is not None or _ships("apparel-body")
    refinement = config.refinement
    if refinement is None and _ships("apparel-refinement"):
        refinement = lab_checkpoint("apparel-refinement")
    merging = None if refinement is None else RefinementNetwork.load(refinement)

    def apart(clip: TrueClip) -> dict[str, Any]:
        """What the displacement network and the mask are worth, each by itself."""
        return {"row": clip_row(clip, network, slow=not quick), "score": mask_scores(clip, masks)}

    def measured(number: int, clip: TrueClip) -> dict[str, Any]:
        own: dict[str, Any] = {} if config.whole_only else apart(clip)
        if number < config.whole and known_body:
            own["whole"], own["whole_ten"] = module_row(clip, guessing, masks, body, merging)
        return own

    every = []
    for number, clip in enumerate(found):
        progress("clips", number / len(found))
        every.append(parts(f"{number} {clip.name} {clip.motion}", partial(measured, number, clip)))
    for rival in rivals_of(config.baselines) if known_body else []:
        for number, clip in enumerate(found[: config.whole]):
            progress(rival.name, number / min(len(found), config.whole))
            named = f"{number} {clip.name} {clip.motion} {rival.name} {rival.digest}"
            own = every[number]
            own["whole"][rival.name], own["whole_ten"][rival.name] = parts(named, partial(rival_rows, clip,
                                                                                          rival.network))  # fmt: skip
    rows, scores, modules, whole_tens = (
        [one[key] for one in every if key in one] for key in ("row", "score", "whole", "whole_ten")
    )
    progress("clips", 1.0)
    real, failed = _files(config.files, network, masks, progress)
    out = _summary(rows, scores, real)
    drift = [] if quick else _drifts(network, config.motions, found, progress)
    out["drift_60s"] = _over(drift, "last", "second")
    table4 = body_table(found[: 4 if quick else 12], bodies) if found else {}
    out["body_attention_first"] = _attention_first(table4)
    reached = reached_bars(APPAREL_BARS, out)
    tables = {
        "From rest, 6 s: PMD_a [cm], ELS of apparel, deeper than 1 cm in the body": _rest_table(rows),
        "60 s from rest: PMD_a [cm]": _drift_table(drift),
        "Modules (Table 3): PMD [cm]": _module_table(modules),
        "Whole meshes over ten frames from true states (Table 2): PMD [cm]": _module_table(whole_tens),
        "Body (Table 4): PMD [cm]": table4,
        "Files, from rest: PMD_a [cm]": _real_table(real),
    }
    return out | {
        "reached": reached, "tables": {title: table for title, table in tables.items() if table},
        "clips": rows, "names": [clip.name for clip in found], "whole": modules, "whole_ten_frames": whole_tens,
        "minutes": drift, "files": real, "failed": failed, "masks": scores,
    }  # fmt: skip


def _chains(config: ApparelEvalConfig, progress: Progress) -> dict[str, Any]:
    """The rows of chains alone."""
    from bunraku.files import load_character

    clips: list[TrueClip] = []
    if config.data is not None:
        for split in ("test", "val"):
            clips += list(data_clips(ApparelData(config.data, split), config.clips - len(clips)))
    rows = []
    for number, clip in enumerate(clips):
        progress("clips", number / len(clips))
        rows.append(chain_row(clip))
    real, failed = [], {}
    for number, path in enumerate(config.files):
        progress("files", number / len(config.files))
        try:
            character = load_character(path)
            real += [chain_row(clip) | {"name": path.stem} for clip in file_clips(character, FILE_MOTIONS)]
        except BunrakuError as error:
            failed[path.name] = str(error)
    out: dict[str, Any] = dict(chain_summary(rows))
    bars = {key: bar for key, bar in APPAREL_BARS.items() if key.startswith("chains")}
    tables = {"Chains from shape, wardrobe": _chain_table(rows), "Chains from shape, files": _chain_table(real)}
    return out | {
        "reached": reached_bars(bars, out), "tables": {title: table for title, table in tables.items() if table},
        "clips": rows, "files": real, "failed": failed,
    }  # fmt: skip


def _chain_table(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    return {
        f"{row['name']} {row['motion']}": {
            "rigid": 100 * row["rigid"], "chains": 100 * row["chains"], "over rigid": row["chains"] / max(row["rigid"],
            1e-9), "ELS": row["chains_els"], "truth's": row["els_truth"], "flew": float(row["lost"]),
        }
        for row in rows
    }  # fmt: skip


def _ships(name: str) -> bool:
    try:
        lab_checkpoint(name)
    except WeightsError:
        return False
    return True


def _files(
    files: Sequence[Path], network: DisplacementNetwork, masks: Path | None, progress: Progress
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    from bunraku.files import load_character

    real: list[dict[str, Any]] = []
    failed: dict[str, str] = {}
    for number, path in enumerate(files):
        progress("files", number / len(files))
        try:
            clips = file_clips(load_character(path), FILE_MOTIONS)
            rows = [clip_row(clip, network, slow=False) for clip in clips]
            mean = {
                key: float(np.mean([row[key] for row in rows])) for key in ("rigid", "nearest_joint", "learned", "safe")
            }
            real.append({"name": path.stem, **mean, "iou": mask_scores(clips[0], masks)["iou"]})
        except BunrakuError as error:
            failed[path.name] = str(error)
    return real, failed


def _drifts(
    network: DisplacementNetwork, motions: Path | None, found: Sequence[TrueClip], progress: Progress
) -> list[dict[str, Any]]:
    """Clips of a minute of test characters of the wardrobe, each in the motion that it has in the data set."""
    out: list[dict[str, Any]] = []
    if motions is None:
        return out
    seen = list({clip.name: clip for clip in found}.values())[:LONG]
    for number, clip in enumerate(seen):
        progress("minutes", number / len(seen))
        path = Path(motions) / f"{clip.motion}.npz"
        seed = clip.name.removeprefix("wardrobe_")
        if path.is_file() and seed.isdecimal():
            out.append({"name": clip.name} | drift_row(long_clip(int(seed), path), network))
    return out


def _over(rows: Sequence[dict[str, Any]], key: str, under: str) -> float | None:
    known = [row for row in rows if key in row and under in row]
    below = sum(row[under] for row in known)
    return float(sum(row[key] for row in known) / below) if below > 0 else None


def _summary(rows: list[dict[str, Any]], scores: list[dict[str, float]], real: list[dict[str, Any]]) -> dict[str, Any]:
    files = [row["iou"] for row in real]
    return {
        "mask_iou": float(np.mean([row["iou"] for row in scores])) if scores else None,
        "mask_iou_files": float(np.mean(files)) if files else None,
        "pmd_apparel_rest_6s_over_rigid": _over(rows, "safe", "rigid"),
        "els_minus_truth": float(np.mean([row["safe_els"] - row["els_truth"] for row in rows])) if rows else None,
        "inside_over_truth": _over(rows, "inside_safe", "inside_truth"),
        "inside_over_rigid": _over(rows, "inside_safe", "inside_rigid"),
        "real_over_rigid": max((row["safe"] / max(row["rigid"], 1e-9) for row in real), default=None),
    }


def _rest_table(rows: list[dict[str, Any]]) -> dict[str, dict[str, float | None]]:
    names = {
        "rigid": "parent-rigid", "nearest_joint": "nearest joint", "head": "head alone", "learned": "learned",
        "safe": "learned, safe", "truth": "truth",
    }  # fmt: skip
    out: dict[str, dict[str, float | None]] = {}
    for key, name in names.items():
        inside = [row[f"inside_{key}"] for row in rows if f"inside_{key}" in row]
        els = [row["els_truth" if key == "truth" else f"{key}_els"] for row in rows
               if ("els_truth" if key == "truth" else f"{key}_els") in row]  # fmt: skip
        pmd = [row[key] for row in rows if key in row]
        two = [row[f"{key}_2s"] for row in rows if f"{key}_2s" in row]
        if pmd or inside or els:
            out[name] = {
                "PMD_a": 100 * float(np.mean(pmd)) if pmd else None,
                "first 2 s": 100 * float(np.mean(two)) if two else None,
                "over rigid": _over(rows, key, "rigid") if pmd else None,
                "ELS": float(np.mean(els)) if els else None,
                "inside [%]": 100 * float(np.mean(inside)) if inside else None,
            }
    return out


def _drift_table(drift: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    columns = {"second": "second 2", "last": "last", "all": "all", "rigid": "rigid"}
    return {row["name"]: {title: 100 * row[key] for key, title in columns.items()} for row in drift}


def _module_table(modules: list[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    if not modules:
        return {}
    return {
        name: {key: float(np.mean([row[name][key] for row in modules])) for key in modules[0][name]}
        for name in modules[0]
    }


def _real_table(real: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    return {
        row["name"]: {
            "rigid": 100 * row["rigid"], "nearest joint": 100 * row["nearest_joint"], "learned": 100 * row["learned"],
            "safe": 100 * row["safe"], "over rigid": row["safe"] / max(row["rigid"], 1e-9), "mask IoU": row["iou"],
        }
        for row in real
    }  # fmt: skip


def _attention_first(table: dict[str, dict[str, float]]) -> float | None:
    if not {"attention", "none", "sorted"} <= set(table):
        return None
    return float(all(table["attention"]["PMD"] < table[other]["PMD"] for other in ("none", "sorted")))
