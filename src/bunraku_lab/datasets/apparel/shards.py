"""Apparel data on disk (shards: mapped safetensors files) and in training: characters and windows of clips."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bunraku.apparel.body import eq4_transforms
from bunraku.apparel.clothed import SWING_NUMBERS
from bunraku.core.body.layout import JOINT_COUNT
from bunraku.core.files import atomic_write, read_bounded
from bunraku.core.skinning import skin
from bunraku.errors import FormatError, OptionError

SHARD_FORMAT = "bunraku-apparel-3"
_KEY = "bunraku"
SHARD_ARRAYS: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "rest": ("F32", ("V", 3)), "faces": ("I32", ("F", 3)), "joints": ("F32", (JOINT_COUNT, 3)),
    "weights": ("F32", ("V", JOINT_COUNT)), "apparel": ("U8", ("V",)), "part": ("I32", ("V",)),
    "spring": ("F32", ("P",)), "mass": ("F32", ("P",)), "damping": ("F32", ("P",)), "limit": ("F32", ("P",)),
    "loose": ("I32", ("M",)), "transforms": ("F32", ("N", JOINT_COUNT, 3, 4)), "offsets": ("F16", ("N", "M", 3)),
    "bone_parents": ("I32", ("B",)), "bone_positions": ("F32", ("B", 3)), "bone_moved": ("U8", ("B",)),
    "bone_indices": ("I32", ("V", "I")), "bone_weights": ("F32", ("V", "I")),
}  # fmt: skip
"""Arrays of a shard -> type and shape; letters are lengths that must agree."""
LATER_ARRAYS: dict[str, tuple[str, tuple[str | int, ...]]] = {"swing": ("F32", ("V", SWING_NUMBERS))}
"""Arrays that shards of older versions lack."""
_BUILD_AGAIN = "build it again with `bunraku data apparel`"


def write_shard(path: Path, arrays: dict[str, np.ndarray], facts: Mapping[str, object]) -> Path:
    """Write a shard, whole or not at all; the same arrays and facts give the same bytes.

    Args:
        path: The file.
        arrays: Those of `SHARD_ARRAYS`, and of `LATER_ARRAYS` where they are known.
        facts: What JSON can say: name, split, fingerprint, clips and more.

    Raises:
        FormatError: The file cannot be written.
    """
    from safetensors.numpy import save

    kinds = {"F32": np.float32, "F16": np.float16, "I32": np.int32, "U8": np.uint8}
    known = SHARD_ARRAYS | {name: how for name, how in LATER_ARRAYS.items() if name in arrays}
    plain = {name: np.ascontiguousarray(arrays[name], kinds[kind]) for name, (kind, _) in known.items()}
    # One key only: safetensors writes several in any order.
    data = save(plain, {_KEY: json.dumps({"format": SHARD_FORMAT, **facts}, sort_keys=True)})
    with atomic_write(path) as file:
        file.write(data)
    return path


def shard_fingerprint(path: Path) -> str:
    """What a shard was made of, "" where there is none that can be read or whose apparel is not pushed out of the
    body.
    """
    try:
        facts = Shard(path).facts
    except FormatError:
        return ""
    return str(facts.get("fingerprint", "")) if facts.get("pushed_out") is True else ""


class Shard:
    """A shard, opened: `facts`, `lengths` and the `names` of its arrays; arrays are read on request.

    Raises:
        FormatError: It is missing, damaged, or no shard.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self._file: Any = None
        self.facts: dict[str, Any] = {}
        self.lengths: dict[str, int] = {}
        self.names: frozenset[str] = frozenset()
        self._open()

    def __getstate__(self) -> dict[str, Any]:  # workers of a loader open the file themselves
        return self.__dict__ | {"_file": None}

    def _open(self) -> Any:
        if self._file is not None:
            return self._file
        if not self.path.is_file():
            raise FormatError(self.path, f"there is no such shard; {_BUILD_AGAIN}")
        from safetensors import safe_open

        try:
            file = safe_open(self.path, framework="numpy")
            facts = json.loads((file.metadata() or {}).get(_KEY, "{}"))
            shapes = {name: file.get_slice(name) for name in file.keys()}  # noqa: SIM118 - not a dict
            found = {name: (view.get_dtype(), tuple(view.get_shape())) for name, view in shapes.items()}
        except Exception as error:
            raise FormatError(self.path, f"the shard is damaged or cut short ({error}); {_BUILD_AGAIN}") from None
        if not isinstance(facts, dict) or facts.get("format") != SHARD_FORMAT:
            raise FormatError(self.path, f"this is no shard of apparel data that this version reads; {_BUILD_AGAIN}")
        lengths: dict[str, int] = {}
        for name, (kind, shape) in (SHARD_ARRAYS | LATER_ARRAYS).items():
            have = found.get(name)
            if have is None and name in LATER_ARRAYS:
                continue
            if have is None or have[0] != kind or len(have[1]) != len(shape):
                raise FormatError(self.path, f"its array '{name}' is missing or of another kind; {_BUILD_AGAIN}")
            for want, length in zip(shape, have[1], strict=True):
                if (lengths.setdefault(want, length) if isinstance(want, str) else want) != length:
                    raise FormatError(
                        self.path,
                        f"its array '{name}' has shape {list(have[1])}, which does not fit the others; {_BUILD_AGAIN}",
                    )
        _check_clips(self.path, facts, lengths["N"])
        self._file, self.facts, self.lengths = file, facts, lengths
        self.names = frozenset(found)
        return file

    def array(self, name: str) -> np.ndarray:
        """A whole array.

        Raises:
            FormatError: It cannot be read.
        """
        try:
            return np.asarray(self._open().get_tensor(name))
        except FormatError:
            raise
        except Exception as error:
            raise FormatError(self.path, f"its array '{name}' cannot be read ({error}); {_BUILD_AGAIN}") from None

    def frames(self, name: str, start: int, stop: int) -> np.ndarray:
        """Frames of "transforms" or "offsets"; only these are read.

        Raises:
            FormatError: They cannot be read, or are not numbers.
        """
        try:
            out = np.asarray(self._open().get_slice(name)[start:stop])
        except FormatError:
            raise
        except Exception as error:
            raise FormatError(self.path, f"its array '{name}' cannot be read ({error}); {_BUILD_AGAIN}") from None
        if not np.isfinite(out).all():
            raise FormatError(self.path, f"its array '{name}' holds values that are not numbers; {_BUILD_AGAIN}")
        return out


def _check_clips(path: Path, facts: dict[str, object], frames: int) -> None:
    """The list of clips must cover the frames, one after the other."""
    clips, fps, end = facts.get("clips"), facts.get("fps"), 0
    good = (
        isinstance(clips, list)
        and isinstance(facts.get("name"), str)
        and facts.get("split") in ("train", "val", "test")
    )
    good &= isinstance(fps, int | float) and math.isfinite(fps) and 1 <= fps <= 1000
    for clip in clips if good and isinstance(clips, list) else ():
        first, length = (clip.get("first"), clip.get("frames")) if isinstance(clip, dict) else (None, None)
        if (
            type(first) is not int
            or type(length) is not int
            or first != end
            or length < 1
            or not isinstance(clip.get("motion"), str)
        ):
            good = False
            break
        end += length
    if not good or end != frames:
        raise FormatError(path, f"its list of clips does not fit its {frames} frames; {_BUILD_AGAIN}")


INDEX = "index.json"
_BUILD = "build it with `bunraku data apparel`"


@dataclass(frozen=True, eq=False)
class ApparelCharacter:
    """What does not move.

    Args:
        name: Of the character.
        rest: Rest mesh V [m], shape (V, 3), float32.
        faces: Triangles, shape (F, 3), int32.
        joints: J, SMPL's 22 joints in the rest pose [m], shape (22, 3).
        weights: Skinning weights W of the vertices for the joints, shape (V, 22), rows sum to 1.
        apparel: Vertices that are apparel, shape (V,), bool.
        part: Number of the apparel part of each vertex, -1 on the body, shape (V,).
        spring, mass, damping, limit: Of each part: stiffness of its joints [N m / rad], mass of its bodies, share of
            the velocity that they lose in a second, how far its joints bend [rad], shape (P,).
        loose: Vertices with offsets, shape (M,).
        swing: As of `ClothedCharacter`, shape (V, SWING_NUMBERS); None in data of older versions.
        bone_parents: The rig itself, which a network does not see: parents (B,), positions [m] (B, 3), which bones
            physics move (B,), and the bones (V, I) and shares (V, I) of each vertex.
    """

    name: str
    rest: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    apparel: np.ndarray
    part: np.ndarray
    spring: np.ndarray
    mass: np.ndarray
    damping: np.ndarray
    limit: np.ndarray
    loose: np.ndarray
    bone_parents: np.ndarray
    bone_positions: np.ndarray
    bone_moved: np.ndarray
    bone_indices: np.ndarray
    bone_weights: np.ndarray
    swing: np.ndarray | None = None


@dataclass(frozen=True)
class ApparelClip:
    """A clip.

    Args:
        character: Name of its character.
        motion: Name of its motion.
        split: "train", "val" or "test".
        shard: Its file's name without a suffix.
        first: Its first frame in the shard.
        frames: How many it has.
        fly_aways: Bodies that flew away, and at which frame of the clip, below 0 in the warm-up.
    """

    character: str
    motion: str
    split: str
    shard: str
    first: int
    frames: int
    fly_aways: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, eq=False)
class ApparelWindow:
    """Some frames of a clip.

    Args:
        transforms: T, `[R | t]` of the joints [m], shape (N, 22, 3, 4), float32.
        vertices: The ground truth [m], shape (N, V, 3), float32.
    """

    transforms: np.ndarray
    vertices: np.ndarray


class ApparelData:
    """The data set in a folder that `bunraku data apparel` wrote, whole or as far as it is built.

    Args:
        folder: The folder.
        split: Only the clips of this one; all when None.
        physics: Whether apparel moves by physics; without, it follows the joints rigidly (Table 4 of MMDMC).
        fly_aways: Whether clips are kept in which a body flew away and was put back; in the warm-up it may.

    Raises:
        FormatError: There is none, or it is damaged.
        OptionError: There is no such split.
    """

    fps = 30.0

    def __init__(
        self, folder: str | Path, split: Literal["train", "val", "test"] | None = None, *, physics: bool = True,
        fly_aways: bool = False,
    ):  # fmt: skip
        if split not in (None, "train", "val", "test"):
            raise OptionError(f"the split is 'train', 'val' or 'test', not '{split}'")
        self.folder, self.physics = Path(folder), physics
        self.clips: tuple[ApparelClip, ...] = tuple(
            clip
            for clip in _clips(self.folder)
            if split in (None, clip.split) and (fly_aways or not any(frame >= 0 for _, frame in clip.fly_aways))
        )
        self._shards: dict[str, Shard] = {}

    def __len__(self) -> int:
        return len(self.clips)

    @property
    def characters(self) -> tuple[str, ...]:
        """Names of the characters."""
        return tuple(dict.fromkeys(clip.character for clip in self.clips))

    @property
    def motions(self) -> tuple[str, ...]:
        """Names of the motions."""
        return tuple(dict.fromkeys(clip.motion for clip in self.clips))

    @property
    def minutes(self) -> float:
        """Length of all clips [min]."""
        return sum(clip.frames for clip in self.clips) / self.fps / 60

    def shard(self, name: str) -> Shard:
        """An opened shard.

        Raises:
            FormatError: It is missing or damaged.
        """
        if name not in self._shards:
            self._shards[name] = Shard(self.folder / "shards" / f"{name}.safetensors")
        return self._shards[name]

    def character(self, clip: ApparelClip) -> ApparelCharacter:
        """The character of a clip.

        Raises:
            FormatError: Its shard is missing or damaged.
        """
        path = self.shard(clip.shard).path
        return _character(str(path), path.stat().st_mtime_ns)

    def window(self, clip: ApparelClip, start: int = 0, stop: int | None = None) -> ApparelWindow:
        """Frames of a clip.

        Args:
            clip: One of `clips`.
            start: First frame.
            stop: The one after the last; the clip's end when None.

        Raises:
            FormatError: The shard is missing or damaged.
            OptionError: The clip has no such frames.
        """
        stop = clip.frames if stop is None else stop
        if not 0 <= start < stop <= clip.frames:
            raise OptionError(f"frames {start} to {stop} are not in a clip of {clip.frames}")
        shard, character = self.shard(clip.shard), self.character(clip)
        if clip.first + clip.frames > shard.lengths["N"]:
            raise FormatError(shard.path, f"it has fewer frames than the index says; {_BUILD}")
        transforms = shard.frames("transforms", clip.first + start, clip.first + stop)
        vertices = np.ascontiguousarray(
            skin(character.rest, character.weights, eq4_transforms(transforms, character.joints))
        )
        offsets = shard.frames("offsets", clip.first + start, clip.first + stop).astype(np.float32)
        if not self.physics:
            offsets[:, character.apparel[character.loose]] = 0
        vertices[:, character.loose] += offsets
        return ApparelWindow(transforms, vertices)


@lru_cache(maxsize=64)
def _character(path: str, changed: int) -> ApparelCharacter:
    shard = Shard(path)
    arrays = {name: shard.array(name) for name in ApparelCharacter.__dataclass_fields__ if name in shard.names}
    count, bones = len(arrays["rest"]), len(arrays["bone_parents"])
    weights = arrays["weights"]
    finite = ("rest", "joints", "weights", "bone_positions", "bone_weights", "spring", "mass", "damping", "limit")
    later = (name for name in LATER_ARRAYS if name in arrays)
    good = all(np.isfinite(arrays[name]).all() for name in (*finite, *later))
    good &= all(_within(arrays[name], 0, count) for name in ("faces", "loose"))
    good &= _within(arrays["part"], -1, len(arrays["spring"]))
    good &= _within(arrays["bone_parents"], -1, bones) and _within(arrays["bone_indices"], 0, bones)
    good &= weights.shape == (count, JOINT_COUNT) and bool((np.abs(weights.sum(axis=1) - 1) < 1e-3).all())
    good &= len(np.unique(arrays["loose"])) == len(arrays["loose"])
    if not good or not count:
        raise FormatError(path, f"the mesh, the weights or the rig of its character are not sound; {_BUILD}")
    for name in ("apparel", "bone_moved"):
        arrays[name] = arrays[name] > 0
    for array in arrays.values():
        array.flags.writeable = False
    return ApparelCharacter(name=str(shard.facts["name"]), **arrays)


def _within(array: np.ndarray, low: int, high: int) -> bool:
    return array.size == 0 or bool(array.min() >= low and array.max() < high)


def read_index(folder: Path) -> dict[str, Any]:
    """What a folder says of its shards.

    Raises:
        FormatError: There is no index, or it is damaged.
    """
    path = folder / INDEX
    if not path.is_file():
        raise FormatError(path, f"there are no apparel data here; {_BUILD}")
    try:
        found = json.loads(read_bounded(path))
        if not isinstance(found, dict) or not isinstance(found["shards"], dict):
            raise ValueError
    except (ValueError, KeyError, RecursionError):
        raise FormatError(path, f"the index is damaged; {_BUILD}") from None
    return found


def _clips(folder: Path) -> list[ApparelClip]:
    out = []
    for name, entry in read_index(folder)["shards"].items():
        if "/" in name or "\\" in name or name.startswith(".") or "\0" in name:
            raise FormatError(folder / INDEX, f"the shard name {name!r} is not a plain name")
        try:
            if entry["split"] not in ("train", "val", "test"):
                raise ValueError
            for clip in entry["clips"]:
                first, frames = clip["first"], clip["frames"]
                if type(first) is not int or type(frames) is not int or first < 0 or frames < 1:
                    raise ValueError
                away = tuple((str(body), int(frame)) for body, frame in clip.get("fly_aways", ()))
                out.append(
                    ApparelClip(str(entry["name"]), str(clip["motion"]), entry["split"], name, first, frames, away)
                )
        except (KeyError, TypeError, ValueError, AttributeError):
            raise FormatError(folder / INDEX, f"what it says of '{name}' is damaged; {_BUILD}") from None
    return out
