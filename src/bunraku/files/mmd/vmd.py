"""VMD, the motion of MikuMikuDance: keys of bones with Bezier curves, and switches of inverse kinematics; and how all
its files are read within bounds.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from bunraku.core.avatars import MMD_METRE
from bunraku.core.files import atomic_write, read_bounded
from bunraku.core.geometry.rotations import continuous, matrix_from_quaternion, quaternion_from_matrix, quaternion_slerp
from bunraku.errors import FormatError

VMD_FPS = 30.0
"""MMD's only rate [1/s]."""

AGAIN = "save it again"
LONGEST = 4 * 3600 * 30  # frames
_BONE = np.dtype(
    [("name", "S15"), ("frame", "<u4"), ("position", "<f4", 3), ("rotation", "<f4", 4), ("curve", "u1", (4, 16))]
)
_MORPH = np.dtype([("name", "S15"), ("frame", "<u4"), ("weight", "<f4")])
_SKIPPED = (("camera keys", 61), ("light keys", 28), ("shadow keys", 9))
_HEADERS = ((b"Vocaloid Motion Data 0002", 20), (b"Vocaloid Motion Data file", 10))  # and bytes of the model's name
_HALVINGS = 24  # of the search on a curve: exact to 1e-7


class MmdReader:
    """Reads one value after the other from the bytes of a file; `encoding` is of texts with a length before them."""

    def __init__(self, path: Path, data: bytes):
        self.path, self.data, self.at = path, data, 0
        self.encoding, self.section = "cp932", "header"

    def fail(self, problem: str) -> NoReturn:
        """Raise the error of this file."""
        raise FormatError(self.path, f"{problem}; {AGAIN}")

    @property
    def left(self) -> int:
        """How many bytes are left."""
        return len(self.data) - self.at

    def skip(self, size: int) -> int:
        """Pass over some bytes, and return where they begin."""
        if size > self.left:
            self.fail(f"it is cut off in its {self.section}")
        self.at += size
        return self.at - size

    def take(self, size: int) -> bytes:
        """The next bytes."""
        start = self.skip(size)
        return self.data[start : self.at]

    def values(self, layout: str) -> tuple[Any, ...]:
        """Values of a `struct` layout, little-endian."""
        return struct.unpack_from("<" + layout, self.data, self.skip(struct.calcsize("<" + layout)))

    def one(self, layout: str) -> Any:
        """A single value."""
        return self.values(layout)[0]

    def floats(self, count: int) -> np.ndarray:
        """Floating-point numbers, shape (count,)."""
        return np.array(self.values(f"{count}f"), float)

    def index(self, size: int) -> int:
        """A signed index of 1, 2 or 4 bytes, -1 for none."""
        return int(self.one({1: "b", 2: "h", 4: "i"}[size]))

    def count(self, section: str, least: int, layout: str = "i", most: int = 2**31) -> int:
        """How many records of at least a size [bytes] follow in a section, as long as they fit into the file."""
        self.section = section
        count = int(self.one(layout))
        if count < 0 or count * least > self.left:
            room = self.left // max(least, 1)
            self.fail(f"it announces {count & 0xFFFFFFFF} {section} but has room for {room}")
        if count > most:
            self.fail(f"it has {count:,} {section}, and at most {most:,} are read")
        return count

    def records(self, dtype: np.dtype, count: int) -> np.ndarray:
        """Records of a fixed size, shape (count,)."""
        return np.frombuffer(self.take(dtype.itemsize * count), dtype, count)

    def text(self) -> str:
        """A text with its length in bytes before it."""
        size = int(self.one("i"))
        if size < 0 or size > self.left:
            self.fail(f"a text in its {self.section} has {size & 0xFFFFFFFF} bytes but {self.left} are left")
        return self.take(size).decode(self.encoding, "replace").replace("\0", "")

    def field(self, size: int) -> str:
        """A text in a field of fixed size that ends with a zero byte."""
        return fixed_text(self.take(size))


@dataclass(frozen=True)
class VmdTrack:
    """Keys of one bone."""

    frames: np.ndarray  # frame of each key at 30 frames a second, rising, shape (K,)
    positions: np.ndarray  # displacement of the bone from its rest position, in its parent's axes [m], shape (K, 3)
    rotations: np.ndarray  # its rotation from the rest pose, xyzw, shape (K, 4)
    # control points x1, y1, x2, y2, from 0 to 1 between the key before and this one, for x, y, z and the rotation,
    # shape (K, 4, 4)
    curves: np.ndarray

    def sample(self, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] (N, 3) and rotation matrices (N, 3, 3) at frames of 30 a second, shape (N,); ends are held."""
        at = np.clip(np.asarray(frames, float), self.frames[0], self.frames[-1])
        low = np.clip(np.searchsorted(self.frames, at, "right") - 1, 0, max(len(self.frames) - 2, 0))
        high = np.minimum(low + 1, len(self.frames) - 1)
        share = (at - self.frames[low]) / np.maximum(self.frames[high] - self.frames[low], 1)
        along = _eased(self.curves[high], share)
        positions = self.positions[low] + along[:, :3] * (self.positions[high] - self.positions[low])
        rotations = quaternion_slerp(self.rotations[low], self.rotations[high], along[:, 3])
        return positions, np.asarray(matrix_from_quaternion(rotations))


@dataclass(frozen=True)
class VmdMotion:
    """What a VMD file holds of a model's motion."""

    model: str  # name of the model that it was made with
    bones: dict[str, VmdTrack]  # track of each bone by its name
    morphs: dict[str, int]  # number of keys of each morph by its name
    # inverse kinematics on or off by the name of its bone, from a frame on, by rising frames
    switches: tuple[tuple[int, dict[str, bool]], ...]

    @property
    def last_frame(self) -> int:
        """Frame of the last key of a bone, at 30 frames a second."""
        return max((int(track.frames[-1]) for track in self.bones.values()), default=0)

    def frame_count(self, fps: float = VMD_FPS) -> int:
        """Number of frames from frame 0 to the last key, at a rate [1/s]."""
        return int(self.last_frame / VMD_FPS * fps + 1e-6) + 1

    def sample(
        self, fps: float = VMD_FPS, bones: Collection[str] | None = None
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Positions [m] (N, 3) and rotations (N, 3, 3) of bones, from frame 0 to the last key, at a rate [1/s]."""
        frames = np.arange(self.frame_count(fps)) * (VMD_FPS / fps)
        return {name: track.sample(frames) for name, track in self.bones.items() if bones is None or name in bones}


def load_vmd(path: str | Path) -> VmdMotion:
    """Read a VMD file; errors are those of `read_vmd`."""
    path = Path(path)
    return read_vmd(path, read_bounded(path))


def read_vmd(path: Path, data: bytes) -> VmdMotion:
    """Read a VMD file from its bytes. FormatError if it is no VMD file, is cut off, announces more keys than it has
    room for, or holds something that is not a number.
    """
    name_size = next((size for magic, size in _HEADERS if data.startswith(magic)), 0)
    reader = MmdReader(path, data)
    if not name_size:
        reader.fail("it does not begin with 'Vocaloid Motion Data', so it is not a VMD file")
    reader.skip(30)
    model = reader.field(name_size)
    keys = reader.records(_BONE, reader.count("bone keys", _BONE.itemsize, "I"))
    if not (np.isfinite(keys["position"]).all() and np.isfinite(keys["rotation"]).all()):
        reader.fail("one of its bone keys holds values that are not numbers")
    if len(keys) and keys["frame"].max() > LONGEST:
        raise FormatError(
            path, f"its last key is at frame {keys['frame'].max()}, hours after the start; delete that key"
        )
    morphs = reader.records(_MORPH, _count(reader, "morph keys", _MORPH.itemsize))
    for section, size in _SKIPPED:
        reader.skip(size * _count(reader, section, size))
    names, counts = np.unique(morphs["name"], return_counts=True)
    by_name = {fixed_text(name): int(count) for name, count in zip(names, counts, strict=True)}
    return VmdMotion(model, _tracks(keys), by_name, _switches(reader))


def _count(reader: MmdReader, section: str, size: int) -> int:
    """The number of records that follow; older programs leave the last sections out."""
    return reader.count(section, size, "I") if reader.left >= 4 else 0


def fixed_text(raw: bytes) -> str:
    """Shift JIS up to the first zero byte; half of a letter that the field's size cut off is dropped."""
    return raw.split(b"\0")[0].decode("cp932", "ignore")


def _tracks(keys: np.ndarray) -> dict[str, VmdTrack]:
    """Keys by bone in our frame: z changes sign, and so do rotations about x and y."""
    out = {}
    names, owner = np.unique(keys["name"], return_inverse=True)
    order = np.lexsort((np.arange(len(keys)), keys["frame"], owner))
    for group in np.split(order, np.flatnonzero(np.diff(owner[order])) + 1) if len(keys) else []:
        frames = keys["frame"][group].astype(np.int64)
        group = group[np.append(np.diff(frames) > 0, True)]  # of two keys at a frame the later one in the file counts
        rotations = keys["rotation"][group].astype(float) * [-1, -1, 1, 1]
        length = np.linalg.norm(rotations, axis=-1, keepdims=True)
        rotations = np.where(length > 1e-6, rotations / np.maximum(length, 1e-6), [0.0, 0, 0, 1])
        # Row r holds the curves from byte r on, so its first column is that of channel r; row 0 itself is partly
        # overwritten.
        curves = np.clip(keys["curve"][group][:, :, [0, 4, 8, 12]] / 127.0, 0, 1)
        positions = keys["position"][group].astype(float) * np.array([1, 1, -1]) * MMD_METRE
        out[fixed_text(names[owner[group[0]]])] = VmdTrack(
            keys["frame"][group].astype(np.int64), positions, rotations, curves
        )
    return out


def _eased(curves: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Progress of each of four channels, from 0 to 1, at a share of the time between two keys (N,): y where x is that
    share, on a Bezier curve of control points x1, y1, x2, y2 (N, 4, 4).
    """
    x1, y1, x2, y2 = np.moveaxis(curves, -1, 0)
    low, high = np.zeros_like(x1), np.ones_like(x1)
    for _ in range(_HALVINGS):  # x rises with the parameter
        middle = (low + high) / 2
        before = _bezier(x1, x2, middle) < share[:, None]
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    straight = (x1 == y1) & (x2 == y2)
    return np.where(straight, share[:, None], _bezier(y1, y2, (low + high) / 2))


def _bezier(first: np.ndarray, second: np.ndarray, s: np.ndarray) -> np.ndarray:
    return np.asarray(3 * (1 - s) ** 2 * s * first + 3 * (1 - s) * s**2 * second + s**3)


def _switches(reader: MmdReader) -> tuple[tuple[int, dict[str, bool]], ...]:
    """Keys that show the model and switch its inverse kinematics."""
    out = []
    for _ in range(_count(reader, "inverse kinematics keys", 9)):
        frame, _ = reader.values("IB")
        bones = range(reader.count("inverse kinematics bones", 21, "I"))
        out.append((int(frame), {reader.field(20): bool(reader.one("B")) for _ in bones}))
    return tuple(sorted(out, key=lambda key: key[0]))


_KEY = np.dtype(
    [("name", "S15"), ("frame", "<u4"), ("position", "<f4", 3), ("rotation", "<f4", 4), ("curve", "u1", 64)]
)
_ROW = bytes([20] * 8 + [107] * 8)  # x1 and y1 of the four channels, then x2 and y2: a straight line
_CURVE = np.frombuffer(b"".join(_ROW[shift:] + bytes(shift) for shift in range(4)), np.uint8)
# Some roundings of float32, in which the file stores both.
_STILL_DEGREES, _STILL_METRES = 1e-4, 1e-7


@dataclass(frozen=True)
class MmdClip:
    """Motion of the bones of a model at 30 frames a second."""

    # by their names: displacement from the rest position, in the parent's axes [m], shape (N, 3), and rotation from the
    # rest pose, shape (N, 3, 3)
    bones: Mapping[str, tuple[np.ndarray, np.ndarray]]
    model: str = ""  # name of the model
    ik_off: tuple[str, ...] = field(default=())  # bones whose inverse kinematics are off

    def __len__(self) -> int:
        return max((len(positions) for positions, _ in self.bones.values()), default=0)


def write_vmd(clip: MmdClip, path: str | Path) -> Path:
    """Write a clip as VMD and return the path. FormatError if a bone's name cannot be written in Shift JIS, or the file
    cannot be written.
    """
    path = Path(path)
    packed = pack_vmd(clip, path)
    with atomic_write(path) as file:
        file.write(packed)
    return path


def pack_vmd(clip: MmdClip, path: Path = Path("motion.vmd")) -> bytes:
    """The bytes of a clip as VMD; a bone that stands still has one key. The path is for messages. FormatError if a
    bone's name cannot be written in Shift JIS.
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
    quaternions = continuous(quaternion_from_matrix(np.asarray(rotations, float)) * [-1, -1, 1, 1])
    still = (
        np.ptp(positions, axis=0).max() <= _STILL_METRES / MMD_METRE
        and (np.abs(quaternions @ quaternions[0]) > np.cos(np.radians(_STILL_DEGREES))).all()
    )
    count = 1 if still else len(positions)
    out = np.zeros(count, _KEY)
    out["name"], out["frame"] = _name(path, name, 15), np.arange(count)
    out["position"], out["rotation"], out["curve"] = positions[:count], quaternions[:count], _CURVE
    return out
