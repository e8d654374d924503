"""A motion in few bytes: whole steps of a millimetre and two milliradians, second differences, LZMA.

A person's motion can be kept as that of the body's 22 joints, at 40 bytes a frame, which leaves out what the handles do
beyond turning about joints; or, as a creature's always is, as that of all handles, at about 100.
"""

from __future__ import annotations

import numpy as np

from bunraku.body.from_handles import skeleton_from_handles
from bunraku.body.layout import HANDLE_COUNT, JOINT_COUNT
from bunraku.body.reference import reference_body
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.formats.whole_steps import lzma_filters, pack_steps, unpack_steps
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.retarget.body_motion import body_handle_motion

__all__ = ["FORMS", "FPS", "MOST_FRAMES", "pack_motion", "unpack_motion"]

FORMS = ("skeleton", "handles")
FPS = 20.0
MOST_FRAMES = 20_000
"""Of one clip; what a file says beyond is damage."""
_METRES, _RADIANS = 1e-3, 2e-3
_LARGEST = 1 << 24
"""Of a number in steps: 16 km, beyond which there is nothing but damage."""
_NUMBERS = {"skeleton": 3 + 3 * JOINT_COUNT, "handles": 6 + 6 * (HANDLE_COUNT - 1)}
_FILTERS = lzma_filters(6, 1 << 20)


def pack_motion(motion: HandleMotion, form: str) -> bytes:
    """A motion of the 30 handles, packed.

    Args:
        motion: At 20 frames a second.
        form: "skeleton" or "handles".
    """
    frames = len(motion)
    if form == "skeleton":
        body = skeleton_from_handles(motion, rounds=1)
        lengths, turns = body.root_translation, body.rotations
    else:
        lengths = np.concatenate([motion.root_translation[:, None], motion.translations[:, 1:]], axis=1)
        turns = np.concatenate([motion.root_rotation[:, None], motion.rotations[:, 1:]], axis=1)
    angles = axis_angle_from_matrix(turns.astype(float)).reshape(frames, -1)
    return pack_steps(np.concatenate([lengths.reshape(frames, -1) / _METRES, angles / _RADIANS], axis=1), 2, _FILTERS)


def unpack_motion(data: bytes, frames: int, form: str) -> HandleMotion:
    """What `pack_motion` packed, in bounded memory.

    Raises:
        ValueError: The bytes are none of that.
    """
    if form not in FORMS or not 0 < frames <= MOST_FRAMES:
        raise ValueError(f"no clip has the form {form!r} and {frames} frames")
    values = unpack_steps(data, frames, _NUMBERS[form], 2, _FILTERS)
    if np.abs(values).max() > _LARGEST:
        raise ValueError("a clip leads out of all bounds")
    split = 3 if form == "skeleton" else 3 * HANDLE_COUNT
    lengths = (values[:, :split] * _METRES).reshape(frames, -1, 3)
    turns = matrix_from_axis_angle((values[:, split:] * _RADIANS).reshape(frames, -1, 3))
    if form == "skeleton":
        return body_handle_motion(SkeletalMotion(reference_body().skeleton, turns, lengths[:, 0], FPS))
    root_rotation, root = turns[:, 0].copy(), lengths[:, 0].copy()
    lengths[:, 0], turns[:, 0] = 0, np.eye(3)
    return HandleMotion(lengths, turns, root, root_rotation, FPS)
