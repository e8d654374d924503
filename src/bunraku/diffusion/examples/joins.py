"""What a motion that is done once is joined to: people who stand and wait, and people who walk on.

A motion that is done once gets longer only by what goes before and after it: somebody stands, turns left, and stands.
Playing it again would be another motion than its sentence tells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.diffusion.features import FeatureStatistics, decode, feature_weights
from bunraku.diffusion.splicing import join_point, played, splice
from bunraku.language.description.track import Track

__all__ = ["AROUND", "FEWEST", "Joins", "on_one_leg", "standing_stretches"]

FEWEST = 24
"""Frames of a stretch of standing that is kept."""
TRIED = 20
NEAR = 0.5
"""Difference of two poses that are joined, at the most, where nothing is done about it afterwards."""
BLEND = 10
"""Frames over which one goes over into the other."""
LIFTED = 0.15
"""Height of an ankle over the other [m] with which a foot is up."""
_LOST = 3
AROUND = BLEND + _LOST
"""Frames at an end that joining may change."""


class Joins:
    """Banks of standing and of walking, and how a motion is joined to them.

    Args:
        standing: Stretches in which somebody stands and hardly moves, shape (N, D) each, network units.
        walking: Walks and runs, with the frames between which they can be played again (see `splicing.played`).
        near: Mean squared difference in network units up to which two poses are joined.
    """

    def __init__(
        self,
        standing: Sequence[np.ndarray],
        walking: Sequence[tuple[np.ndarray, tuple[int, int]]] = (),
        near: float = NEAR,
    ):
        self._share, self._near = feature_weights(), near
        self.standing, self.walking = list(standing), list(walking)

    def around(self, values: np.ndarray, target: int, goes: bool, random: np.random.Generator) -> np.ndarray:
        """The motion with standing before and after it, or walking on after it, as far as poses agree.

        Args:
            values: Its frames, shape (N, D).
            target: Frames wanted.
            goes: Somebody walks or runs in it, and may walk on.
            random: Draws the pieces.

        Returns:
            The very array where nothing fits, else a longer one of at most `target` frames.
        """
        room = target - len(values)
        before = int(random.integers(6, 50)) if random.random() < 0.6 else 0
        if 0 < before <= room and self.standing:
            values = self.led(values, before, random)
        if len(values) < target:
            values = self.followed(values, target, goes and bool(self.walking), random)
        return values[:target]

    def led(self, values: np.ndarray, frames: int, random: np.random.Generator) -> np.ndarray:
        """The motion with at most so many frames of standing before it; the very array where no pose agrees."""
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
        """The motion with standing, or walking on where it `goes`, after it, of about `target` frames; the very array
        where no pose agrees.
        """
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
    """Whether a foot is up in a frame of a motion, as at the height of a kick.

    Args:
        features: Of each frame (see `diffusion.features`), shape (N, 271).
    """
    points = Track.of(decode(features)).points
    return bool(np.abs(points["left_ankle"][:, 1] - points["right_ankle"][:, 1]).max() > LIFTED)


def standing_stretches(values: np.ndarray, statistics: FeatureStatistics) -> list[np.ndarray]:
    """Stretches in which somebody stands upright on both legs and hardly moves."""
    if len(values) < FEWEST:
        return []
    features = statistics.restore(values)
    change = (np.diff(values[:, 4:], axis=0, prepend=values[:1, 4:]) ** 2).mean(1)
    calm = (
        (change < 0.004) & (np.abs(features[:, :3]).max(1) < 0.25) & (features[:, 3] > -0.1) & (features[:, 8] > 0.95)
    )
    edges = np.flatnonzero(np.diff(np.concatenate([[0], calm.astype(np.int8), [0]])))
    return [
        values[start:stop]
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
        if stop - start >= FEWEST and not on_one_leg(features[start:stop])
    ]
