"""All gestures."""

from __future__ import annotations

from bunraku_lab.synthetic.gestures.balls import BALLS
from bunraku_lab.synthetic.gestures.boxing import BOXING
from bunraku_lab.synthetic.gestures.feelings import FEELINGS
from bunraku_lab.synthetic.gestures.floor import FLOOR
from bunraku_lab.synthetic.gestures.kneeling import KNEELING
from bunraku_lab.synthetic.gestures.obstacles import OBSTACLES
from bunraku_lab.synthetic.gestures.pose import Gesture, Pose
from bunraku_lab.synthetic.gestures.raising import RAISING
from bunraku_lab.synthetic.gestures.seats import SEATS
from bunraku_lab.synthetic.gestures.signs import SIGNS
from bunraku_lab.synthetic.gestures.sports import SPORTS
from bunraku_lab.synthetic.gestures.steps import STEPS
from bunraku_lab.synthetic.gestures.things import THINGS

__all__ = ["GESTURES", "STANDING"]

GESTURES: tuple[Gesture, ...] = (
    *SIGNS, *THINGS, *FEELINGS, *KNEELING, *RAISING, *SEATS, *SPORTS, *BOXING, *BALLS, *STEPS, *OBSTACLES, *FLOOR,
)  # fmt: skip
STANDING = Gesture("standing", (), ((0.0, Pose()), (9.5, Pose())))
"""What gestures that are done once begin and end in."""
