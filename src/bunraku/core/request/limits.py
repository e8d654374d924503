"""How much may be requested, stated here alone: Python, the command line, the studio and its files hold to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bunraku.errors import OptionError

__all__ = [
    "CANDIDATES",
    "FPS",
    "GRAVITY",
    "GUIDANCE",
    "SECONDS",
    "SEED",
    "STEPS",
    "STIFFNESS",
    "TAKES",
    "WHOLE",
    "Limit",
]


@dataclass(frozen=True)
class Limit:
    """The range of a number.

    Args:
        name: What the number is, as in a sentence of Python.
        low: The least.
        high: The most.
    """

    name: str
    low: float
    high: float

    def check(self, value: float | None, name: str = "") -> None:
        """Whether a number is in the range; None, which stands for a default, always is.

        Args:
            value: The number.
            name: What it is called in the message.

        Raises:
            OptionError: It is outside, or not finite.
        """
        if value is not None and not (math.isfinite(value) and self.low <= value <= self.high):
            raise OptionError(f"{name or self.name} must be from {self.low:g} to {self.high:g}, not {value:g}")


SECONDS = Limit("seconds", 0.5, 120.0)
"""Length of a clip that is made in one pass [s]; longer ones are made stretch by stretch."""
WHOLE = Limit("seconds", 0.5, 36_000.0)
"""Length of a clip, and of each of its parts [s]."""
FPS = Limit("frames a second", 1, 240)
"""Rate of a clip, of a file and of a video [1/s]."""
SEED = Limit("seed", 0, 2**63 - 1)
STEPS = Limit("steps", 1, 1000)
"""Steps of the sampler."""
GUIDANCE = Limit("guidance", 0, 20)
"""Scale of classifier-free guidance."""
CANDIDATES = Limit("candidates", 1, 16)
"""Motions that are drawn for one that is given back."""
TAKES = Limit("takes", 1, 100)
"""Takes of one sentence in one run."""
STIFFNESS = Limit("stiffness", 0.001, 1000)
"""Factor on how stiff apparel is."""
GRAVITY = Limit("gravity", 0, 10)
"""Factor on the gravity of apparel that is simulated."""
