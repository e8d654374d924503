"""Motions cut and put together: join points, cross-fades, loops, and what a motion that is done once is joined to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.core.geometry.curves import smooth_step
from bunraku.generation.features import FeatureStatistics, decode, feature_weights
from bunraku.generation.track import Track

__all__ = [
    "AROUND", "END", "FEWEST", "Joins", "held", "join_point", "on_one_leg", "played", "rests", "splice",

]  # fmt: skip

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


FEWEST = 24  # fewest frames of a stretch of standing
TRIED = 20
NEAR = 0.5  # largest difference of two poses that are joined, where no sampler follows
BLEND = 10  # frames over which one blends into the other
LIFTED = 0.15  # height of an ankle over the other [m] with which a foot is up; chosen by eye
_LOST = 3
AROUND = BLEND + _LOST  # frames at an end that joining may change


class Joins:
    """Banks of standing and of walking in network units, walks with the frames of their loops (see `played`), and how a
    motion is joined to them: two poses up to `near` apart, in mean squared difference.
    """

    def __init__(
        self, standing: Sequence[np.ndarray], walking: Sequence[tuple[np.ndarray, tuple[int, int]]] = (),
        near: float = NEAR,
    ):  # fmt: skip
        self._share, self._near = feature_weights(), near
        self.standing, self.walking = list(standing), list(walking)

    def around(self, values: np.ndarray, target: int, goes: bool, random: np.random.Generator) -> np.ndarray:
        """The motion (N, D) with standing before and after it, or walking on after it where it `goes`, as far as poses
        agree, at most `target` frames; the very array where nothing fits.
        """
        room = target - len(values)
        before = int(random.integers(6, 50)) if random.random() < 0.6 else 0
        if 0 < before <= room and self.standing:
            values = self.led(values, before, random)
        if len(values) < target:
            values = self.followed(values, target, goes and bool(self.walking), random)
        return values[:target]

    def led(self, values: np.ndarray, frames: int, random: np.random.Generator) -> np.ndarray:
        """The motion with at most this many frames of standing before it; the very array where no pose agrees."""
        best: tuple[float, int, int, np.ndarray] | None = None
        for index in random.integers(len(self.standing), size=TRIED):
            piece = self._idle(int(index), frames + BLEND)
            i, j, distance = join_point(piece, values, self._share, BLEND, (min(8, len(piece) // 3), _LOST))
            if best is None or distance < best[0]:
                best = (distance, i, j, piece)
        if best is None or best[0] > self._near:
            return values
        _, i, j, piece = best
        return splice(piece[max(0, i - frames) :], values, min(i, frames), j, BLEND)

    def followed(self, values: np.ndarray, target: int, goes: bool, random: np.random.Generator) -> np.ndarray:
        """The motion with standing, or walking on where it `goes`, after it; the very array where no pose agrees."""
        best: tuple[float, int, int, np.ndarray] | None = None
        bank = len(self.standing) + (len(self.walking) if goes else 0)
        if bank == 0:
            return values
        for _ in range(TRIED):
            wanted = target - len(values) + BLEND + _LOST
            if goes and random.random() < 0.6:
                walk, loop = self.walking[int(random.integers(len(self.walking)))]
                piece = played(walk, loop, wanted)
            elif self.standing:
                piece = self._idle(int(random.integers(len(self.standing))), wanted)
            else:
                continue
            i, j, distance = join_point(values, piece, self._share, BLEND, (_LOST, min(16, len(piece) // 2)))
            if best is None or distance < best[0]:
                best = (distance, i, j, piece)
        if best is None or best[0] > self._near:
            return values
        _, i, j, piece = best
        return splice(values, piece, i, j, BLEND)

    def _idle(self, index: int, frames: int) -> np.ndarray:
        piece = self.standing[index]
        if len(piece) >= frames:
            return piece
        i, j, _ = join_point(piece, piece, self._share)
        return played(piece, (i, j), frames) if i - j >= 6 else piece


def on_one_leg(features: np.ndarray) -> bool:
    """Whether a foot is up in a frame of a motion, as at the height of a kick, by its features (N, 271)."""
    points = Track.of(decode(features)).points
    return bool(np.abs(points["left_ankle"][:, 1] - points["right_ankle"][:, 1]).max() > LIFTED)
