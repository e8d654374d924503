"""What apparel feels of the motion that carries it: a bank of damped oscillators that hang on it, and turns that lag
behind it. Linear, causal and stable, so whatever is computed from them cannot drift.
"""

from __future__ import annotations

import numpy as np

__all__ = ["FREQUENCIES", "LAGS", "MotionFilters"]

FREQUENCIES = (0.4, 0.7, 1.2, 2.0, 3.4)
"""Of the oscillators [1/s]: apparel swings at 0.6 on the average, stiff pieces at 4."""
DAMPING = 0.3
LAGS = (0.08, 0.25, 0.8)
"""Times in which a lagging turn follows [s]."""


class MotionFilters:
    """The state of the filters, frame by frame.

    Args:
        places: Of the M carried nodes in the first frame [m], shape (M, 3).
        turns: Of the J joints, shape (J, 3, 3).
        fps: Frames a second [1/s].
    """

    def __init__(self, places: np.ndarray, turns: np.ndarray, fps: float = 30.0):
        self.step = 1 / fps
        self.omega = 2 * np.pi * np.array(FREQUENCIES, np.float32)[:, None, None]
        self.places = np.stack([places, places]).astype(np.float32)  # the last two
        self.sway = np.zeros((len(FREQUENCIES), len(places), 3), np.float32)
        self.speed = np.zeros_like(self.sway)
        self.late = np.repeat(np.asarray(turns, np.float32)[None], len(LAGS), axis=0)
        self.follow = (1 - np.exp(-self.step / np.array(LAGS, np.float32)))[:, None, None, None]

    def advance(self, places: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Go on by a frame.

        The sway y of each oscillator is where a mass on a spring is, seen from what carries it:
        `y'' + 2 zeta omega y' + omega^2 y = -p''`, by semi-implicit Euler steps.

        Args:
            places: [m], shape (M, 3).
            turns: Shape (J, 3, 3).

        Returns:
            Velocity [m/s] and acceleration [m/s^2] of the nodes, shape (M, 3) each; `sway` and `late` hold the rest.
        """
        velocity = (places - self.places[1]) / self.step
        acceleration = (places - 2 * self.places[1] + self.places[0]) / self.step**2
        force = -acceleration - 2 * DAMPING * self.omega * self.speed - self.omega**2 * self.sway
        self.speed += self.step * force
        self.sway += self.step * self.speed
        self.late += self.follow * (turns - self.late)
        self.places = np.stack([self.places[1], np.asarray(places, np.float32)])
        return velocity, acceleration
