"""Which way a rigged character stands, told by where its bones are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.body.layout import HANDLE_MIRROR, HANDLE_NAMES
from bunraku.geometry.axes import AXES, axis_vector
from bunraku.skeletons.bone_names import NO_HANDLE, handle_of_joints

__all__ = ["rig_axes"]

_CLEAR = 0.85  # least cosine between a direction and the axis that it is taken for
_TOPS = [HANDLE_NAMES.index(name) for name in ("left_hip", "right_hip")]
_FEET = [HANDLE_NAMES.index(f"{side}_{part}") for part in ("foot", "ankle", "knee") for side in ("left", "right")]


def rig_axes(
    names: Sequence[str], parents: Sequence[int] | np.ndarray, positions: np.ndarray
) -> tuple[str, str] | None:
    """The axis that is up and the axis that a rig faces, such as ("+y", "+z").

    Legs say what is down, and what is left and right by name says the rest.

    Args:
        names: Joint names, length J.
        parents: Parent of each joint, -1 for a root, shape (J,).
        positions: Joint positions in the rest pose [m], shape (J, 3).

    Returns:
        None where the names or the places leave a doubt: no two legs, no left and right, or directions between the
            axes.
    """
    handles = handle_of_joints(names, parents)
    centres = {int(h): positions[handles == h].mean(axis=0) for h in np.unique(handles) if h != NO_HANDLE}
    ends = next(
        (
            [centres[a], centres[b]]
            for a, b in zip(_FEET[::2], _FEET[1::2], strict=True)
            if a in centres and b in centres
        ),
        None,
    )
    if ends is None or any(top not in centres for top in _TOPS):
        return None
    up = np.mean([centres[top] for top in _TOPS], axis=0) - np.mean(ends, axis=0)
    pairs = [
        centres[h] - centres[m]
        for h, m in enumerate(HANDLE_MIRROR)
        if HANDLE_NAMES[h].startswith("left_") and h in centres and m in centres
    ]
    lengths = np.linalg.norm(pairs, axis=1)
    left = np.sum(pairs, axis=0)
    if np.linalg.norm(left) < 0.7 * lengths.sum():  # left and right of the parts do not agree
        return None
    found = [_axis(direction) for direction in (up, np.cross(left, up))]
    return (found[0], found[1]) if found[0] and found[1] and found[0][1] != found[1][1] else None


def _axis(direction: np.ndarray) -> str:
    """The axis that a direction lies along; "" where it lies along none."""
    shares = np.array([axis_vector(axis) for axis in AXES]) @ direction / max(float(np.linalg.norm(direction)), 1e-12)
    best = int(shares.argmax())
    return AXES[best] if shares[best] >= _CLEAR else ""
