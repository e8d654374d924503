"""What the words about a motion are measured on (path, heading, heights, feet and hands of the reference body), and a
phrase of them.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.geometry.filters import gaussian, running_least
from bunraku.geometry.rotations import heading, matrix_y

__all__ = ["SIDES", "Phrase", "Track", "runs", "smooth"]

SIDES = ("left", "right")
_PARTS = ("ankle", "foot", "wrist", "elbow", "shoulder", "hip")
_NAMES = [f"{side}_{part}" for side in SIDES for part in _PARTS] + ["head_top", "head"]


@functools.cache
def _rest() -> tuple[np.ndarray, np.ndarray]:
    from bunraku.body.reference import reference_body

    positions = reference_body().handles.positions.astype(float)
    rows = np.array([HANDLE_NAMES.index(name) for name in _NAMES])
    return rows, np.concatenate([positions[:1], positions[rows]])


def smooth(values: np.ndarray, seconds: float, fps: float) -> np.ndarray:
    """Gaussian mean over time with this deviation."""
    return gaussian(values, seconds * fps)


def runs(mask: np.ndarray, least: float = 1, bridge: float = 0) -> list[tuple[int, int]]:
    """Stretches (start, stop) where the mask holds for at least `least` frames, gaps of up to `bridge` frames counted
    in.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    found: list[tuple[int, int]] = []
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if found and start - found[-1][1] <= bridge:
            found[-1] = (found[-1][0], stop)
        else:
            found.append((start, stop))
    return [(start, stop) for start, stop in found if stop - start >= least]


@dataclass(frozen=True)
class Phrase:
    """Something that a motion does in some of its frames.

    Args:
        kind: "go", "turn", "jump", "kick", "arm", "bend" or "still".
        texts: Rewordings of the same, with verbs in braces.
        start: First frame.
        stop: Frame after the last.
        part: Words that are still true where only a part of the frames is there; none where a part is nothing.
        manner: For "go": direction and speed, to follow another verb, such as "backwards", "slowly".
    """

    kind: str
    texts: tuple[str, ...]
    start: int
    stop: int
    part: tuple[str, ...] = ()
    manner: tuple[str, ...] = ()


@dataclass(frozen=True)
class Track:
    """Measures of a motion of the reference body; +left is the body's own left.

    Args:
        fps: Frames a second [1/s].
        position: Path of the root on the ground (x, z) [m], shape (N, 2).
        height: Root over its rest height, over the ground near it in time [m], shape (N,).
        up: Cosine of the root's tilt, 1 upright, shape (N,).
        angle: Heading [rad], positive to the left, smooth, shape (N,).
        velocity: Forward and to the left, smooth [m/s], shape (N, 2).
        course: Direction of the path itself [rad], unwrapped, shape (N,).
        points: World position of each named handle [m], shape (N, 3) each.
        feet: Lowest handle of each foot over the ground [m], shape (N, 2), left first.
    """

    fps: float
    position: np.ndarray
    height: np.ndarray
    up: np.ndarray
    angle: np.ndarray
    velocity: np.ndarray
    course: np.ndarray
    points: dict[str, np.ndarray]
    feet: np.ndarray

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
        own = np.einsum("nij,nj->ni", back, np.stack([drift[:, 0], 0 * drift[:, 0], drift[:, 1]], 1))
        course = np.unwrap(np.arctan2(drift[:, 0], drift[:, 1]))
        height = motion.root_translation[:, 1].astype(float) - ground
        return cls(fps, position, height, turn[:, 1, 1], angle, own[:, [2, 0]], course, points, feet - ground[:, None])

    def __len__(self) -> int:
        return len(self.position)

    def frames(self, seconds: float) -> int:
        """How many frames a time takes, at least one."""
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
