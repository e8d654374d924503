"""Gestures of what a clause says is done with a thing: touching it, taking and putting it, looking at it, walking on
it.

Constants here were chosen by eye on the reference body, 1.84 m tall, unless they say otherwise.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.gestures.catalogue import gesture_row, hand_row, place_pose, read_places, things_file
from bunraku.gestures.play import SIDES
from bunraku.gestures.pose import (
    HANGING,
    STEP,
    Foot,
    Gesture,
    Hand,
    Key,
    Pose,
    Repeat,
    foot_on,
    mirrored_pose,
    repeated_gesture,
    vector,
)
from bunraku.language.interactions import Contact, Gaze, Handling, Interaction, Terrain


@functools.lru_cache(maxsize=512)
def interaction_gesture(interaction: Interaction) -> Gesture:
    """What a clause says is done with a thing, as a gesture between two rests; a walk goes on."""
    return _GESTURES[type(interaction)](interaction)


# Chosen by eye on sheets of the sentences of benchmarks/things.txt.
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


def _contact_gesture(contact: Contact) -> Gesture:
    row = things_file()["deeds"][contact.deed]
    if "path" not in row:
        shared: dict[str, dict[str, Any]] = {"hands": {}, "feet": {}, "poses": {"rest": {}}}
        named = {kind: common | row.get(kind, {}) for kind, common in shared.items()}
        gesture = gesture_row({"texts": [], **row, "name": contact.deed}, named, {})
        if contact.hands != "left":
            return gesture
        return replace(gesture, keys=tuple((moment, mirrored_pose(pose)) for moment, pose in gesture.keys))
    hands = contact.hands if contact.hands in ("left", "right") else row.get("hands", contact.hands)
    contact = contact._replace(hands=hands, height=row.get("height", contact.height))
    poses = _contact_poses(row, contact)
    if "period" in row:
        return repeated_gesture(contact.deed, poses, row["period"], TIMES, start=START, end=END)
    moment, keys = 0.0, [(0.0, Pose())]
    for seconds, pose in zip(row["seconds"], poses, strict=True):
        moment += seconds
        keys.append((moment, pose))
    keys += [(moment + row["stays"], poses[-1]), (moment + row["stays"] + END, Pose())]
    return Gesture(contact.deed, (), tuple(keys))


def _contact_poses(row: Mapping[str, Any], contact: Contact) -> list[Pose]:
    """The body at each place of a deed's path."""
    base = place_pose(contact.height, contact.way, contact.hands)
    path, count = [np.array(point, float) for point in row["path"]], len(row["path"])
    surfaces = things_file()["surfaces"]
    frame = np.array(surfaces["top" if row.get("up") else contact.surface]["axes"], float)
    face = np.array(surfaces["front" if "height" in row else contact.surface]["axes"], float)
    hold = things_file()["holds"][row.get("hold", surfaces[contact.surface]["hold"])]
    turns = row.get("turn", [0.0] * count)
    poses = []
    for number in range(count):
        hands, goes = {}, np.zeros(3)
        for side, sign in SIDES:
            hand = getattr(base, side)
            if contact.hands not in ("both", side) and not (contact.hands == "one" and side == "right"):
                hands[side] = hand
                continue
            late = count // 2 if row.get("apart") and sign > 0 else 0
            by = path[(number + late) % count] @ frame
            goes += by / (2 if contact.hands == "both" else 1)
            away = _away(hand, contact)
            hands[side] = _on(hand, by + away, hold, face, turns[number])
        share = number / max(count - 1, 1)
        opens, bows = (share * row.get(name, 0.0) for name in ("opens", "bows"))
        poses.append(_followed(replace(base, **hands), goes, opens, bows))
    return poses


def _away(hand: Hand, contact: Contact) -> np.ndarray:
    """How far a hand is beyond where it holds what it has taken, on what stands upright or is high: at arm's length."""
    if (contact.surface == "top" and contact.height < HIGH) or contact.way:
        return np.zeros(3)
    return np.array([0, 0, max(ARM - hand.palm[2], 0.0)])


def _on(hand: Hand, by: np.ndarray, hold: Mapping[str, Sequence[float]], face: np.ndarray, turn: float) -> Hand:
    """A hand moved by an offset, held as on a thing that faces the given way."""
    fingers, faces = (np.array(hold[part], float) @ face for part in ("fingers", "faces"))
    axis = fingers / np.linalg.norm(fingers)
    faces = matrix_from_axis_angle(axis * math.radians(turn)) @ faces
    palm, fingers, faces = (vector(direction) for direction in (np.array(hand.palm) + by, fingers, faces))
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

# Chosen by eye on sheets of the sentences of benchmarks/things.txt.
THERE, STAYS, BACK = 0.9, 0.35, 0.85
"""Seconds from the place before, that hands are there, and from the last place to standing."""
STOOP, SLOWER = 0.9, 0.5
"""Height of a place that is reached without bending [m], and how much longer it takes to bend down to a lower one, or
to get up [s/m].
"""


def _bends(height: str) -> float:
    """Seconds by which it takes longer to bend down to a place, or to get up."""
    return SLOWER * max(STOOP - read_places()[height].one.palm[1], 0.0) if height else 0.0


def _handling_gesture(handling: Handling) -> Gesture:
    """What is held at the beginning is so from the first moment, and what is held at the end stays there."""
    steps = handling.steps
    poses = [place_pose(*step.place, handling.hands, step.does == "hold") for step in steps]
    keys: list[Key] = [] if steps[0].does == "hold" else [(0.0, Pose())]
    moment, before = 0.0, ""
    for step, pose in zip(steps, poses, strict=True):
        low = max(map(_bends, (before, step.place.height)))
        moment += THERE + low if keys else 0.0
        keys.append((moment, pose))
        moment += STAYS
        keys.append((moment, pose))
        before = step.place.height
    if steps[-1].does == "put":
        keys.append((moment + BACK + _bends(before), Pose()))
    return Gesture(NAME, (), tuple(keys), (0.0, moment) if handling.only_held else None)


# Chosen by eye on sheets of the sentences of benchmarks/things.txt.
CHEST = 0.25
"""Share of what the gaze goes up or down, and of what it goes aside, that is the chest's."""
PERIOD, GAZE_TIMES = 6.0, 3
"""Seconds of a gaze to both sides and back, and how often it goes so."""
LEAST = 3.0
"""How far the gaze goes to both sides of a single thing [degrees]."""
GAZE_LEANS = 12.0
"""Lean of the trunk from which on arms keep the balance, and knees bend by so much again [degrees]."""
BENT = 2.0
"""How often so from where on hands are on the knees."""
OUT = Hand((0.36, 0.98, -0.04), (0.3, -0.9, 0.2), (-0.9, 0.0, 0.2), (0.35, 0.0, -1.0))
"""A hand of a body that leans over a depth."""


def _gaze_gesture(gaze: Gaze) -> Gesture:
    poses = [_gaze_pose(gaze, way * max(gaze.sweep, LEAST)) for way in (0.0, 1.0, 1.0, 0.2, -0.9, -0.9)]
    return repeated_gesture("look", poses, PERIOD, GAZE_TIMES, start=1.1, end=1.1)


def _gaze_pose(gaze: Gaze, aside: float) -> Pose:
    share = CHEST if not gaze.lean else 0.0
    lean = (share * gaze.pitch + gaze.lean, CHEST * aside, 0.0)
    head = ((1 - share) * gaze.pitch - 0.3 * gaze.lean, (1 - CHEST) * aside, 0.0)
    if not gaze.lean > GAZE_LEANS:
        return Pose(lean=lean, head=head)
    low = (gaze.lean - GAZE_LEANS) / GAZE_LEANS
    hand = read_places()["low"].other if low > BENT else OUT
    return Pose(right=hand, left=hand, lean=lean, head=head, hips=(0.0, -0.08 * low, -0.08 - 0.02 * low))


STANCE = 0.62
"""Share of a cycle for which a foot is on the ground. In people who walk it is about .6 (Perry 1992)."""
WALK_TIMES = 4
"""Cycles that are laid."""
ROLL = 26.0
"""How far the heel is up when the foot leaves the ground [degrees]."""
STRIKE = 14.0
"""How far the toes are up when it comes down [degrees]."""
ABOUT = 5.0
"""How far pelvis and chest turn against each other [degrees], for steps of a metre."""


@dataclass(frozen=True)
class TerrainGait:
    """A row of `[grounds]`."""

    stride: float  # how far a cycle of two steps goes [m]
    period: float  # how long it takes [s]
    lift: float  # how high an ankle is lifted over the ground [m]
    width: float  # Of a foot from the middle [m]
    sinks: float  # how much lower the pelvis is than in standing [m]
    lean: float  # of the trunk ahead [degrees]
    sway: float  # how far the pelvis goes to the foot that stands [m]
    head: float = 0.0  # how far the head is bent [degrees]
    flat: bool = False  # whether feet are put down flat
    toes: float = 0.0  # how far heels are up all the time [degrees]
    tips: float = 0.0  # how far the trunk tips to both sides, slowly, to keep the balance [degrees]
    looks: float = 0.0  # how far the head turns to both sides [degrees]
    knees: float = 0.15  # how far knees go outwards
    arms: Hand = HANGING  # Of both sides; hanging for none
    right: Hand | None = None  # of the right one, where it is another
    swing: float = 0.0  # how far hands go to and fro [m]
    held: bool = False  # whether hands stay where they are ahead of the pelvis, on what is pushed


@functools.cache
def read_terrain_gaits() -> dict[str, TerrainGait]:
    """The rows of `[grounds]` by their names."""
    gaits = {}
    for name, row in things_file()["grounds"].items():
        hands = {part: hand_row(row[part]) for part in ("arms", "right") if part in row}
        gaits[name] = TerrainGait(**{**row, **hands})
    return gaits


def _walk_gesture(terrain: Terrain) -> Gesture:
    gait = read_terrain_gaits()[terrain.ground]
    if terrain.height:
        out, _, ahead = gait.arms.palm
        gait = replace(gait, arms=replace(gait.arms, palm=(out, terrain.height, ahead)))
    count = round(gait.period / STEP)
    keys = tuple((round(STEP * at, 3), _walk_pose(gait, at / count)) for at in range(WALK_TIMES * count + 1))
    repeat = Repeat(0.0, STEP * count, WALK_TIMES, (0.0, 0.0, gait.stride))
    return Gesture(terrain.ground, (), keys, (0.0, STEP * count * (WALK_TIMES - 1)), steps=True, repeat=repeat)


def _walk_pose(gait: TerrainGait, phase: float) -> Pose:
    """The body after this many cycles; at each whole one the left foot comes down."""
    along = gait.stride * phase
    beat = math.cos(2 * math.pi * (phase - 0.3))  # 1 in the middle of the left foot's stance
    swing = math.cos(2 * math.pi * phase)  # 1 where the left foot is ahead
    about = ABOUT * gait.stride * swing
    bob = 0.018 * math.cos(4 * math.pi * (phase - 0.3)) * min(gait.stride, 1)
    slow = math.sin(math.pi * phase + 0.4)  # over two cycles
    hands = {}
    for side, sign in SIDES:
        hand = gait.right if side == "right" and gait.right is not None else gait.arms
        out, up, ahead = hand.palm
        if gait.held:
            hands[side] = replace(hand, palm=(out, up, ahead + along), on="ground")
            continue
        goes = -sign * swing * gait.swing
        tip = sign * gait.tips / 90 * slow
        fixed = hand is gait.right
        palm = (out, up - tip + (0 if fixed else 0.3 * abs(goes)), ahead + (0 if fixed else goes))
        hands[side] = replace(hand, palm=palm)
    return Pose(
        right=hands["right"], left=hands["left"],
        lean=(gait.lean, about, -0.3 * gait.sway / 0.03 * beat - gait.tips * slow),
        head=(gait.head, -about + gait.looks * math.sin(math.pi * phase), 0.5 * gait.tips * slow),
        hips=(gait.sway * beat, bob - gait.sinks, along), turn=-about,
        right_foot=_walk_foot(gait, phase - 0.5), left_foot=_walk_foot(gait, phase),
    )  # fmt: skip


def _walk_foot(gait: TerrainGait, phase: float) -> Foot:
    """A foot that comes down at each whole cycle, this many cycles after one."""
    cycles = math.floor(phase)
    share, ahead = phase - cycles, 0.5 * STANCE * gait.stride
    strike, roll = (0.0, 6.0) if gait.flat else (-STRIKE, ROLL)
    if gait.toes:
        strike = roll = gait.toes
    place = gait.stride * cycles + ahead
    knee = (gait.knees, 0.0, 1.0)
    if share < STANCE:
        at = share / STANCE
        pitch = strike * max(1 - at / 0.15, 0) + roll * max((at - 0.55) / 0.45, 0) ** 1.5
        if gait.toes:
            pitch = gait.toes
        return replace(foot_on(gait.width, place, pitch), knee=knee)
    at = (share - STANCE) / (1 - STANCE)
    first, last = foot_on(gait.width, place, roll), foot_on(gait.width, place + gait.stride, strike)
    smooth = at**3 * (10 - 15 * at + 6 * at * at)
    up = gait.lift * math.sin(math.pi * min(at**0.8, 1)) ** 1.4
    start, end = np.array(first.ankle), np.array(last.ankle)
    x, y, z = ((1 - smooth) * start + smooth * end).tolist()
    pitch = (1 - smooth) * roll + smooth * strike + (18 * math.sin(math.pi * at) if not gait.flat else 0)
    return Foot((x, y + up, z), pitch, knee=knee)


_GESTURES: dict[type, Callable[[Any], Gesture]] = {
    Contact: _contact_gesture, Handling: _handling_gesture, Gaze: _gaze_gesture, Terrain: _walk_gesture,
}  # fmt: skip
