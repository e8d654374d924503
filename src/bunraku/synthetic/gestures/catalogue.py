"""All gestures."""

from __future__ import annotations

from bunraku.synthetic.gestures.feelings import FEELINGS
from bunraku.synthetic.gestures.kneeling import KNEELING
from bunraku.synthetic.gestures.pose import Gesture, Pose
from bunraku.synthetic.gestures.signs import SIGNS
from bunraku.synthetic.gestures.sports import SPORTS
from bunraku.synthetic.gestures.things import THINGS

__all__ = ["GESTURES", "STANDING"]

GESTURES: tuple[Gesture, ...] = (*SIGNS, *THINGS, *FEELINGS, *KNEELING, *SPORTS)
STANDING = Gesture("standing", (), ((0.0, Pose()), (9.5, Pose())))
"""What gestures that are done once begin and end in."""
