"""The training data in one small file: clips packed, their index, and the mesh features to train with.

A safetensors file of kind "motion-bundle", for a machine to which the folder is too large to be copied.
"""

from __future__ import annotations

import functools
import json
import lzma
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.body.reference import reference_body
from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError, OptionError, WeightsError
from bunraku.formats.files import check_input
from bunraku_lab.datasets.motions.clips import load_clip, load_index
from bunraku_lab.datasets.motions.packing import FORMS, FPS, MOST_FRAMES, pack_motion, unpack_motion

__all__ = ["KIND", "Bundle", "BundleFacts", "read_bundle", "write_bundle"]

KIND = "motion-bundle"
MOST_BYTES = 1 << 30
MOST_INDEX = 64 << 20
MOST_IN_ALL = 2_000_000
"""Frames of all clips, 28 hours: what is decoded stays below 2.2 GB."""
_EACH = 16
"""Of every so many clips of a form one tells the error of packing."""


@dataclass(frozen=True)
class BundleFacts:
    """What was packed.

    Args:
        clips: How many.
        frames: Of all of them.
        bytes: Of the file.
        error: Mean distance of the handles from where they were [m], of every sixteenth clip of
            people and of creatures.
        largest: The same, of the handle and frame that 99 of 100 are better than.
    """

    clips: int
    frames: int
    bytes: int
    error: float
    largest: float


@dataclass(frozen=True, eq=False)
class Bundle:
    """What `write_bundle` wrote.

    Args:
        path: The file.
        clips: Index entries by clip name, as `load_index` has them.
        data: Packed clip by name.
        meshes: Arrays of the mesh features by name, as in the NPZ of `bunraku data mesh-bank`; None without.
    """

    path: Path
    clips: dict[str, dict[str, Any]]
    data: dict[str, bytes]
    meshes: dict[str, np.ndarray] | None

    def motion(self, name: str) -> HandleMotion:
        """One clip.

        Raises:
            FormatError: It is damaged.
        """
        entry = self.clips[name]
        try:
            return unpack_motion(self.data[name], int(entry["frames"]), str(entry["form"]))
        except Exception as error:
            raise _damaged(self.path, f"{name}: {error}") from error


def write_bundle(
    folder: Path,
    path: Path,
    mesh_bank: Path | None = None,
    people: str = "skeleton",
    splits: Collection[str] = ("train", "val"),
    progress: Callable[[int, int], None] | None = None,
) -> BundleFacts:
    """Pack what training reads of a folder of clips.

    Args:
        folder: What `bunraku data motions` wrote.
        path: File to write.
        mesh_bank: NPZ of mesh features; its rows that train, in half precision, go along.
        people: "skeleton" or "handles": how people's clips are kept; creatures' clips keep all handles.
        splits: Of the clips that go along.
        progress: Called with (done, total).

    Raises:
        OptionError: `people` is another word.
        FormatError: The data are missing or damaged, or the file cannot be written.
    """
    from bunraku.nn.checkpoints import save_checkpoint

    if people not in FORMS:
        raise OptionError(f"people's clips are kept as one of: {', '.join(FORMS)}; not as '{people}'")
    index = {
        name: entry
        for name, entry in sorted(load_index(folder).items())
        if (entry.get("texts") or entry.get("species")) and entry.get("split", "train") in splits
    }
    if not index:
        raise FormatError(folder, "there is no captioned clip; build the data with 'bunraku data motions'")
    kept: dict[str, dict[str, Any]] = {}
    data: list[bytes] = []
    errors: list[np.ndarray] = []
    seen = dict.fromkeys(FORMS, 0)
    for done, (name, entry) in enumerate(index.items()):
        source = folder / f"{name}.npz"
        motion = load_clip(source)
        if abs(motion.fps - FPS) > 0.01 or len(motion) > MOST_FRAMES:
            raise FormatError(
                source,
                f"a clip of {len(motion)} frames, {motion.fps:g} a second, cannot be packed; build the data again with "
                "'bunraku data motions'",
            )
        form = "handles" if entry.get("species") else people
        data.append(pack_motion(motion, form))
        kept[name] = {**entry, "frames": len(motion), "form": form}
        seen[form] += 1
        if seen[form] % _EACH == 1:
            errors.append(_distances(motion, unpack_motion(data[-1], len(motion), form)))
        if progress is not None:
            progress(done + 1, len(index))
    tensors: dict[str, np.ndarray] = {
        "data": np.frombuffer(b"".join(data), np.uint8),
        "sizes": np.array([len(part) for part in data], np.int64),
        "index": np.frombuffer(lzma.compress(json.dumps(kept).encode()), np.uint8),
    }
    config: dict[str, Any] = {}
    if mesh_bank is not None:
        meshes = _mesh_rows(mesh_bank)
        tensors["features"] = meshes.pop("features").astype(np.float16)
        config["meshes"] = {name: value.tolist() for name, value in meshes.items()}
    save_checkpoint(path, tensors, config, KIND)
    distances = np.concatenate(errors)
    return BundleFacts(
        len(kept),
        sum(entry["frames"] for entry in kept.values()),
        path.stat().st_size,
        float(distances.mean()),
        float(np.quantile(distances, 0.99)),
    )


def _distances(one: HandleMotion, other: HandleMotion) -> np.ndarray:
    """How far apart two motions put the handles of the reference body [m], for each frame and handle."""
    rest = reference_body().handles.positions
    positions = [
        np.einsum("nkij,kj->nki", found[..., :3], rest) + found[..., 3]
        for found in (motion.transforms(rest) for motion in (one, other))
    ]
    return np.asarray(np.linalg.norm(positions[0] - positions[1], axis=-1)).ravel()


def _mesh_rows(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: file[name] for name in ("features", "names", "split", "humanoid") if name in file.files}
            kept = found["split"] == "train" if "split" in found else np.ones(len(found["features"]), bool)
            return {name: value[kept] for name, value in found.items()}
    except Exception as error:
        raise FormatError(
            path, f"the mesh features cannot be read ({error}); write them with 'bunraku data mesh-bank'"
        ) from error


def _damaged(path: Path, reason: str) -> FormatError:
    return FormatError(path, f"the bundle of motions is damaged ({reason}); write it again with 'bunraku data bundle'")


@functools.lru_cache(maxsize=1)
def _read(path: Path, changed: int) -> Bundle:
    from bunraku.nn.checkpoints import load_checkpoint

    try:
        state, config = load_checkpoint(path, KIND)
        sizes, data = state["sizes"], state["data"]
        packed = state["index"].tobytes()
        text = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=256 << 20).decompress(packed, MOST_INDEX + 1)
        if len(text) > MOST_INDEX:
            raise ValueError("its index is too large")
        clips = json.loads(text)
        if not isinstance(clips, dict) or data.dtype != np.uint8 or sizes.shape != (len(clips),):
            raise ValueError("its index and its clips disagree")
        if not all(isinstance(entry, dict) and type(entry.get("frames")) is int for entry in clips.values()):
            raise ValueError("its index lacks what is known of a clip")
        frames = [entry["frames"] for entry in clips.values()]
        if min(frames, default=1) < 1 or max(frames, default=1) > MOST_FRAMES or sum(frames) > MOST_IN_ALL:
            raise ValueError("its clips are too long")
        if (sizes < 0).any() or (sizes > len(data)).any() or int(sizes.sum()) != len(data):
            raise ValueError("the sizes of its clips do not add up")
        ends = np.concatenate([[0], np.cumsum(sizes)]).tolist()
        parts = {name: data[a:b].tobytes() for name, a, b in zip(clips, ends, ends[1:], strict=False)}
        meshes = None
        if "features" in state:
            meshes = {"features": state["features"]}
            meshes |= {
                str(name): np.array(value, bool if name == "humanoid" else str)
                for name, value in config["meshes"].items()
            }
    except WeightsError as error:
        raise _damaged(path, str(error).removeprefix(f"{path}: ").partition(";")[0]) from error
    except Exception as error:
        raise _damaged(path, " ".join(str(error).split())) from error
    return Bundle(path, clips, parts, meshes)


def read_bundle(path: str | Path) -> Bundle:
    """What `write_bundle` wrote, its clips still packed; kept between calls.

    Raises:
        FormatError: The file is missing, damaged or of another kind.
    """
    path = Path(path)
    if check_input(path) > MOST_BYTES:
        raise FormatError(path, f"a bundle has at most {MOST_BYTES >> 30} GiB; write a smaller one")
    return _read(path, path.stat().st_mtime_ns)
