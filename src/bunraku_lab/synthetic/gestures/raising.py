"""To raise an arm, or both, and hold it up."""

from __future__ import annotations

from bunraku_lab.synthetic.gestures.pose import AHEAD, HANGING, UP, Gesture, Hand, Pose

__all__ = ["RAISING"]

_UP = Hand((0.25, 2.06, 0.10), UP, AHEAD, (1.0, 0.0, 0.1))
_HIGH = Hand((0.26, 2.08, 0.10), (0.03, 1.0, 0.05), AHEAD, (1.0, 0.0, 0.1))


def _keys(both: bool) -> tuple[tuple[float, Pose], ...]:
    def pose(hand: Hand, lean: float) -> Pose:
        return Pose(hand, hand if both else HANGING, (-2, 0, 0 if both else -lean), (-6, 0, 0))

    up, high = pose(_UP, 3.0), pose(_HIGH, 4.0)
    return (0.0, Pose()), (0.4, Pose()), (1.2, up), (2.0, high), (2.8, up), (3.6, Pose()), (4.0, Pose())


def _one() -> Gesture:
    texts = (
        "a person raises the right arm", "raises the right hand", "raises a hand", "puts up the right hand",
        "lifts the right arm up high", "a person lifts one arm above the head", "raises one hand",
    )  # fmt: skip
    return Gesture("raise arm", texts, _keys(both=False))


def _two() -> Gesture:
    texts = (
        "a person raises both arms", "raises both hands above the head", "lifts both arms up high",
        "raises the arms",
    )  # fmt: skip
    return Gesture("raise arm", texts, _keys(both=True))


RAISING: tuple[Gesture, ...] = (_one(), _two())
