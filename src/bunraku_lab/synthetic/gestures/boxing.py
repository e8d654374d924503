"""To box: a guard with the left foot ahead, from which fists go straight or round."""

from __future__ import annotations

from bunraku_lab.synthetic.gestures.flow import foot_on
from bunraku_lab.synthetic.gestures.pose import DOWN, Foot, Gesture, Hand, Key, Pose

__all__ = ["BOXING"]

Vector = tuple[float, float, float]
_FRONT, _REAR = foot_on(0.13, 0.24, 0, 0), Foot((0.17, 0.13, -0.24), 22, (0.4, 0, 1), 40)
_GUARD = Hand((0.06, 1.56, 0.27), (-0.25, 0.95, 0.1), (-0.6, 0, -0.8), (0.5, -1, 0.15))
_LEAD = Hand((0.08, 1.54, 0.38), (-0.2, 0.9, 0.35), (-0.7, 0, -0.6), (0.5, -1, 0.1))
_STRAIGHT = Hand((0.0, 1.52, 0.68), (-0.05, 0.0, 1), DOWN, (0.7, -0.8, 0))


def _boxer(right: Hand, left: Hand, turn: float, lean: Vector, bob: float, shift: float = 0.0) -> Pose:
    """The left foot ahead, the head to the front whatever the trunk does."""
    return Pose(
        right, left, lean, (2, -0.7 * (lean[1] + turn), 0), 0.3, (0.0, -0.09 + bob, shift), turn, _REAR, _FRONT,
    )  # fmt: skip


_FACING = Pose(right_foot=_REAR, left_foot=_FRONT, hips=(0, -0.05, 0))
_STILL = _boxer(_GUARD, _LEAD, -28, (8, -6, 0), 0.0)
_CROSS = _boxer(_STRAIGHT, _LEAD, 6, (12, 26, 0), -0.03, 0.07)


def _box() -> Gesture:
    hook = Hand((-0.06, 1.55, 0.46), (-1, 0.05, 0.25), DOWN, (1, 0.1, 0.25))
    low, jab = (
        _boxer(_GUARD, _LEAD, -28, (10, -4, 0), -0.025),
        _boxer(_GUARD, _STRAIGHT, -34, (10, -22, 0), -0.01, 0.05),
    )
    swung = _boxer(_GUARD, hook, -44, (8, -30, 2), -0.02, 0.02)
    plan = (
        (0.0, _STILL), (0.20, jab), (0.42, _STILL), (0.60, low), (0.80, jab), (1.00, _STILL), (1.22, _CROSS),
        (1.46, _STILL), (1.66, low), (1.84, _boxer(_GUARD, _LEAD, -18, (8, 10, 0), -0.02)), (2.04, swung),
        (2.30, _STILL), (2.50, low), (2.70, _STILL),
    )  # fmt: skip
    keys: list[Key] = [(0.0, _FACING)]
    for number in range(3):
        keys += [(0.5 + 2.7 * number + time, one) for time, one in plan[: -1 if number < 2 else None]]
    texts = (
        "a person throws punches like a boxer: jabs, a cross and a hook", "boxes", "shadow boxes", "shadow boxing",
        "a boxer throws punches", "throws punches like a boxer", "punches the air like a boxer", "a person is boxing",
        "a person boxes",
    )  # fmt: skip
    return Gesture("box", texts, tuple(keys), (0.5, 0.5 + 2 * 2.7), steps=True)


def _punch() -> Gesture:
    """Straight punches of one hand out of a guard, with the turn of the hips."""
    keys: list[Key] = [(0.0, _FACING), (0.5, _STILL)]
    for number in range(4):
        start = 0.5 + 1.1 * number
        keys += [(start + 0.35, _STILL), (start + 0.57, _CROSS), (start + 0.68, _CROSS), (start + 1.1, _STILL)]
    texts = (
        "a person punches straight ahead with the right hand", "punches with the right hand", "a right punch",
        "throws a straight punch with the right fist", "jabs with the right hand", "hits out with the right fist",
        "a person throws a right punch",
    )  # fmt: skip
    return Gesture("punch", texts, tuple(keys), (0.5, 0.5 + 3 * 1.1), steps=True)


BOXING: tuple[Gesture, ...] = (_box(), _punch())
