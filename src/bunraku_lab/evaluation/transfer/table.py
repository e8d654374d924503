"""What motion transfer is worth: the table of `bunraku evaluate transfer`."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from bunraku.errors import FormatError
from bunraku.nn.spread import spread
from bunraku_lab.evaluation.report import Bar, reached_bars
from bunraku_lab.evaluation.transfer.character import CharacterRow, Source, facing_character, measure_character
from bunraku_lab.evaluation.transfer.mmd import measure_soles
from bunraku_lab.evaluation.transfer.quadrupeds import measure_quadrupeds
from bunraku_lab.evaluation.transfer.results import SUFFIXES, measure_results, pairs_of, write_pairs
from bunraku_lab.evaluation.transfer.speed import MANY, bvh_again, times

__all__ = ["BARS", "KINDS", "evaluate_transfer", "pick_motions", "write_transfer_pairs"]

KINDS = ("walk", "dance", "kick", "sit", "roll")
Progress = Callable[[str, float], None]


def _bar(title: str, unit: str, least: float | None = None, most: float | None = None) -> Bar:
    def show(value: float) -> str:
        if unit == " m":
            return f"{1000 * value:.4f} mm"
        return f"{value:.2f}{unit}" if unit and value >= 0.1 else f"{value:.4f}{unit}" if unit else f"{value:.2%}"

    return Bar(title, least, most, show)


BARS: dict[str, Bar] = {
    "finished": _bar("pairs of character and motion that finished", "", least=1.0),
    "angle_rig": _bar("limb directions on rigs, mean", " deg", most=5.0),
    "results": _bar("another method: pairs that came back and play", ""),
    "angle_results": _bar("the same: limb directions on rigs, mean", " deg"),
    "angle_rig_there": _bar("ours on the same characters", " deg"),
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
    "seconds_bvh": _bar("reading a BVH of 2 minutes at 120 Hz", " s", most=0.5),
    "seconds_rig": _bar("10 s of motion onto the rig of 20k vertices", " s", most=1.5),
    "seconds_handles": _bar("10 s of motion onto the handles of 20k vertices, handles known", " s", most=1.5),
}


def pick_motions(folder: str | Path) -> dict[str, Path]:
    """A motion of each kind of `KINDS` in a folder: by the captions of its `captions.csv`, or by the names of the
    files.

    Of several that fit, one that says just this word is taken, then the one with the fewest words, then the first by
    name.

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
    characters: str | Path,
    motions: str | Path,
    *,
    mmd: str | Path | None = None,
    limit: int | None = None,
    work: str | Path | None = None,
    results: str | Path | None = None,
    speed: bool = True,
    jobs: int | str = 1,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure all rows.

    Args:
        characters: Folder of characters, searched through.
        motions: Folder with a motion of each kind, BVH with a `captions.csv` beside them or named by kind.
        mmd: Folder with MMD models and VMD files, searched through, for the rows of soles.
        limit: How many characters to take, spread over all; all when None.
        work: Where what was measured of each character is kept, so that a second call goes on where the first was
            stopped.
        results: Folder of another method's results (`results.measure_results`).
        speed: Whether to measure times too.
        jobs: How many processes share the characters, or "ray" for a cluster whose machines see the same files.
        progress: Called with a stage's name and the share done.

    Returns:
        Values by the keys of `BARS`, None where nothing could be measured; `reached`, `failed`, `rows` and `counts`.

    Raises:
        FormatError: There is no character, or a motion of some kind is missing.
    """
    from bunraku.io.motions import load_motion
    from bunraku.pipelines.to_reference import reference_motion

    names = _names(Path(characters).absolute() if jobs == "ray" else Path(characters), limit)
    files, picked = list(names), pick_motions(motions)
    sources = {kind: Source.of(reference_motion(load_motion(path))) for kind, path in picked.items()}
    kept = _Kept(None if work is None else Path(work), picked)
    before = {path: kept.row(path, names[path]) for path in files}
    found_rows = {path: row for path, row in before.items() if row is not None}
    measure = partial(_measured, sources)
    batches = [[(path, names[path])] for path in files if path not in found_rows]
    alone = ((batch[0], measure(batch)[0]) for batch in batches)
    for (path, name), row in alone if jobs == 1 else spread(measure, batches, jobs, _lost):
        if isinstance(row, str):  # its process ended, and may not next time
            row = {"name": name, "finished": 0, "failed": {"": row}}
        else:
            kept.keep(path, row)
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
    result |= dict.fromkeys(("results", "angle_results", "angle_rig_there"))
    if results is not None:
        result |= measure_results(results, pairs_of(names, picked), sources, rows, failed, progress)
    if speed:
        humanoids = [
            (abs(row["vertices"] - MANY), path) for row, path in zip(rows, files, strict=True) if row.get("humanoid")
        ]
        nearest = min(humanoids)[1] if humanoids else None
        result |= times(None if nearest is None else facing_character(nearest, names[nearest]), sources["walk"].motion)
    else:
        result |= dict.fromkeys(("seconds_bvh", "seconds_rig", "seconds_handles"))
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


def write_transfer_pairs(
    path: str | Path, characters: str | Path, motions: str | Path, limit: int | None = None
) -> Path:
    """Write which pairs of character and motion another method is to make, and how each result is to be named.

    Args:
        path: The CSV.
        characters, motions, limit: As `evaluate_transfer` takes them.

    Raises:
        FormatError: There is no character, a motion of some kind is missing, or the file cannot be written.
    """
    return write_pairs(path, pairs_of(_names(Path(characters), limit), pick_motions(motions)))


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


class _Kept:
    """Rows of characters in a file, a line of JSON each, with what they were made of."""

    def __init__(self, folder: Path | None, picked: dict[str, Path]):
        from bunraku import __version__

        self.file = None if folder is None else folder / "transfer.jsonl"
        self.made_of = [__version__, *(_mark(path) for path in picked.values())]
        self.rows: dict[str, CharacterRow] = {}
        if folder is None or self.file is None:
            return
        try:
            folder.mkdir(parents=True, exist_ok=True)
            lines = self.file.read_text(encoding="utf-8").splitlines() if self.file.is_file() else []
        except OSError as error:
            raise FormatError(
                folder, f"rows cannot be kept here ({error.strerror}); name another folder with --work"
            ) from None
        for line in lines:
            try:
                made_of, row = json.loads(line)
                self.rows[json.dumps(made_of)] = cast(CharacterRow, dict(row))
            except (ValueError, TypeError, RecursionError):
                continue  # the line that was being written when the run was stopped

    def row(self, path: Path, name: str) -> CharacterRow | None:
        return self.rows.get(json.dumps([*self.made_of, name, _mark(path)]))

    def keep(self, path: Path, row: CharacterRow) -> None:
        if self.file is not None:
            with self.file.open("a", encoding="utf-8") as file:
                file.write(json.dumps([[*self.made_of, row["name"], _mark(path)], row]) + "\n")


def _mark(path: Path) -> list[Any]:
    facts = path.stat()
    return [path.name, facts.st_size, facts.st_mtime_ns]
