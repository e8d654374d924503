"""To sit down on a chair and to get up from it."""

from __future__ import annotations

from dataclasses import replace

from bunraku_lab.synthetic.gestures.flow import through
from bunraku_lab.synthetic.gestures.pose import DOWN, Gesture, Hand, Key, Pose

__all__ = ["SEATS"]


def _seated_keys(down: bool) -> tuple[Key, ...]:
    """The trunk leans ahead until the weight is over the feet, then the legs push; the other way round to sit down."""
    lap = Hand((0.15, 0.98, 0.30), (-0.1, -0.4, 1), DOWN, (0.8, -0.2, -0.7), "hips")
    knees = Hand((0.16, 0.93, 0.40), (-0.1, -0.5, 0.9), DOWN, (0.8, 0.0, -0.7), "hips")
    thighs = Hand((0.20, 0.90, 0.22), (0.0, -0.9, 0.4), (-0.8, -0.3, -0.3), (0.6, 0.0, -0.9), "hips")
    hanging = replace(Pose().right, on="hips")
    seated = Pose(lap, lap, (2, 0, 0), (2, 0, 0), 0, (0, -0.44, -0.40))
    poses = (
        (0.55, Pose(knees, knees, (42, 0, 0), (-18, 0, 0), 0, (0, -0.43, -0.37))),
        (0.9, Pose(knees, knees, (46, 0, 0), (-20, 0, 0), 0, (0, -0.34, -0.24))),
        (1.35, Pose(thighs, thighs, (28, 0, 0), (-12, 0, 0), 0, (0, -0.14, -0.07))),
        (1.8, Pose(hanging, hanging, (6, 0, 0), (-2, 0, 0), 0, (0, -0.02, 0.0))),
        (2.2, Pose(hanging, hanging)),
    )
    if not down:
        return through(((0.0, seated), (0.6, seated), *((0.6 + time, pose) for time, pose in poses)))
    back = tuple((0.3 + 2.2 - time, pose) for time, pose in reversed(poses))
    return through(((0.0, Pose(hanging, hanging)), *back, (2.5, seated), (4.5, seated)))


def _stand_up() -> Gesture:
    texts = (
        "a person stands up from a chair", "stands up from a chair", "gets up from a chair", "rises from a chair",
        "a person gets up from a seat", "stands up from a stool", "gets up from the bench",
        "stands up", "a person stands up",
    )  # fmt: skip
    return Gesture("stand up", texts, _seated_keys(down=False))


def _sit() -> Gesture:
    texts = (
        "a person sits down on a chair", "sits down on a chair", "takes a seat", "sits down on a bench",
        "a person sits down on a stool", "sits down",
    )  # fmt: skip
    return Gesture("sit", texts, _seated_keys(down=True))


SEATS: tuple[Gesture, ...] = (_stand_up(), _sit())
