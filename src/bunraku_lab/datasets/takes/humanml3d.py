"""Motions of HumanML3D and AMASS, which people with a licence have, beside the archive: `bunraku data motions
--humanml3d --amass`.

HumanML3D brings captions. With `index.csv` of its repository beside it, whole AMASS files get those captions too, with
rotations as they were captured in place of those found from positions. AMASS alone has names of takes, which are
captions where they hold words.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

from bunraku.errors import FormatError
from bunraku.formats.arrays.humanml3d import HUMANML3D_FPS, TimedCaption, read_texts
from bunraku_lab.datasets.motions.build import split_of
from bunraku_lab.datasets.takes.takes import Take

__all__ = ["amass_takes", "humanml3d_takes", "licensed_takes"]

_SPLITS = {"train": "train", "val": "val", "test": "test"}
_SKIPPED = {
    "Eyes_Japan_Dataset": 3.0,
    "MPI_HDM05": 3.0,
    "TotalCapture": 1.0,
    "MPI_Limits": 1.0,
    "Transitions_mocap": 0.5,
}
"""Seconds that HumanML3D cut off the start of some sets before its index counts frames."""


def humanml3d_takes(folder: str | Path) -> list[Take]:
    """What the clips of a HumanML3D folder are: `new_joint_vecs` or `new_joints`, `texts`, and `train.txt`, `val.txt`,
    `test.txt`.

    Mirrored clips (`M000001`) are left out, training mirrors by itself. A caption about a span is a clip of its own.

    Raises:
        FormatError: A folder is missing, or none of its motions has a caption.
    """
    folder = Path(folder)
    motions = next((folder / name for name in ("new_joint_vecs", "new_joints") if (folder / name).is_dir()), None)
    if motions is None or not (folder / "texts").is_dir():
        raise FormatError(
            folder, "there are no folders new_joint_vecs (or new_joints) and texts; name the folder of HumanML3D"
        )
    splits = _splits(folder)
    takes = []
    for file in sorted(motions.glob("*.npy")):
        if not file.stem.startswith("M"):
            takes += _captioned(folder, file.stem, file, f"humanml3d_{file.stem}", splits, "HumanML3D")
    if not takes:
        raise FormatError(folder, "none of its motions has a caption in texts; unpack texts.zip")
    return takes


def _splits(folder: Path) -> dict[str, str]:
    out: dict[str, str] = {}
    for split in _SPLITS:
        file = folder / f"{split}.txt"
        if file.is_file():
            out |= dict.fromkeys(file.read_text(encoding="utf-8", errors="replace").split(), split)
    return out


def _captioned(
    folder: Path,
    key: str,
    file: Path,
    name: str,
    splits: dict[str, str],
    source: str,
    start: float = 0.0,
    end: float | None = None,
) -> list[Take]:
    """One take for the captions of the whole motion, and one for each span that others are about."""
    texts = folder / "texts" / f"{key}.txt"
    if not texts.is_file() or (splits and key not in splits):
        return []
    spans: dict[tuple[float, float], list[str]] = {}
    for caption in _captions(texts):
        spans.setdefault((caption.start, caption.end), []).append(caption.text)
    split, out = splits.get(key, split_of(key)), []
    for number, ((first, last), words) in enumerate(sorted(spans.items())):
        stop = start + last if last else end
        out.append(
            Take(name if not last else f"{name}_{number}", file, tuple(words), split, source, start + first, stop)
        )
    return out


def _captions(path: Path) -> list[TimedCaption]:
    try:
        return read_texts(path)
    except FormatError:
        return []


def amass_takes(folder: str | Path, captions: str | Path | None = None) -> list[Take]:
    """What the clips of an AMASS folder are: all `.npz` below it but those of body shapes.

    Args:
        folder: It, unpacked: `SET/SUBJECT/TAKE_poses.npz`.
        captions: Folder of HumanML3D with `texts` and `index.csv`; the takes are those that it has captions for.

    Raises:
        FormatError: There are no such files, or none that the captions are about.
    """
    folder = Path(folder)
    files = sorted(file for file in folder.rglob("*.npz") if file.stem != "shape" and not file.stem.endswith("stagei"))
    if not files:
        raise FormatError(
            folder, "there is no .npz in this folder or below it; name the one that AMASS was unpacked to"
        )
    if captions is not None and (Path(captions) / "index.csv").is_file():
        takes = _indexed(folder, Path(captions))
        if not takes:
            raise FormatError(
                Path(captions) / "index.csv",
                f"none of its motions is in {folder}; name the folder that holds the sets of AMASS",
            )
        return takes
    takes = []
    for file in files:
        parts = file.relative_to(folder).with_suffix("").parts
        name = "amass_" + re.sub(r"[^A-Za-z0-9]+", "_", "_".join(parts)).strip("_")
        takes.append(Take(name, file, _words(file.stem), split_of(name), f"AMASS, {parts[0]}"))
    return takes


def licensed_takes(humanml3d: Path | None, amass: Path | None) -> list[Take]:
    """The takes of both folders, each motion once: one that AMASS has under HumanML3D's caption is not taken from
    positions too.

    Raises:
        FormatError: As `humanml3d_takes` and `amass_takes`.
    """
    captured = amass_takes(amass, humanml3d) if amass is not None else []
    known = {take.name.removeprefix("amass_") for take in captured}
    found = humanml3d_takes(humanml3d) if humanml3d is not None else []
    return captured + [take for take in found if take.name.removeprefix("humanml3d_") not in known]


def _indexed(folder: Path, captions: Path) -> list[Take]:
    splits, out = _splits(captions), []
    with (captions / "index.csv").open(newline="", encoding="utf-8", errors="replace") as rows:
        for row in csv.DictReader(rows):
            try:
                source, key = Path(row["source_path"].replace("\\", "/")), Path(row["new_name"]).stem
                first, last = int(row["start_frame"]) / HUMANML3D_FPS, int(row["end_frame"]) / HUMANML3D_FPS
            except (KeyError, TypeError, ValueError):
                raise FormatError(
                    captions / "index.csv", "its columns must be source_path, start_frame, end_frame and new_name"
                ) from None
            parts = source.parts[source.parts.index("pose_data") + 1 :] if "pose_data" in source.parts else source.parts
            file = folder.joinpath(*parts).with_suffix(".npz")
            if ".." in parts or source.is_absolute() or not file.is_file():
                continue
            skipped = next((seconds for set_name, seconds in _SKIPPED.items() if set_name in parts), 0.0)
            end = skipped + last if last > first else None
            out += _captioned(captions, key, file, f"amass_{key}", splits, f"AMASS, {parts[0]}", skipped + first, end)
    return out


def _words(stem: str) -> tuple[str, ...]:
    """The caption that a take's name is: `03_walk_backwards_poses` says "walk backwards", `01_01_poses` nothing."""
    words = re.findall(r"[A-Z]?[a-z]{2,}", re.sub(r"_(poses|stageii)$", "", stem))
    return (" ".join(words).lower(),) if any(len(word) > 2 for word in words) else ()
