"""Gestures of what a clause says is done with a thing: touching it, taking and putting it, looking at it, walking on
it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.gestures.catalogue import gesture_row, hand_row, place_pose, read_places, things_file
from bunraku.gestures.pose import (
    HANGING,
    STEP,
    Foot,
    Gesture,
    Hand,
    Key,
    Pose,
    Repeat,
    again,
    foot_on,
    mirrored_pose,
    vector,
)
from bunraku.gestures.standing import SIDES
from bunraku.language.interactions import Contact, Handling, Interaction, Terrain
from bunraku.language.things import Gaze

__all__ = [
    "TerrainGait",
    "contact_gesture",
    "gaze_gesture",
    "interaction_gesture",
    "object_gesture",
    "read_terrain_gaits",
    "walk_gesture",
]


SURFACES = {
    "top": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "front": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "grip": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "body": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
}
"""Across it, off it and along it, in the axes of the body: out, up, ahead; the last for what has `up`."""
HOLDS = {"top": "flat", "front": "flat", "grip": "grip"}
"""How a hand is on what faces so."""
LEANS, GOES = 42.0, 0.22
"""How far the trunk leans after hands that go ahead [degrees/m], and how far the pelvis goes with them [m/m]."""
BENDS, SINKS = 30.0, 0.2
"""The same after hands that go down."""
ARM = 0.5
"""How far ahead things are that stand upright, at the least [m]."""
HIGH = 1.1
"""From where on what faces up is as far away [m]."""
START, END = 0.9, 0.9
"""Seconds from standing to what is done again and again, and back."""
TIMES = 6
"""How often that is done."""


@functools.lru_cache(maxsize=256)
def contact_gesture(contact: Contact) -> Gesture:
    """What hands do with a thing, as a gesture between two rests."""
    row = things_file()["deeds"][contact.deed]
    if "path" not in row:
        made = gesture_row({"texts": [], **row, "name": contact.deed}, _named(row), {})
        return replace(made, keys=tuple((moment, _of_side(pose, contact.hands)) for moment, pose in made.keys))
    hands = contact.hands if contact.hands in ("left", "right") else row.get("hands", contact.hands)
    contact = contact._replace(hands=hands, height=row.get("height", contact.height))
    poses = _poses(row, contact)
    if "period" in row:
        keys, repeat = again(poses, row["period"], TIMES, start=START, end=END)
        return Gesture(contact.deed, (), keys, (repeat.start, repeat.stop - repeat.period), repeat=repeat)
    moment, made_keys = 0.0, [(0.0, Pose())]
    for seconds, pose in zip(row["seconds"], poses, strict=True):
        moment += seconds
        made_keys.append((moment, pose))
    made_keys.append((moment + row["stays"], poses[-1]))
    made_keys.append((moment + row["stays"] + END, Pose()))
    return Gesture(contact.deed, (), tuple(made_keys))


def _named(row: Mapping[str, Any]) -> dict[str, Any]:
    shared: dict[str, dict[str, Any]] = {"hands": {}, "feet": {}, "poses": {"rest": {}}}
    return {kind: {**common, **row.get(kind, {})} for kind, common in shared.items()}


def _of_side(pose: Pose, hands: str) -> Pose:
    """A pose of the right hand as one of the hand that is named."""
    return mirrored_pose(pose) if hands == "left" else pose


def _poses(row: Mapping[str, Any], contact: Contact) -> list[Pose]:
    """The body at each place of a deed's path."""
    base = place_pose(contact.height, contact.way, contact.hands)
    path, count = [np.array(one, float) for one in row["path"]], len(row["path"])
    frame = np.array(SURFACES["body" if row.get("up") else contact.surface], float)
    face = np.array(SURFACES["front" if "height" in row else contact.surface], float)
    hold = things_file()["holds"][row.get("hold", HOLDS[contact.surface])]
    turns = row.get("turn", [0.0] * count)
    found = []
    for number in range(count):
        hands, goes = {}, np.zeros(3)
        for side, sign in SIDES:
            own = getattr(base, side)
            if contact.hands not in ("both", side) and not (contact.hands == "one" and side == "right"):
                hands[side] = own
                continue
            late = count // 2 if row.get("apart") and sign > 0 else 0
            by = path[(number + late) % count] @ frame
            goes += by / (2 if contact.hands == "both" else 1)
            away = _away(own, contact)
            hands[side] = _on(own, by + away, hold, face, turns[number])
        share = number / max(count - 1, 1)
        opens, bows = (share * row.get(name, 0.0) for name in ("opens", "bows"))
        found.append(_followed(replace(base, **hands), goes, opens, bows))
    return found


def _away(hand: Hand, contact: Contact) -> np.ndarray:
    """How far a hand is beyond where it holds what it has taken, on what stands upright or is high: at arm's length."""
    if (contact.surface == "top" and contact.height < HIGH) or contact.way:
        return np.zeros(3)
    return np.array([0, 0, max(ARM - hand.palm[2], 0.0)])


def _on(hand: Hand, by: np.ndarray, hold: Mapping[str, Sequence[float]], face: np.ndarray, turn: float) -> Hand:
    """A hand so far from where it is, held as it is on a thing that faces so."""
    fingers, faces = (np.array(hold[part], float) @ face for part in ("fingers", "faces"))
    axis = fingers / np.linalg.norm(fingers)
    faces = matrix_from_axis_angle(axis * math.radians(turn)) @ faces
    palm, fingers, faces = (vector(one) for one in (np.array(hand.palm) + by, fingers, faces))
    return replace(hand, palm=palm, fingers=fingers, faces=faces)


def _followed(pose: Pose, goes: np.ndarray, opens: float, bows: float) -> Pose:
    """A pose whose trunk and pelvis go with hands that go so far from where they were at first [m], turn so far to the
    left, and lean so far over them [degrees].
    """
    _, up, ahead = goes.tolist()
    down = min(up, 0.0)
    x, y, z = pose.hips
    lean, head = pose.lean, pose.head
    hips = (x, y + SINKS * down, z + GOES * ahead - 0.005 * bows)
    leans = (lean[0] + LEANS * ahead - BENDS * down + bows, lean[1] + 0.5 * opens, lean[2])
    looks = (head[0], head[1] - 0.4 * opens, head[2])  # at what is opened
    return replace(pose, hips=hips, lean=leans, head=looks, turn=pose.turn + 0.5 * opens)


NAME = "handle"
THERE = {"take": 0.9, "put": 0.95, "hold": 0.85}
"""Seconds from the place before."""
STAYS = {"take": 0.35, "put": 0.3, "hold": 0.5}
"""Seconds that hands are there."""
LOW = {"floor": 0.35, "low": 0.2}
"""Seconds by which it takes longer to bend down, or to get up."""
BACK = 0.85
"""Seconds from the last place to standing."""
AGAIN = 3
"""How often something is done that is done again and again."""


@functools.lru_cache(maxsize=64)
def object_gesture(handling: Handling) -> Gesture:
    """What a sentence says is done with a thing, as a gesture. What is held at its beginning is so from the first
    moment, and what is held at its end stays there.
    """
    places = [(one.place, one.does == "hold") for one in handling.stations]
    poses = [place_pose(place.height, place.way, handling.hands, held) for place, held in places]
    if handling.repeated:
        played, repeat = again(poses, 0.9 * len(poses), AGAIN, start=1.1, end=1.1)
        return Gesture(NAME, (), played, (repeat.start, repeat.stop - repeat.period), repeat=repeat)
    keys: list[Key] = [] if handling.stations[0].does == "hold" else [(0.0, Pose())]
    moment, before = 0.0, ""
    for station, pose in zip(handling.stations, poses, strict=True):
        low = max(LOW.get(height, 0.0) for height in (before, station.place.height))
        moment += THERE[station.does] + low if keys else 0.0
        keys.append((moment, pose))
        moment += STAYS[station.does]
        keys.append((moment, pose))
        before = station.place.height
    if handling.stations[-1].does == "put":
        keys.append((moment + BACK + LOW.get(before, 0.0), Pose()))
    cycle = (0.0, moment) if handling.only_held else None
    return Gesture(NAME, (), tuple(keys), cycle)


CHEST = 0.25
"""Share of what the gaze goes up or down, and of what it goes aside, that is the chest's."""
PERIOD, GAZE_TIMES = 6.0, 3
"""Seconds of a gaze to both sides and back, and how often it goes so."""
LEAST = 3.0
"""How far it goes to both sides of who looks at one thing [degrees]."""
GAZE_LEANS = 12.0
"""Lean of the trunk from which on arms keep the balance, and knees bend by so much again [degrees]."""
BENT = 2.0
"""How often so from where on hands are on the knees."""
OUT = Hand((0.36, 0.98, -0.04), (0.3, -0.9, 0.2), (-0.9, 0.0, 0.2), (0.35, 0.0, -1.0))
"""A hand of who leans over a depth."""


@functools.lru_cache(maxsize=64)
def gaze_gesture(sight: Gaze) -> Gesture:
    """A look at something, as a gesture."""
    ways = (0.0, 1.0, 1.0, 0.2, -0.9, -0.9)
    poses = [_turned(sight, way * max(sight.sweep, LEAST)) for way in ways]
    keys, repeat = again(poses, PERIOD, GAZE_TIMES, start=1.1, end=1.1)
    return Gesture("look", (), keys, (repeat.start, repeat.stop - repeat.period), repeat=repeat)


def _turned(sight: Gaze, aside: float) -> Pose:
    share = CHEST if not sight.lean else 0.0
    lean = (share * sight.pitch + sight.lean, CHEST * aside, 0.0)
    head = ((1 - share) * sight.pitch - 0.3 * sight.lean, (1 - CHEST) * aside, 0.0)
    if not sight.lean > GAZE_LEANS:
        return Pose(lean=lean, head=head)
    low = max(sight.lean - GAZE_LEANS, 0.0) / GAZE_LEANS
    hand = read_places()["low"].other if low > BENT else OUT
    return Pose(right=hand, left=hand, lean=lean, head=head, hips=(0.0, -0.08 * low, -0.08 - 0.02 * low))


STANCE = 0.62
"""Share of a cycle for which a foot is on the ground."""
WALK_TIMES = 4
"""Cycles that are laid."""
ROLL = 26.0
"""How far the heel of who walks is up when the foot leaves the ground [degrees]."""
STRIKE = 14.0
"""How far the toes are up when it comes down [degrees]."""
ABOUT = 5.0
"""How far pelvis and chest turn against each other [degrees], for steps of a metre."""


@dataclass(frozen=True)
class TerrainGait:
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
def read_terrain_gaits() -> dict[str, TerrainGait]:
    """The rows of `[grounds]` by their names."""
    found = {}
    for name, row in things_file()["grounds"].items():
        hands = {part: hand_row(row[part]) for part in ("arms", "right") if part in row}
        found[name] = TerrainGait(**{**row, **hands})
    return found


@functools.lru_cache(maxsize=64)
def walk_gesture(footing: Terrain) -> Gesture:
    """A walk as a gesture that goes on."""
    tread = read_terrain_gaits()[footing.ground]
    if footing.height:
        out, _, ahead = tread.arms.palm
        tread = replace(tread, arms=replace(tread.arms, palm=(out, footing.height, ahead)))
    count = round(tread.period / STEP)
    keys = tuple((round(STEP * number, 3), _pose(tread, number / count)) for number in range(WALK_TIMES * count + 1))
    repeat = Repeat(0.0, STEP * count, WALK_TIMES, (0.0, 0.0, tread.stride))
    return Gesture(footing.ground, (), keys, (0.0, STEP * count * (WALK_TIMES - 1)), steps=True, repeat=repeat)


def _pose(tread: TerrainGait, phase: float) -> Pose:
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


def _foot(tread: TerrainGait, phase: float) -> Foot:
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


def interaction_gesture(told: Interaction) -> Gesture:
    """The gesture of one of the forms of `Told`."""
    if isinstance(told, Handling):
        return object_gesture(told)
    if isinstance(told, Contact):
        return contact_gesture(told)
    return walk_gesture(told) if isinstance(told, Terrain) else gaze_gesture(told)
