"""Sample characters made by code, so that demos and tests need no downloads.

Each sample stands on y = 0, faces +Z and has its left side at +X; people are in T-pose. A sample has no source
document, so writers store its positions, faces and `Character.colors` as the vertex colours COLOR_0 (sRGB bytes, to be
made linear where the format asks for it) under one white material. Vertices are doubled along the seams between
colours, as in most files from
artists: welded, every part is closed.
"""

from __future__ import annotations

import importlib

from bunraku.core.character import Character
from bunraku.errors import OptionError

__all__ = ["sample_character", "sample_names"]

_NAMES = ("person", "dancer", "dog", "mushroom", "robot", "dragon")


def sample_names() -> tuple[str, ...]:
    """The names that `sample_character` knows."""
    return _NAMES


def sample_character(name: str, detail: float = 1.0, *, rigged: bool = False) -> Character:
    """A sample character, the same on every call.

    Args:
        name: One of `sample_names`.
        detail: Factor on the number of vertices, 0.3 to 4; 1 gives 3,000 to 8,000.
        rigged: Give it its skeleton and skin weights too (names such as Hips, Spine, LeftArm, Tail1); without it `rig`
            is None.

    Returns:
        The character: closed parts, wound outward, with vertex colours.

    Raises:
        OptionError: The name is unknown or the detail out of range.
    """
    if name not in _NAMES:
        raise OptionError(f"there is no sample character named {name!r}; choose one of {', '.join(_NAMES)}")
    if not 0.3 <= detail <= 4:
        raise OptionError(f"the detail of a sample character must be between 0.3 and 4, not {detail}")
    return importlib.import_module(f"bunraku.samples.{name}").build(detail, rigged)
