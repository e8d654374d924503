"""Labelled clips of rigged characters as handle motions of the reference body: `bunraku data motions --characters`.

Game packs hold what motion capture lacks: waving, clapping, punches and kicks with either side. `game_clips.json` names
the clips and gives their captions, in which {hand} and {leg} become the side that moves more. Only clips that stay in
place are taken, because most packs let their characters walk on the spot, and only characters whose default pose is
near to upright.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.animation import Animation
from bunraku.core.motion import HandleMotion
from bunraku.errors import BunrakuError
from bunraku.handles.from_rig import rig_handles
from bunraku.retarget.from_mesh import handle_motion_of_mesh
from bunraku.retarget.reference import motion_to_reference
from bunraku_lab.datasets.archive import present_files
from bunraku_lab.datasets.motions.build import split_of
from bunraku_lab.datasets.motions.clips import load_index, write_clip, write_index

__all__ = ["add_game_clips", "reference_clip"]


def reference_clip(animation: Animation) -> HandleMotion:
    """What a rigged character does, by whatever handles it is driven, as handle motion of the reference body.

    Raises:
        CharacterError: The character has no rig with telling names.
    """
    character = animation.character
    handles = rig_handles(character, least=8)
    areas = character.areas
    motion = handle_motion_of_mesh(
        character.vertices, animation.vertices(), handles.weights, handles.positions, areas, animation.motion.fps
    )
    return motion_to_reference(motion, Anatomy.of(character, handles))


def _side(motion: HandleMotion, part: str) -> str:
    """The side on which a handle travels farther in the root's frame."""
    travel = {}
    for side in ("left", "right"):
        handle = HANDLE_NAMES.index(f"{side}_{part}")
        travel[side] = float(np.linalg.norm(np.diff(motion.translations[:, handle], axis=0), axis=1).sum())
    return max(travel, key=lambda side: travel[side])


def add_game_clips(
    characters: str | Path, out: str | Path, progress: Callable[[str, float], None] | None = None
) -> tuple[list[str], dict[str, str]]:
    """Convert the clips that `game_clips.json` names and add them to the index that `build_motions` wrote.

    Args:
        characters: Folder of the unpacked character archive.
        out: Folder of the motions, with its `index.json`.
        progress: Called with a stage's name and the share done.

    Returns:
        Names of the clips in the index, and what failed with its reason.

    Raises:
        FormatError: There is no index, or none of the characters is there.
    """
    from bunraku.io.play import load_animation

    characters, out = Path(characters), Path(out)
    clips = load_index(out)
    table = json.loads(
        resources.files("bunraku_lab.datasets.motions").joinpath("game_clips.json").read_text(encoding="utf-8")
    )
    wanted = [
        (file, clip, caption) for file in present_files(characters, table) for clip, caption in table[file].items()
    ]
    added, failed = [], {}
    for number, (file, clip, caption) in enumerate(wanted):
        name = "game_" + file.replace("/", "-") + f"_{clip}"
        try:
            motion = reference_clip(load_animation(characters / f"{file}.glb", clip, 20.0))
        except BunrakuError as error:
            failed[name] = str(error)
            continue
        write_clip(out / f"{name}.npz", motion)
        text = caption.format(hand=_side(motion, "wrist"), leg=_side(motion, "ankle"))
        entry = {"texts": [text], "source": f"character archive, {file}", "licence": "CC0-1.0", "frames": len(motion)}
        clips[name] = entry | {"split": split_of(name), "weight": 1.0}
        added.append(name)
        if progress:
            progress("converting clips of characters", (number + 1) / len(wanted))
    write_index(out, clips)
    return added, failed
