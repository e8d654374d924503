"""A shard on disk: one safetensors file, whole or not there, that is mapped and not loaded.

safetensors hold plain arrays behind a JSON header whose bounds are checked on opening: nothing in them can run code.
The rest of what a hostile file could say (indices of vertices that are not there, clips beyond the last frame) is
checked here.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.apparel.swing import SWING_NUMBERS
from bunraku.body.layout import JOINT_COUNT
from bunraku.errors import FormatError
from bunraku.formats.files import atomic_write

__all__ = ["LATER_ARRAYS", "SHARD_ARRAYS", "SHARD_FORMAT", "Shard", "shard_fingerprint", "write_shard"]

SHARD_FORMAT = "bunraku-apparel-3"
_KEY = "bunraku"
SHARD_ARRAYS: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "rest": ("F32", ("V", 3)),
    "faces": ("I32", ("F", 3)),
    "joints": ("F32", (JOINT_COUNT, 3)),
    "weights": ("F32", ("V", JOINT_COUNT)),
    "apparel": ("U8", ("V",)),
    "part": ("I32", ("V",)),
    "spring": ("F32", ("P",)),
    "mass": ("F32", ("P",)),
    "damping": ("F32", ("P",)),
    "limit": ("F32", ("P",)),
    "loose": ("I32", ("M",)),
    "transforms": ("F32", ("N", JOINT_COUNT, 3, 4)),
    "offsets": ("F16", ("N", "M", 3)),
    "bone_parents": ("I32", ("B",)),
    "bone_positions": ("F32", ("B", 3)),
    "bone_moved": ("U8", ("B",)),
    "bone_indices": ("I32", ("V", "I")),
    "bone_weights": ("F32", ("V", "I")),
}
"""Arrays of a shard -> type and shape; letters are lengths that must agree."""
LATER_ARRAYS: dict[str, tuple[str, tuple[str | int, ...]]] = {"swing": ("F32", ("V", SWING_NUMBERS))}
"""Arrays that shards of older versions lack."""
_AGAIN = "build it again with `bunraku data apparel`"


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
    """A shard, opened: `facts`, `lengths` and the `names` of its arrays are known, arrays are read when they are asked
    for.

    Args:
        path: The file.

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
            raise FormatError(self.path, f"there is no such shard; {_AGAIN}")
        from safetensors import safe_open

        try:
            file = safe_open(self.path, framework="numpy")
            facts = json.loads((file.metadata() or {}).get(_KEY, "{}"))
            shapes = {name: file.get_slice(name) for name in file.keys()}  # noqa: SIM118 - not a dict
            found = {name: (view.get_dtype(), tuple(view.get_shape())) for name, view in shapes.items()}
        except Exception as error:
            raise FormatError(self.path, f"the shard is damaged or cut short ({error}); {_AGAIN}") from None
        if not isinstance(facts, dict) or facts.get("format") != SHARD_FORMAT:
            raise FormatError(self.path, f"this is no shard of apparel data that this version reads; {_AGAIN}")
        lengths: dict[str, int] = {}
        for name, (kind, shape) in (SHARD_ARRAYS | LATER_ARRAYS).items():
            have = found.get(name)
            if have is None and name in LATER_ARRAYS:
                continue
            if have is None or have[0] != kind or len(have[1]) != len(shape):
                raise FormatError(self.path, f"its array '{name}' is missing or of another kind; {_AGAIN}")
            for want, length in zip(shape, have[1], strict=True):
                if (lengths.setdefault(want, length) if isinstance(want, str) else want) != length:
                    raise FormatError(
                        self.path,
                        f"its array '{name}' has shape {list(have[1])}, which does not go with the others; {_AGAIN}",
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
            raise FormatError(self.path, f"its array '{name}' cannot be read ({error}); {_AGAIN}") from None

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
            raise FormatError(self.path, f"its array '{name}' cannot be read ({error}); {_AGAIN}") from None
        if not np.isfinite(out).all():
            raise FormatError(self.path, f"its array '{name}' holds values that are not numbers; {_AGAIN}")
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
        raise FormatError(path, f"its list of clips does not fit its {frames} frames; {_AGAIN}")
