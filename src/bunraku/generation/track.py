"""The measures of a motion: path, heading, heights, feet, hands."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.geometry.curves import gaussian, running_least
from bunraku.core.geometry.rotations import heading, matrix_y
from bunraku.core.motion import HandleMotion

SIDES = ("left", "right")
_PARTS = ("ankle", "foot", "wrist", "elbow", "shoulder", "hip")
_NAMES = [f"{side}_{part}" for side in SIDES for part in _PARTS] + ["head_top", "head"]


@functools.cache
def _rest() -> tuple[np.ndarray, np.ndarray]:
    from bunraku.core.body.reference import reference_body

    positions = reference_body().handles.positions.astype(float)
    rows = np.array([HANDLE_NAMES.index(name) for name in _NAMES])
    return rows, np.concatenate([positions[:1], positions[rows]])


def smooth(values: np.ndarray, seconds: float, fps: float) -> np.ndarray:
    """Gaussian mean over time with this deviation."""
    return gaussian(values, seconds * fps)


@dataclass(frozen=True)
class Track:
    """Measures of a motion of the reference body; +left is the body's own left."""

    fps: float  # frames a second [1/s]
    position: np.ndarray  # path of the root on the ground (x, z) [m], shape (N, 2)
    height: np.ndarray  # root over its rest height, over the ground near it in time [m], shape (N,)
    up: np.ndarray  # cosine of the root's tilt, 1 upright, shape (N,)
    angle: np.ndarray  # heading [rad], positive to the left, smooth, shape (N,)
    velocity: np.ndarray  # forward and to the left, smooth [m/s], shape (N, 2)
    course: np.ndarray  # direction of the path itself [rad], unwrapped, shape (N,)
    points: dict[str, np.ndarray]  # world position of each named handle [m], shape (N, 3) each
    feet: np.ndarray  # lowest handle of each foot over the ground [m], shape (N, 2), left first

    @classmethod
    def of(cls, motion: HandleMotion) -> Track:
        """Measure a motion."""
        fps = motion.fps
        rows, rest = _rest()
        turn = motion.root_rotation.astype(float)
        local = rest[1:] - rest[0] + motion.translations[:, rows]
        world = np.einsum("nij,nkj->nki", turn, local) + rest[0] + motion.root_translation[:, None]
        points = {name: world[:, index] for index, name in enumerate(_NAMES)}
        feet = np.stack(
            [np.minimum(points[f"{side}_ankle"][:, 1] - 0.046, points[f"{side}_foot"][:, 1] - 0.016) for side in SIDES],
            1,
        )
        ground = running_least(feet.min(1), 2 * int(1.2 * fps) + 1)
        position = motion.root_translation[:, [0, 2]].astype(float)
        angle = smooth(heading(motion.root_rotation, fps), 0.2, fps)
        step = np.gradient(position, axis=0) * fps if len(position) > 1 else np.zeros_like(position)
        drift = smooth(step, 0.25, fps)
        back = matrix_y(-angle)
        local_drift = np.einsum("nij,nj->ni", back, np.stack([drift[:, 0], 0 * drift[:, 0], drift[:, 1]], 1))
        course = np.unwrap(np.arctan2(drift[:, 0], drift[:, 1]))
        height = motion.root_translation[:, 1].astype(float) - ground
        return cls(
            fps, position, height, turn[:, 1, 1], angle, local_drift[:, [2, 0]], course, points, feet - ground[:, None]
        )

    def __len__(self) -> int:
        return len(self.position)

    def frames(self, seconds: float) -> int:
        """Number of frames of a time, at least one."""
        return max(1, round(seconds * self.fps))

    @property
    def speed(self) -> np.ndarray:
        """Of the root over the ground, smooth [m/s], shape (N,)."""
        return np.hypot(self.velocity[:, 0], self.velocity[:, 1])

    def relative(self, name: str) -> np.ndarray:
        """A handle seen from the root in its heading: to the left, height in the world, forward [m], shape (N, 3)."""
        offset = self.points[name].copy()
        offset[:, [0, 2]] -= self.position
        return np.einsum("nij,nj->ni", matrix_y(-self.angle), offset)
