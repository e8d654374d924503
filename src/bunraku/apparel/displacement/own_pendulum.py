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
    """

    def __init__(self, swing: Swing, positions: np.ndarray, turns: np.ndarray, fps: float = 30.0):
        self.swing, self.step = swing, 1 / (fps * SUBSTEPS)
        self.axes = np.asarray(swing.axes, np.float64)
        self.arm = np.einsum("mba,mb->ma", self.axes, swing.arm)
        self.length = np.maximum(np.linalg.norm(self.arm, axis=1), SHORT)[:, None]
        self.arm = self.arm / np.maximum(np.linalg.norm(self.arm, axis=1), 1e-9)[:, None]
        fall = GRAVITY * swing.weight.astype(np.float64)[:, None] / self.length
        self.spring = np.minimum(np.asarray(swing.spring, np.float64), STIFFEST)
        self.gravity = np.array([0, -GRAVITY, 0]) * swing.weight[:, None]
        least = 2 * LEAST_RATIO * np.sqrt(self.spring.mean(axis=1, keepdims=True) + fall)
        self.friction, self.drag = np.maximum(swing.friction[:, None], least), swing.drag[:, None]
        self.bent = np.zeros((len(positions), 3))  # how far it turns about its axes [rad]
        self.frames, self.pivots = self._hung(positions, turns)
        self.points = self.pivots + self._out(self.frames, self.arm * self.length)
        self.speed = np.zeros_like(self.points)

    def _hung(self, positions: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        frames = np.matmul(turns, self.axes)
        return frames, positions - self._out(turns, self.swing.away)

    @staticmethod
    def _out(frames: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        return np.asarray(np.matmul(frames, vectors[..., None])[..., 0])

    def advance(self, positions: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Go on by a frame: how far each node is from where it is carried, in the world [m], shape (M, 3).

        Args:
            positions: Of the carried nodes [m], shape (M, 3).
            turns: Frames of the carrying joints, shape (M, 3, 3).
        """
        frames, pivots = self._hung(positions, turns)
        for number in range(1, SUBSTEPS + 1):
            share = number / SUBSTEPS
            frame = self.frames + share * (frames - self.frames)
            pivot = self.pivots + share * (pivots - self.pivots)
            held = (pivots - self.pivots) / (self.step * SUBSTEPS)
            held = held + self._out(frames - self.frames, self.arm * self.length) / (self.step * SUBSTEPS)
            pull = np.cross(self._out(frame, -self.spring * self.bent), self.points - pivot)
            force = self.gravity + pull - self.friction * (self.speed - held) - self.drag * self.speed
            self.speed += self.step * force
            away = self.points + self.step * self.speed - pivot
            # the least turn from where it is carried to where it would be, within its limits
            seen = np.matmul(frame.transpose(0, 2, 1), away[..., None])[..., 0]
            self.bent = np.clip(_turn(self.arm, seen), self.swing.lower, self.swing.upper)
            there = pivot + self._out(frame, _turned(self.bent, self.arm) * self.length)
            self.speed = (there - self.points) / self.step
            self.points = there
        self.frames, self.pivots = frames, pivots
        lever = np.einsum("mba,mb->ma", self.axes, self.swing.lever)
        moved = self.swing.share[:, None] * (_turned(self.bent, lever) - lever)
        return self._out(frames, moved)


def _turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Rotation vectors of the least turns from unit vectors to the directions of others, shape (M, 3)."""
    axis = np.cross(start, end)
    sine = np.sqrt(np.einsum("ma,ma->m", axis, axis))
    angle = np.arctan2(sine, np.einsum("ma,ma->m", start, end))
    return np.asarray(axis * (angle / np.maximum(sine, 1e-12))[:, None])


def _turned(turn: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors turned by rotation vectors, shapes (M, 3)."""
    square = np.einsum("ma,ma->m", turn, turn)
    angle = np.sqrt(square)
    sine = np.where(angle > 1e-6, np.sin(angle) / np.maximum(angle, 1e-9), 1.0)[:, None]
    cosine = np.where(angle > 1e-4, (1 - np.cos(angle)) / np.maximum(square, 1e-12), 0.5)[:, None]
    once = np.cross(turn, vectors)
    return np.asarray(vectors + sine * once + cosine * np.cross(turn, once))
