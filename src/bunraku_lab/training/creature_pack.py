"""The clips of animals after which creatures attack, eat and die (`bunraku.retarget.creature_clips`), in one file."""

from __future__ import annotations

import csv
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.geometry.rotations import axis_angle_from_matrix
from bunraku.errors import BunrakuError
from bunraku.files import bones_of, clip_names, load_animation, load_character
from bunraku.pipelines.to_reference import facing
from bunraku.retarget.creature_clips import (
    FPS,
    CreatureClip,
    body_shape,
    creature_action,
    packed_clip,
    shown_by,
    write_clips,
)  # fmt: skip
from bunraku.retarget.creatures import CreatureMotion, motion_of_handles
from bunraku.retarget.rig_parts import RigParts
from bunraku.retarget.to_reference import bones_to_handles

FEWEST, MOST = 6, 130  # frames of a clip; longer ones wait before they begin
LEAP = 1.0  # a clip whose body is higher over the ground leaps away, as a frog that dies [m of the reference body]
LEAST = 0.35
"""A clip in which the head turns by less shows nothing [rad]; chosen by eye, those of 20° stood still."""
AHEAD = 0.3
"""How far ahead a body must look in every frame, as a cosine; chosen by eye: two strike with their tails."""
REARED = 0.42
"""Sine of the slope from which on a body on four legs rears; chosen by eye: dinosaurs made a crocodile leap."""
_HEAD = HANDLE_NAMES.index("head")


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
            return counts[of, action] < each

        try:
            for clip in _clips(path, animal, category, wanted):
                if clip.data not in seen:
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
    labels = clip_names(load_character(path).source.document)
    shown = {action for actions in shown_by().values() for action in actions}
    rig = None
    for label in labels:
        action = creature_action(re.sub(r"[_\d]+", " ", label.split("|")[-1]))
        if action not in shown or not wanted(action):
            continue
        animation = load_animation(path, label, FPS)
        assert isinstance(animation, Animation)
        if not FEWEST <= len(animation.motion) <= MOST:
            continue
        character, rotations, positions = facing(animation.character, *bones_of(animation))
        rig = rig or RigParts.of(character)
        creature = motion_of_handles(bones_to_handles(rig, rotations, positions, FPS), rig.anatomy)
        if creature is None:
            return
        misread = category == "quadruped" and creature.plan.front != 2
        if creature.plan.legs and not creature.flies and not misread and _shows(creature, action == "death"):
            heights = np.maximum(creature.heights - creature.heights[0], 0)  # they begin standing, and sink nowhere
            data = packed_clip(creature.motion, heights)
            yield CreatureClip(animal, action, creature.plan.kind, body_shape(rig.anatomy), len(creature.motion), data)


def _shows(creature: CreatureMotion, dies: bool) -> bool:
    """Whether the head of a body is seen to move, and the body neither turns its back nor leaps away, nor rears where
    it dies on four legs.
    """
    motion = creature.motion
    root = motion.root_rotation.astype(float)
    if dies and creature.plan.front and root[:, 1, 2].max() > REARED:
        return False
    head = root @ motion.rotations[:, _HEAD].astype(float)
    turned = np.linalg.norm(axis_angle_from_matrix(head[0].T @ head), axis=-1)
    return bool(turned.max() > LEAST and root[:, 2, 2].min() > AHEAD and np.ptp(creature.heights) < LEAP)


def main() -> None:
    """`python -m bunraku_lab.training.creature_pack OUT FOLDER ...`"""
    out, *folders = map(Path, sys.argv[1:])
    clips, left_out = pack_creatures(folders, out)
    for line in left_out:
        print(f"left out {line}", file=sys.stderr)
    print(f"wrote {len(clips)} clips of {len({clip.animal for clip in clips})} animals to {out}")


if __name__ == "__main__":
    main()
