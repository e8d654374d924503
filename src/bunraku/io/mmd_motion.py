"""Animations of MMD characters, written as VMD."""

from __future__ import annotations

from pathlib import Path

from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.core.mmd_model import mmd_model
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import FormatError, MotionError, OptionError
from bunraku.formats.mmd.vmd import VMD_FPS
from bunraku.formats.mmd.vmd_write import write_vmd
from bunraku.io.humanoid import humanoid_motion

__all__ = ["check_character", "write_character_vmd"]


def check_character(character: Character, path: Path) -> None:
    """Raise FormatError unless a VMD can hold what a character does."""
    if mmd_model(character) is None:
        raise FormatError(
            path,
            f"a VMD moves the bones of an MMD model, and {character.name} is none; transfer onto a .pmx or .pmd, or "
            "write a .bvh or .vrma",
        )


def write_character_vmd(animation: Animation | RigAnimation, path: Path, *, fps: float | None = None) -> Path:
    """Write what an MMD character does as keys of its bones, at 30 frames a second, with the inverse kinematics of its
    legs off.

    An animation of the character's own bones is written bone by bone, one of its handles as what SMPL's 22 joints do.

    Args:
        animation: Of a character that was read from a PMX or PMD file.
        path: The file.
        fps: Only 30 is possible, which is what VMD files have.

    Raises:
        FormatError: The character is of another kind, the model has a bone whose name VMD cannot hold, or the file
            cannot be written.
        OptionError: Another rate is requested.
        MotionError: The animation is of handles, and the model's bones lack MMD's standard names.
    """
    from bunraku.retarget.mmd.retarget import mmd_clip, mmd_motion

    if fps not in (None, VMD_FPS):
        raise OptionError(f"VMD files have 30 frames a second, not {fps:g}; leave fps out, and the motion is resampled")
    character = animation.character
    check_character(character, path)
    if isinstance(animation, RigAnimation):
        return write_vmd(mmd_clip(animation), path)
    try:
        motion = humanoid_motion(animation)
    except MotionError as error:
        raise FormatError(path, str(error)) from None
    return write_vmd(mmd_motion(character, motion), path)
