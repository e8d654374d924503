"""The training data on disk: a folder of handle-motion clips, one NPZ each, with an `index.json` of their captions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError
from bunraku.formats.files import atomic_write
from bunraku.geometry.rotations import matrix_from_6d, matrix_to_6d

__all__ = ["load_clip", "load_index", "load_lowest", "write_clip", "write_index"]


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
        "rotations6d": matrix_to_6d(motion.rotations).astype(np.float16),
        "root_translation": motion.root_translation,
        "root_rotation6d": matrix_to_6d(motion.root_rotation),
        "fps": np.float32(motion.fps),
    }
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
