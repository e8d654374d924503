"""Handle motion as NPZ: plain arrays that numpy opens anywhere, read without pickle and within bounds."""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.errors import FormatError
from bunraku.formats.files import atomic_write
from bunraku.formats.gltf_motion import handle_names
from bunraku.geometry.rotations import matrix_from_6d, matrix_to_6d
from bunraku.motion import HandleMotion

if TYPE_CHECKING:
    from bunraku.animation import Animation

__all__ = ["read_motion", "write_animation"]

MAX_ARRAY_BYTES = 1 << 30
_NEEDED = ("translations", "rotations", "root_translation", "root_rotation", "fps")


def write_animation(animation: Animation, path: Path) -> Path:
    """Write the handle motion of an animation.

    The arrays, all float32: `translations` (N, K, 3) [m], `rotations` (N, K, 6) in 6D, `root_translation` (N, 3) [m],
    `root_rotation` (N, 6), `fps` () [1/s], `handle_positions` (K, 3) [m]; and `handle_names` (K,) text.

    Raises:
        FormatError: The file cannot be written.
    """
    motion, positions = animation.motion, animation.handles.positions
    arrays: dict[str, Any] = {
        "translations": motion.translations,
        "rotations": matrix_to_6d(motion.rotations),
        "root_translation": motion.root_translation,
        "root_rotation": matrix_to_6d(motion.root_rotation),
        "fps": np.float32(motion.fps),
        "handle_positions": positions,
        "handle_names": np.array(handle_names(animation.handles)),
    }
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)
    with atomic_write(path) as file:
        file.write(packed.getbuffer())
    return path


def read_motion(path: Path, data: bytes) -> HandleMotion:
    """Read a handle motion; rotations may be 6D or matrices.

    Args:
        path: The file.
        data: Its bytes.

    Raises:
        FormatError: The file is broken, or is not a handle motion.
        MotionError: What it holds breaks the rules of a motion.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            missing = [name for name in _NEEDED if f"{name}.npy" not in archive.namelist()]
            if missing:
                raise FormatError(path, f"this NPZ lacks {', '.join(missing)}, so it is no handle motion; save one with Animation.save")
            arrays = {name: _array(path, archive, name) for name in _NEEDED}
    except (zipfile.BadZipFile, EOFError, NotImplementedError, OSError, RuntimeError, ValueError, zlib.error):
        raise FormatError(path, "the NPZ is truncated or broken; save it again") from None
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
    )


def _matrices(path: Path, values: np.ndarray, dimensions: int) -> np.ndarray:
    if values.ndim == dimensions - 1 and values.shape[-1] == 6:
        matrices: np.ndarray = matrix_from_6d(values)
        return matrices
    if values.ndim == dimensions and values.shape[-2:] == (3, 3):
        return values
    raise FormatError(path, f"rotations must be 6D or 3 x 3 matrices, not of shape {values.shape}; save it again")


def _array(path: Path, archive: zipfile.ZipFile, name: str) -> np.ndarray:
    entry = archive.getinfo(f"{name}.npy")
    if entry.file_size > MAX_ARRAY_BYTES:
        raise FormatError(path, f"its array '{name}' unpacks to more than {MAX_ARRAY_BYTES >> 30} GiB; cut the motion")
    with archive.open(entry) as file:
        content = io.BytesIO(file.read(entry.file_size))
    version = np.lib.format.read_magic(content)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(content)
    size = dtype.itemsize
    for length in shape:
        size *= int(length)
    if dtype.kind not in "fiu" or size != entry.file_size - content.tell():
        raise FormatError(path, f"its array '{name}' is not plain numbers, or is cut short; save it again")
    content.seek(0)
    array: np.ndarray = np.lib.format.read_array(content, allow_pickle=False)
    return array.astype(np.float32)
