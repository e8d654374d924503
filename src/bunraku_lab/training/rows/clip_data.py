"""The clips that networks train on and are measured with: features and captions, by stretches where these are known."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypedDict, cast

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.diffusion.features import encode
from bunraku.errors import FormatError, OptionError
from bunraku_lab.datasets.motions.bundle import read_bundle
from bunraku_lab.datasets.motions.clips import load_clip, load_index

__all__ = ["ClipEntry", "load_clips", "load_people", "people"]

MIN_FRAMES = 8


class ClipEntry(TypedDict, total=False):
    """What is known of a clip; `features`, shape (N, D), and `frames` always are."""

    features: np.ndarray
    frames: int
    split: str
    texts: list[str]
    labels: list[str]
    watched: bool
    weight: float
    species: str | None
    action: str | None
    character: str | None
    next: str
    source: str
    licence: str
    credit: str
    rehearsed: bool


def _features(path: Path, motion: HandleMotion) -> np.ndarray:
    if abs(motion.fps - 20) > 0.01:
        raise FormatError(
            path,
            f"the clip has {motion.fps:g} frames a second, not 20; build the data again with 'bunraku data motions'",
        )
    return encode(motion)


def load_clips(folder: str | Path, progress: Any = None, splits: Collection[str] | None = None) -> dict[str, ClipEntry]:
    """Features and index entries of clips by name.

    A clip with captions by time becomes one entry a stretch, "name@first frame", without those that are faulty.

    Args:
        folder: What `bunraku data motions` wrote: `index.json` and one NPZ a clip; or the one file that `bunraku data
            bundle` made of it.
        progress: Called with (done, total).
        splits: "train", "val", "test": those to load; None for all.

    Raises:
        FormatError: The index or a clip is missing or damaged.
    """
    folder = Path(folder)
    bundle = read_bundle(folder) if folder.is_file() else None
    index = load_index(folder) if bundle is None else bundle.clips
    found: dict[str, ClipEntry] = {}
    for done, (name, entry) in enumerate(sorted(index.items())):
        if (entry.get("texts") or entry.get("species")) and (splits is None or entry.get("split", "train") in splits):
            path = folder / f"{name}.npz"
            features = _features(path, load_clip(path)) if bundle is None else encode(bundle.motion(name))
            try:
                found |= _entries(name, entry, features)
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                raise FormatError(
                    folder, f"what the index says of {name} cannot be read ({error!r}); build the data again"
                ) from error
        if progress is not None:
            progress(done + 1, len(index))
    if not found:
        raise FormatError(folder, "there is no captioned clip; build the data with 'bunraku data motions'")
    return found


def load_people(
    folder: str | Path, progress: Callable[[str, float], None], labelled: bool = True
) -> tuple[dict[str, ClipEntry], dict[str, ClipEntry]]:
    """Clips of people to train on, and those to validate with.

    Args:
        folder: As of `load_clips`.
        progress: Called with a stage's name and the share done.
        labelled: With labelled actions of game characters.

    Raises:
        OptionError: There are none to train on.
        FormatError: The data are missing or damaged.
    """
    clips = load_clips(folder, lambda done, total: progress("clips", done / total), splits={"train", "val"})
    train, held = (people(clips, split, labelled) for split in ("train", "val"))
    if not train:
        raise OptionError(
            f"{folder}: there are no training clips of people; build the data again with 'bunraku data motions'"
        )
    return train, held


def people(clips: Mapping[str, ClipEntry], split: str, labelled: bool = False) -> dict[str, ClipEntry]:
    """Captured motions of people of one split: no creature.

    Args:
        clips: What `load_clips` returned.
        split: "train", "val" or "test".
        labelled: With labelled actions of game characters, each of which has many captions that mean the same.
    """
    others = ("species",) if labelled else ("species", "character", "action")
    return {
        name: entry
        for name, entry in clips.items()
        if entry.get("split", "train") == split and not any(entry.get(key) for key in others)
    }


def _entries(name: str, entry: Mapping[str, object], features: np.ndarray) -> dict[str, ClipEntry]:
    if "stretches" in entry:
        return _stretches(name, entry, features)
    return {name: cast(ClipEntry, {**entry, "features": features})} if len(features) >= MIN_FRAMES else {}


def _stretches(name: str, entry: Mapping[str, object], features: np.ndarray) -> dict[str, ClipEntry]:
    """What is captioned by time, as entries of their own; those that follow each other without a gap say so in
    "next".
    """
    parts = entry["stretches"]
    if not isinstance(parts, list):
        raise TypeError("its stretches are no list")
    sound = [part for part in parts if "fault" not in part and part["stop"] - part["start"] >= MIN_FRAMES]
    found: dict[str, ClipEntry] = {}
    common = {key: value for key, value in entry.items() if key not in ("stretches", "texts")}
    for part, after in zip_longest(sound, sound[1:]):
        start, stop = int(part["start"]), int(part["stop"])
        own: dict[str, Any] = {
            "texts": part["texts"],
            "watched": True,
            "features": features[start:stop],
            "frames": stop - start,
        }
        if len(sound) == 1:
            own["labels"] = entry.get("texts") or []
        if after is not None and after["start"] == stop:
            own["next"] = f"{name}@{stop}"
        found[f"{name}@{start}"] = cast(ClipEntry, common | own)
    return found
