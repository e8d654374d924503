"""How motions of training rows are joined to standing and walking."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.generation.composition import join_point, played, splice
from bunraku.generation.features import feature_weights

FEWEST = 24  # fewest frames of a stretch of standing
TRIED = 20
NEAR = 0.5  # largest difference of two poses that are joined, where no sampler follows
BLEND = 10  # frames over which one blends into the other
_LOST = 3


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
