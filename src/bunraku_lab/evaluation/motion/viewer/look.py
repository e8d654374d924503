"""What a look at a motion sees: hands in the body, and contacts that slide. Nothing here uses what the stages of
fitting detect.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin

__all__ = ["Slides", "hands_in_body", "sliding_contacts"]

DEEP = 0.01
"""How deep a point of a hand in the body is seen [m]."""
LOW = 0.03
"""Height of a sole's lowest point with which it is on the ground [m]."""
FAST = 1.0
"""Speed along the ground with which a foot is swung [m/s]."""
SLID = 0.03
"""Way that is seen [m]."""
MOMENT = 0.1
"""Time in which it is [s]."""
SOLE = 0.02
"""How much higher than the lowest a point of a sole may be to be where the foot stands [m]."""


@functools.cache
def _surface() -> tuple[np.ndarray, np.ndarray]:
    """Faces of the reference body without its arms, and some vertices of both hands."""
    body = reference_body()

    def moved_by(*ends: str) -> np.ndarray:
        chosen = [name.endswith(ends) for name in HANDLE_NAMES]
        return np.asarray(body.handle_weights[:, chosen].sum(axis=1))

    arms = moved_by("collar", "shoulder", "elbow", "wrist", "fingers")
    faces = body.character().faces
    return faces[(arms[faces] < 0.5).all(axis=1)], np.flatnonzero(moved_by("wrist", "fingers") > 0.8)[::20]


def hands_in_body(motion: HandleMotion, every: int = 2) -> np.ndarray:
    """Whether a hand is more than 1 cm deep in the body without its arms, in every second frame, shape (N / 2,), bool:
    by the generalised winding number of the posed surface (Jacobson et al. 2013).

    Args:
        motion: Of the reference body.
        every: Frames from one to the next that is looked at.
    """
    import igl

    body = reference_body()
    faces, hands = _surface()
    transforms = motion.transforms(body.handles.positions)
    found = []
    for frame in range(0, len(motion), every):
        posed = skin(body.vertices, body.handle_weights, transforms[frame : frame + 1])[0].astype(np.float64)
        points = posed[hands]
        inside = igl.fast_winding_number(posed, faces.astype(np.int64), points) > 0.5
        deep = 0.0
        if inside.any():
            deep = float(igl.point_mesh_squared_distance(points[inside], posed, faces.astype(np.int64))[0].max()) ** 0.5
        found.append(deep > DEEP)
    return np.array(found)


class Slides(NamedTuple):
    """Contacts, counted for each foot and each frame in which it stays on the ground to the next.

    Args:
        fast: How many slide more than 3 cm in a tenth of a second.
        far: How many are more than 3 cm from where their contact began.
        contacts: All of them.
    """

    fast: int
    far: int
    contacts: int


def sliding_contacts(motion: HandleMotion) -> Slides:
    """How feet slide that are on the ground and not swung; a foot is where the lowest part of its sole is, so rolling
    is no way.

    Args:
        motion: Of the reference body.
    """
    body = reference_body()
    transforms = motion.transforms(body.handles.positions)
    fast = far = count = 0
    for side in ("left", "right"):
        columns = [HANDLE_NAMES.index(f"{side}_{part}") for part in ("ankle", "foot")]
        foot = body.handle_weights[:, columns].sum(axis=1) > 0.9
        posed = skin(body.vertices[foot], body.handle_weights[foot], transforms)
        height = posed[..., 1]
        sole = height - height.min(axis=1, keepdims=True) < SOLE
        both = sole[1:] & sole[:-1]
        ways = (np.diff(posed[..., [0, 2]], axis=0) * both[..., None]).sum(axis=1)
        ways /= np.maximum(both.sum(axis=1), 1)[:, None]
        speed = np.linalg.norm(ways, axis=1) * motion.fps
        low = height.min(axis=1) < LOW
        down = low[1:] & low[:-1] & (speed < FAST)
        from_start = np.zeros(2)
        for frame in range(len(down)):
            from_start = from_start + ways[frame] if down[frame] else np.zeros(2)
            count += bool(down[frame])
            fast += bool(down[frame] and speed[frame] * MOMENT > SLID)
            far += bool(down[frame] and np.linalg.norm(from_start) > SLID)
    return Slides(fast, far, count)
