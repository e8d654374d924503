"""Handle motion as NPZ: plain arrays that numpy opens anywhere, read without pickle and within bounds."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.body.layout import handle_names
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.errors import FormatError
from bunraku.formats.arrays.npy import npz_names, open_npz, read_member
from bunraku.formats.files import atomic_write
from bunraku.geometry.rotations import matrix_from_6d

if TYPE_CHECKING:
    from bunraku.core.animation import Animation
    from bunraku.core.character import Handles

__all__ = [
    "REFERENCE",
    "motion_arrays",
    "pack_animation",
    "pack_motion",
    "read_any_motion",
    "read_motion",
    "read_positions",
    "read_reference",
    "write_animation",
]

REFERENCE = "reference_"

_NEEDED = ("translations", "rotations", "root_translation", "root_rotation", "fps")
_OWN = ("own_kind", "own_height", "soft")
_ALL_OWN = "native"
"""What files say that hold one member for all three."""


def write_animation(animation: Animation, path: Path) -> Path:
    """Write the handle motion of an animation; see `pack_animation` for the arrays.

    Raises:
        FormatError: The file cannot be written.
    """
    with atomic_write(path) as file:
        file.write(pack_animation(animation))
    return path


def pack_animation(animation: Animation) -> bytes:
    """The NPZ of an animation's handle motion.

    The arrays, all float32: `translations` (N, K, 3) [m], `rotations` (N, K, 3, 3), `root_translation` (N, 3) [m],
    `root_rotation` (N, 3, 3), `fps` () [1/s], `own_kind`, `own_height` and `soft` (), 0 or 1 (`HandleMotion`),
    `handle_positions` (K, 3) [m];
    and `handle_names` (K,) text. Where it is known, the
    motion of the reference body that it was fitted from, under the same names with `reference_` before them.
    """
    return pack_motion(animation.motion, animation.handles, animation.reference)


def pack_motion(motion: HandleMotion, handles: Handles, reference: HandleMotion | None = None) -> bytes:
    """The NPZ of a motion of some handles, as `pack_animation` describes it."""
    arrays: dict[str, Any] = motion_arrays(motion)
    arrays |= {"handle_positions": handles.positions, "handle_names": np.array(handle_names(handles))}
    if reference is not None:
        arrays |= motion_arrays(reference, REFERENCE)
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)
    return packed.getvalue()


def motion_arrays(motion: HandleMotion, prefix: str = "") -> dict[str, np.ndarray]:
    """The arrays of a motion by their names in an NPZ, with `prefix` before each."""
    return {f"{prefix}{name}": np.asarray(getattr(motion, name), np.float32) for name in (*_NEEDED, *_OWN)}


def read_any_motion(path: Path, data: bytes) -> HandleMotion | SkeletalMotion:
    """Read what an NPZ holds: a motion of AMASS if it has that set's arrays, a handle motion otherwise.

    Raises:
        FormatError: The file is broken, or is neither.
        MotionError: What it holds breaks the rules of a motion.
    """
    from bunraku.formats.arrays.amass import AMASS_ARRAYS, read_amass

    with open_npz(path, data) as archive:
        names = npz_names(archive)
    return read_amass(path, data) if AMASS_ARRAYS & names else read_motion(path, data)


def read_motion(path: Path, data: bytes, *, prefix: str = "") -> HandleMotion:
    """Read a handle motion; rotations may be 6D or matrices.

    Args:
        path: The file.
        data: Its bytes.
        prefix: What stands before the names of the arrays: nothing, or `REFERENCE` for the motion of the reference
            body.

    Raises:
        FormatError: The file is broken, or is not a handle motion.
        MotionError: What it holds breaks the rules of a motion.
    """
    with open_npz(path, data) as archive:
        missing = [name for name in _NEEDED if prefix + name not in npz_names(archive)]
        if missing:
            raise FormatError(
                path, f"this NPZ lacks {', '.join(missing)}, so it is no handle motion; save one with Animation.save"
            )
        arrays = {name: read_member(path, archive, prefix + name, len(data)) for name in _NEEDED}
        known = npz_names(archive)
        names = {name: prefix + (name if prefix + name in known else _ALL_OWN) for name in _OWN}
        own = {
            name: member in known and bool(np.any(read_member(path, archive, member, len(data))))
            for name, member in names.items()
        }
    if arrays["fps"].size != 1:
        raise FormatError(path, "its 'fps' must be one number; save it again")
    fps = float(arrays["fps"].reshape(()))
    if not 1 <= fps <= 1000:
        raise FormatError(path, f"its 'fps' must be from 1 to 1000, not {fps:g}; save it again")
    return HandleMotion(
        arrays["translations"],
        _matrices(path, arrays["rotations"], 4),
        arrays["root_translation"],
        _matrices(path, arrays["root_rotation"], 3),
        fps,
        **own,
    )


def read_reference(path: Path, data: bytes) -> HandleMotion | None:
    """The motion of the reference body that a handle motion was fitted from, or None where the file does not hold it.

    Raises:
        FormatError: The file is broken.
        MotionError: What it holds breaks the rules of a motion.
    """
    with open_npz(path, data) as archive:
        known = f"{REFERENCE}translations" in npz_names(archive)
    return read_motion(path, data, prefix=REFERENCE) if known else None


def read_positions(path: Path, data: bytes) -> np.ndarray | None:
    """Rest positions of the handles that a motion was made for [m], shape (K, 3), or None where the file does not hold
    them.

    Raises:
        FormatError: The file is broken.
    """
    with open_npz(path, data) as archive:
        if "handle_positions" not in npz_names(archive):
            return None
        positions = read_member(path, archive, "handle_positions", len(data))
    if positions.ndim != 2 or positions.shape[1] != 3 or not np.isfinite(positions).all():
        raise FormatError(path, "its 'handle_positions' must be points; save it again")
    return positions


def _matrices(path: Path, values: np.ndarray, dimensions: int) -> np.ndarray:
    if values.ndim == dimensions - 1 and values.shape[-1] == 6:
        matrices: np.ndarray = matrix_from_6d(values)
        return matrices
    if values.ndim == dimensions and values.shape[-2:] == (3, 3):
        return values
    raise FormatError(path, f"rotations must be 6D or 3 x 3 matrices, not of shape {values.shape}; save it again")
