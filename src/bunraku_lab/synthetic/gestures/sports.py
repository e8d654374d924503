"""Sports that hardly anybody has captured."""

from __future__ import annotations

from bunraku_lab.synthetic.gestures.pose import Foot, Gesture, Hand, Pose, again

__all__ = ["SPORTS"]

_OUT = Hand((0.34, 1.18, 0.10), (0.4, -0.6, 0.6), (-0.3, -0.9, 0), (0.5, -0.2, -1))


def _hop() -> Gesture:
    lifted = Foot((0.12, 0.40, -0.26), 60, (0.1, 0, 1))

    def pose(height: float, up: float, lean: float) -> Pose:
        foot = Foot((0.05, 0.081 + up, 0.0), 200 * up)
        return Pose(_OUT, _OUT, (lean, 0, 0), (0, 0, 0), 0.0, (-0.07, height, 0), 0.0, foot, lifted)

    keys, cycle = again([pose(-0.10, 0.0, 8), pose(0.10, 0.14, 3)], 0.55, 5, start=0.7)
    texts = (
        "a person hops up and down on the right foot", "hops on the right leg", "hops on one leg", "hops on one foot",
        "a person hops on the right foot",
    )  # fmt: skip
    return Gesture("hop", texts, keys, cycle)


def _golf() -> Gesture:
    def club(out: float, up: float, ahead: float, lean: tuple[float, float, float], turn: float = 0.0) -> Pose:
        """Both hands on the grip, `out` to the right."""
        right = Hand((out, up, ahead), (-0.4, -0.8, 0.4), (-0.9, 0, 0.2), (0.5, -0.6, -0.6))
        left = Hand((-out + 0.02, up + 0.07, ahead), (-0.4, -0.8, 0.4), (-0.9, 0, 0.2), (0.5, -0.6, -0.6))
        return Pose(right, left, lean, (10, 0, 0), 0.0, (0, -0.06, -0.04), turn)

    at_ball, back = club(0.0, 0.92, 0.42, (26, 0, 0)), club(0.42, 1.62, 0.10, (16, -52, 6), -20)
    through = club(-0.40, 1.66, 0.06, (2, 56, -4), 40)
    keys = (
        (0.0, Pose()), (0.7, at_ball), (1.2, at_ball), (2.0, back), (2.2, back), (2.5, at_ball), (2.85, through),
        (3.6, through), (4.4, Pose()),
    )  # fmt: skip
    texts = ("a person swings a golf club right-handed", "swings a golf club", "plays golf", "hits a golf ball")
    return Gesture("golf", texts, keys)


SPORTS: tuple[Gesture, ...] = (_hop(), _golf())
