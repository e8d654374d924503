"""A walk on or in something, made by code: long or short steps, feet lifted high or slid, arms out for balance."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from bunraku.gestures.catalogue import hand_row
from bunraku.gestures.flow import STEP, foot_on
from bunraku.gestures.places import things_file
from bunraku.gestures.pose import HANGING, Foot, Gesture, Hand, Pose, Repeat
from bunraku.language.footing import Footing

__all__ = ["Tread", "read_treads", "trodden"]

STANCE = 0.62
"""Share of a cycle for which a foot is on the ground."""
TIMES = 4
"""Cycles that are laid."""
ROLL = 26.0
"""How far the heel of who walks is up when the foot leaves the ground [degrees]."""
STRIKE = 14.0
"""How far the toes are up when it comes down [degrees]."""
ABOUT = 5.0
"""How far pelvis and chest turn against each other [degrees], for steps of a metre."""


@dataclass(frozen=True)
class Tread:
    """A row of `[grounds]`.

    Args:
        stride: How far a cycle of two steps goes [m].
        period: How long it takes [s].
        lift: How high an ankle is lifted over the ground [m].
        width: Of a foot from the middle [m].
        sinks: How much lower the pelvis is than in who stands [m].
        lean: Of the trunk ahead [degrees].
        sway: How far the pelvis goes to the foot that stands [m].
        head: How far the head is bent [degrees].
        flat: Whether feet are put down flat.
        toes: How far heels are up all the time [degrees].
        tips: How far the trunk tips to both sides, slowly, in who keeps the balance [degrees].
        looks: How far the head turns to both sides [degrees].
        knees: How far knees go outwards.
        arms: Of both sides; hanging for none.
        right: Of the right one, where it is another.
        swing: How far hands go to and fro [m].
        held: Whether hands stay where they are ahead of the pelvis, on what is pushed.
    """

    stride: float
    period: float
    lift: float
    width: float
    sinks: float
    lean: float
    sway: float
    head: float = 0.0
    flat: bool = False
    toes: float = 0.0
    tips: float = 0.0
    looks: float = 0.0
    knees: float = 0.15
    arms: Hand = HANGING
    right: Hand | None = None
    swing: float = 0.0
    held: bool = False


@functools.cache
def read_treads() -> dict[str, Tread]:
    """The rows of `[grounds]` by their names."""
    found = {}
    for name, row in things_file()["grounds"].items():
        hands = {part: hand_row(row[part]) for part in ("arms", "right") if part in row}
        found[name] = Tread(**{**row, **hands})
    return found


@functools.lru_cache(maxsize=64)
def trodden(footing: Footing) -> Gesture:
    """A walk as a gesture that goes on."""
    tread = read_treads()[footing.ground]
    if footing.height:
        out, _, ahead = tread.arms.palm
        tread = replace(tread, arms=replace(tread.arms, palm=(out, footing.height, ahead)))
    count = round(tread.period / STEP)
    keys = tuple((round(STEP * number, 3), _pose(tread, number / count)) for number in range(TIMES * count + 1))
    repeat = Repeat(0.0, STEP * count, TIMES, (0.0, 0.0, tread.stride))
    return Gesture(footing.ground, (), keys, (0.0, STEP * count * (TIMES - 1)), steps=True, repeat=repeat)


def _pose(tread: Tread, phase: float) -> Pose:
    """The body after so many cycles; at each whole one the left foot comes down."""
    along = tread.stride * phase
    feet = {"left": _foot(tread, phase), "right": _foot(tread, phase - 0.5)}
    beat = math.cos(2 * math.pi * (phase - 0.3))  # 1 in the middle of the left foot's stance
    swing = math.cos(2 * math.pi * phase)  # 1 where the left foot is ahead
    about = ABOUT * tread.stride * swing
    bob = 0.018 * math.cos(4 * math.pi * (phase - 0.3)) * min(tread.stride, 1)
    slow = math.sin(math.pi * phase + 0.4)  # over two cycles
    hands = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        hand = tread.right if side == "right" and tread.right is not None else tread.arms
        out, up, ahead = hand.palm
        if tread.held:
            hands[side] = replace(hand, palm=(out, up, ahead + along), on="ground")
            continue
        goes = -sign * swing * tread.swing
        tip = sign * tread.tips / 90 * slow
        fixed = hand is tread.right
        palm = (out, up - tip + (0 if fixed else 0.3 * abs(goes)), ahead + (0 if fixed else goes))
        hands[side] = replace(hand, palm=palm)
    return Pose(
        right=hands["right"], left=hands["left"],
        lean=(tread.lean, about, -0.3 * tread.sway / 0.03 * beat - tread.tips * slow),
        head=(tread.head, -about + tread.looks * math.sin(math.pi * phase), 0.5 * tread.tips * slow),
        hips=(tread.sway * beat, bob - tread.sinks, along), turn=-about,
        right_foot=feet["right"], left_foot=feet["left"],
    )  # fmt: skip


def _foot(tread: Tread, phase: float) -> Foot:
    """A foot that comes down at each whole cycle, so many cycles after one."""
    whole = math.floor(phase)
    share, ahead = phase - whole, 0.5 * STANCE * tread.stride
    strike, roll = (0.0, 6.0) if tread.flat else (-STRIKE, ROLL)
    if tread.toes:
        strike = roll = tread.toes
    place = tread.stride * whole + ahead
    knee = (tread.knees, 0.0, 1.0)
    if share < STANCE:
        at = share / STANCE
        pitch = strike * max(1 - at / 0.15, 0) + roll * max((at - 0.55) / 0.45, 0) ** 1.5
        if tread.toes:
            pitch = tread.toes
        return replace(foot_on(tread.width, place, pitch), knee=knee)
    at = (share - STANCE) / (1 - STANCE)
    first, last = foot_on(tread.width, place, roll), foot_on(tread.width, place + tread.stride, strike)
    smooth = at**3 * (10 - 15 * at + 6 * at * at)
    up = tread.lift * math.sin(math.pi * min(at**0.8, 1)) ** 1.4
    start, end = np.array(first.ankle), np.array(last.ankle)
    x, y, z = ((1 - smooth) * start + smooth * end).tolist()
    pitch = (1 - smooth) * roll + smooth * strike + (18 * math.sin(math.pi * at) if not tread.flat else 0)
    return Foot((x, y + up, z), pitch, knee=knee)
