"""Hands at a thing where it is: the deeds of `things.toml`, as high and on the side as what they are done with."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.gestures.catalogue import gesture_row
from bunraku.gestures.places import place_pose, things_file
from bunraku.gestures.pose import Gesture, Hand, Pose, again, mirrored_pose, vector
from bunraku.gestures.standing import SIDES
from bunraku.language.contact import Contact

__all__ = ["touched"]

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
def touched(contact: Contact) -> Gesture:
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
