"""Parts of the body by name, for what is kept in an edit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.errors import OptionError

__all__ = ["PARTS", "kept_handles"]


def _named(*endings: str, side: str = "") -> tuple[int, ...]:
    return tuple([i for i, name in enumerate(HANDLE_NAMES) if name.startswith(side) and name.endswith(endings)])


_LEG = ("hip", "knee", "ankle", "foot")
_ARM = ("collar", "shoulder", "elbow", "wrist", "fingers")
_TORSO = ("spine1", "spine2", "spine3")
_HEAD = ("neck", "head", "head_top", "face")
PARTS: dict[str, tuple[int, ...]] = {
    "root": (0,),
    "legs": (0, *_named(*_LEG)),
    "left leg": (0, *_named(*_LEG, side="left")),
    "right leg": (0, *_named(*_LEG, side="right")),
    "arms": _named(*_ARM),
    "left arm": _named(*_ARM, side="left"),
    "right arm": _named(*_ARM, side="right"),
    "torso": _named(*_TORSO),
    "head": _named(*_HEAD),
    "upper body": (*_named(*_TORSO), *_named(*_HEAD), *_named(*_ARM), *_named("wing")),
    "lower body": (0, *_named(*_LEG), *_named("tail", "tail_tip")),
    "tail": _named("tail", "tail_tip"),
    "wings": _named("wing"),
}
"""Handles of each part. Legs come with the root: they step where they did only on its path."""


def kept_handles(keep: str | Sequence[str]) -> np.ndarray:
    """Which handles words name, shape (K,), bool.

    Args:
        keep: Parts (`PARTS`) or single handles (`HANDLE_NAMES`), as a list or parted by commas; case, hyphens and
            underscores do not matter.

    Raises:
        OptionError: A word names nothing, or all words together name everything.
    """
    words = [word for entry in ([keep] if isinstance(keep, str) else keep) for word in entry.split(",")]
    out = np.zeros(HANDLE_COUNT, bool)
    for word in words:
        plain = " ".join(word.lower().replace("_", " ").replace("-", " ").split())
        if not plain and len(words) > 1:
            continue
        if plain in PARTS:
            out[list(PARTS[plain])] = True
        elif plain.replace(" ", "_") in HANDLE_NAMES:
            out[HANDLE_NAMES.index(plain.replace(" ", "_"))] = True
        else:
            raise OptionError(
                f"there is no part '{word.strip()}' to keep; there are {', '.join(PARTS)}, and single handles such as "
                "left_wrist"
            )
    if out.all():
        raise OptionError("all handles are kept, so there is nothing to generate; keep fewer")
    return out
