"""What is done with balls: thrown, pitched, bounced, and hit with a racket or a bat.

Who throws or hits stands with the left side ahead and turns the hips before the shoulders, and those before the hand.
"""

from __future__ import annotations

from bunraku_lab.synthetic.gestures.flow import foot_on, through
from bunraku_lab.synthetic.gestures.pose import AHEAD, BACK, DOWN, IN, UP, Foot, Gesture, Hand, Pose, again

__all__ = ["BALLS"]

Vector = tuple[float, float, float]
_BALANCE = Hand((0.34, 1.15, 0.16), (0.3, -0.7, 0.5), IN, (0.4, -0.2, -1))


def _thrown(name: str, texts: tuple[str, ...], wound: bool) -> Gesture:
    """Overarm with the right hand: the weight goes back, the left foot steps ahead, the trunk turns, the arm whips."""
    back, step = foot_on(0.13, -0.02, 0, 60), foot_on(0.12, 0.62, 0, 5)
    together = Hand((0.04, 1.36, 0.24), (-0.4, 0.6, 0.5), IN, (0.8, -0.9, 0))
    glove = Hand((0.05, 1.38, 0.23), (-0.3, 0.6, 0.5), IN, (0.8, -0.9, 0))
    out_front = Hand((0.66, 1.48, 0.10), (1, 0.1, 0.1), DOWN, (0.2, -1, -0.3))
    low_back = Hand((0.48, 1.05, -0.22), (0.5, -0.7, -0.3), BACK, (0.4, 0.2, -1))
    cocked = Hand((0.42, 1.80, -0.16), (0.1, 0.8, -0.6), (-0.2, 0.5, 0.9), (1, -0.1, -0.25))
    layback = Hand((0.44, 1.72, -0.10), (0.1, 0.4, -0.9), (0, 0.9, 0.4), (1, 0, 0.2))
    release = Hand((0.26, 1.84, 0.50), (0, 0.55, 0.85), (0, -0.5, 0.9), (0.9, -0.3, 0))
    let_go = Hand((0.06, 1.44, 0.68), (-0.1, -0.2, 1), DOWN, (0.9, -0.4, 0))
    follow = Hand((-0.18, 1.02, 0.42), (-0.5, -0.8, 0.3), (-0.5, 0, -0.8), (0.9, 0.2, 0.3))
    tucked = Hand((0.20, 1.25, 0.16), (-0.3, 0.4, 0.6), IN, (0.7, -0.6, -0.6))
    knee = Foot((0.03, 0.62, 0.16), 20, (-0.35, 0.3, 1), 0) if wound else Foot((0.10, 0.22, 0.14), 20, (0, 0.2, 1), 0)
    turned = -78.0 if wound else -62.0
    keys = through((
        (0.0, Pose()),
        (0.45, Pose(together, glove, (2, -6, 0), (0, 0, 0), 0, (-0.02, -0.02, 0.0), -20, foot_on(0.13, -0.02, 0, 30))),
        (0.95, Pose(together, glove, (0, -12, 3), (0, 50, 0), 0, (-0.07, -0.02, -0.04), turned, back, knee)),
        (1.15, Pose(together, glove, (0, -12, 3), (0, 52, 0), 0, (-0.07, -0.03, -0.05), turned, back, knee)),
        (1.45, Pose(low_back, out_front, (0, -10, 6), (0, 60, 0), 0, (-0.03, -0.12, 0.12), -72, back,
                    Foot((0.11, 0.16, 0.46), -5, (0.1, 0, 1), 5))),
        (1.65, Pose(cocked, out_front, (-4, -14, 4), (0, 48, 0), 0, (0.0, -0.14, 0.24), -54,
                    foot_on(0.13, -0.02, 12, 50), step)),
        (1.80, Pose(cocked, out_front, (-8, -12, 2), (0, 42, 0), 0, (0.0, -0.16, 0.30), -44,
                    foot_on(0.13, -0.02, 18, 45), step)),
        (1.95, Pose(layback, tucked, (-8, 0, -2), (4, 18, 0), 0, (0.0, -0.15, 0.36), -8, foot_on(0.13, -0.02, 34, 30),
                step)),
        (2.07, Pose(release, tucked, (12, 20, -8), (0, -14, 0), 0, (0.02, -0.14, 0.42), 16, foot_on(0.12, -0.02, 46,
                14), step)),
        (2.20, Pose(let_go, tucked, (24, 28, -6), (-14, -18, 0), 0, (0.03, -0.15, 0.46), 24, foot_on(0.11, -0.02, 56,
                8), step)),
        (2.40, Pose(follow, tucked, (38, 32, -4), (-24, -18, 0), 0, (0.04, -0.15, 0.50), 32, foot_on(0.11, -0.02, 64,
                8), step)),
        (2.70, Pose(follow, _BALANCE, (34, 20, 0), (-24, -10, 0), 0, (0.03, -0.10, 0.55), 20,
                    Foot((0.14, 0.20, 0.25), 35), step)),
        (3.05, Pose(_BALANCE, _BALANCE, (14, 4, 0), (-8, 0, 0), 0, (0, -0.05, 0.60), 4, foot_on(0.14, 0.62), step)),
        (3.5, Pose(hips=(0, 0, 0.61), right_foot=foot_on(0.14, 0.62), left_foot=step)),
    ))  # fmt: skip
    return Gesture(name, texts, keys, steps=True)


def _throw() -> Gesture:
    texts = (
        "a person throws a ball overarm with the right hand", "throws a ball", "a person throws a ball",
        "throws something far", "hurls a stone", "throws a stone", "a person throws something", "tosses a ball away",
    )  # fmt: skip
    return _thrown("throw", texts, False)


def _pitch() -> Gesture:
    texts = (
        "a person winds up with a high knee and pitches a baseball", "pitches a baseball", "a pitcher throws the ball",
        "a person pitches a ball", "a baseball pitcher winds up and throws",
    )  # fmt: skip
    return _thrown("pitch", texts, True)


_READY = Hand((0.04, 1.18, 0.44), (-0.3, 0.4, 0.9), (-0.8, 0.2, 0.1), (0.7, -0.8, -0.2))
_THROAT = Hand((0.02, 1.26, 0.52), (-0.4, 0.2, 0.9), (-0.6, 0, 0.2), (0.7, -0.8, -0.2))


def _tennis() -> Gesture:
    right, left = foot_on(0.19, -0.02, 0, 20), foot_on(0.19, 0.0, 0, 20)
    across = foot_on(0.10, 0.42, 0, 0)

    def ready(bob: float) -> Pose:
        return Pose(_READY, _THROAT, (16, 0, 0), (-8, 0, 0), 0, (0, -0.13 + bob, -0.06), 0, right, left)

    drawn = Hand((0.58, 1.24, -0.30), (0.7, 0.2, -0.7), (0.6, -0.2, 0.6), (0.7, -0.4, -0.9))
    low = Hand((0.56, 0.98, -0.16), (0.8, -0.5, -0.2), AHEAD, (0.5, -0.5, -0.9))
    hit = Hand((0.42, 1.22, 0.54), (0.7, -0.1, 0.7), (-0.5, 0, 0.9), (0.7, -0.8, -0.1))
    over = Hand((-0.16, 1.62, 0.28), (-0.7, 0.5, -0.4), (-0.3, -0.4, -0.8), (0.8, 0.3, 0.7))
    aim = Hand((0.20, 1.36, 0.56), (-0.2, 0.2, 1), DOWN, (0.7, -0.8, 0))
    aside = Hand((0.30, 1.28, 0.20), (-0.2, 0.5, 0.7), IN, (0.7, -0.6, -0.5))
    one = [
        (0.0, ready(0.0)), (0.3, ready(0.03)),
        (0.75, Pose(drawn, aim, (8, -40, 2), (0, 62, 0), 0, (-0.07, -0.12, -0.04), -42, right, foot_on(0.16, 0.10, 10,
                10))),
        (1.0, Pose(low, aim, (12, -36, 4), (0, 58, 0), 0, (-0.05, -0.15, 0.04), -38, right, across)),
        (1.2, Pose(hit, aside, (12, 10, 0), (2, 0, 0), 0, (-0.01, -0.12, 0.16), 4, foot_on(0.19, -0.02, 24, 10),
                across)),
        (1.45, Pose(over, aside, (6, 38, -4), (0, -36, 0), 0, (0.02, -0.08, 0.20), 28, foot_on(0.19, -0.02, 42, 0),
                across)),
        (1.7, Pose(over, aside, (6, 36, -4), (0, -34, 0), 0, (0.02, -0.08, 0.20), 28, foot_on(0.19, -0.02, 42, 0),
                across)),
        (2.2, ready(-0.01)),
    ]  # fmt: skip
    wrist = Hand((-0.48, 1.20, -0.06), (-0.8, 0.2, -0.5), (0.4, -0.4, 0.6), (0.8, -0.2, 0.8))
    held = Hand((0.50, 1.24, -0.10), (0.6, 0.2, -0.7), (0.4, -0.4, 0.6), (0.7, -0.5, -0.8))
    struck = Hand((0.06, 1.20, 0.58), (-0.2, 0.0, 1), (0.3, -0.2, 0.9), (0.8, -0.7, 0))
    ended = Hand((0.48, 1.66, 0.34), (0.6, 0.7, 0.3), (0.3, 0.3, 0.9), (0.6, -0.9, -0.3))
    other = foot_on(0.10, 0.42, 0, 0)
    two = [
        (0.3, ready(0.03)),
        (0.75, Pose(wrist, held, (10, 42, -2), (0, -60, 0), 0, (0.07, -0.13, -0.03), 42, foot_on(0.16, 0.10, 10, 10),
                left)),
        (1.0, Pose(wrist, held, (12, 38, -3), (0, -56, 0), 0, (0.05, -0.15, 0.05), 38, other, left)),
        (1.2, Pose(struck, aside, (12, 0, 0), (2, 0, 0), 0, (0.01, -0.12, 0.16), 0, other, foot_on(0.19, 0.0, 22, 10))),
        (1.45, Pose(ended, _BALANCE, (6, -26, 2), (0, 24, 0), 0, (-0.01, -0.08, 0.19), -20, other, foot_on(0.19, 0.0,
                38, 0))),
        (1.7, Pose(ended, _BALANCE, (6, -24, 2), (0, 22, 0), 0, (-0.01, -0.08, 0.19), -20, other, foot_on(0.19, 0.0,
                38, 0))),
        (2.2, ready(-0.01)),
    ]  # fmt: skip
    rally = [*one, *((2.2 + time, pose) for time, pose in two)]
    keys = through([*rally, *((4.4 + time, pose) for time, pose in rally[1:])])
    texts = (
        "a person hits a ball with a tennis racket, forehand and backhand", "plays tennis", "a person plays tennis",
        "hits a tennis ball", "swings a tennis racket", "a tennis player hits a forehand", "swings a racket",
        "a person hits a ball with a racket",
    )  # fmt: skip
    return Gesture("tennis", texts, keys, (0.0, 4.4), steps=True)


def _serve() -> Gesture:
    right, left = foot_on(0.14, -0.10, 0, 50), foot_on(0.12, 0.16, 0, 20)
    down = Hand((0.06, 1.06, 0.36), (-0.3, -0.2, 0.9), IN, (0.7, -0.6, -0.6))
    toss = Hand((0.14, 2.00, 0.34), (0, 1, 0.2), UP, (0.9, -0.2, 0))
    swung = Hand((0.52, 1.00, -0.24), (0.5, -0.7, -0.4), IN, (0.4, 0.2, -1))
    trophy = Hand((0.40, 1.80, -0.18), (-0.3, 0.9, -0.1), (0.2, 0, 1), (1, 0.1, -0.3))
    behind = Hand((0.26, 1.62, -0.24), (0, -0.9, -0.4), (0.6, 0, -0.6), (0.8, 0.9, 0.2))
    top = Hand((0.18, 2.10, 0.24), (0, 0.9, 0.5), (0, -0.4, 0.9), (0.9, 0.2, 0))
    low = Hand((-0.24, 0.98, 0.34), (-0.5, -0.8, 0.1), (-0.3, 0, -0.9), (0.9, 0.2, 0.3))
    tucked = Hand((0.14, 1.24, 0.20), (-0.6, 0.4, 0.4), IN, (0.7, -0.7, -0.3))
    keys = through((
        (0.0, Pose()),
        (0.6, Pose(down, down, (10, -6, 0), (6, 14, 0), 0, (0, -0.03, 0.02), -36, right, left)),
        (1.0, Pose(down, down, (12, -6, 0), (6, 14, 0), 0, (0, -0.05, 0.04), -36, right, left)),
        (1.45, Pose(swung, toss, (-4, -18, 4), (-18, 40, 0), 0, (-0.01, -0.06, 0.0), -50, right, left)),
        (1.75, Pose(trophy, toss, (-12, -18, 8), (-26, 38, 0), 0, (0.0, -0.16, 0.06), -50, right, left)),
        (1.95, Pose(behind, tucked, (-8, 4, 6), (-24, 10, 0), 0, (0, -0.06, 0.10), -20, foot_on(0.14, -0.10, 30, 30),
                left)),
        (2.10, Pose(top, tucked, (6, 18, -10), (-20, -8, 0), 0, (0.01, 0.02, 0.18), 4, foot_on(0.14, -0.10, 44, 20),
                foot_on(0.12, 0.16, 14, 15))),
        (2.35, Pose(low, tucked, (36, 30, -2), (-22, -14, 0), 0, (0.02, -0.10, 0.32), 24, Foot((0.13, 0.24, 0.10),
                45), left)),
        (2.75, Pose(low, _BALANCE, (24, 14, 0), (-16, -6, 0), 0, (0, -0.10, 0.46), 8, foot_on(0.14, 0.56),
                foot_on(0.12, 0.16, 20, 10))),
        (3.1, Pose(_BALANCE, _BALANCE, (10, 0, 0), (-4, 0, 0), 0, (0, -0.03, 0.50), 0, foot_on(0.14, 0.56),
                Foot((0.12, 0.16, 0.32), 20))),
        (3.5, Pose(hips=(0, 0, 0.52), right_foot=foot_on(0.14, 0.56), left_foot=foot_on(0.12, 0.54))),
    ))  # fmt: skip
    texts = (
        "a person serves a tennis ball", "serves in tennis", "tennis serve",
                "a tennis player tosses the ball up and serves",
    )  # fmt: skip
    return Gesture("serve", texts, keys, steps=True)


def _dribble() -> Gesture:
    off = Hand((0.26, 1.20, 0.36), (-0.3, 0.3, 0.9), IN, (0.6, -0.6, -0.6))
    right, left = foot_on(0.17, -0.08, 0, 14), foot_on(0.17, 0.12, 0, 10)

    def pose(up: float, fall: float, lean: float, low: float) -> Pose:
        hand = Hand((0.30, up, 0.42), (-0.05, fall, 1), DOWN, (0.6, -0.5, -0.9))
        return Pose(hand, off, (lean, -6, 4), (8, -4, 0), 0, (-0.02, low, -0.05), 0, right, left)

    keys, cycle = again([pose(1.17, 0.45, 15, -0.13), pose(0.86, -0.75, 19, -0.16)], 0.6, 9, start=0.7)
    keys = tuple((time, pose if pose != Pose() else Pose(right_foot=right, left_foot=left)) for time, pose in keys)
    texts = (
        "a person dribbles a basketball with the right hand", "dribbles a ball", "dribbles", "bounces a basketball",
        "a person dribbles a ball", "bounces a ball", "a person dribbles a basketball",
    )  # fmt: skip
    return Gesture("dribble", texts, keys, cycle, steps=True)


def _bat() -> Gesture:
    right, left = foot_on(0.20, 0.0, 0, 55), foot_on(0.20, 0.0, 0, 55)

    def grip(x: float, up: float, ahead: float, turned: bool = False) -> tuple[Hand, Hand]:
        """Both hands on the bat, `x` to the right."""
        fingers = (-0.5, 0.5, 0.6) if not turned else (-0.8, 0.2, 0.4)
        return (
            Hand((x, up, ahead), fingers, (-0.5, 0, -0.6), (0.9, -0.3, -0.2)),
            Hand((0.03 - x, up - 0.07, ahead + 0.02), (-0.6, 0.4, 0.6), (-0.6, 0, -0.5), (0.7, -0.8, 0.1)),
        )

    stance = Pose(*grip(0.24, 1.50, 0.16), (14, -8, 0), (0, 66, 0), 0, (-0.05, -0.11, 0), -68, right, left)
    load = Pose(*grip(0.32, 1.56, 0.06), (12, -24, 0), (0, 76, 0), 0, (-0.06, -0.12, -0.05), -76, right,
                Foot((0.20, 0.20, 0.14), 10, (0.2, 0, 1), 40))  # fmt: skip
    step = foot_on(0.18, 0.34, 0, 30)
    meet = Pose(
        *grip(0.02, 1.16, 0.54), (16, 6, 2), (10, 8, 0), 0, (0.0, -0.14, 0.12), -2, foot_on(0.20, 0.0, 30, 20), step
    )
    through_it = Pose(*grip(-0.42, 1.46, 0.20, True), (4, 44, -4), (4, -36, 0), 0, (0.03, -0.12, 0.15), 34,
                      foot_on(0.20, 0.0, 46, 0), step)  # fmt: skip
    keys = through((
        (0.0, Pose(right_foot=foot_on(0.2, 0), left_foot=foot_on(0.2, 0))), (0.7, stance), (1.25, stance), (1.65,
                load), (1.8, load),
        (1.95, Pose(*grip(0.26, 1.36, 0.26), (16, -22, 2), (6, 40, 0), 0, (-0.03, -0.14, 0.06), -38, foot_on(0.20, 0,
                12, 40), step)),
        (2.1, meet), (2.35, through_it), (2.9, through_it),
        (3.5, Pose(hips=(0, 0, 0.12), right_foot=foot_on(0.2, 0), left_foot=step)),
    ))  # fmt: skip
    texts = (
        "a person swings a baseball bat",
        "swings a bat",
        "hits a baseball with a bat",
        "plays baseball",
        "bats a ball away",
    )
    return Gesture("bat", texts, keys, steps=True)


BALLS: tuple[Gesture, ...] = (_throw(), _pitch(), _tennis(), _serve(), _dribble(), _bat())
