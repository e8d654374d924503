"""Motions in files as clips to train on: a folder with captions, and HumanML3D and AMASS for licensees."""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Callable, Mapping
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from pathlib import Path

from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.files import path_inside, read_bounded, remove_leftovers
from bunraku.core.motion import HandleMotion, SkeletalMotion, resample_motion
from bunraku.core.parallel import Pool
from bunraku.errors import BunrakuError, FormatError, MotionError
from bunraku.files import HUMANML3D_FPS
from bunraku.generation.pack import OWN
from bunraku_lab.datasets.motions.build import handle_motion_of_body, split_of
from bunraku_lab.datasets.motions.clips import load_clip, load_index, write_clip, write_index

FPS = 20.0
"""Frames a second of clips to train on [1/s]."""
SHORTEST, LONGEST = 0.4, 60.0  # seconds of a clip: what training can take; longer ones are cut


@dataclass(frozen=True)
class Take:
    """A clip to be made of a motion's file, with captions.

    Args:
        split: "train", "val" or "test".
        source: What the index says of where it is from.
        start, end: When it begins and ends in the file [s]; None for the end of the file.
        clip: Number or name of the clip of a file with several.
        licence, credit: On which terms it may be learned from, and the authors to name.
        watched: Its sentences were written for just these seconds of it.
    """

    name: str
    file: Path
    texts: tuple[str, ...]
    split: str
    source: str
    start: float = 0.0
    end: float | None = None
    clip: int | str = 0
    licence: str = "as the owner's"
    credit: str = ""
    watched: bool = False


def take_motion(take: Take) -> HandleMotion:
    """The motion of a take on the reference body, at 20 frames a second.

    Raises:
        FormatError: The file cannot be read, or what is asked of it is too short.
        MotionError: Its skeleton does not go on two legs.
        OptionError: It has no such clip.
    """
    from bunraku.anatomy.names.skeleton_map import map_skeleton
    from bunraku.anatomy.names.to_smpl import to_smpl
    from bunraku.pipelines.to_reference import load_motion, reference_motion

    motion = load_motion(take.file, fps=FPS, clip=take.clip)
    if isinstance(motion, SkeletalMotion):
        if motion.skeleton.names != JOINT_NAMES:
            motion = to_smpl(motion, map_skeleton(motion.skeleton))
        end = len(motion) / motion.fps if take.end is None else take.end
        motion = resample_motion(_cut(motion, take.start, min(end, take.start + LONGEST)), FPS)
        _check_length(take, len(motion))
        return handle_motion_of_body(motion)
    whole = reference_motion(motion, fps=FPS)
    end = len(whole) / FPS if take.end is None else take.end
    part = whole.take(slice(round(take.start * FPS), round(min(end, take.start + LONGEST) * FPS)))
    _check_length(take, len(part))
    return part


def _cut(motion: SkeletalMotion, start: float, end: float) -> SkeletalMotion:
    """The frames from one time to another [s]; what lies outside the motion is left out."""
    first, stop = max(round(start * motion.fps), 0), min(round(end * motion.fps), len(motion))
    if stop <= first:
        seconds = len(motion) / motion.fps
        raise MotionError(f"no frame lies between {start:g} s and {end:g} s of a motion of {seconds:.2f} s")
    rotations, root = motion.rotations[first:stop], motion.root_translation[first:stop]
    return SkeletalMotion(motion.skeleton, rotations, root, motion.fps)


def _check_length(take: Take, frames: int) -> None:
    if frames < SHORTEST * FPS:
        raise FormatError(take.file, f"the {frames / FPS:.2f} s of clip {take.name} are too short to learn from")


def _convert(take: Take, out: Path) -> tuple[str, int, str]:
    try:
        motion = take_motion(take)
        write_clip(out / f"{take.name}.npz", motion)
        return take.name, len(motion), ""
    except BunrakuError as error:
        return take.name, 0, str(error)


def add_takes(
    takes: list[Take], out: str | Path, jobs: int | None = None, progress: Callable[[str, float], None] | None = None
) -> tuple[list[str], dict[str, str]]:
    """Convert takes of `humanml3d_takes`, `amass_takes` or `own_takes` to handle motion, on as many processes as there
    are cores by default, and add them to the index that `build_motions` wrote, or to a new one. The names of its clips
    are given back, and what failed with its reason.

    Clips that are there are not made again, so a second run goes on where the first one stopped.

    Raises:
        FormatError: The index is damaged, or cannot be written.
    """
    out = Path(out)
    remove_leftovers(out)
    clips = load_index(out) if (out / "index.json").is_file() else {}
    by_name = {take.name: take for take in takes}
    added: list[str] = []
    failed: dict[str, str] = {}
    since = 0

    def enter(name: str, frames: int) -> None:
        take = by_name[name]
        entry = {"texts": list(take.texts), "source": take.source, "licence": take.licence, "frames": frames}
        if take.watched:
            entry["stretches"] = [{"start": 0, "stop": frames, "texts": list(take.texts)}]
        clips[name] = entry | {"split": take.split, "weight": 1.0} | ({"credit": take.credit} if take.credit else {})
        added.append(name)

    for name in by_name:  # the index may have been written anew without them
        if (out / f"{name}.npz").is_file():
            enter(name, len(load_clip(out / f"{name}.npz")))
    made = set(added)
    todo = [take for name, take in by_name.items() if name not in made]

    def note(name: str, frames: int, problem: str) -> None:
        nonlocal since
        if problem:
            failed[name] = problem
        else:
            enter(name, frames)
        since += 1
        if since >= 500:  # a run that is cut off keeps what it has done
            write_index(out, clips)
            since = 0
        if progress:
            progress("converting motions", (len(added) + len(failed)) / len(by_name))

    jobs = jobs or os.cpu_count() or 1
    if jobs == 1 or len(todo) < 8:
        for take in todo:
            note(*_convert(take, out))
    else:
        try:
            with Pool(jobs) as pool:
                for future in as_completed([pool.submit(_convert, take, out) for take in todo]):
                    note(*future.result())
        except KeyboardInterrupt:
            write_index(out, clips)
            raise
    write_index(out, clips)
    return added, failed


CAPTIONS = "captions.csv"
"""The file of the captions, in the folder of the motions."""
MOST_ROWS = 100_000
MOST_WORDS = 1_000
"""Letters of one sentence."""
_SPLIT_NAMES = ("train", "val", "test")


def own_takes(folder: str | Path) -> list[Take]:
    """What the rows of `captions.csv` say of the motions beside it.

    Rows about the same seconds of the same file are one take with several sentences, the fullest first.

    Raises:
        FormatError: There is no such file, a column is missing, or a row cannot be followed; the row is named.
    """
    folder = Path(folder)
    path = folder / CAPTIONS
    if not path.is_file():
        raise FormatError(path, "there is no such file; write one with the columns file and text beside the motions")
    found: dict[tuple[object, ...], tuple[Take, list[str]]] = {}
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.DictReader(file)
            if not {"file", "text"} <= set(rows.fieldnames or ()):
                raise FormatError(path, "its first line must name the columns file and text, parted by commas")
            for row in rows:
                if rows.line_num > MOST_ROWS:
                    raise FormatError(path, f"it has more than {MOST_ROWS} lines; take several folders")
                take = _take(path, row, rows.line_num)
                key = (take.file, take.clip, take.start, take.end)
                found.setdefault(key, (take, []))[1].extend(take.texts)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FormatError(path, f"it cannot be read ({error}); save it as CSV in UTF-8") from error
    if not found:
        raise FormatError(path, "it has no rows; write one for each sentence")
    return [
        replace(
            take, texts=tuple(sorted(dict.fromkeys(texts), key=lambda text: -len(text.split())))
        )  # the fullest first
        for take, texts in found.values()
    ]


def _take(path: Path, row: Mapping[str | None, str | None], line: int) -> Take:
    cells = {name: (value or "").strip() for name, value in row.items() if name and isinstance(value, str)}
    name, text = cells.get("file", ""), " ".join(cells.get("text", "").split())
    if not name or not text:
        raise FormatError(path, f"line {line}: the {'text' if name else 'file'} is missing")
    if len(text) > MOST_WORDS:
        raise FormatError(path, f"line {line}: the text has more than {MOST_WORDS} letters; say it shorter")
    file = path_inside(path.parent, name)
    if file is None:
        raise FormatError(path, f"line {line}: {name!r} names no file below the folder; copy the motion into it")
    if not file.exists():
        raise FormatError(path, f"line {line}: there is no file {name} in the folder")
    start, end = (_seconds(path, cells.get(column, ""), line) for column in ("start", "end"))
    if end is not None and end <= (start or 0.0):
        raise FormatError(path, f"line {line}: the end must come after the start")
    split = cells.get("split", "") or "train"
    if split not in _SPLIT_NAMES:
        raise FormatError(path, f"line {line}: the split is '{split[:20]}'; write train, val or test")
    clip = cells.get("clip", "")
    licence = cells.get("licence", "") or cells.get("license", "") or "as the owner's"
    return Take(
        _name(name, clip, start, end), file, (text,), split, f"own, {name}", start or 0.0, end,
        int(clip) if clip.isdecimal() else clip or 0, licence, cells.get("credit", ""), True,
    )  # fmt: skip


def _seconds(path: Path, text: str, line: int) -> float | None:
    try:
        value = float(text) if text else None
    except ValueError:
        value = math.nan
    if value is not None and not 0 <= value < 1e6:
        raise FormatError(path, f"line {line}: '{text[:20]}' is no time in seconds")
    return value


def _name(name: str, clip: str, start: float | None, end: float | None) -> str:
    """A plain name for a take, by what it is cut from, so that other cuts of a file are other clips."""
    parts = [Path(name).with_suffix("").as_posix(), clip]
    parts += [f"{seconds:.2f}" for seconds in (start, end) if seconds is not None]
    return OWN + re.sub(r"[^A-Za-z0-9]+", "_", "_".join(filter(None, parts))).strip("_")


_SPLITS = {"train": "train", "val": "val", "test": "test"}
_SKIPPED = {
    "Eyes_Japan_Dataset": 3.0, "MPI_HDM05": 3.0, "TotalCapture": 1.0, "MPI_Limits": 1.0, "Transitions_mocap": 0.5,
}  # fmt: skip
"""Seconds that HumanML3D (Guo et al. 2022) cut off the start of some sets before its index counts frames."""


def humanml3d_takes(folder: str | Path) -> list[Take]:
    """The files of a HumanML3D folder: `new_joint_vecs` or `new_joints`, `texts`, `train.txt`, `val.txt`, `test.txt`.

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
    folder: Path, key: str, file: Path, name: str, splits: dict[str, str], source: str, start: float = 0.0,
    end: float | None = None,
) -> list[Take]:  # fmt: skip
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


@dataclass(frozen=True)
class TimedCaption:
    """A description of a motion.

    Args:
        text: The caption.
        start: When it begins [s].
        end: When it ends [s]; 0 like the start where it is about the whole motion.
    """

    text: str
    start: float = 0.0
    end: float = 0.0


def read_texts(path: str | Path) -> list[TimedCaption]:
    """Captions of a file of `texts`: lines of `caption#word/KIND word/KIND#start#end`.

    Lines whose span is not a number, or ends before it begins, are about the whole motion.

    Raises:
        FormatError: The file cannot be read, or holds no caption.
    """
    path = Path(path)
    try:
        lines = read_bounded(path).decode("utf-8").splitlines()
    except UnicodeDecodeError:
        raise FormatError(path, "these captions are not text in UTF-8; download them again") from None
    out = []
    for line in lines:
        text, *rest = line.split("#")
        text = " ".join(text.split())
        if text:
            out.append(TimedCaption(text, *_span(rest[-2:] if len(rest) >= 3 else [])))
    if not out:
        raise FormatError(path, "there is no caption in it; lines are 'caption#tokens#start#end'")
    return out


def _span(words: list[str]) -> tuple[float, float]:
    try:
        start, end = (float(word) for word in words)
    except ValueError:
        return 0.0, 0.0
    return (start, end) if math.isfinite(start) and math.isfinite(end) and 0 <= start < end else (0.0, 0.0)


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
    """The takes of both folders, each motion once: AMASS goes before positions of HumanML3D.

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
