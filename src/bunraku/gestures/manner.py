"""What a sentence says of how a gesture is made, or another example is laid."""

from __future__ import annotations

from dataclasses import dataclass

from bunraku.language.limbs.posing import Stance

__all__ = ["AS_USUAL", "Manner"]


@dataclass(frozen=True)
class Manner:
    """What a sentence says of how a gesture is made.

    Args:
        count: How often; None where it says nothing of that.
        pace: Factor of its tempo.
        closed: It is a loop, whose last frame is followed by the first.
        lasts: Who does it goes somewhere, for all of its time, and does not stand before or after.
        stance: How somebody is who makes it; None for who stands, or goes where it says.
    """

    count: int | None = None
    pace: float = 1.0
    closed: bool = False
    lasts: bool = False
    stance: Stance | None = None


AS_USUAL = Manner()
"""How it is made where nothing is said of it."""
