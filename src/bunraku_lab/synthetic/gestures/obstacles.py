"""What is in the way: to stumble over it, to jump over it, and to climb up on it."""

from __future__ import annotations

import math
from typing import Any

from bunraku_lab.synthetic.gestures.flow import STEP, eased, foot_on, mixed, through
from bunraku_lab.synthetic.gestures.pose import DOWN, IN, Foot, Gesture, Hand, Pose

__all__ = ["OBSTACLES"]

_OUT = Hand((0.55, 1.40, 0.25), (0.8, 0.2, 0.4), DOWN, (0.2, -1, -0.4))
_BACK = Hand((0.45, 1.20, -0.28), (0.5, -0.6, -0.6), DOWN, (0.4, 0, -1))
_LOW = Hand((0.34, 0.98, 0.02), (0.2, -0.9, 0.1), IN, (0.4, 0, -1))
_FRONT = Hand((0.22, 1.25, 0.45), (-0.1, 0.1, 1), DOWN, (0.6, -1, -0.2))
_HIGH = Hand((0.36, 1.70, 0.35), (0.2, 0.8, 0.5), DOWN, (0.8, -0.8, 0))


def _stumble() -> Gesture:
    def feet(one: Foot, other: Foot, lean: float, low: float, z: float, **more: Any) -> Pose:
        return Pose(
            lean=(lean, 0, 0), hips=(0, -low, z), right_foot=one, left_foot=other, **more,
        )  # fmt: skip

    swing = Foot((0.10, 0.24, 0.16), 36)
    keys = through((
        (0.0, Pose()),
        (0.35, feet(swing, foot_on(0.11, 0.0), 4, 0.01, 0.12)),
        (0.65, feet(foot_on(0.11, 0.42, -8), foot_on(0.11, 0.0, 35), 3, 0.03, 0.28, right=_BACK, left=_FRONT)),
        (0.77, feet(foot_on(0.11, 0.42), Foot((0.11, 0.25, 0.14), 42), 4, 0.02, 0.40)),
        (0.90, feet(foot_on(0.11, 0.42), Foot((0.11, 0.18, 0.34), 42), 8, 0.01, 0.50)),  # here the left foot is caught
        (1.05, feet(foot_on(0.11, 0.42, 20), Foot((0.11, 0.17, 0.36), 58), 34, 0.03, 0.70, right=_BACK, left=_OUT,
                    head=(10, 0, 0), tilt=10)),
        (1.15, feet(foot_on(0.11, 0.42, 35), Foot((0.12, 0.30, 0.62), 40), 44, 0.09, 0.84, right=_OUT, left=_OUT,
                head=(-10, 0, 0), tilt=15)),
        (1.25, feet(foot_on(0.11, 0.42, 55), Foot((0.13, 0.22, 0.98), 15), 52, 0.16, 0.98, right=_OUT, left=_HIGH,
                    head=(-25, 0, 0), tilt=20)),
        (1.40, feet(Foot((0.11, 0.22, 0.85), 60), foot_on(0.14, 1.25), 55, 0.26, 1.18, right=_HIGH, left=_OUT,
                    head=(-30, 0, 0), tilt=22)),
        (1.60, feet(Foot((0.12, 0.20, 1.50), 10), foot_on(0.14, 1.25, 40), 50, 0.25, 1.45, right=_FRONT, left=_BACK,
                    head=(-25, 0, 0), tilt=18)),
        (1.75, feet(foot_on(0.14, 1.80), foot_on(0.14, 1.25, 55), 42, 0.22, 1.62, right=_OUT, left=_OUT,
                    head=(-15, 0, 0), tilt=14)),
        (2.00, feet(foot_on(0.14, 1.80), Foot((0.13, 0.22, 1.85), 20), 26, 0.15, 1.86, right=_OUT, left=_HIGH, tilt=6)),
        (2.20, feet(foot_on(0.14, 1.80, 15), foot_on(0.15, 2.16), 18, 0.12, 1.98, right=_OUT, left=_OUT)),
        (2.60, feet(Foot((0.13, 0.14, 1.98), 25), foot_on(0.15, 2.16), 10, 0.05, 2.08, right=_OUT, left=_FRONT)),
        (2.95, feet(foot_on(0.12, 2.14), foot_on(0.15, 2.16), 4, 0.02, 2.13)),
        (3.6, feet(foot_on(0.12, 2.14), foot_on(0.15, 2.16), 0, 0.005, 2.14)),
    ))  # fmt: skip
    texts = (
        "a person trips over something, stumbles forward with the arms out and catches the balance again",
        "trips and catches himself", "stumbles", "a person stumbles", "a person trips", "trips over something",
        "stumbles over a stone", "loses the balance and stumbles",
    )  # fmt: skip
    return Gesture("stumble", texts, keys, steps=True)


def _jump_over() -> Gesture:
    def pose(z: float, up: float, lean: float, right: Foot, left: Foot, hands: tuple[Hand, Hand] | None = None) -> Pose:
        both = hands or (Pose().right, Pose().left)
        return Pose(*both, (lean, 0, 0), (0.3 * lean - 6, 0, 0), 0.0, (0, up, z), right_foot=right, left_foot=left)

    run = 0.42
    keys = [
        (0.0, pose(0, 0, 0, Foot(), Foot())),
        (0.25, pose(0.14, -0.05, 10, Foot((0.10, 0.22, 0.16), 35), foot_on(0.10, 0.0, 15), (_BACK, _FRONT))),
        (0.45, pose(0.42, -0.06, 12, foot_on(0.10, run), foot_on(0.10, 0.0, 50), (_BACK, _FRONT))),
        (0.70, pose(1.00, -0.02, 12, foot_on(0.10, run, 50), Foot((0.10, 0.25, 1.0), 20), (_FRONT, _BACK))),
        (0.80, pose(1.24, -0.11, 8, Foot((0.10, 0.30, 0.75), 60), foot_on(0.10, 1.28), (_LOW, _LOW))),
        (0.95, pose(1.54, -0.06, 4, Foot((0.10, 0.44, 1.62), 40), foot_on(0.10, 1.28, 45), (_FRONT, _FRONT))),
    ]
    # in the air: a parabola, with both knees drawn up
    for number in range(1, 9):
        share = number / 9
        up = 0.02 + 1.50 * share * (1 - share) - 0.10 * share
        tuck = math.sin(math.pi * share)
        z = 1.54 + 1.40 * share
        right = Foot((0.12, 0.081 + up + 0.40 * tuck + 0.05, z + 0.10 + 0.30 * tuck), 20 - 20 * share, (0.2, 0.3, 1))
        behind = 1 - share
        left = Foot(
            (0.12, 0.081 + up + 0.36 * tuck + 0.02, z - 0.34 * behind + 0.25 * tuck + 0.12 * share),
            50 - 45 * share,
            (0.2, 0.3, 1),
        )
        hand = mixed(_FRONT, _HIGH, eased(min(number / 5, 1))) if number < 6 else mixed(_HIGH, _OUT, (number - 5) / 4)
        keys.append((round(0.95 + 0.05 * number, 2), pose(z, up, 4 + 14 * tuck, right, left, (hand, hand))))
    keys += [
        (1.40, pose(2.94, -0.06, 12, foot_on(0.13, 3.04), foot_on(0.13, 2.98), (_OUT, _OUT))),
        (1.55, pose(3.06, -0.30, 34, foot_on(0.13, 3.04), foot_on(0.13, 2.98), (_FRONT, _FRONT))),
        (1.80, pose(3.06, -0.22, 24, foot_on(0.13, 3.04), foot_on(0.13, 2.98), (_FRONT, _FRONT))),
        (2.25, pose(3.01, -0.02, 4, foot_on(0.13, 3.04), foot_on(0.13, 2.98))),
        (2.7, pose(3.01, 0, 0, foot_on(0.13, 3.04), foot_on(0.13, 2.98))),
    ]
    texts = (
        "a person takes a run-up and jumps over something with both knees drawn up", "jumps over something",
        "jumps over an obstacle", "leaps over a puddle", "a person jumps over a box", "hurdles an obstacle",
        "vaults over a log",
    )  # fmt: skip
    return Gesture("jump over", texts, through(keys), steps=True)


def _climb(cycles: int) -> Gesture:
    """Up a ladder with rungs 30 cm apart, two of them a cycle, beginning and ending at rest."""
    period, way, front, late, moves = 1.6, 0.60, 0.40, 0.30, 0.36

    def moved(phase: float, start: float) -> tuple[float, float]:
        """Height of what goes up two rungs from `start` of each cycle on, and how far it is off the ladder, of 1."""
        over = min(phase, cycles - 0.01) - start
        if over < 0:
            return 0.0, 0.0
        share = min(over % 1.0 / moves, 1.0)
        return way * (math.floor(over) + eased(share)), math.sin(math.pi * share)

    def hand(phase: float, start: float, first: float) -> Hand:
        up, off = moved(phase, start)
        palm = 0.19, first + up, front - 0.08 * off
        return Hand(palm, (-0.1, 0.75, 0.6), (0, -0.3, 1), (0.7, -1, -0.3), "ground")

    def foot(phase: float, start: float) -> Foot:
        up, off = moved(phase, start)
        return Foot((0.12, 0.081 + up, 0.20 - 0.16 * off), 10 * off, (0.35, 0.1, 1), 12)

    def at(phase: float) -> Pose:
        sway = math.sin(2 * math.pi * min(phase, cycles))
        left = cycles + late - phase
        risen = phase**2 / (2 * late) if phase < late else phase - late / 2
        risen = cycles - left**2 / (2 * late) if left < late else risen
        return Pose(
            hand(phase, 0.10, 1.55), hand(phase, 0.60, 1.85), (6, 0, 2.5 * sway), (-14, 0, 0), 0.0,
            (0.02 * sway, way * risen - 0.02, -0.02), 0.0, foot(phase, 0.55), foot(phase, 0.05),
        )  # fmt: skip

    each = round(period / STEP)
    count = round((cycles + late) * each)
    keys = tuple((round(STEP * index, 3), at(index / each)) for index in range(count + 1))
    texts = (
        "a person climbs up a ladder hand over hand", "climbs a ladder", "a person climbs a ladder", "goes up a ladder",
        "climbs up the ladder",
    )  # fmt: skip
    return Gesture("ladder", texts, keys, steps=True)


OBSTACLES: tuple[Gesture, ...] = (_stumble(), _jump_over(), _climb(3), _climb(5), _climb(8))
