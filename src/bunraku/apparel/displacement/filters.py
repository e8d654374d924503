"""What apparel feels of the motion that carries it: a bank of damped oscillators that hang on it, rotations that lag
behind it, and pendulums that hang where its part is held. Causal and damped, so whatever is computed from them cannot
drift.
"""

from __future__ import annotations

import numpy as np

__all__ = ["FREQUENCIES", "LAGS", "PENDULUMS", "MotionFilters", "Pendulums"]

FREQUENCIES = (0.4, 0.7, 1.2, 2.0, 3.4)
"""Of the oscillators [1/s]: apparel swings at 0.6 on the average, stiff pieces at 4."""
DAMPING = 0.3
LAGS = (0.08, 0.25, 0.8)
"""Times in which a lagging rotation follows [s]."""
PENDULUMS = ((0.0, 3.0), (20.0, 3.0), (80.0, 5.0), (200.0, 12.0))
"""Of each, the stiffness of the spring to where it is carried [1/s^2] and the damping [1/s], for a unit of mass."""
SUBSTEPS = 4
GRAVITY = 9.81


class MotionFilters:
    """The state of the filters, frame by frame.

    Args:
        positions: Of the M carried nodes in the first frame [m], shape (M, 3).
        turns: Of the J joints, shape (J, 3, 3).
        fps: Frames a second [1/s].
    """

    def __init__(self, positions: np.ndarray, turns: np.ndarray, fps: float = 30.0):
        self.step = 1 / fps
        self.omega = 2 * np.pi * np.array(FREQUENCIES, np.float32)[:, None, None]
        self.positions = np.stack([positions, positions]).astype(np.float32)  # the last two
        self.sway = np.zeros((len(FREQUENCIES), len(positions), 3), np.float32)
        self.speed = np.zeros_like(self.sway)
        self.late = np.repeat(np.asarray(turns, np.float32)[None], len(LAGS), axis=0)
        self.follow = (1 - np.exp(-self.step / np.array(LAGS, np.float32)))[:, None, None, None]

    def advance(self, positions: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Go on by a frame.

        The sway y of each oscillator is where a mass on a spring is, seen from what carries it:
        `y'' + 2 zeta omega y' + omega^2 y = -p''`, by semi-implicit Euler steps.

        Args:
            positions: [m], shape (M, 3).
            turns: Shape (J, 3, 3).

        Returns:
            Velocity [m/s] and acceleration [m/s^2] of the nodes, shape (M, 3) each; `sway` and `late` hold the rest.
        """
        velocity = (positions - self.positions[1]) / self.step
        acceleration = (positions - 2 * self.positions[1] + self.positions[0]) / self.step**2
        force = -acceleration - 2 * DAMPING * self.omega * self.speed - self.omega**2 * self.sway
        self.speed += self.step * force
        self.sway += self.step * self.speed
        self.late += self.follow * (turns - self.late)
        self.positions = np.stack([self.positions[1], np.asarray(positions, np.float32)])
        return velocity, acceleration


class Pendulums:
    """Masses on rods of fixed length, which hang where the parts of the nodes are held, under gravity, damping against
    what carries them and springs to where that takes them.

    Args:
        positions: Of the M carried nodes in the first frame, over the character's size, shape (M, 3).
        held: From where its part is held to each node, over the size, shape (M, 3).
        turns: Frames of the carrying joints, shape (M, 3, 3).
        size: The clothed's size [m].
        fps: Frames a second [1/s].
    """

    def __init__(self, positions: np.ndarray, held: np.ndarray, turns: np.ndarray, size: float, fps: float = 30.0):
        count = len(PENDULUMS)
        self.held, self.step = np.asarray(held, np.float32), np.float32(1 / (fps * SUBSTEPS))
        self.length = np.linalg.norm(self.held, axis=1)[:, None].astype(np.float32)
        self.spring, self.damping = np.array(PENDULUMS, np.float32).T[:, :, None, None]
        self.gravity = np.array([0, -GRAVITY / size, 0], np.float32)
        self.positions = np.asarray(positions, np.float32)
        self.rods = np.matmul(turns, self.held[..., None])[..., 0].astype(np.float32)
        self.points = np.repeat(self.positions[None], count, axis=0)
        self.speed = np.zeros_like(self.points)

    def advance(self, positions: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Go on by a frame: where the masses are, from the carried nodes, in the world over the size, shape (P, M, 3).

        Semi-implicit Euler steps, after each of which the rods have their lengths again.

        Args:
            positions: Shape (M, 3).
            turns: Shape (M, 3, 3).
        """
        positions = np.asarray(positions, np.float32)
        rods = np.matmul(turns, self.held[..., None])[..., 0].astype(np.float32)
        carried = (positions - self.positions) / (self.step * SUBSTEPS)
        for number in range(1, SUBSTEPS + 1):
            share = np.float32(number / SUBSTEPS)
            here = self.positions + share * (positions - self.positions)
            hung = here - (self.rods + share * (rods - self.rods))
            force = self.gravity - self.spring * (self.points - here) - self.damping * (self.speed - carried)
            self.speed += self.step * force
            away = self.points + self.step * self.speed - hung
            away *= self.length / np.maximum(np.sqrt(np.einsum("pma,pma->pm", away, away))[..., None], 1e-6)
            self.speed = (hung + away - self.points) / self.step
            self.points = hung + away
        self.positions, self.rods = positions, rods
        return self.points - positions
