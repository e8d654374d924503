"""The clips that networks train on and are measured with: features and captions, by stretches where these are known."""

from __future__ import annotations

from collections.abc import Collection
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.diffusion.features import encode
from bunraku.errors import FormatError
from bunraku_lab.datasets.motions.bundle import read_bundle
from bunraku_lab.datasets.motions.clips import load_clip, load_index

__all__ = ["load_clips"]

MIN_FRAMES = 8


def _features(path: Path, motion: HandleMotion) -> np.ndarray:
    if abs(motion.fps - 20) > 0.01:
        raise FormatError(
            path,
            f"the clip has {motion.fps:g} frames a second, not 20; build the data again with 'bunraku data motions'",
        )
    return encode(motion)


def load_clips(
    folder: str | Path, progress: Any = None, splits: Collection[str] | None = None
) -> dict[str, dict[str, Any]]:
    """Features and index entries of clips: {name: {"features": (N, D), "texts", "split", "weight", ...}}.

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
    found: dict[str, dict[str, Any]] = {}
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


def _entries(name: str, entry: dict[str, Any], features: np.ndarray) -> dict[str, dict[str, Any]]:
    if "stretches" in entry:
        return _stretches(name, entry, features)
    return {name: {**entry, "features": features}} if len(features) >= MIN_FRAMES else {}


def _stretches(name: str, entry: dict[str, Any], features: np.ndarray) -> dict[str, dict[str, Any]]:
    """What is captioned by time, as entries of their own; those that follow each other without a gap say so in
    "next".
    """
    sound = [part for part in entry["stretches"] if "fault" not in part and part["stop"] - part["start"] >= MIN_FRAMES]
    found: dict[str, dict[str, Any]] = {}
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
        found[f"{name}@{start}"] = common | own
    return found
