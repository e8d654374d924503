"""How VRM 1.0 moves spring bones: its own steps of a sixtieth of a second, for many values at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["VrmValues", "vrm_tails"]

SUBSTEPS = 60


@dataclass(frozen=True, eq=False)
class VrmValues:
    """Settings of a spring, S of them: stiffness, drag and gravity power, each of shape (S,)."""

    stiffness: np.ndarray
    drag: np.ndarray
    gravity: np.ndarray


def vrm_tails(turns: np.ndarray, heads: np.ndarray, rest: np.ndarray, values: VrmValues, fps: float) -> np.ndarray:
    """Where the tails of the links of one spring are, without colliders, as VRM's specification moves them:
    `x += (1 - drag) dx + stiffness dt rest + gravity dt down`, and then back to its length.

    Args:
        turns: World rotation of what the first link hangs on, shape (N, 3, 3).
        heads: Where the first link begins [m], shape (N, 3).
        rest: From the beginning of each link to its tail at rest [m], shape (R, 3).
        values: S settings.
        fps: Frames a second [1/s].

    Returns:
        Shape (S, N, R, 3) [m].
    """
    count, links = len(values.drag), len(rest)
    lengths = np.linalg.norm(rest, axis=1)
    axes = rest / np.maximum(lengths, 1e-9)[:, None]
    parts = max(1, round(SUBSTEPS / fps))
    step = 1 / (fps * parts)
    out = np.empty((count, len(heads), links, 3))
    start = heads[0] + np.cumsum(rest @ turns[0].T, axis=0)
    now = np.broadcast_to(start, (count, links, 3)).copy()
    before = now.copy()
    out[:, 0] = now
    keep, back = (1 - values.drag)[:, None], (values.stiffness * step)[:, None]
    fall = np.zeros((count, 3))
    fall[:, 1] = -values.gravity * step
    for frame in range(1, len(heads)):
        for part in range(1, parts + 1):
            share = part / parts
            head = np.broadcast_to((1 - share) * heads[frame - 1] + share * heads[frame], (count, 3))
            turn = np.broadcast_to(turns[frame if share > 0.5 else frame - 1], (count, 3, 3))
            for link in range(links):
                aim = turn @ axes[link]
                here = now[:, link]
                new = here + keep * (here - before[:, link]) + back * aim + fall
                away = new - head
                away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
                before[:, link], now[:, link] = here, head + lengths[link] * away
                turn = _between(aim, away) @ turn
                head = now[:, link]
        out[:, frame] = now
    return out


def _between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The shortest rotations from unit vectors to others, shape (S, 3, 3)."""
    cross = np.cross(start, end)
    cosine = (start * end).sum(axis=1)
    skew = np.zeros((len(start), 3, 3))
    skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = -cross[:, 2], cross[:, 1], -cross[:, 0]
    skew -= skew.transpose(0, 2, 1)
    scale = 1 / np.maximum(1 + cosine, 1e-6)
    return np.eye(3) + skew + scale[:, None, None] * (skew @ skew)
