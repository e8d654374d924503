"""What people say with their hands and heads."""

from __future__ import annotations

from bunraku_lab.synthetic.gestures.pose import AHEAD, BACK, DOWN, IN, UP, Gesture, Hand, Pose, again

__all__ = ["SIGNS"]

_BROW = Hand((0.10, 1.80, 0.15), (-0.75, 0.65, 0.05), (-0.1, -0.55, -0.8), (1.0, -0.1, 0.25), "head")
_AT_EAR = Hand((0.125, 1.71, 0.06), (-0.1, 0.95, 0.25), IN, (0.8, -0.9, 0.3), "head")
_STOP = Hand((0.14, 1.50, 0.62), (0, 1, 0.12), AHEAD, (0.5, -1, 0))
_ON_HIP = Hand((0.21, 1.06, 0.05), (-0.45, -0.55, 0.7), (-1, 0, -0.1), (1, 0.1, -0.7), "hips")
_CROSSED = Hand((-0.12, 1.30, 0.20), (-0.95, 0.3, 0.0), (0, 0.1, -1), (0.9, -0.5, 0.1))
_UNDER = Hand((-0.10, 1.23, 0.235), (-0.95, 0.2, 0.05), (0, -0.2, -1), (0.9, -0.5, 0.2))
_UP_HIGH = Hand((0.24, 2.02, 0.08), (0.05, 1, 0.05), (-0.5, 0, 0.9), (1, 0, 0.1))
_FIST_UP = Hand((0.24, 1.93, 0.14), (-0.05, 1, 0.0), (-0.2, 0, 1), (1, 0, 0.3))


def _held(pose: Pose, up: float, until: float, over: float) -> tuple[tuple[float, Pose], ...]:
    """From hanging arms to a pose, held, and back [s]."""
    return ((0.0, Pose()), (up, pose), (until, pose), (over, Pose()))


def _clap() -> Gesture:
    apart = Hand((0.15, 1.36, 0.37), (-0.15, 0.55, 0.8), IN, (1, -0.8, 0))
    together = Hand((0.012, 1.38, 0.38), (-0.2, 0.55, 0.8), IN, (1, -0.8, 0))
    keys, cycle = again([Pose(apart, apart), Pose(together, together)], 0.4, 8)
    texts = (
        "a person claps the hands in front of the chest", "somebody applauds, clapping again and again",
        "a person claps", "claps", "claps hands", "applauds happily",
    )  # fmt: skip
    return Gesture("clap", texts, keys, cycle)


def _wave() -> Gesture:
    poses = [
        Pose(Hand((0.34 + out, 1.74, 0.18), (tilt, 1, 0.05), AHEAD, (0.9, -1, -0.1)), lean=(0, 3, -2), head=(-3, 4, 3))
        for out, tilt in ((0.13, 0.55), (-0.11, -0.45))
    ]
    keys, cycle = again(poses, 0.65, 5, start=0.7)
    texts = (
        "a person waves the right hand beside the head from side to side", "waves with the right hand",
        "a person waves with the right hand", "a person waves", "waves hello", "waves goodbye", "waves at somebody",
    )  # fmt: skip
    return Gesture("wave", texts, keys, cycle)


def _wave_both() -> Gesture:
    poses = []
    for out, tilt in ((0.20, 0.6), (-0.12, -0.5)):
        hand = Hand((0.36 + out, 1.96, 0.12), (tilt, 1, 0.05), AHEAD, (0.9, -0.6, -0.1))
        poses.append(Pose(hand, hand, lean=(-3, 0, 0), head=(-6, 0, 0)))
    keys, cycle = again(poses, 0.8, 5, start=0.8)
    texts = (
        "a person waves goodbye with both hands above the head", "waves with both hands", "waves both arms",
        "a person waves goodbye with both hands", "waves both arms overhead", "waves with both arms",
    )  # fmt: skip
    return Gesture("wave both", texts, keys, cycle)


def _nod() -> Gesture:
    keys, cycle = again([Pose(head=(-3, 0, 0)), Pose(head=(22, 0, 0))], 0.7, 3, start=0.4, end=0.4)
    return Gesture("nod", ("a person nods the head in agreement", "nods", "says yes with a nod"), keys, cycle)


def _shake_head() -> Gesture:
    keys, cycle = again([Pose(head=(4, 30, 0)), Pose(head=(4, -30, 0))], 0.9, 3, start=0.4, end=0.4)
    texts = ("a person shakes the head", "shakes the head to say no", "a person shakes the head from side to side")
    return Gesture("shake head", texts, keys, cycle)


def _shrug() -> Gesture:
    out = Hand((0.40, 1.20, 0.24), (0.75, 0.1, 0.6), UP, (0.2, -1, -0.3))
    pose = Pose(out, out, head=(2, 0, 10), shrug=1)
    texts = ("a person shrugs the shoulders with open palms", "somebody shrugs, not knowing", "shrugs")
    return Gesture("shrug", texts, _held(pose, 0.6, 1.4, 2.2))


def _point_ahead() -> Gesture:
    pose = Pose(Hand((0.12, 1.46, 0.66), AHEAD, DOWN, (0.6, -1, 0)), lean=(3, 6, 0))
    texts = (
        "a person points forward with the right hand", "points straight ahead", "a person points at something in front",
        "points",
    )  # fmt: skip
    return Gesture("point", texts, _held(pose, 0.7, 2.0, 2.8))


def _point_aside() -> Gesture:
    pose = Pose(Hand((0.74, 1.48, 0.14), (1, 0.05, 0.1), DOWN, (0, -1, -0.4)), lean=(0, -8, 0), head=(0, -45, 0))
    texts = ("a person points to the right with the right hand", "points right", "points to the right side")
    return Gesture("point", texts, _held(pose, 0.7, 2.0, 2.8))


def _point_up() -> Gesture:
    pose = Pose(Hand((0.22, 2.0, 0.16), (0, 1, 0.1), AHEAD, (1, 0, 0.2)), head=(-18, 0, 0))
    texts = ("a person points up at the sky with the right hand", "points up", "points upwards")
    return Gesture("point", texts, _held(pose, 0.8, 2.0, 2.8))


def _salute() -> Gesture:
    pose = Pose(_BROW, head=(-3, 0, 0), lean=(-2, 0, 0))
    texts = ("a person salutes with the right hand like a soldier", "gives a military salute", "salutes")
    return Gesture("salute", texts, _held(pose, 0.55, 1.9, 2.5))


def _pray() -> Gesture:
    palms = Hand((0.012, 1.38, 0.27), (-0.05, 1, 0.2), IN, (1, -0.8, 0))
    keys, cycle = again([Pose(palms, palms, head=(20, 0, 0)), Pose(palms, palms, (3, 0, 0), (24, 0, 0))], 3.0, 2)
    texts = (
        "a person prays with the palms together in front of the chest", "prays with folded hands", "prays",
        "somebody bows the head and prays",
    )  # fmt: skip
    return Gesture("pray", texts, keys, cycle)


def _look_around() -> Gesture:
    poses = [Pose(lean=(0, 10, 0), head=(2, 45, 0)), Pose(lean=(0, -10, 0), head=(-2, -45, 0))]
    keys, cycle = again(poses, 3.2, 2, start=0.9, end=0.9)
    texts = (
        "a person stands and looks around, to the left and to the right", "looks left and right", "looks around",
        "somebody looks about searching",
    )  # fmt: skip
    return Gesture("look around", texts, keys, cycle)


def _look_far() -> Gesture:
    shade = Hand((0.05, 1.805, 0.185), (-0.95, 0.1, 0.15), (0, -1, 0.1), (1, -0.3, 0.3), "head")
    poses = [Pose(shade, lean=(4, 12, 0), head=(-2, 22, 0)), Pose(shade, lean=(4, -12, 0), head=(-2, -22, 0))]
    keys, cycle = again(poses, 3.0, 2)
    texts = (
        "a person shades the eyes with the right hand and looks into the distance", "looks far away, hand at the brow",
        "looks into the distance",
    )  # fmt: skip
    return Gesture("look far", texts, keys, cycle)


def _kiss() -> Gesture:
    mouth = Hand((0.03, 1.63, 0.235), (-0.5, 0.8, 0.2), BACK, (0.8, -1, 0.2), "head")
    away = Hand((0.24, 1.52, 0.60), (0.3, 0.2, 1), UP, (0.6, -1, 0))
    keys = (
        (0.0, Pose()), (0.6, Pose(mouth, head=(6, 0, 0))), (1.0, Pose(mouth, head=(6, 0, 0))),
        (1.5, Pose(away, lean=(5, 8, 0))), (2.1, Pose(away, lean=(5, 8, 0))), (2.8, Pose()),
    )  # fmt: skip
    return Gesture(
        "kiss", ("a person blows a kiss with the right hand", "blows a kiss", "blows kisses to everybody"), keys
    )


def _thumbs_up() -> Gesture:
    pose = Pose(Hand((0.16, 1.36, 0.46), (-0.75, 0.1, 0.7), (-0.6, 0, -0.8), (0.7, -1, 0)), head=(-3, 0, 5))
    texts = ("a person gives a thumbs up with the right hand", "gives a thumbs up", "shows a thumb in approval")
    return Gesture("thumbs up", texts, _held(pose, 0.6, 1.9, 2.6))


def _stop() -> Gesture:
    texts = (
        "a person holds the right hand out to stop somebody", "holds up a hand to say stop",
        "a person puts a palm forward to say stop", "says stop with the hand",
    )  # fmt: skip
    return Gesture("stop", texts, _held(Pose(_STOP, lean=(-2, 8, 0)), 0.6, 2.0, 2.8))


def _beckon() -> Gesture:
    out = Hand((0.16, 1.42, 0.54), (-0.1, 0.2, 1), UP, (0.6, -1, 0))
    to = Hand((0.15, 1.55, 0.30), (-0.2, 0.9, -0.3), BACK, (0.6, -1, 0.1))
    keys, cycle = again([Pose(out), Pose(to, head=(-4, 0, 0))], 0.8, 3)
    texts = (
        "a person beckons with the right hand", "waves somebody over, come here", "beckons somebody to come closer",
        "a person calls somebody over with a hand",
    )  # fmt: skip
    return Gesture("beckon", texts, keys, cycle)


def _facepalm() -> Gesture:
    face = Hand((0.015, 1.70, 0.185), (-0.35, 0.9, 0.0), BACK, (0.8, -1, 0.3), "head")
    pose = Pose(face, lean=(8, 0, 0), head=(24, 0, 0))
    shaken = [Pose(face, lean=(8, 0, 0), head=(26, yaw, 0)) for yaw in (8, -8)]
    keys = (
        (0.0, Pose()), (0.7, pose), (1.2, shaken[0]), (1.7, shaken[1]), (2.2, pose), (3.0, Pose()),
    )  # fmt: skip
    texts = ("a person covers the face with the right palm in despair", "does a facepalm", "facepalms")
    return Gesture("facepalm", texts, keys)


def _hands_on_hips() -> Gesture:
    pose = Pose(_ON_HIP, _ON_HIP)
    keys, cycle = again([pose, Pose(_ON_HIP, _ON_HIP, (0, 5, 0), (0, 8, 0))], 3.0, 2)
    texts = (
        "a person stands with the hands on the hips", "puts the hands on the hips", "stands with arms akimbo",
        "poses like a superhero with hands on hips",
    )  # fmt: skip
    return Gesture("hands on hips", texts, keys, cycle)


def _cross_arms() -> Gesture:
    keys, cycle = again([Pose(_CROSSED, _UNDER), Pose(_CROSSED, _UNDER, (2, 4, 0), (3, -8, 3))], 3.0, 2, start=0.9)
    texts = (
        "a person crosses the arms in front of the chest", "stands with folded arms", "crosses the arms",
        "folds the arms and waits",
    )  # fmt: skip
    return Gesture("cross arms", texts, keys, cycle)


def _think() -> Gesture:
    chin = Hand((0.03, 1.575, 0.17), (-0.5, 0.8, 0.1), (-0.3, 0.2, -1), (0.35, -1, 0.45), "head")
    under = Hand((-0.16, 1.24, 0.24), (-0.95, 0.05, 0.1), UP, (0.8, -0.8, 0.1))
    poses = [Pose(chin, under, head=(10, 6, -4)), Pose(chin, under, (0, -3, 0), (4, -8, -6))]
    keys, cycle = again(poses, 3.4, 2, start=0.9)
    texts = (
        "a person thinks with a hand on the chin", "stands thinking, chin on the right hand", "thinks", "ponders",
        "somebody rubs the chin, thinking it over",
    )  # fmt: skip
    return Gesture("think", texts, keys, cycle)


def _cheer() -> Gesture:
    low = Hand((0.30, 1.84, 0.14), (0.1, 1, 0.1), (-0.5, 0, 0.9), (1, -0.2, 0.1))
    poses = [
        Pose(_UP_HIGH, _UP_HIGH, (-4, 0, 0), (-10, 0, 0)),
        Pose(low, low, (-2, 0, 0), (-6, 0, 0), hips=(0, -0.03, 0)),
    ]
    keys, cycle = again(poses, 0.7, 4)
    texts = (
        "a person cheers with both arms up", "somebody cheers with the arms in the air", "cheers",
        "celebrates with both hands in the air", "rejoices",
    )  # fmt: skip
    return Gesture("cheer", texts, keys, cycle)


def _fist_pump() -> Gesture:
    down = Hand((0.24, 1.38, 0.24), (-0.2, 0.7, 0.7), (-1, 0, -0.2), (0.5, -1, -0.6))
    keys, cycle = again([Pose(_FIST_UP, head=(-8, 0, 0)), Pose(down, lean=(6, -5, 0), hips=(0, -0.04, 0))], 0.9, 2)
    texts = ("a person pumps the right fist in victory", "pumps a fist", "celebrates with a fist pump")
    return Gesture("fist pump", texts, keys, cycle)


def _hands_up() -> Gesture:
    up = Hand((0.34, 1.78, 0.08), (0.05, 1, 0), AHEAD, (1, -0.8, -0.1))
    keys, cycle = again([Pose(up, up), Pose(up, up, (2, 0, 0), (4, 5, 0))], 2.4, 2)
    texts = (
        "a person puts both hands up and surrenders", "surrenders with raised hands", "puts the hands up",
        "stands with both hands up in surrender",
    )  # fmt: skip
    return Gesture("surrender", texts, keys, cycle)


def _shake_hands() -> Gesture:
    poses = [
        Pose(Hand((0.08, height, 0.50), (-0.1, 0.05, 1), IN, (0.6, -1, -0.2)), lean=(5, 8, 0))
        for height in (1.24, 1.14)
    ]
    keys, cycle = again(poses, 0.55, 4, start=0.7)
    texts = ("a person shakes hands with somebody in front", "shakes somebody's hand", "shakes hands")
    return Gesture("shake hands", texts, keys, cycle)


def _high_five() -> Gesture:
    ready = Hand((0.24, 1.80, 0.16), (0, 1, -0.1), AHEAD, (1, -0.5, 0))
    slap = Hand((0.14, 1.80, 0.50), (0, 1, 0.1), AHEAD, (0.8, -0.8, 0))
    keys = (
        (0.0, Pose()), (0.6, Pose(ready, lean=(-3, -8, 0))), (0.85, Pose(slap, lean=(6, 12, 0))),
        (1.15, Pose(ready)), (1.8, Pose()),
    )  # fmt: skip
    return Gesture("high five", ("a person gives a high five with the right hand", "gives a high five"), keys)


def _hug() -> Gesture:
    wide = Hand((0.55, 1.42, 0.38), (0.5, 0.1, 1), (-0.9, 0, 0.3), (0.2, -1, -0.2))
    closed = Hand((-0.05, 1.40, 0.42), (-0.9, 0.05, 0.2), (-0.2, 0, -1), (1, -0.6, 0.1))
    low = Hand((-0.05, 1.30, 0.40), (-0.9, -0.1, 0.2), (-0.2, 0, -1), (1, -0.6, 0.1))
    hold = Pose(closed, low, (8, 0, 0), (8, 12, 8))
    keys = ((0.0, Pose()), (0.7, Pose(wide, wide)), (1.5, hold), (2.6, hold), (3.2, Pose(wide, wide)), (3.9, Pose()))
    return Gesture("hug", ("a person opens the arms and hugs somebody", "hugs somebody", "gives a hug"), keys)


def _listen() -> Gesture:
    pose = Pose(_AT_EAR, lean=(8, 10, 8), head=(4, 18, 10))
    texts = ("a person cups the right hand behind the ear to listen", "listens with a hand at the ear", "listens")
    return Gesture("listen", texts, _held(pose, 0.8, 2.6, 3.4))


def _dab() -> Gesture:
    bent = Hand((-0.16, 1.62, 0.30), (-0.85, 0.45, 0.1), (0, -0.6, -0.8), (0.9, -0.1, 0.5))
    straight = Hand((0.66, 1.78, 0.10), (0.9, 0.45, 0.1), DOWN, (0, -1, -0.3))
    pose = Pose(bent, straight, (8, 14, -8), (26, 22, 0), hips=(0, -0.04, 0))
    return Gesture(
        "dab", ("a person dabs, hiding the face in the right elbow", "does the dab", "dabs"), _held(pose, 0.5, 1.5, 2.2)
    )


SIGNS: tuple[Gesture, ...] = (
    _clap(), _wave(), _wave_both(), _nod(), _shake_head(), _shrug(), _point_ahead(), _point_aside(), _point_up(),
    _salute(), _pray(),
    _look_around(), _look_far(), _kiss(), _thumbs_up(), _stop(), _beckon(), _facepalm(), _hands_on_hips(),
    _cross_arms(), _think(), _cheer(), _fist_pump(), _hands_up(), _shake_hands(), _high_five(), _hug(), _listen(),
    _dab(),
)  # fmt: skip
