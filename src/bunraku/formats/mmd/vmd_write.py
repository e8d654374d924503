"""Write VMD: keys of bones at every frame with straight curves between them, and inverse kinematics switched off.

Where the rotations of legs are known the inverse kinematics of a model would only overwrite them, so they are off from
frame 0 on.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bunraku.core.mmd_model import MMD_METRE
from bunraku.errors import FormatError
from bunraku.formats.files import atomic_write
from bunraku.geometry.rotations import quaternion_from_matrix

__all__ = ["MmdClip", "pack_vmd", "write_vmd"]

_KEY = np.dtype(
    [("name", "S15"), ("frame", "<u4"), ("position", "<f4", 3), ("rotation", "<f4", 4), ("curve", "u1", 64)]
)
_ROW = bytes([20] * 8 + [107] * 8)  # x1 and y1 of the four channels, then x2 and y2: a straight line
_CURVE = np.frombuffer(b"".join(_ROW[shift:] + bytes(shift) for shift in range(4)), np.uint8)
_STILL_DEGREES, _STILL_METRES = 1e-4, 1e-7


@dataclass(frozen=True)
class MmdClip:
    """Motion of the bones of a model at 30 frames a second.

    Args:
        bones: By their names: how far each is moved from its rest position, in its parent's axes [m], shape (N, 3), and
            how it is turned from its rest pose, shape (N, 3, 3).
        model: Name of the model.
        ik_off: Bones whose inverse kinematics are off.
    """

    bones: Mapping[str, tuple[np.ndarray, np.ndarray]]
    model: str = ""
    ik_off: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return max((len(positions) for positions, _ in self.bones.values()), default=0)


def write_vmd(clip: MmdClip, path: str | Path) -> Path:
    """Write a clip as VMD and return the path.

    Raises:
        FormatError: A bone's name cannot be written in Shift JIS, or the file cannot be written.
    """
    path = Path(path)
    packed = pack_vmd(clip, path)
    with atomic_write(path) as file:
        file.write(packed)
    return path


def pack_vmd(clip: MmdClip, path: Path = Path("motion.vmd")) -> bytes:
    """The bytes of a clip as VMD; a bone that stands still has one key.

    Args:
        clip: The clip.
        path: For messages.

    Raises:
        FormatError: A bone's name cannot be written in Shift JIS.
    """
    parts = [_keys(path, name, *track) for name, track in clip.bones.items()]
    keys = np.concatenate(parts) if parts else np.zeros(0, _KEY)
    model = clip.model.encode("cp932", "ignore")[:19]
    head = struct.pack("<30s20sI", b"Vocaloid Motion Data 0002", model, len(keys))
    names = [_name(path, name, 20) for name in clip.ik_off]
    switches = struct.pack("<IIBI", 1, 0, 1, len(names)) + b"".join(struct.pack("<20sB", name, 0) for name in names)
    return head + keys.tobytes() + bytes(16) + switches  # no keys of morphs, camera, light and shadow


def _name(path: Path, name: str, size: int) -> bytes:
    try:
        return name.encode("cp932")[:size]
    except UnicodeEncodeError:
        raise FormatError(
            path, f"the bone {name[:40]!r} has a name that VMD cannot hold (it is in Shift JIS); rename it in the model"
        ) from None


def _keys(path: Path, name: str, positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    positions = np.asarray(positions, float) * [1, 1, -1] / MMD_METRE
    quaternions = quaternion_from_matrix(np.asarray(rotations, float)) * [-1, -1, 1, 1]
    still = (
        np.ptp(positions, axis=0).max() <= _STILL_METRES / MMD_METRE
        and (np.abs(quaternions @ quaternions[0]) > np.cos(np.radians(_STILL_DEGREES))).all()
    )
    count = 1 if still else len(positions)
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(-1) < 0, -1.0, 1.0)
    quaternions[1:] *= np.cumprod(flips)[:, None]  # other programs may not take the short way
    out = np.zeros(count, _KEY)
    out["name"], out["frame"] = _name(path, name, 15), np.arange(count)
    out["position"], out["rotation"], out["curve"] = positions[:count], quaternions[:count], _CURVE
    return out
