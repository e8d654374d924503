"""HumanML3D (Guo et al. 2022): motions as feature vectors (N, 263) or joint positions (N, 22, 3) in `.npy` files, and
their captions.

A row of `new_joint_vecs` holds, at 20 frames a second and for SMPL's 22 joints in our frame:

======= =====================================================================================================
0       half of the turn about +Y from this frame to the next one [rad]
1:3     step of the root (x, z) from this frame to the next one, in the next one's heading [m]
3       height of the root [m]
4:67    positions of joints 1..21 from the point below the root, heading removed [m]
67:193  6D rotations of joints 1..21 by the set's own inverse kinematics
193:259 steps of the 22 joints, heading removed [m]
259:263 contacts of both feet
======= =====================================================================================================

The rotations are relative to a skeleton whose bones lie along the axes and know nothing of how bones are rolled, so the
positions, which are exact, are what is read; `bunraku.body.from_positions` finds the rotations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.body.layout import JOINT_COUNT
from bunraku.core.motion import SkeletalMotion
from bunraku.errors import FormatError
from bunraku.formats.arrays.npy import read_npy
from bunraku.formats.files import read_bounded
from bunraku.geometry.rotations import matrix_y

__all__ = ["HUMANML3D_FPS", "TimedCaption", "positions_of_vectors", "read_humanml3d", "read_texts"]

HUMANML3D_FPS = 20.0
MAX_FRAMES = 24_000
"""Longest motion that is read: each frame takes a tenth of a millisecond, as its rotations are found anew."""
VECTOR_SIZE = 12 * JOINT_COUNT - 1


def read_humanml3d(path: Path, data: bytes) -> SkeletalMotion:
    """Read a file of `new_joint_vecs` or `new_joints`.

    Args:
        path: The file.
        data: Its bytes.

    Returns:
        SMPL's 22 joints at 20 frames a second, through the positions of the file.

    Raises:
        FormatError: The file is broken, holds objects, or has another shape.
        MotionError: A value is not a number.
    """
    array = read_npy(path, data)
    if len(array.shape) and len(array) > MAX_FRAMES:
        raise FormatError(
            path, f"it has {len(array):,} frames but at most {MAX_FRAMES:,} (20 minutes) are read; cut it into parts"
        )
    if array.ndim == 2 and array.shape[1] == VECTOR_SIZE and len(array):
        positions = positions_of_vectors(array)
    elif array.ndim == 3 and array.shape[1:] == (JOINT_COUNT, 3) and len(array):
        positions = array
    else:
        raise FormatError(
            path,
            f"motions of HumanML3D have shape (N, {VECTOR_SIZE}) or (N, {JOINT_COUNT}, 3), not {array.shape}; give "
            "one of those",
        )
    from bunraku.body.from_positions import motion_from_positions  # after the formats, in the order of imports

    return motion_from_positions(positions, HUMANML3D_FPS)


def positions_of_vectors(vectors: np.ndarray) -> np.ndarray:
    """Joint positions of feature vectors, from a start at x = z = 0 that faces +Z.

    Args:
        vectors: Rows as above, not normalised, shape (N, 263).

    Returns:
        Positions [m], shape (N, 22, 3).
    """
    x = np.asarray(vectors, float)
    turned, steps = np.zeros(len(x)), np.zeros((len(x), 3))
    turned[1:] = np.cumsum(x[:-1, 0])
    steps[1:, [0, 2]] = x[:-1, 1:3]
    facing = matrix_y(-2 * turned)  # the set stores the turn that takes the heading off
    root = np.cumsum(np.einsum("nij,nj->ni", facing, steps), axis=0)
    local = np.zeros((len(x), JOINT_COUNT, 3))
    local[:, 0, 1] = x[:, 3]
    local[:, 1:] = x[:, 4 : 4 + 3 * (JOINT_COUNT - 1)].reshape(len(x), -1, 3)
    return np.asarray(np.einsum("nij,nkj->nki", facing, local) + root[:, None])


@dataclass(frozen=True)
class TimedCaption:
    """What somebody saw in a motion.

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
