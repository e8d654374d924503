"""Motions cut and put together: join points, cross-fades, loops, and what a motion that is done once is joined to."""

from __future__ import annotations

import numpy as np

from bunraku.core.geometry.curves import smooth_step
from bunraku.generation.features import FeatureStatistics, decode
from bunraku.generation.track import Track

END = 4  # frames that tell whether a motion rests
_BLEND = 6


def join_point(
    tail: np.ndarray, head: np.ndarray, weights: np.ndarray, blend: int = _BLEND,
    most: tuple[int | None, int | None] = (None, None),
) -> tuple[int, int, float]:  # fmt: skip
    """Frame i of a tail to leave, frame j of a head to enter, such that pose and velocity agree best, and the mean
    squared difference there.

    Args:
        tail: Motion to leave in its last quarter, shape (N, D), network units.
        head: Motion to enter in its first quarter, shape (M, D).
        weights: Share of each feature, shape (D,).
        blend: Frames that both must still have after that.
        most: Most frames, beside the blend, that are lost of the tail's end and of the head's beginning; None for a
            quarter.
    """
    last = max(len(tail) - blend + 1, 1)
    first = min(3 * len(tail) // 4, last - 1) if most[0] is None else max(last - 1 - most[0], 0)
    stop = max(1, min(len(head) // 4 if most[1] is None else most[1] + 1, len(head) - blend))
    scale = np.sqrt(weights / weights.sum())
    a, b = tail[first:last] * scale, head[:stop] * scale
    distance = (a**2).sum(1)[:, None] + (b**2).sum(1) - 2 * a @ b.T
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    return first + int(i), int(j), float(max(distance[i, j], 0))


def splice(tail: np.ndarray, head: np.ndarray, i: int, j: int, blend: int = _BLEND) -> np.ndarray:
    """`tail` up to frame i, then `head` from frame j, cross-faded over the next `blend` frames of both."""
    blend = min(blend, len(tail) - i, len(head) - j)
    share = smooth_step(np.linspace(0, 1, blend + 2, dtype=np.float32)[1:-1, None])
    mixed = tail[i : i + blend] * (1 - share) + head[j : j + blend] * share
    return np.concatenate([tail[:i], mixed, head[j + blend :]])


def played(values: np.ndarray, loop: tuple[int, int], target: int) -> np.ndarray:
    """A motion repeated from frame j after frame i until it has at least `target` frames."""
    i, j = loop
    longer = values
    while len(longer) < target:
        longer = splice(longer, values, len(longer) - len(values) + i, j)
    return longer


def held(values: np.ndarray, frames: int, still: np.ndarray, ease: float = 0.0) -> np.ndarray:
    """A motion (N, D) with its last pose held for this many more frames, its root coming to the velocities of a resting
    one (3,). `ease` is the share of the pose's change that is left from frame to frame; 0 stops it at once.
    """
    hold = np.repeat(values[-1:], frames, axis=0)
    count = np.arange(1, len(hold) + 1, dtype=np.float32)[:, None]
    hold[:, :3] = still + (hold[:, :3] - still) * 0.5**count
    if ease > 0 and len(values) > 1:
        hold[:, 3:] += (values[-1:, 3:] - values[-2:-1, 3:]) * (ease * (1 - ease**count) / (1 - ease))
    return np.concatenate([values, hold])


def rests(values: np.ndarray, statistics: FeatureStatistics) -> bool:
    """Whether a body that moves like this could stay so, by frames at an end of a motion in network units, (N, D)."""
    speed = np.abs(statistics.restore(values)[:, :3]).max()
    return bool(speed < 0.5 and (np.diff(values, axis=0)[:, 4:] ** 2).mean() < 0.02)


LIFTED = 0.15  # height of an ankle over the other [m] with which a foot is up; chosen by eye


def on_one_leg(features: np.ndarray) -> bool:
    """Whether a foot is up in a frame of a motion, as at the height of a kick, by its features (N, 271)."""
    points = Track.of(decode(features)).points
    return bool(np.abs(points["left_ankle"][:, 1] - points["right_ankle"][:, 1]).max() > LIFTED)
