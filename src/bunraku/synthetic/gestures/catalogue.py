"""All gestures."""

from __future__ import annotations

from bunraku.synthetic.gestures.balls import BALLS
from bunraku.synthetic.gestures.boxing import BOXING
from bunraku.synthetic.gestures.feelings import FEELINGS
from bunraku.synthetic.gestures.floor import FLOOR
from bunraku.synthetic.gestures.kneeling import KNEELING
from bunraku.synthetic.gestures.obstacles import OBSTACLES
from bunraku.synthetic.gestures.pose import Gesture, Pose
from bunraku.synthetic.gestures.raising import RAISING
from bunraku.synthetic.gestures.seats import SEATS
from bunraku.synthetic.gestures.signs import SIGNS
from bunraku.synthetic.gestures.sports import SPORTS
from bunraku.synthetic.gestures.steps import STEPS
from bunraku.synthetic.gestures.things import THINGS

__all__ = ["GESTURES", "STANDING"]

GESTURES: tuple[Gesture, ...] = (
    *SIGNS, *THINGS, *FEELINGS, *KNEELING, *RAISING, *SEATS, *SPORTS, *BOXING, *BALLS, *STEPS, *OBSTACLES, *FLOOR,
)  # fmt: skip
STANDING = Gesture("standing", (), ((0.0, Pose()), (9.5, Pose())))
"""What gestures that are done once begin and end in."""
