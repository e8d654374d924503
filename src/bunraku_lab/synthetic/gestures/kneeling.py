"""Ways to kneel."""

from __future__ import annotations

from bunraku_lab.synthetic.gestures.pose import DOWN, IN, Foot, Gesture, Hand, Pose

__all__ = ["KNEELING"]


_KNEEL = Pose(
    Hand((0.20, 0.92, 0.10), (0.0, -1.0, 0.3), IN, (0.5, 0, -1), "chest"),
    Hand((0.13, 1.01, 0.30), (-0.2, -0.3, 1), DOWN, (0.8, -0.2, -0.6), "hips"),
    (6, 0, 0), (4, 0, 0), 0.0, (0, -0.47, -0.02),
    right_foot=Foot((0.12, 0.13, -0.40), 75, (0.1, -0.6, 1)), left_foot=Foot((0.14, 0.081, 0.40), 0, (0.15, 0.3, 1)),
)  # fmt: skip

_STEP = Pose(
    lean=(8, 0, 0), hips=(0, -0.14, 0.02), right_foot=Foot((0.12, 0.10, -0.25), 30), left_foot=Foot((0.14, 0.12, 0.30))
)

_BOTH_KNEES = Pose(
    Hand((0.17, 0.97, 0.20), (-0.1, -0.6, 0.9), DOWN, (0.8, -0.2, -0.7), "hips"),
    Hand((0.17, 0.97, 0.20), (-0.1, -0.6, 0.9), DOWN, (0.8, -0.2, -0.7), "hips"),
    (4, 0, 0), (6, 0, 0), 0.0, (0, -0.50, 0.04),
    right_foot=Foot((0.12, 0.12, -0.42), 78, (0.1, -0.5, 1)), left_foot=Foot((0.12, 0.12, -0.42), 78, (0.1, -0.5, 1)),
)  # fmt: skip


def _kneel() -> Gesture:
    keys = ((0.0, Pose()), (0.8, _STEP), (1.6, _KNEEL), (3.4, _KNEEL))
    texts = (
        "a person kneels down on the right knee", "kneels down on one knee", "kneels down", "a person kneels",
        "gets down on one knee", "takes a knee",
    )  # fmt: skip
    return Gesture("kneel", texts, keys)


def _kneel_both() -> Gesture:
    keys = ((0.0, Pose()), (0.8, _STEP), (1.5, _KNEEL), (2.3, _BOTH_KNEES), (3.8, _BOTH_KNEES))
    texts = ("a person kneels down on both knees", "kneels on both knees", "sinks to both knees")
    return Gesture("both knees", texts, keys)


def _propose() -> Gesture:
    ring = Hand((0.03, 1.30, 0.46), (-0.2, 0.3, 0.9), (-0.5, 0.6, -0.5))
    offer = Pose(
        ring, ring, (4, 0, 0), (-8, 0, 0), 0.0, _KNEEL.hips, right_foot=_KNEEL.right_foot, left_foot=_KNEEL.left_foot
    )
    keys = ((0.0, Pose()), (0.8, _STEP), (1.6, _KNEEL), (2.3, offer), (4.0, offer))
    texts = ("a person proposes with a ring on one knee", "proposes on one knee", "kneels and holds out a ring")
    return Gesture("propose", texts, keys)


KNEELING: tuple[Gesture, ...] = (
    _kneel(), _kneel_both(), _propose(),
)  # fmt: skip
