"""Motions in files of their own, as clips to train on: cut out, taken to the reference body, entered in the index."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path

from bunraku.body.layout import JOINT_NAMES
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.core.resample import cut_motion, resample_motion
from bunraku.errors import BunrakuError, FormatError
from bunraku.formats.files import sweep
from bunraku.nn.pool import Pool
from bunraku.retarget.from_mesh import handle_motion_of_body
from bunraku_lab.datasets.motions.clips import load_clip, load_index, write_clip, write_index

__all__ = ["Take", "add_takes"]

FPS = 20.0
"""Frames a second of clips to train on [1/s]."""
SHORTEST, LONGEST = 0.4, 60.0  # seconds of a clip: what training can take; longer ones are cut


@dataclass(frozen=True)
class Take:
    """A clip to be made.

    Args:
        name: Its name in the index, plain and unique.
        file: The motion that it is cut from.
        texts: Captions.
        split: "train", "val" or "test".
        source: What the index says of where it is from.
        start: When it begins in the file [s].
        end: When it ends [s]; None for the end of the file.
        clip: Number or name of the clip of a file with several.
        licence: On which terms it may be learned from.
        credit: Whom to name; "" for nobody.
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
        MotionError: Its skeleton is nobody's that goes on two legs.
        OptionError: It has no such clip.
    """
    from bunraku.io.motions import load_motion
    from bunraku.pipelines.to_reference import reference_motion
    from bunraku.skeletons.skeleton_map import map_skeleton
    from bunraku.skeletons.to_smpl import to_smpl

    motion = load_motion(take.file, fps=FPS, clip=take.clip)
    if isinstance(motion, SkeletalMotion):
        if motion.skeleton.names != JOINT_NAMES:
            motion = to_smpl(motion, map_skeleton(motion.skeleton))
        end = len(motion) / motion.fps if take.end is None else take.end
        motion = resample_motion(cut_motion(motion, take.start, min(end, take.start + LONGEST)), FPS)
        _check_length(take, len(motion))
        return handle_motion_of_body(motion)
    whole = reference_motion(motion, fps=FPS)
    end = len(whole) / FPS if take.end is None else take.end
    part = whole.take(slice(round(take.start * FPS), round(min(end, take.start + LONGEST) * FPS)))
    _check_length(take, len(part))
    return part


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
    """Convert takes to handle motion and add them to the index that `build_motions` wrote.

    Clips that are there are not made again, so a second run goes on where the first one stopped.

    Args:
        takes: Of `humanml3d_takes`, `amass_takes` or `own_takes`.
        out: Folder of the motions; an index is begun where there is none.
        jobs: Processes; the number of cores when None.
        progress: Called with a stage's name and the share done.

    Returns:
        Names of the clips that are in the index now, and what failed with its reason.

    Raises:
        FormatError: The index is damaged, or cannot be written.
    """
    out = Path(out)
    sweep(out)
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
