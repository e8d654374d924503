"""The table of motion transfer (`bunraku evaluate transfer`), with BVH exactness, and soles of MMD models."""

from __future__ import annotations

import csv
import json
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.avatars import MmdIkLink, MmdModel
from bunraku.core.character import Character
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import SkeletalMotion
from bunraku.core.parallel import run_parallel
from bunraku.errors import BunrakuError, FormatError
from bunraku.files import VmdMotion
from bunraku_lab.evaluation.report import Bar, KeptParts, reached_bars
from bunraku_lab.evaluation.transfer.character import (
    SUFFIXES,
    CharacterRow,
    Source,
    measure_character,
)
from bunraku_lab.evaluation.transfer.quadrupeds import measure_quadrupeds


def bvh_again(path: Path) -> float | None:
    """Largest difference of a rotation after a skeletal motion is written as BVH and read again [degrees]."""
    from bunraku.core.geometry.rotations import axis_angle_from_matrix
    from bunraku.files import read_motion, write_bvh

    motion = read_motion(path)
    if not isinstance(motion, SkeletalMotion):
        return None
    with tempfile.TemporaryDirectory() as folder:
        again = read_motion(write_bvh(motion, Path(folder) / "again.bvh"))
    assert isinstance(again, SkeletalMotion)
    order = [again.skeleton.names.index(name) for name in motion.skeleton.names]
    change = np.swapaxes(again.rotations[:, order].astype(float), -1, -2) @ motion.rotations.astype(float)
    return float(np.degrees(np.linalg.norm(axis_angle_from_matrix(change), axis=-1)).max())


KEYS = ("soles", "soles_reached", "soles_beyond", "soles_target")
HAIR = 1e-5  # a leg that is stretched to within so much of its reach is as good as there, by definition [m]


def measure_soles(folder: str | Path | None, failed: dict[str, str]) -> dict[str, float | None]:
    """Each model of a folder with each VMD that moves legs by their IK targets.

    Args:
        folder: Searched through for .pmx, .pmd and .vmd files; None measures nothing.
        failed: Gets the files that could not be read, and why.

    Returns:
        `soles`, the largest distance of an ankle or toe from where the targets put it, in frames in which the leg
        reaches [m]; `soles_reached`, the share of these; `soles_beyond`, in the other frames the largest distance of an
        ankle from the position nearest to its target that the leg can reach [m]; `soles_target`, the largest from the
        target itself [m]. None without files.
    """
    from bunraku.core.avatars import mmd_model
    from bunraku.files import load_character, load_vmd

    files = [] if folder is None else sorted(path for path in Path(folder).rglob("*") if path.is_file())
    motions: dict[str, VmdMotion] = {}
    found: list[dict[str, np.ndarray]] = []
    for path in files:
        if path.suffix.lower() == ".vmd":
            try:
                motions[path.name] = load_vmd(path)
            except BunrakuError as error:
                failed[path.name] = str(error)
    for path in files:
        if path.suffix.lower() in (".pmx", ".pmd"):
            try:
                character = load_character(path)
                model = mmd_model(character)
                assert model is not None
                for vmd in motions.values():
                    if any(_moves(vmd, name) for name in _goals(model)):
                        found += sole_gaps(character, model, vmd)
            except BunrakuError as error:
                failed[path.name] = str(error)
    if not found:
        return dict.fromkeys(KEYS)
    reached, gap, beyond, target = (
        np.concatenate([legs[key] for legs in found]) for key in ("reached", "gap", "beyond", "target")
    )
    return {
        "soles": float(gap[reached].max()) if reached.any() else None, "soles_reached": float(reached.mean()),
        "soles_beyond": 0.0 if reached.all() else float(beyond[~reached].max()), "soles_target": float(target.max()),
    }  # fmt: skip


def sole_gaps(character: Character, model: MmdModel, vmd: VmdMotion) -> list[dict[str, np.ndarray]]:
    """Both legs of a model that plays a VMD, at 30 frames a second.

    Args:
        character: That was read from the model; a `transfer` of the VMD onto it is what is measured.
        model: The model.
        vmd: The motion.

    Returns:
        For each leg, arrays of N frames: `reached`, whether the ankle's target is within the leg's reach; `gap`, the
        larger of the ankle's and the toe's distance from where the targets put them [m]; `beyond`, that of the ankle
        from the position nearest to its target that the leg reaches [m]; `target`, that of the ankle from its target
        [m].

    Raises:
        MotionError: The motion moves none of the model's bones.
    """
    from bunraku.retarget.mmd_motion import mmd_animation

    positions = mmd_animation(character, vmd).world()[1]
    out = []
    for name, toe_name in _goals(model).items():
        goal, toe_goal = model.bone(name), model.bone(toe_name)
        ik = model.bones[goal].ik
        if ik is None or len(ik.links) != 2:
            continue
        ankle, hip = ik.target, ik.links[1].bone
        away = positions[:, goal] - positions[:, hip]
        distance = np.linalg.norm(away, axis=-1)
        reach = leg_reach(model, ik.links[0], hip, ankle)
        gap = target = np.linalg.norm(positions[:, ankle] - positions[:, goal], axis=-1)
        toe_ik = model.bones[toe_goal].ik if toe_goal >= 0 else None
        if toe_ik is not None:
            line, toe = positions[:, toe_goal] - positions[:, goal], toe_ik.target
            length = np.linalg.norm(model.positions[toe] - model.positions[ankle])
            want = positions[:, goal] + line * (length / np.maximum(np.linalg.norm(line, axis=-1), 1e-9))[:, None]
            gap = np.maximum(gap, np.linalg.norm(positions[:, toe] - want, axis=-1))
        nearest = positions[:, hip] + away * np.minimum(1, reach / np.maximum(distance, 1e-9))[:, None]
        beyond = np.linalg.norm(positions[:, ankle] - nearest, axis=-1)
        out.append({"reached": distance <= reach + HAIR, "gap": gap, "beyond": beyond, "target": target})
    return out


def leg_reach(model: MmdModel, knee: MmdIkLink, hip: int, ankle: int) -> float:
    """How far from the hip the ankle can be [m], with the knee between its limits."""
    rest = model.positions
    thigh, shin = rest[knee.bone] - rest[hip], rest[ankle] - rest[knee.bone]
    if knee.lower is None or knee.upper is None:
        return float(np.linalg.norm(thigh) + np.linalg.norm(shin))
    angles = np.linspace(knee.lower, knee.upper, 3601)
    if np.count_nonzero(np.ptp(angles, axis=0)) > 1:  # more than one axis is free
        return float(np.linalg.norm(thigh) + np.linalg.norm(shin))
    return float(np.linalg.norm(thigh + matrix_from_axis_angle(angles) @ shin, axis=-1).max())


def _goals(model: MmdModel) -> dict[str, str]:
    """The bones whose places are targets of ankles, each with that of its toes."""
    names = {f"{side}足ＩＫ": f"{side}つま先ＩＫ" for side in "左右"}
    return {name: toe for name, toe in names.items() if model.bone(name) >= 0}


def _moves(vmd: VmdMotion, name: str) -> bool:
    track: Any = vmd.bones.get(name)
    return track is not None and len(track.frames) > 1


KINDS = ("walk", "dance", "kick", "sit", "roll")
Progress = Callable[[str, float], None]


def _bar(title: str, unit: str, least: float | None = None, most: float | None = None) -> Bar:
    def show(value: float) -> str:
        if unit == " m":
            return f"{1000 * value:.4f} mm"
        return f"{value:.2f}{unit}" if unit and value >= 0.1 else f"{value:.4f}{unit}" if unit else f"{value:.2%}"

    return Bar(title, least, most, show)


# Goals, set before anything was measured.
BARS: dict[str, Bar] = {
    "finished": _bar("pairs of character and motion that finished", "", least=1.0),
    "angle_rig": _bar("limb directions on rigs, mean", " deg", most=5.0),
    "angle_handles": _bar("limb directions on handles, mean", " deg", most=8.0),
    "quadruped_limbs_degrees": _bar("captured animals on four-legged handles: limbs, mean", " deg", most=15.0),
    "quadruped_ground": _bar("the same: lowest point off the ground, over the height, mean", ""),
    "quadruped_hind_above_back": _bar("the same: frames with a hind foot above the back", "", most=0.0),
    "back": _bar("a character's clip to the reference body and back, over the height, mean", "", most=0.005),
    "back_median": _bar("the same, median", ""),
    "back_copied": _bar("a character's clip copied to the same skeleton, over the height", "", most=0.005),
    "bvh_degrees": _bar("BVH written and read again", " deg", most=0.01),
    "soles": _bar("VMD with leg IK: soles from where the IK target puts them, where the leg reaches", " m", most=0.01),
    "soles_reached": _bar("frames in which the leg reaches", ""),
    "soles_beyond": _bar("other frames: ankles from the place nearest to the target that the leg can reach", " m"),
    "soles_target": _bar("other frames: ankles from the target itself, largest", " m"),
}


def pick_motions(folder: str | Path) -> dict[str, Path]:
    """A motion of each kind of `KINDS` in a folder, by its `captions.csv` or by file names.

    Of several that fit, the one that says just this word is taken, then that with the fewest words, then by name.

    Raises:
        FormatError: There is none of some kind.
    """
    folder = Path(folder)
    found: list[tuple[str, Path]] = []
    table = folder / "captions.csv"
    if table.is_file():
        with table.open(newline="", encoding="utf-8") as file:
            found = [
                (row["caption"], folder / row["file"])
                for row in csv.DictReader(file)
                if row.get("caption") and (folder / row["file"]).is_file()
            ]
    found += [
        (path.stem.replace("_", " "), path)
        for path in sorted(folder.glob("*"))
        if path.suffix.lower() in (".bvh", ".npz", ".npy", ".fbx")
    ]
    out = {}
    for kind in KINDS:
        words = [(text.lower().split(), path) for text, path in found]
        fits = [
            (kind not in some, len(some), path.name, path)
            for some, path in words
            if any(word.startswith(kind) for word in some)
        ]
        if not fits:
            raise FormatError(
                folder, f"it holds no motion whose caption or name says '{kind}'; the table needs {', '.join(KINDS)}"
            )
        out[kind] = min(fits)[3]
    return out


def evaluate_transfer(
    characters: str | Path, motions: str | Path, *, mmd: str | Path | None = None, limit: int | None = None,
    work: str | Path | None = None, jobs: int | str = 1, progress: Progress | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Measure all rows.

    Args:
        characters: Folder of characters, searched through.
        motions: Folder with a motion of each kind, BVH with a `captions.csv` beside them or named by kind.
        mmd: Folder with MMD models and VMD files, searched through, for the rows of soles.
        limit: How many characters to take, spread over all; all when None.
        work: Where results are kept, so that a second call goes on where the first was stopped.
        jobs: How many processes share the characters, or "ray" for a cluster whose machines see the same files.

    Returns:
        Values by the keys of `BARS`, None where nothing could be measured; `reached`, `failed`, `rows` and `counts`.

    Raises:
        FormatError: There is no character, or a motion of some kind is missing.
    """
    from bunraku import __version__
    from bunraku.pipelines.to_reference import load_motion, reference_motion

    names = _names(Path(characters).absolute() if jobs == "ray" else Path(characters), limit)
    files, picked = list(names), pick_motions(motions)
    sources = {kind: Source.of(reference_motion(load_motion(path))) for kind, path in picked.items()}
    kept = None if work is None else KeptParts(Path(work) / "transfer")
    made_of = [__version__, *(_mark(path) for path in picked.values())]
    parts = {path: json.dumps([*made_of, names[path], _mark(path)]) for path in files}
    before = {} if kept is None else {path: kept.known(part) for path, part in parts.items()}
    found_rows: dict[Path, CharacterRow] = {path: row for path, row in before.items() if row is not None}
    measure = partial(_measured, sources)
    batches = [[(path, names[path])] for path in files if path not in found_rows]
    alone = ((batch[0], measure(batch)[0]) for batch in batches)
    for (path, name), row in alone if jobs == 1 else run_parallel(measure, batches, jobs, _lost):
        if isinstance(row, str):  # its process ended, and may not next time
            row = {"name": name, "finished": 0, "failed": {"": row}}
        elif kept is not None:
            row = kept.keep(parts[path], row)
        found_rows[path] = row
        if progress:
            progress("characters", len(found_rows) / len(files))
    rows = [found_rows[path] for path in files]
    result: dict[str, Any] = {"finished": sum(row["finished"] for row in rows) / (len(rows) * len(KINDS))}
    found = {
        key: [row[key] for row in rows if key in row] for key in ("angle_rig", "angle_handles", "back", "back_copied")
    }
    result |= {key: float(np.mean(values)) if values else None for key, values in found.items()}
    result["back_median"] = float(np.median(found["back"])) if found["back"] else None
    result["bvh_degrees"] = bvh_again(picked["walk"])
    failed = {f"{row['name']} {kind}".rstrip(): reason for row in rows for kind, reason in row["failed"].items()}
    result |= measure_quadrupeds({names[path]: path for path in files}, progress=progress)
    failed |= {f"{row['target']} as {row['source']}": row["failed"] for row in result["quadrupeds"] if "failed" in row}
    result |= measure_soles(mmd, failed)
    result["reached"] = {key: met for key, met in reached_bars(BARS, result).items() if met is not None}
    counts = {
        "characters": len(rows),
        "humanoids": sum(bool(row.get("humanoid")) for row in rows),
        "clips": len(found["back"]),
    }
    return result | {
        "counts": counts,
        "motions": {kind: path.name for kind, path in picked.items()},
        "failed": failed,
        "rows": rows,
    }


def _names(folder: Path, limit: int | None) -> dict[Path, str]:
    """The characters of a folder and their names, spread over all where there are more than `limit`."""
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    if not files:
        raise FormatError(folder, "it holds no .glb, .gltf, .vrm or .fbx character")
    if limit is not None and limit < len(files):
        files = [files[index] for index in np.linspace(0, len(files) - 1, limit).round().astype(int)]
    return {path: path.relative_to(folder).with_suffix("").as_posix() for path in files}


def _measured(sources: Mapping[str, Source], characters: list[tuple[Path, str]]) -> list[CharacterRow | str]:
    """The row of each character, by its file and name."""
    return [measure_character(path, name, sources) for path, name in characters]


def _lost(reason: str) -> CharacterRow | str:
    return reason


def _mark(path: Path) -> list[Any]:
    facts = path.stat()
    return [path.name, facts.st_size, facts.st_mtime_ns]
