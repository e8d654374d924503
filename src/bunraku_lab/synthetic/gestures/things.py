"""What people do with things that they hold."""

from __future__ import annotations

import math

from bunraku_lab.synthetic.gestures.flow import whirled
from bunraku_lab.synthetic.gestures.pose import AHEAD, IN, UP, Gesture, Hand, Pose, again

__all__ = ["THINGS"]

_MOUTH = Hand((0.035, 1.62, 0.24), (-0.6, 0.6, -0.2), (-0.2, -0.1, -1), (0.9, -0.9, 0.2), "head")
_PLATE = Hand((0.10, 1.16, 0.36), (-0.5, 0.0, 0.85), UP)


def _eat() -> Gesture:
    fetch = Hand((0.04, 1.19, 0.38), (-0.6, -0.2, 0.8))
    poses = [
        Pose(fetch, _PLATE, head=(14, 0, 0)),
        Pose(_MOUTH, _PLATE, head=(6, 0, 0)),
        Pose(_MOUTH, _PLATE, head=(8, 0, 0)),
    ]
    keys, cycle = again(poses, 2.1, 3, start=0.8)
    texts = (
        "a person eats something with the right hand from a plate in the left", "eats something", "eats",
        "somebody lifts food to the mouth again and again", "has a meal", "eats an apple",
    )  # fmt: skip
    return Gesture("eat", texts, keys, cycle)


def _phone() -> Gesture:
    ear = Hand((0.115, 1.68, 0.07), (-0.1, 0.95, 0.3), IN, (0.7, -1, 0.4), "head")
    talk = Hand((0.26, 1.22, 0.34), (-0.2, 0.3, 1), (-0.6, 0.7, 0))
    poses = [Pose(ear, head=(4, -4, -6)), Pose(ear, talk, (0, 6, 0), (0, 10, -6)), Pose(ear, head=(8, -10, -8))]
    keys, cycle = again(poses, 3.6, 2, start=0.8)
    texts = (
        "a person talks on the phone with the right hand at the ear", "makes a phone call", "talks on the phone",
        "somebody phones, one hand at the ear",
    )  # fmt: skip
    return Gesture("phone", texts, keys, cycle)


def _text() -> Gesture:
    def hands(shift: float) -> tuple[Hand, Hand]:
        return (
            Hand((0.06, 1.28 + shift, 0.32), (-0.35, 0.6, 0.7), (-0.3, 0.6, -0.7)),
            Hand((0.06, 1.28 - shift, 0.32), (-0.35, 0.6, 0.7), (-0.3, 0.6, -0.7)),
        )

    poses = [Pose(*hands(shift), head=(28, 0, 0)) for shift in (0.006, -0.006, 0.008, -0.004)]
    keys, cycle = again(poses, 1.2, 4, start=0.8)
    texts = (
        "a person looks down and texts on a phone with both hands", "types a message on the phone",
        "texts on the phone", "looks at a phone",
    )  # fmt: skip
    return Gesture("text", texts, keys, cycle)


def _photo() -> Gesture:
    hold = Hand((0.075, 1.64, 0.36), (-0.3, 0.7, 0.6), (-0.5, 0, 0.8), (0.8, -1, 0.2))
    press = Hand((0.075, 1.635, 0.355), (-0.3, 0.7, 0.6), (-0.5, 0, 0.8), (0.8, -1, 0.2))
    keys = (
        (0.0, Pose()), (0.8, Pose(hold, hold, (3, 0, 0))), (1.7, Pose(hold, hold, (5, 0, 0), (2, 0, 0))),
        (1.85, Pose(press, hold, (5, 0, 0), (2, 0, 0))), (2.5, Pose(hold, hold, (3, 0, 0))), (3.2, Pose()),
    )  # fmt: skip
    texts = ("a person holds up a camera with both hands and takes a photo", "takes a picture", "takes a photo")
    return Gesture("photo", texts, keys)


def _watch() -> Gesture:
    pose = Pose(
        left=Hand((-0.03, 1.30, 0.33), (-0.95, 0.15, 0.2), (0, -0.6, 0.6), (0.9, -0.6, 0)),
        head=(26, 8, 0),
        lean=(3, 4, 0),
    )
    keys = ((0.0, Pose()), (0.7, pose), (2.0, pose), (2.7, Pose()))
    texts = ("a person looks at the watch on the left wrist", "checks the watch", "looks at a watch")
    return Gesture("watch", texts, keys)


def _guitar() -> Gesture:
    def fret(along: float) -> Hand:
        return Hand((0.44 + along, 1.27 + 0.4 * along, 0.30), (-0.3, 0.5, 0.3), (-0.2, 0.2, -1), (0.5, -1, -0.1))

    poses = [
        Pose(
            Hand((0.02, 1.10 + stroke, 0.27), (-0.75, -0.55, 0.15), (0.1, 0.1, -1), (1, 0.1, -0.2)),
            fret(along),
            (4, 4, 0),
            (nod, 8, 0),
        )
        for stroke, along, nod in ((0.07, 0, 6), (-0.07, 0, 12), (0.07, 0.05, 6), (-0.07, 0.05, 12))
    ]
    keys, cycle = again(poses, 1.0, 5, start=0.8)
    texts = (
        "a person plays the guitar, strumming with the right hand", "strums a guitar", "plays the guitar",
        "plays air guitar",
    )  # fmt: skip
    return Gesture("guitar", texts, keys, cycle)


def _piano() -> Gesture:
    def press(out: float, down: bool) -> Hand:
        return Hand((0.16 + out, 1.05 if down else 1.10, 0.46), (-0.05, -0.1 if down else 0.1, 1))

    plan = ((0, True, 0.02, False), (0.06, False, 0.08, True), (0.12, True, 0.04, False), (0.05, False, 0.0, True))
    poses = [Pose(press(a, b), press(c, d), (7, 0, 0), (14, 0, 0)) for a, b, c, d in plan]
    keys, cycle = again(poses, 1.2, 4, start=0.8)
    texts = ("a person plays the piano with both hands", "plays the piano", "plays a keyboard standing")
    return Gesture("piano", texts, keys, cycle)


def _type() -> Gesture:
    poses = [
        Pose(Hand((0.09, 1.06 + a, 0.40)), Hand((0.09, 1.06 + b, 0.40)), (5, 0, 0), (16, 0, 0))
        for a, b in ((0.012, -0.008), (-0.008, 0.014), (0.01, -0.01), (-0.01, 0.006))
    ]
    keys, cycle = again(poses, 0.8, 6, start=0.8)
    texts = ("a person types on a keyboard with both hands", "types on a keyboard", "works at a computer")
    return Gesture("type", texts, keys, cycle)


def _drums() -> Gesture:
    high, low = Hand((0.20, 1.30, 0.40), (-0.3, 0.5, 0.8)), Hand((0.14, 1.08, 0.46), (-0.3, -0.3, 0.9))
    poses = [Pose(low, high, (6, -3, 0), (14, 0, 0)), Pose(high, low, (6, 3, 0), (8, 0, 0))]
    keys, cycle = again(poses, 0.55, 8, start=0.7)
    texts = ("a person plays the drums, one hand after the other", "plays the drums", "drums")
    return Gesture("drums", texts, keys, cycle)


def _violin() -> Gesture:
    neck = Hand((0.40, 1.50, 0.36), (-0.4, 0.6, 0.2), (-0.3, 0.6, -0.7), (0.2, -1, 0.3))

    def bow(out: float) -> Hand:
        return Hand((out, 1.44 - 0.35 * out, 0.38), (-0.8, 0.15, 0.5), (-0.1, -0.9, 0.2), (1, -0.2, 0.1))

    poses = [Pose(bow(0.02), neck, (2, 4, -3), (10, 22, -10)), Pose(bow(0.36), neck, (2, -4, 2), (10, 22, -10))]
    keys, cycle = again(poses, 1.7, 3, start=1.0, end=0.9)
    texts = ("a person plays the violin, the bow in the right hand", "plays the violin", "plays the fiddle")
    return Gesture("violin", texts, keys, cycle)


def _conduct() -> Gesture:
    def beat(out: float, up: float) -> Hand:
        return Hand((out, up, 0.44), (-0.2, 0.5, 0.9), (-0.5, -0.8, 0), (0.8, -1, 0))

    way = ((0.20, 1.55), (0.18, 1.22), (0.08, 1.34), (0.40, 1.36))
    poses = [Pose(beat(*place), beat(*place), (3, 0, 0), (-2, 0, 0)) for place in way]
    keys, cycle = again(poses, 1.8, 3)
    texts = ("a person conducts an orchestra with both hands", "conducts an orchestra", "conducts music with the arms")
    return Gesture("conduct", texts, keys, cycle)


def _knock() -> Gesture:
    poses = [
        Pose(Hand((0.10, height, ahead), (-0.1, 0.8, fall), (0, -0.3, 1), (0.9, -0.7, 0)), lean=(5, 8, 0))
        for height, ahead, fall in ((1.62, 0.40, 0.1), (1.56, 0.60, 0.7))
    ]
    keys, cycle = again(poses, 0.5, 4, start=0.7)
    texts = ("a person knocks on a door with the right hand", "knocks on a door", "knocks")
    return Gesture("knock", texts, keys, cycle)


def _open_door() -> Gesture:
    handle, pulled = Hand((0.14, 1.08, 0.52), (-0.4, 0, 0.9)), Hand((0.34, 1.08, 0.20), (-0.6, 0, 0.8))
    keys = (
        (0.0, Pose()), (0.7, Pose(handle, lean=(6, 8, 0), head=(12, 0, 0))),
        (1.0, Pose(Hand((0.14, 1.05, 0.52), (-0.3, -0.4, 0.9)), lean=(6, 8, 0), head=(12, 0, 0))),
        (1.9, Pose(pulled, lean=(-2, -12, 0))), (2.7, Pose()),
    )  # fmt: skip
    return Gesture("open door", ("a person reaches for the handle and opens a door", "opens a door"), keys)


def _write() -> Gesture:
    pad = Hand((0.08, 1.12, 0.34), (-0.5, 0.1, 0.85), UP)
    poses = [
        Pose(Hand((x, 1.18 + y, 0.34), (-0.6, -0.2, 0.7), (-0.4, -0.8, 0)), pad, head=(28, 4, 0))
        for x, y in ((-0.06, 0.01), (-0.04, -0.01), (-0.01, 0.01), (0.01, -0.01), (0.04, 0.01), (0.06, -0.01))
    ]
    keys, cycle = again(poses, 2.0, 3, start=0.8)
    return Gesture(
        "write", ("a person writes on a pad with the right hand", "writes something down", "writes"), keys, cycle
    )


def _read() -> Gesture:
    cover = Hand((0.12, 1.34, 0.42), (-0.30, 0.55, 0.7), (-0.6, 0.65, -0.5), (0.55, -1, -0.1))
    tongue = Hand((0.02, 1.605, 0.225), (-0.6, 0.75, -0.1), (-0.2, 0, -1), (0.8, -1, 0.2), "head")
    near = Hand((0.12, 1.42, 0.40), (-0.6, 0.6, 0.3), (-0.5, 0, -0.8), (0.8, -0.9, 0.1))
    over = Hand((-0.06, 1.43, 0.39), (-0.9, 0.4, 0.2), (-0.2, -0.2, -0.9), (0.8, -0.7, 0.2))

    def page(*, right: Hand = cover, yaw: float = 0.0, down: float = 30.0) -> Pose:
        return Pose(right, cover, (4, 0, 0), (down, yaw, 0))

    # lines are read from left to right, then the page is turned with a wet finger
    turn = ((0.0, page(yaw=6)), (1.0, page(yaw=-5)), (1.5, page(yaw=6, down=32)), (2.4, page(yaw=-5, down=33)),
            (2.9, page(right=tongue, down=26)), (3.1, page(right=tongue, down=26)), (3.6, page(right=near)),
            (4.2, page(right=over, yaw=6)), (4.8, page(yaw=6)))  # fmt: skip
    keys = [(0.0, Pose()), *((0.9 + 4.8 * turns + time, pose) for turns in range(2) for time, pose in turn[:-1])]
    keys += [(0.9 + 2 * 4.8, page(yaw=6)), (0.9 + 2 * 4.8 + 0.8, Pose())]
    texts = (
        "a person reads a book held in both hands and turns a page", "reads a book", "stands and reads",
        "a person reads a book", "a person is reading a book", "reads a newspaper",
    )  # fmt: skip
    return Gesture("read", texts, tuple(keys), (0.9, 0.9 + 4.8))


def _brush_teeth() -> Gesture:
    poses = [
        Pose(
            Hand((0.10 + along, 1.615, 0.225), (-0.9, 0.25, -0.1), (0.1, -0.5, -0.8), (0.9, -0.3, 0.3), "head"),
            head=(2, 0, 0),
        )
        for along in (0.03, -0.03)
    ]
    keys, cycle = again(poses, 0.4, 8, start=0.7)
    return Gesture("brush teeth", ("a person brushes the teeth with the right hand", "brushes the teeth"), keys, cycle)


def _stir() -> Gesture:
    rim = Hand((0.24, 1.14, 0.46), (-0.4, -0.2, 1), (-1, 0, 0.1), (0.8, -0.7, -0.2))

    def at(phase: float) -> Pose:
        across, ahead = math.cos(2 * math.pi * phase), math.sin(2 * math.pi * phase)
        spoon = Hand(
            (0.02 + 0.13 * across, 1.24, 0.46 + 0.12 * ahead), (-0.4 - 0.2 * across, -0.85, 0.3), (-0.8, 0.1, -0.3),
            (0.9, -0.3 + 0.2 * across, -0.2),
        )  # fmt: skip
        return Pose(spoon, rim, (12 + 2 * ahead, 3 * across, 0), (24, 0, 0), 0.1)

    keys, cycle = whirled(at, 1.25, 6)
    texts = (
        "a person stirs a pot with the right hand", "stirs a pot", "cooks, stirring a pot", "stirs soup in a pot",
        "a person stirs a pot", "stirs with a big spoon",
    )  # fmt: skip
    return Gesture("cook", texts, keys, cycle)


def _cast() -> Gesture:
    gather = Hand((0.12, 1.16, 0.14), (-0.4, 0.2, 0.9), (-0.9, 0, 0.2), (0.7, -0.4, -0.9))
    thrust = Hand((0.09, 1.42, 0.60), (-0.1, 0.85, 0.4), AHEAD, (0.8, -0.8, 0))
    back = Pose(gather, gather, (-4, 10, 0), (4, -8, 0), hips=(0, -0.07, -0.05))
    ahead = Pose(thrust, thrust, (12, 0, 0), (-6, 0, 0), hips=(0, -0.08, 0.07))
    keys = ((0.0, Pose()), (0.8, back), (1.2, back), (1.5, ahead), (2.4, ahead), (3.2, Pose()))
    texts = (
        "a person gathers power at the hip and casts a spell forward with both hands", "casts a spell", "casts magic",
        "throws a fireball with both hands",
    )  # fmt: skip
    return Gesture("cast", texts, keys)


def _sing() -> Gesture:
    microphone = Hand((0.02, 1.56, 0.25), (-0.75, 0.5, -0.2), (-0.4, -0.3, -0.8), (0.8, -1, 0.2), "head")
    low, out = (
        Hand((0.30, 1.14, 0.32), (0.1, 0.1, 1), UP),
        Hand((0.55, 1.48, 0.42), (0.6, 0.4, 0.8), (-0.3, 1, 0), (0.2, -1, 0)),
    )
    poses = [
        Pose(microphone, low, (2, 5, 3), (-4, 0, 0), hips=(0.03, 0, 0)),
        Pose(microphone, out, (-4, -6, -3), (-10, 0, 0), hips=(-0.03, 0, 0)),
    ]
    keys, cycle = again(poses, 2.4, 3, start=0.8)
    texts = ("a person sings into a microphone in the right hand", "sings a song", "sings", "does karaoke")
    return Gesture("sing", texts, keys, cycle)


def _rock_baby() -> Gesture:
    def pose(sway: float) -> Pose:
        near = Hand((-0.06, 1.22, 0.28), (-0.95, 0.15, 0.1), (0, 0.7, -0.7), (0.9, -0.8, 0))
        far = Hand((-0.10, 1.30, 0.28), (-0.9, 0.4, 0.0), (0, 0.3, -0.9), (0.9, -0.8, 0))
        return Pose(near, far, (2, 9 * sway, 3 * sway), (22, 6 * sway, 0), hips=(0.04 * sway, 0, 0))

    keys, cycle = again([pose(1), pose(-1)], 2.0, 3, start=0.9, end=0.9)
    texts = ("a person holds a baby in both arms and rocks it", "rocks a baby", "cradles a baby in the arms")
    return Gesture("rock", texts, keys, cycle)


THINGS: tuple[Gesture, ...] = (
    _eat(), _phone(), _text(), _photo(), _watch(), _guitar(), _piano(), _type(), _drums(), _violin(), _conduct(),
    _knock(), _open_door(), _write(), _read(), _brush_teeth(), _stir(), _cast(), _sing(), _rock_baby(),
)  # fmt: skip
