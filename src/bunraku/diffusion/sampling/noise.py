"""Noise by seed: the same numbers on every machine, and those that torch's generator draws from this seed on a CPU."""

from __future__ import annotations

import numpy as np

__all__ = ["Noise", "row_noise", "starting_noise"]

_BITS = 24
_LANES = 16
"""Numbers that are made together: the first half are lengths, the second angles (Box & Muller 1958)."""


class Noise:
    """Normal numbers from a Mersenne twister (Matsumoto & Nishimura 1998).

    Args:
        seed: Any number; its lowest 32 bits count.
    """

    def __init__(self, seed: int):
        self._twister = np.random.RandomState(seed & 0xFFFFFFFF)

    def draw(self, *shape: int) -> np.ndarray:
        """The next numbers, float32: at least 16 at a time.

        Args:
            shape: Of what is drawn.
        """
        count = int(np.prod(shape))
        uniform = self._uniform(count)
        whole = count // _LANES * _LANES
        out = np.empty(count, np.float32)
        out[:whole] = _normal(uniform[:whole])
        if whole < count:  # the last 16 are drawn anew
            out[count - _LANES :] = _normal(self._uniform(_LANES))
        return out.reshape(shape)

    def _uniform(self, count: int) -> np.ndarray:
        """Numbers from 0 to below 1, float32."""
        drawn = self._twister.randint(0, 1 << _BITS, count, np.uint32)
        return drawn.astype(np.float32) * np.float32(2.0**-_BITS)


def _normal(uniform: np.ndarray) -> np.ndarray:
    first, second = np.split(uniform.reshape(-1, _LANES), 2, axis=1)
    length = np.sqrt(np.float32(-2) * np.log(np.float32(1) - first))
    angle = np.float32(2 * np.pi) * second
    return np.concatenate([length * np.cos(angle), length * np.sin(angle)], axis=1).reshape(-1)


def generator(seed: int, row: int) -> Noise:
    """What draws the noise of one row of a batch, so that a row is the same in any batch."""
    return Noise((seed + row * 0x9E3779B97F4A7C15) % 2**63)


def row_noise(frames: int, features: int, seed: int, row: int = 0) -> np.ndarray:
    """x_T of one row of a batch, from a generator of (seed, row) of its own, shape (frames, features)."""
    return generator(seed, row).draw(frames, features)


def starting_noise(rows: int, frames: int, features: int, seed: int) -> np.ndarray:
    """x_T, shape (rows, frames, features): one `row_noise` for each row."""
    return np.stack([row_noise(frames, features, seed, row) for row in range(rows)])
