"""Who collides with whom: MMD's groups and masks in MuJoCo's bits.

In MMD two bodies collide where each one's mask names the other's group; in MuJoCo where one's contype meets the other's
conaffinity. Bodies of one group and mask are a class. Each class gets a bit of its own as contype, and the bits of the
classes that it collides with as
conaffinity: since the table is symmetric, MuJoCo's "or" is MMD's "and".
"""

from __future__ import annotations

from collections.abc import Sequence

from bunraku.core.mmd_model import MmdBody

__all__ = ["MOST_CLASSES", "collision_bits"]

MOST_CLASSES = 31

Kind = tuple[int, int, bool]


def collision_bits(bodies: Sequence[MmdBody], moving: Sequence[bool]) -> tuple[list[tuple[int, int]], int]:
    """contype and conaffinity of each body, 0 where it collides with none.

    Args:
        bodies: The bodies.
        moving: Whether physics move each; two that only follow bones do not collide.

    Returns:
        The bits, and how many bodies collide with nothing because there are more classes than bits.
    """
    kinds: list[Kind] = [(body.group, body.mask, bool(moves)) for body, moves in zip(bodies, moving, strict=True)]
    counts: dict[Kind, int] = {}
    for kind in kinds:
        counts[kind] = counts.get(kind, 0) + 1
    useful = [kind for kind in counts if any(_meet(kind, other) for other in counts)]
    useful.sort(key=lambda kind: (-counts[kind], kind))
    chosen = {kind: bit for bit, kind in enumerate(useful[:MOST_CLASSES])}
    bits = {
        kind: (1 << bit, sum(1 << there for other, there in chosen.items() if _meet(kind, other)))
        for kind, bit in chosen.items()
    }
    return [bits.get(kind, (0, 0)) for kind in kinds], sum(counts[kind] for kind in useful[MOST_CLASSES:])


def _meet(a: Kind, b: Kind) -> bool:
    return (a[2] or b[2]) and bool(a[1] >> b[0] & 1) and bool(b[1] >> a[0] & 1)
