"""Clips that Bunraku wrote, to go on from: the handle motion of a GLB or an NPZ with all that the file knows of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.body.reference import reference_body
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError, MotionError
from bunraku.formats.arrays.npz import read_motion, read_positions, read_reference
from bunraku.formats.files import check_input, read_bounded
from bunraku.formats.gltf.bunraku_clip import clip_handles, packed_motion
from bunraku.io.registry import load_character

__all__ = ["Clip", "load_clip", "load_clip_animation"]

SAME = 1e-3  # of a character's largest extent: handles this near are the same ones


@dataclass(frozen=True)
class Clip:
    """A handle motion as a file has it.

    Args:
        path: The file.
        motion: The motion, in the frame of the character that it was made for.
        reference: The motion of the reference body that it was fitted from, where the file holds it.
        positions: Rest positions of the character's handles [m], shape (K, 3), where the file holds them.
    """

    path: Path
    motion: HandleMotion
    reference: HandleMotion | None
    positions: np.ndarray | None

    def is_of(self, handles: Handles) -> bool:
        """Whether the motion was made for these handles."""
        if self.positions is None or self.positions.shape != handles.positions.shape:
            return False
        return bool(np.abs(self.positions - handles.positions).max() <= SAME * np.ptp(handles.positions, axis=0).max())

    def of_the_reference_body(self) -> HandleMotion:
        """The motion of the reference body.

        Raises:
            MotionError: The file holds that of another character only.
        """
        if self.reference is not None:
            return self.reference
        if self.positions is None or self.is_of(reference_body().handles):
            return self.motion
        raise MotionError(
            f"{self.path}: this motion was made for a character and does not tell what the reference body does; name "
            "that character"
        )

    def on(self, character: Character, handles: Handles) -> Animation | None:
        """The animation of the character that the motion was made for, or None if this is another one."""
        return Animation(character, handles, self.motion, self.reference) if self.is_of(handles) else None


def load_clip(path: str | Path) -> Clip:
    """Read a clip that Bunraku wrote, GLB or NPZ.

    Raises:
        FormatError: The file is missing or broken, or was not written by Bunraku.
        MotionError: What it holds breaks the rules of a motion.
    """
    path = Path(path)
    check_input(path)
    data = read_bounded(path)
    if data[:4] == b"glTF":
        data = packed_motion(path, data)
    elif data[:2] != b"PK":
        raise FormatError(
            path, "clips are read from the .glb and .npz files that Bunraku writes; make one with `bunraku animate`"
        )
    return Clip(path, read_motion(path, data), read_reference(path, data), read_positions(path, data))


def load_clip_animation(path: str | Path) -> Animation:
    """Read a GLB that Bunraku wrote: character, handles and motion, to be edited or followed.

    Raises:
        FormatError: The file is missing or broken, or was not written by Bunraku.
        CharacterError: It holds no usable mesh.
        MotionError: What it holds breaks the rules of a motion.
    """
    clip = load_clip(path)
    character = load_character(path)
    return Animation(character, clip_handles(clip.path, character), clip.motion, clip.reference)
