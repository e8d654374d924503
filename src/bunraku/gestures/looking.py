"""Who stands and looks at something: head, chest and trunk turned to where it is."""

from __future__ import annotations

import functools

from bunraku.gestures.places import read_places
from bunraku.gestures.pose import Gesture, Hand, Pose, again
from bunraku.language.lexicon.things import Sight

__all__ = ["looked"]

CHEST = 0.25
"""Share of what the gaze goes up or down, and of what it goes aside, that is the chest's."""
PERIOD, TIMES = 6.0, 3
"""Seconds of a gaze to both sides and back, and how often it goes so."""
LEAST = 3.0
"""How far it goes to both sides of who looks at one thing [degrees]."""
LEANS = 12.0
"""Lean of the trunk from which on arms keep the balance, and knees bend by so much again [degrees]."""
BENT = 2.0
"""How often so from where on hands are on the knees."""
OUT = Hand((0.36, 0.98, -0.04), (0.3, -0.9, 0.2), (-0.9, 0.0, 0.2), (0.35, 0.0, -1.0))
"""A hand of who leans over a depth."""


@functools.lru_cache(maxsize=64)
def looked(sight: Sight) -> Gesture:
    """A look at something, as a gesture."""
    ways = (0.0, 1.0, 1.0, 0.2, -0.9, -0.9)
    poses = [_turned(sight, way * max(sight.sweep, LEAST)) for way in ways]
    keys, repeat = again(poses, PERIOD, TIMES, start=1.1, end=1.1)
    return Gesture("look", (), keys, (repeat.start, repeat.stop - repeat.period), repeat=repeat)


def _turned(sight: Sight, aside: float) -> Pose:
    share = CHEST if not sight.lean else 0.0
    lean = (share * sight.pitch + sight.lean, CHEST * aside, 0.0)
    head = ((1 - share) * sight.pitch - 0.3 * sight.lean, (1 - CHEST) * aside, 0.0)
    if not sight.lean > LEANS:
        return Pose(lean=lean, head=head)
    low = max(sight.lean - LEANS, 0.0) / LEANS
    hand = read_places()["low"].other if low > BENT else OUT
    return Pose(right=hand, left=hand, lean=lean, head=head, hips=(0.0, -0.08 * low, -0.08 - 0.02 * low))
