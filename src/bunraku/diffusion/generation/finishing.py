"""What is repaired in a drawn motion before anything else sees it: trembling, a heading that wanders off, and a turn
that stops short or goes too far.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from bunraku.geometry.filters import correlated, gaussian
from bunraku.language.sentence import Clause

__all__ = ["clause_spans", "steadied", "straightened", "turned_as_asked"]

_SAVITZKY_GOLAY = np.array([-3, 12, 17, 12, -3]) / 35
"""Least-squares parabolas through five frames (Savitzky & Golay 1964): nothing changes below 3 Hz, half goes at 6."""
STRENGTH = 0.6
MOST = 1.6
"""Factor by which a turn is made faster or slower at the most."""
INSIDE = np.radians(10)
"""How far within the bounds of what was requested it then ends."""
SWAY = 1.0
"""Deviation of the mean that counts as the course [s]; a stride sways within."""


def steadied(features: np.ndarray, loop: bool = False) -> np.ndarray:
    """A motion with less of what is faster than people move; its travel over the ground stays.

    Args:
        features: Features of each frame (see `diffusion.features`), shape (N, D).
        loop: The last frame is followed by the first.

    Returns:
        Shape (N, D), float32.
    """
    pose = features[:, 3:]
    smooth = correlated(pose, _SAVITZKY_GOLAY, edge="wrap" if loop else "nearest")
    return np.concatenate([features[:, :3], pose + STRENGTH * (smooth - pose)], axis=1).astype(np.float32)


def turned_as_asked(features: np.ndarray, script: Sequence[tuple[Clause, int]], fps: float) -> np.ndarray:
    """A motion whose turns go as far as its clauses say, where they nearly do: faster or slower by at most `MOST`.

    Args:
        features: Features of each frame, the root's yaw velocity [rad/s] first, shape (N, D).
        script: Its clauses with the frames that each lasts.
        fps: Frames a second [1/s].

    Returns:
        Shape (N, D), float32.
    """
    out = features.copy()
    for clause, part in clause_spans(script):
        requested, angle = clause.turn, float(out[part, 0].sum()) / fps
        if requested is None or not angle or requested.side * angle < 0:
            continue
        wanted = float(
            np.clip(abs(angle), requested.least + INSIDE, max(requested.most - INSIDE, requested.least + INSIDE))
        )
        factor = wanted / abs(angle)
        if 1 / MOST <= factor <= MOST:
            out[part, 0] *= factor
    return out


def straightened(features: np.ndarray, script: Sequence[tuple[Clause, int]], fps: float) -> np.ndarray:
    """A motion that keeps its course wherever a clause says "forward" and nothing of a turn.

    Args:
        features: Features of each frame, the root's yaw velocity [rad/s] first, shape (N, D).
        script: Its clauses with the frames that each lasts.
        fps: Frames a second [1/s].

    Returns:
        Shape (N, D), float32.
    """
    out = features.copy()
    for clause, part in clause_spans(script):
        if clause.straight and len(out[part]):
            out[part, 0] -= gaussian(out[part, 0], SWAY * fps)
    return out


def clause_spans(script: Iterable[tuple[Clause, int]]) -> Iterator[tuple[Clause, slice]]:
    """The clauses of a script that have frames each, with those frames as slices."""
    start = 0
    for clause, frames in script:
        yield clause, slice(start, start + frames)
        start += frames
