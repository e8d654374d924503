"""Names that handles have in files."""

from __future__ import annotations

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.character import Handles

__all__ = ["handle_names"]


def handle_names(handles: Handles) -> tuple[str, ...]:
    """Names of handles: those of the layout where there are as many, numbers otherwise.

    A handle that plays the part of another is named after it and numbered: left_hip_2 is the second left hip.
    """
    count = len(handles.positions)
    if count != len(HANDLE_NAMES):
        return tuple(f"handle_{handle}" for handle in range(count))
    names, met = list(HANDLE_NAMES), [1] * count
    for handle, role in enumerate(handles.played.tolist()):
        if role != handle:
            met[role] += 1
            names[handle] = f"{HANDLE_NAMES[role]}_{met[role]}"
    return tuple(names)
