"""A pendulum for each node that swings as its chains would: its own length, limits, springs and damping."""

from __future__ import annotations

import numpy as np

from bunraku.apparel.clothed import GRAVITY
from bunraku.apparel.swing import Swing

__all__ = ["OwnPendulum"]

SUBSTEPS = 4
LEAST_RATIO = 0.15
"""Of the critical damping there is at least so much, as in the simulation."""
STIFFEST = 900.0  # spring [1/s^2]
SHORT = 5e-3  # arms count as no shorter [m]


class OwnPendulum:
    """Masses on arms of fixed length that turn about the pivots of M nodes.

    Args:
        swing: Of the nodes.
        positions: Of the carried nodes in the first frame [m], shape (M, 3).
        turns: Frames of the carrying joints, shape (M, 3, 3).
        fps: Frames a second [1/s].
        ease: Factor on the friction against what carries them, shape (M,) or one for all.
        calm: Further such friction [1/s], likewise.

    Attributes:
        bent: How far each turns about its axes [rad], shape (3, M).
        beyond: How much farther it would turn without limits [rad], shape (M,).
    """

    def __init__(
        self, swing: Swing, positions: np.ndarray, turns: np.ndarray, fps: float = 30.0,
        ease: np.ndarray | float = 1.0, calm: np.ndarray | float = 0.0,
    ):  # fmt: skip
        self.step = 1 / (fps * SUBSTEPS)
        # a column for each node, so that a step is a few long operations
        self.axes = np.asarray(swing.axes, np.float64)
        arm = np.einsum("mba,mb->am", self.axes, swing.arm)
        length = np.linalg.norm(arm, axis=0)
        self.arm, self.length = arm / np.maximum(length, 1e-9), np.maximum(length, SHORT)
        self.lever = np.einsum("mba,mb->am", self.axes, swing.lever)
        self.away, self.share = np.asarray(swing.away, np.float64), np.asarray(swing.share, np.float64)
        weight = np.asarray(swing.weight, np.float64)
        fall = GRAVITY * weight / self.length
        self.spring = np.minimum(np.asarray(swing.spring, np.float64), STIFFEST).T
        self.lower, self.upper = np.asarray(swing.lower, np.float64).T, np.asarray(swing.upper, np.float64).T
        self.gravity = np.array([0, -GRAVITY, 0])[:, None] * weight
        least = 2 * LEAST_RATIO * np.sqrt(self.spring.mean(axis=0) + fall)
        self.friction = np.maximum(ease * swing.friction, least) + calm
        self.drag = np.asarray(swing.drag, np.float64)
        self.bent, self.beyond = np.zeros((3, len(positions))), np.zeros(len(positions))
        self.frames, self.pivots = self._hung(positions, turns)
        self.points = self.pivots + _out(self.frames, self.arm * self.length)
        self.speed = np.zeros_like(self.points)

    def _hung(self, positions: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        frames = np.matmul(turns, self.axes).transpose(1, 2, 0)
        away = np.matmul(turns, self.away[..., None])[..., 0]
        return np.ascontiguousarray(frames), np.ascontiguousarray((positions - away).T)

    def advance(self, positions: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Go on by a frame: how far each node is from where it is carried, in the world [m], shape (M, 3).

        Args:
            positions: Of the carried nodes [m], shape (M, 3).
            turns: Frames of the carrying joints, shape (M, 3, 3).
        """
        frames, pivots = self._hung(positions, turns)
        frame_change, pivot_change = (frames - self.frames) / SUBSTEPS, (pivots - self.pivots) / SUBSTEPS
        held = (pivot_change + _out(frame_change, self.arm * self.length)) / self.step
        frame, pivot = self.frames, self.pivots
        for _ in range(SUBSTEPS):
            frame, pivot = frame + frame_change, pivot + pivot_change
            pull = _cross(_out(frame, -self.spring * self.bent), self.points - pivot)
            force = self.gravity + pull - self.friction * (self.speed - held) - self.drag * self.speed
            away = self.points + self.step * (self.speed + self.step * force) - pivot
            # the least turn from where it is carried to where it would be, within its limits
            turn = _turn(self.arm, (frame * away[:, None]).sum(axis=0))
            self.bent = np.minimum(np.maximum(turn, self.lower), self.upper)
            there = pivot + _out(frame, _turned(self.bent, self.arm) * self.length)
            self.speed = (there - self.points) / self.step
            self.points = there
        self.beyond = _length(turn) - _length(self.bent)
        self.frames, self.pivots = frames, pivots
        return np.ascontiguousarray(_out(frames, self.share * (_turned(self.bent, self.lever) - self.lever)).T)


def _out(frames: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors of frames in the world, shapes (3, 3, M) and (3, M)."""
    return np.asarray((frames * vectors).sum(axis=1))


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("am,am->m", vectors, vectors))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Rotation vectors of the least turns from unit vectors to the directions of others, shape (3, M)."""
    axis = _cross(start, end)
    sine = _length(axis)
    angle = np.arctan2(sine, np.einsum("am,am->m", start, end))
    return np.asarray(axis * (angle / np.maximum(sine, 1e-12)))


def _turned(turn: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors turned by rotation vectors, shapes (3, M)."""
    square = np.einsum("am,am->m", turn, turn)
    angle = np.sqrt(square)
    sine = np.where(angle > 1e-6, np.sin(angle) / np.maximum(angle, 1e-9), 1.0)
    cosine = np.where(angle > 1e-4, (1 - np.cos(angle)) / np.maximum(square, 1e-12), 0.5)
    once = _cross(turn, vectors)
    return np.asarray(vectors + sine * once + cosine * _cross(turn, once))
