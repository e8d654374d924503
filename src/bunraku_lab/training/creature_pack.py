"""The clips of animals after which creatures walk, attack, eat and die (`bunraku.retarget.creature_clips`), in one
file.
"""

from __future__ import annotations

import csv
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from bunraku.anatomy.handles.orientation import upright
from bunraku.errors import BunrakuError
from bunraku.files import load_character
from bunraku.language.parse import parse
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.requests import Request
from bunraku.retarget.creature_clips import GAITS, CreatureClip, file_clips, write_clips
from bunraku.retarget.creatures import CreatureMotion

LEAP = 1.0  # a clip whose body is higher over the ground leaps away, as a frog that dies [m of the reference body]
SHARED = 4  # clips of all fish, and of what flies without legs, that do the same
SUDDEN = 15  # a death that takes fewer frames is only a fall; chosen by eye on a deer
AHEAD = 0.3
"""How far ahead a body must look in every frame, as a cosine; chosen by eye: two strike with their tails."""
REARED = 0.42
"""Sine of the slope from which on a body on four legs rears; chosen by eye: dinosaurs made a crocodile leap."""


def pack_creatures(
    folders: Sequence[Path], out: Path, each: int = 2, progress: Callable[[str, float], None] | None = None
) -> tuple[list[CreatureClip], list[str]]:
    """Pack the clips of rigged animals: of each animal and action the first `each` that differ.

    Args:
        folders: Each with `index_new_rows.csv` or `index.csv`, whose columns are path, category and licence.
        out: The file to write.
        each: Clips of one animal that do the same.
        progress: Called with the stage and the share done.

    Returns:
        The clips, and a line for each file that was left out.
    """
    rows = [row for folder in folders for row in _rows(folder)]
    clips: list[CreatureClip] = []
    left_out: list[str] = []
    counts: Counter[tuple[str, str]] = Counter()
    seen: set[bytes] = set()
    licences: Counter[str] = Counter()
    credits: dict[str, None] = {}
    for done, (path, category, licence, origin) in enumerate(rows):
        animal = re.split(r"[_\d]", path.stem.lower())[0]

        def wanted(action: str, of: str = animal) -> bool:
            return counts[of, action] < (1 if action in GAITS else each)

        try:
            for clip in _clips(path, animal, category, wanted):
                legless = clip.body.startswith(("fish", "wings"))  # forty fish share their clips
                counts[clip.body, clip.action] += 1
                if clip.data not in seen and not (legless and counts[clip.body, clip.action] > SHARED):
                    counts[animal, clip.action] += 1
                    seen.add(clip.data)
                    licences[licence] += 1
                    credits[origin] = None
                    clips.append(clip)
        except BunrakuError as error:
            left_out.append(f"{path.name}: {error}")
        if progress:
            progress("creatures", (done + 1) / len(rows))
    write_clips(out, clips, {"licences": dict(licences), "credits": sorted(credits)})
    return clips, left_out


def _rows(folder: Path) -> Iterator[tuple[Path, str, str, str]]:
    for table in sorted(folder.glob("index*.csv")):
        with table.open(encoding="utf-8", newline="") as lines:
            for row in csv.DictReader(lines):
                if row["category"] != "humanoid" and row["path"].endswith(".glb"):
                    yield folder / row["path"], row["category"], row["licence"], row["origin"]


def _clips(path: Path, animal: str, category: str, wanted: Callable[[str], bool]) -> Iterator[CreatureClip]:
    """The clips of a file whose actions are wanted and that move a body that is no person and was read rightly."""
    parts = Animator.shipped().body(upright(load_character(path)), Request(parse("it waits", 1.0))).parts
    if parts is None or (category == "quadruped" and parts.anatomy.plan.front != 2):
        return
    for clip, motion in file_clips(parts, animal, wanted):
        if clip.action in GAITS or _shows(motion, clip.action == "death"):
            yield clip


def _shows(creature: CreatureMotion, dies: bool) -> bool:
    """Whether a body neither turns its back nor leaps away, nor dies at once, nor rears where it dies on four legs."""
    root = creature.motion.root_rotation.astype(float)
    reared = bool(creature.plan.front) and root[:, 1, 2].max() > REARED
    if dies and (reared or len(root) < SUDDEN):
        return False
    leaps = bool(creature.plan.legs) and np.ptp(creature.heights) > LEAP
    return bool(root[:, 2, 2].min() > AHEAD and not leaps)


def main() -> None:
    """`python -m bunraku_lab.training.creature_pack OUT FOLDER ...`"""
    out, *folders = map(Path, sys.argv[1:])
    clips, left_out = pack_creatures(folders, out)
    for line in left_out:
        print(f"left out {line}", file=sys.stderr)
    print(f"wrote {len(clips)} clips of {len({clip.animal for clip in clips})} animals to {out}")


if __name__ == "__main__":
    main()
