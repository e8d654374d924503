"""Apparel data to train on: characters, and windows of their clips, read from mapped files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bunraku.apparel.skinning import eq4_transforms
from bunraku.body.layout import JOINT_COUNT
from bunraku.core.skinning import skin
from bunraku.errors import FormatError, OptionError
from bunraku.formats.files import read_bounded
from bunraku_lab.datasets.apparel.shards import LATER_ARRAYS, Shard

__all__ = ["INDEX", "ApparelCharacter", "ApparelClip", "ApparelData", "ApparelWindow", "read_index"]

INDEX = "index.json"
_AGAIN = "build it with `bunraku data apparel`"


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
        fly_aways: Bodies that flew away and were put back, and at which frame of the clip, below 0 in the warm-up
            before it.
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
        self,
        folder: str | Path,
        split: Literal["train", "val", "test"] | None = None,
        *,
        physics: bool = True,
        fly_aways: bool = False,
    ):
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
            raise FormatError(shard.path, f"it has fewer frames than the index says; {_AGAIN}")
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
    good = all(
        np.isfinite(arrays[name]).all()
        for name in (
            "rest",
            "joints",
            "weights",
            "bone_positions",
            "bone_weights",
            "spring",
            "mass",
            "damping",
            "limit",
            *(name for name in LATER_ARRAYS if name in arrays),
        )
    )
    good &= all(_within(arrays[name], 0, count) for name in ("faces", "loose"))
    good &= _within(arrays["part"], -1, len(arrays["spring"]))
    good &= _within(arrays["bone_parents"], -1, bones) and _within(arrays["bone_indices"], 0, bones)
    good &= weights.shape == (count, JOINT_COUNT) and bool((np.abs(weights.sum(axis=1) - 1) < 1e-3).all())
    good &= len(np.unique(arrays["loose"])) == len(arrays["loose"])
    if not good or not count:
        raise FormatError(path, f"the mesh, the weights or the rig of its character are not sound; {_AGAIN}")
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
        raise FormatError(path, f"there are no apparel data here; {_AGAIN}")
    try:
        found = json.loads(read_bounded(path))
        if not isinstance(found, dict) or not isinstance(found["shards"], dict):
            raise ValueError
    except (ValueError, KeyError, RecursionError):
        raise FormatError(path, f"the index is damaged; {_AGAIN}") from None
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
            raise FormatError(folder / INDEX, f"what it says of '{name}' is damaged; {_AGAIN}") from None
    return out
