"""What a sentence says of how a gesture is made, or another example is laid."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AS_USUAL", "Manner"]


@dataclass(frozen=True)
class Manner:
    """What a sentence says of how a gesture is made.

    Args:
        count: How often; None where it says nothing of that.
        pace: Factor of its tempo.
        closed: It is a loop, whose last frame is followed by the first.
        lasts: Who does it goes somewhere, for all of its time, and does not stand before or after.
    """

    count: int | None = None
    pace: float = 1.0
    closed: bool = False
    lasts: bool = False


AS_USUAL = Manner()
"""How it is made where nothing is said of it."""
