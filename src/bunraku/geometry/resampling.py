"""Values of a clip at another rate: between two frames they move in straight lines, and rotations turn the short way
round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix, quaternion_slerp

__all__ = ["Resampling"]


@dataclass(frozen=True, eq=False)
class Resampling:
    """Between which frames of a clip those of the result lie.

    Args:
        low: The frame before each, shape (M,).
        high: The frame after it, shape (M,).
        share: How far it is from the one to the other, 0 to 1, shape (M,).
    """

    low: np.ndarray
    high: np.ndarray
    share: np.ndarray

    @classmethod
    def of(cls, frames: int, have: float, want: float) -> Resampling:
        """The frames that lie within a clip's duration.

        Args:
            frames: Of the clip, at least one.
            have: Its frames a second [1/s].
            want: Those of the result [1/s].
        """
        last = frames - 1
        at = np.minimum(np.arange(int(last / have * want + 1e-6) + 1) * (have / want), last)
        low = np.minimum(at.astype(np.int64), max(last - 1, 0))
        return cls(low, np.minimum(low + 1, last), at - low)

    def __len__(self) -> int:
        return len(self.low)

    def linear(self, values: np.ndarray) -> np.ndarray:
        """Floats of each frame, shape (N, ...) -> (M, ...), in their own precision."""
        share = self.share.astype(values.dtype).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values[self.low] * (1 - share) + values[self.high] * share)

    def quaternions(self, values: np.ndarray) -> np.ndarray:
        """Unit quaternions xyzw of each frame, shape (N, ..., 4) -> (M, ..., 4)."""
        return quaternion_slerp(values[self.low], values[self.high], self.share.reshape(-1, *[1] * (values.ndim - 2)))

    def rotations(self, values: np.ndarray) -> np.ndarray:
        """Rotations of each frame, shape (N, ..., 3, 3) -> (M, ..., 3, 3), float64."""
        return np.asarray(matrix_from_quaternion(self.quaternions(quaternion_from_matrix(values.astype(float)))))
