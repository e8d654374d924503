"""Training motions on disk: a folder of clips with an `index.json`, or one packed file; and their sources."""

from __future__ import annotations

import functools
import json
import lzma
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.arrays import lzma_filters, pack_steps, unpack_steps
from bunraku.core.body.joint_rotations import skeleton_from_handles
from bunraku.core.body.layout import HANDLE_COUNT, JOINT_COUNT
from bunraku.core.body.reference import reference_body
from bunraku.core.files import atomic_write, check_input
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_6d, matrix_from_axis_angle, matrix_to_6d
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.core.nn.checkpoints import save_checkpoint
from bunraku.errors import FormatError, WeightsError
from bunraku.generation.features import body_handle_motion
from bunraku.generation.pack import FILTERS, METRES, ORDER, RADIANS, STEPS, ExamplePack, stand_well
from bunraku.generation.pack import KIND as EXAMPLES

_CUT = "turn_"
"""How the names of clips begin that were cut out of others (`turns`)."""


@dataclass(frozen=True)
class Source:
    """One source of clips.

    Args:
        prefixes: How the names of its clips begin.
        credit: The authors to name.
        licence: On which terms.
        weight: How often its clips are drawn, 1 for most; less where a toy's or a robot's proportions make feet slide,
            or where there is much of the same.
        subject_parts: Parts of a name, between underscores, that name the subject; None: two, without a last number.
        holds_ends: Its takes begin and end in a pose that is held, which is no part of what their captions say.
    """

    prefixes: tuple[str, ...]
    credit: str
    licence: str
    weight: float = 1.0
    subject_parts: int | None = None
    holds_ends: bool = False

    @property
    def credit_line(self) -> str:
        """A line of a model card's credits."""
        return f"{self.credit}. Licence: {self.licence}."


@functools.cache
def _table() -> tuple[Source, ...]:
    text = resources.files("bunraku_lab.datasets.motions").joinpath("sources.json").read_text(encoding="utf-8")
    return tuple(Source(**{**entry, "prefixes": tuple(entry["prefixes"])}) for entry in json.loads(text)["sources"])


def source_of(name: str) -> Source | None:
    """The source of a clip, that of the longest prefix; None where the table does not know it."""
    found = [
        (len(prefix), source)
        for source in _table()
        for prefix in source.prefixes
        if name.removeprefix(_CUT).startswith(prefix)
    ]
    return max(found, key=lambda pair: pair[0])[1] if found else None


def subject_of(name: str) -> str:
    """The captured subject of a clip, by its name: `cmu_16_11` -> `cmu_16`, `accad_m1_Walk2` -> `accad_m1`."""
    source = source_of(name)
    if source is not None and source.subject_parts is not None:
        return "_".join(name.split("_")[: source.subject_parts])
    return "_".join(name.split("_")[:2]).rstrip("0123456789")


def credit_lines(names: Iterable[str]) -> list[str]:
    """The credits of these clips, each source once, in the order of the table."""
    used = {source for source in map(source_of, names) if source is not None}
    return list(dict.fromkeys(source.credit_line for source in _table() if source in used))


NAME, ASKED = "captions_watched.json", "captions_asked.tsv"
FEWEST = 8
"""Frames of the shortest stretch that is kept."""
_SPACES = re.compile(r"\s+")


@dataclass(frozen=True)
class Stretch:
    """A part of a clip and what it shows.

    Args:
        start: First frame.
        stop: Frame after the last.
        texts: Sentences, the fullest first, the tersest last.
        fault: Why it is not to be trained on; None where it is.
        note: What the watcher noticed.
        asked: Sentences in which people ask for it, which the texts do not contradict.
    """

    start: int
    stop: int
    texts: tuple[str, ...]
    fault: str | None = None
    note: str = ""
    asked: tuple[str, ...] = ()


def plain(sentence: str) -> str:
    """A sentence in lower case at its start, with single spaces and no full stop, as people type."""
    sentence = _SPACES.sub(" ", sentence).strip().rstrip(". ")
    return sentence[:1].lower() + sentence[1:]


@functools.cache
def action_labels() -> dict[str, tuple[tuple[str, ...], tuple[str, ...]]]:
    """The actions that stretches were labelled with by hand, by "clip@first frame": those that it shows, in order,
    and further ones that only the fullest caption names.
    """
    table = Path(__file__).with_name("action_labels.tsv").read_text(encoding="utf-8")
    rows = [line.split("\t") for line in table.splitlines()]
    return {
        name: (tuple(filter(None, shows.split(", "))), tuple(filter(None, besides.split(", "))))
        for name, shows, besides in rows
    }


def load_watched(folder: str | Path, frames: dict[str, int], fps: float = 20.0) -> dict[str, list[Stretch]]:
    """Stretches of each clip, with the sentences of `captions_asked.tsv` where the folder has it; nothing where it has
    no `captions_watched.json`.

    Args:
        folder: Of the archive.
        frames: Length of each clip by its name.
        fps: Frames a second [1/s].

    Raises:
        FormatError: The file is damaged.
    """
    path = Path(folder) / NAME
    if not path.is_file():
        return {}
    try:
        table: dict[str, list[dict[str, Any]]] = json.loads(path.read_text(encoding="utf-8"))["clips"]
        asked = _asked(path.with_name(ASKED))
        found: dict[str, list[Stretch]] = {}
        for name, rows in table.items():
            if name not in frames:
                continue
            for number, row in enumerate(rows):
                start, stop = round(float(row["start"]) * fps), min(round(float(row["end"]) * fps), frames[name])
                texts = tuple(dict.fromkeys(plain(str(text)) for text in row["texts"] if str(text).strip()))
                note = str(row.get("note") or "")
                if stop - start < FEWEST or not texts:
                    continue
                fault = None if row.get("ok", True) else f"watched: {note or 'broken'}"
                found.setdefault(name, []).append(
                    Stretch(max(start, 0), stop, texts, fault, note, asked.get(f"{name}#{number}", ()))
                )
        return found
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise FormatError(
            path, f"cannot be read as captions by time ({type(error).__name__}); copy it again or take it away"
        ) from error


def _asked(path: Path) -> dict[str, tuple[str, ...]]:
    """Sentences that ask for each stretch, by its clip and its number there."""
    if not path.is_file():
        return {}
    rows = [line.split("\t") for line in path.read_text(encoding="utf-8").splitlines()]
    return {row[0]: tuple(dict.fromkeys(plain(text) for text in row[1:] if text.strip())) for row in rows}


def write_clip(path: Path, motion: HandleMotion, lowest: np.ndarray | None = None) -> None:
    """Write a clip, whole or not at all; locals in half precision, which costs under a millimetre.

    Args:
        path: File to write.
        motion: The clip.
        lowest: Lowest point of the body over the ground in each frame [m], shape (N,), where it is known.

    Raises:
        FormatError: The file cannot be written.
    """
    arrays: dict[str, Any] = {
        "translations": motion.translations.astype(np.float16),
        "rotations6d": matrix_to_6d(motion.rotations).astype(np.float16), "root_translation": motion.root_translation,
        "root_rotation6d": matrix_to_6d(motion.root_rotation), "fps": np.float32(motion.fps),
    }  # fmt: skip
    if lowest is not None:
        arrays["lowest"] = lowest.astype(np.float16)
    with atomic_write(path) as file:
        np.savez(file, **arrays)


def load_clip(path: str | Path) -> HandleMotion:
    """A clip that `write_clip` wrote.

    Raises:
        FormatError: The file is missing or broken.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            translations = np.asarray(file["translations"], np.float32)
            rotations = matrix_from_6d(np.asarray(file["rotations6d"], np.float32))
            translations[:, 0], rotations[:, 0] = 0, np.eye(3)
            root = matrix_from_6d(np.asarray(file["root_rotation6d"], np.float32))
            return HandleMotion(
                translations, rotations, np.asarray(file["root_translation"], np.float32), root, float(file["fps"])
            )
    except Exception as error:
        raise FormatError(
            path, f"this is not a handle-motion clip ({error}); build the data again with 'bunraku data motions'"
        ) from error


def load_lowest(path: str | Path) -> np.ndarray:
    """The lowest point of the body over the ground in each frame [m], shape (N,); zeros where the clip does not say.

    Raises:
        FormatError: The file is missing or broken.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return (
                np.asarray(file["lowest"], np.float32)
                if "lowest" in file
                else np.zeros(len(file["root_translation"]), np.float32)
            )
    except Exception as error:
        raise FormatError(
            path, f"this is not a handle-motion clip ({error}); build the data again with 'bunraku data motions'"
        ) from error


def write_index(folder: Path, clips: dict[str, dict[str, object]]) -> Path:
    """Write what is known of each clip (captions, source, frames, split, weight) and return the path of `index.json`.

    Raises:
        FormatError: The file cannot be written.
    """
    path = folder / "index.json"
    with atomic_write(path) as file:
        file.write(json.dumps({"fps": 20, "clips": clips}, indent=1).encode())
    return path


def load_index(folder: Path) -> dict[str, dict[str, Any]]:
    """What `write_index` wrote, by clip name.

    Raises:
        FormatError: The index is missing or damaged, or a name would lead out of the folder.
    """
    path = folder / "index.json"
    try:
        clips: dict[str, dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["clips"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        problem = (
            "there is no index that can be read: the motion data are missing or damaged; build them with "
            "'bunraku data motions'"
        )
        raise FormatError(path, problem) from error
    for name in clips:
        if "/" in name or "\\" in name or name.startswith("."):
            raise FormatError(path, f"the clip name {name!r} is not a plain name")
    return clips


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
    values = unpack_steps([data], [frames], _NUMBERS[form], 2, _FILTERS)
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


KIND = "motion-bundle"
MOST_BYTES = 1 << 30
MOST_INDEX = 64 << 20
MOST_IN_ALL = 2_000_000
"""Frames of all clips, 28 hours: what is decoded stays below 2.2 GB."""


@dataclass(frozen=True)
class BundleFacts:
    """What was packed.

    Args:
        clips: How many.
        frames: Of all of them.
        bytes: Of the file.
    """

    clips: int
    frames: int
    bytes: int


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
    folder: Path, path: Path, mesh_bank: Path | None = None, splits: Collection[str] = ("train", "val"),
    progress: Callable[[int, int], None] | None = None,
) -> BundleFacts:  # fmt: skip
    """Pack what training reads of a folder of clips: of people 22 joints, 0.6 cm off, of creatures all handles.

    Args:
        folder: What `bunraku data motions` wrote.
        path: File to write.
        mesh_bank: NPZ of mesh features; its rows that train, in half precision, go along.
        splits: Of the clips that go along.
        progress: Called with (done, total).

    Raises:
        FormatError: The data are missing or damaged, or the file cannot be written.
    """
    from bunraku.core.nn.checkpoints import save_checkpoint

    index = {
        name: entry
        for name, entry in sorted(load_index(folder).items())
        if (entry.get("texts") or entry.get("species")) and entry.get("split", "train") in splits
    }
    if not index:
        raise FormatError(folder, "there is no captioned clip; build the data with 'bunraku data motions'")
    kept: dict[str, dict[str, Any]] = {}
    data: list[bytes] = []
    for done, (name, entry) in enumerate(index.items()):
        source = folder / f"{name}.npz"
        motion = load_clip(source)
        if abs(motion.fps - FPS) > 0.01 or len(motion) > MOST_FRAMES:
            raise FormatError(
                source,
                f"a clip of {len(motion)} frames, {motion.fps:g} a second, cannot be packed; build the data again with "
                "'bunraku data motions'",
            )
        form = "handles" if entry.get("species") else "skeleton"
        data.append(pack_motion(motion, form))
        kept[name] = {**entry, "frames": len(motion), "form": form}
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
    return BundleFacts(len(kept), sum(entry["frames"] for entry in kept.values()), path.stat().st_size)


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
    from bunraku.core.nn.checkpoints import load_checkpoint

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


def packed_stretch(root: np.ndarray, rotations: np.ndarray) -> bytes:
    """A skeleton's motion in few bytes.

    Args:
        root: Position of the root in each frame [m], shape (N, 3).
        rotations: Of the 22 joints relative to their parents, shape (N, 22, 3, 3).
    """
    turns = axis_angle_from_matrix(rotations.astype(float)).reshape(len(root), -1)
    return pack_steps(np.concatenate([root / METRES, turns / RADIANS], axis=1), ORDER, FILTERS)


def write_pack(path: str | Path, pack: ExamplePack, notes: Mapping[str, object]) -> Path:
    """Write examples with notes on their sources and choice, with those in which a person stands well, and with what
    they show.
    """
    table = [[example.name, list(example.texts), example.frames, list(example.loop or ())] for example in pack.examples]
    texts = np.rint(STEPS * pack.texts).astype(np.int8)
    sided = np.flatnonzero((texts[0] != texts[1]).any(axis=1))  # most sentences are the same in the mirror
    readings = pack.said
    distinct = {said: number for number, said in enumerate(dict.fromkeys(readings))}
    tensors: dict[str, np.ndarray] = {
        "data": np.frombuffer(b"".join(pack.data), np.uint8),
        "sizes": np.array([len(part) for part in pack.data], np.int32),
        "owners": pack.owners.astype(np.int32),
        "readings": np.array([distinct[said] for said in readings], np.int32),
        "texts": texts[0], "sided": sided.astype(np.int32), "mirrored": texts[1, sided],
        "motions": np.rint(STEPS * pack.motions).astype(np.int8),
    }  # fmt: skip
    config: dict[str, object] = {
        "examples": table, "ranker": pack.ranker, "notes": notes, "stand": list(stand_well(pack)),
        "readings": [[sorted(part) for part in said] for said in distinct], "radians": RADIANS,
    }  # fmt: skip
    return save_checkpoint(path, tensors, config, EXAMPLES, half=True)
