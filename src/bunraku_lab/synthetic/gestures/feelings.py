"""How people show that they are cold, tired, sad, ill, or strong."""

from __future__ import annotations

import math

from bunraku_lab.synthetic.gestures.pose import BACK, IN, Gesture, Hand, Pose, again

__all__ = ["FEELINGS"]


def _scratch() -> Gesture:
    poses = [
        Pose(Hand((0.07, 1.86, along), (-0.75, 0.4, -0.4), (-0.4, -0.9, 0), (1, 0.1, 0.3), "head"), head=(10, 8, 4))
        for along in (0.05, -0.01)
    ]
    keys, cycle = again(poses, 0.45, 5, start=0.8)
    texts = ("a person scratches the head with the right hand", "scratches the head, puzzled", "scratches the head")
    return Gesture("scratch", texts, keys, cycle)


def _shiver() -> Gesture:
    arms = Hand((-0.15, 1.34, 0.17), (-0.8, 0.5, -0.2), (0, 0, -1), (0.8, -0.7, 0.3))
    under = Hand((-0.14, 1.27, 0.20), (-0.8, 0.5, -0.1), (0, 0, -1), (0.8, -0.7, 0.3))
    poses = [Pose(arms, under, (14, yaw, 0), (12, -yaw, 0), 0.7, (0, -0.04, 0)) for yaw in (2.2, -2.2)]
    keys, cycle = again(poses, 0.25, 14, start=0.9, end=0.8)
    texts = (
        "a person shivers with cold, the arms around the chest",
        "trembles, arms wrapped around the body",
        "shivers",
        "freezes in the cold",
    )
    return Gesture("shiver", texts, keys, cycle)


def _yawn() -> Gesture:
    mouth = Hand((0.02, 1.63, 0.235), (-0.8, 0.4, -0.1), (-0.1, 0, -1), (0.9, -0.7, 0.3), "head")
    reach = Hand((0.36, 1.98, 0.0), (0.2, 1, -0.1), (-0.4, 0, 0.9), (1, 0, -0.2))
    wide = Pose(mouth, reach, (-9, 0, -5), (-16, 0, 5), 0.4)
    keys = ((0.0, Pose()), (1.2, wide), (2.4, wide), (3.6, Pose()))
    texts = (
        "a person yawns with the right hand at the mouth and stretches the left arm",
        "yawns",
        "is tired and yawns",
    )
    return Gesture("yawn", texts, keys)


def _stretch() -> Gesture:
    up = Hand((0.10, 2.10, 0.0), (-0.2, 1, -0.1), (-0.3, 0, 0.9), (1, 0, 0.1))
    long, bent = Pose(up, up, (-8, 0, 0), (-14, 0, 0), 0.6), Pose(up, up, (-4, 0, 14), (-6, 0, 4), 0.6)
    other = Pose(up, up, (-4, 0, -14), (-6, 0, -4), 0.6)
    keys = ((0.0, Pose()), (1.1, long), (1.9, long), (2.6, bent), (3.4, other), (4.5, Pose()))
    texts = (
        "a person stretches both arms overhead and bends to each side", "stretches the arms overhead",
        "a person stretches", "stretches after waking up",
    )  # fmt: skip
    return Gesture("stretch", texts, keys)


def _cover_ears() -> Gesture:
    ears = Hand((0.115, 1.71, 0.05), (-0.1, 0.95, -0.2), IN, (1, -0.4, 0.3), "head")
    keys, cycle = again([Pose(ears, ears, (10, 0, 0), (16, 0, 0)), Pose(ears, ears, (14, 4, 0), (20, -6, 0))], 1.6, 2)
    texts = ("a person covers both ears with the hands", "covers the ears", "holds the ears shut against noise")
    return Gesture("cover ears", texts, keys, cycle)


def _cry() -> Gesture:
    face = Hand((0.045, 1.69, 0.185), (-0.25, 0.9, 0.0), BACK, (0.9, -1, 0.2), "head")
    poses = [
        Pose(face, face, (16 + sob, 0, 0), (22, 0, 0), shrug) for sob, shrug in ((0, 0.1), (4, 0.5), (0, 0.2), (3, 0.6))
    ]
    keys, cycle = again(poses, 1.8, 2, start=0.9, end=0.9)
    texts = (
        "a person cries with the face in both hands", "weeps, hands over the face", "cries",
        "covers the face with both hands", "sobs",
    )  # fmt: skip
    return Gesture("cry", texts, keys, cycle)


def _cough() -> Gesture:
    fist = Hand((0.02, 1.63, 0.235), (-0.9, 0.3, 0.0), (-0.1, 0, -1), (0.9, -0.8, 0.2), "head")
    poses = [Pose(fist, lean=(4, 0, 0), head=(6, 0, 0)), Pose(fist, lean=(17, 0, 0), head=(16, 0, 0), shrug=0.4)]
    keys, cycle = again(poses, 0.5, 3, start=0.6)
    texts = ("a person coughs into the right fist", "coughs", "somebody coughs hard, bending forward")
    return Gesture("cough", texts, keys, cycle)


def _sneeze() -> Gesture:
    face = Hand((0.02, 1.66, 0.25), (-0.8, 0.5, 0.0), (-0.1, 0, -1), (0.9, -0.8, 0.2), "head")
    back = Pose(face, lean=(-9, 0, 0), head=(-18, 0, 0), shrug=0.5)
    keys = (
        (0.0, Pose()),
        (1.0, back),
        (1.25, Pose(face, lean=(28, 0, 0), head=(24, 0, 0))),
        (1.7, Pose(face, lean=(18, 0, 0), head=(14, 0, 0))),
        (2.6, Pose()),
    )
    return Gesture("sneeze", ("a person sneezes into the right hand", "sneezes"), keys)


def _flex() -> Gesture:
    up = Hand((0.36, 1.72, 0.05), (-0.7, 0.6, 0.0), (-0.6, -0.7, 0), (0.6, -0.8, -0.3))
    hard = Hand((0.30, 1.73, 0.05), (-0.8, 0.4, 0.0), (-0.6, -0.8, 0), (0.6, -0.8, -0.3))
    keys, cycle = again([Pose(up, up), Pose(hard, hard, (-4, 0, 0), (-4, 10, 0), 0.2)], 1.2, 3, start=0.8)
    texts = (
        "a person flexes both biceps like a bodybuilder",
        "flexes the muscles",
        "flexes the biceps",
        "shows off the muscles",
    )
    return Gesture("flex", texts, keys, cycle)


def _rub_hands() -> Gesture:
    def rub(ahead: float) -> Hand:
        return Hand((0.014, 1.28, 0.34 + ahead), (-0.25, 0.35, 0.9), IN, (1, -0.8, 0))

    poses = [Pose(rub(0.045), rub(-0.045), (4, 0, 0), (10, 0, 0)), Pose(rub(-0.045), rub(0.045), (4, 0, 0), (8, 0, 0))]
    keys, cycle = again(poses, 0.5, 8)
    texts = ("a person rubs the hands together", "rubs the hands", "warms the hands by rubbing them")
    return Gesture("rub hands", texts, keys, cycle)


def _wipe_brow() -> Gesture:
    here = Hand((0.08, 1.79, 0.175), (-0.9, 0.3, 0.1), BACK, (1, -0.4, 0.3), "head")
    there = Hand((-0.06, 1.79, 0.175), (-0.9, 0.3, 0.1), BACK, (1, -0.4, 0.3), "head")
    flick = Hand((0.40, 1.20, 0.30), (0.4, -0.4, 0.8))
    keys = (
        (0.0, Pose()),
        (0.7, Pose(there, head=(6, 0, 0))),
        (1.3, Pose(here, head=(8, -4, 0))),
        (1.8, Pose(flick)),
        (2.4, Pose()),
    )
    return Gesture("wipe brow", ("a person wipes sweat off the forehead with the right hand", "wipes the brow"), keys)


def _rub_belly() -> Gesture:
    poses = [
        Pose(
            Hand(
                (0.02 + 0.06 * math.cos(turn), 1.12 + 0.05 * math.sin(turn), 0.185),
                (-0.9, 0.1, 0.1),
                BACK,
                (0.9, -0.6, 0),
            ),
            head=(12, 0, 0),
        )
        for turn in (0, math.pi / 2, math.pi, 3 * math.pi / 2)
    ]
    keys, cycle = again(poses, 1.1, 4, start=0.8)
    return Gesture(
        "rub belly",
        ("a person rubs the belly with the right hand", "rubs the belly", "has a stomach ache"),
        keys,
        cycle,
    )


FEELINGS: tuple[Gesture, ...] = (
    _scratch(), _shiver(), _yawn(), _stretch(), _cover_ears(), _cry(),
    _cough(), _sneeze(), _flex(), _rub_hands(), _wipe_brow(), _rub_belly(),
)  # fmt: skip
