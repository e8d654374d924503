"""Things that are taken, held and put somewhere: one gesture through the places that a sentence names."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Literal

import numpy as np

from bunraku.geometry.rotations import matrix_y
from bunraku.gestures.catalogue import read_places
from bunraku.gestures.pose import Gesture, Hand, Key, Pose, Vector, again
from bunraku.gestures.standing import SIDES
from bunraku.language.handling import Handling, Station

__all__ = ["handled", "station_pose"]

NAME = "handle"
ASIDE = {"left": 1.0, "aside": 1.0, "right": -1.0, "": 0.0}
"""To the left or to the right; what is put elsewhere goes to the left, and in the mirror image to the right."""
AWAY = 68.0
"""How far from straight ahead a place aside is [degrees]."""
HIPS, CHEST, HEAD = 18.0, 26.0, 14.0
"""How far pelvis, chest and head turn towards it [degrees]."""
OVER = 0.06
"""How far the pelvis goes to that side [m]."""
THERE = {"take": 0.9, "put": 0.95, "hold": 0.85, "touch": 0.8}
"""Seconds from the place before."""
STAYS = {"take": 0.35, "put": 0.3, "hold": 0.5, "touch": 1.6}
"""Seconds that hands are there."""
LOW = {"floor": 0.35, "low": 0.2}
"""Seconds by which it takes longer to bend down, or to get up."""
BACK = 0.85
"""Seconds from the last place to standing."""
AGAIN = 3
"""How often something is done that is done again and again."""


@functools.lru_cache(maxsize=64)
def handled(handling: Handling) -> Gesture:
    """What a sentence says is done with a thing, as a gesture. What is held at its beginning is so from the first
    moment, and what is held at its end stays there.
    """
    poses = [station_pose(one, handling.hands) for one in handling.stations]
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
    if handling.stations[-1].does in ("put", "touch"):
        keys.append((moment + BACK + LOW.get(before, 0.0), Pose()))
    cycle = (0.0, moment) if handling.only_held else None
    return Gesture(NAME, (), tuple(keys), cycle)


def station_pose(station: Station, hands: str) -> Pose:
    """Somebody with both hands, or one of them, at a place.

    Args:
        station: The place, and what is done there: what is held goes along with the chest.
        hands: "both", "left", "right", or "one" for the right one.
    """
    row = read_places()[station.place.height]
    side = ASIDE[station.place.way]
    base, own, other = row["pose"], row["both" if hands == "both" else "one"], row["other"]
    turned = matrix_y(np.array(np.radians(side * AWAY)))
    carrier: Literal["chest", "ground"] = "chest" if station.does == "hold" and not side else "ground"

    def placed(hand: Hand, sign: float) -> Hand:
        out = np.array([sign, 1, 1])
        palm, fingers, faces, elbow = (
            _vector(out * (turned @ (out * np.array(one)))) for one in (hand.palm, hand.fingers, hand.faces, hand.elbow)
        )
        return Hand(palm, fingers, faces, elbow, on=carrier)

    made = {}
    for name, sign in SIDES:
        used = hands in ("both", name) or (hands == "one" and name == "right")
        made[name] = placed(own, sign) if used else other
    hips = matrix_y(np.array(np.radians(side * HIPS))) @ np.array(base.hips) + [side * OVER, 0, 0]
    lean, head = base.lean, base.head
    return replace(
        base, right=made["right"], left=made["left"], hips=_vector(hips), turn=side * HIPS,
        lean=(lean[0], lean[1] + side * CHEST, lean[2]), head=(head[0], head[1] + side * HEAD, head[2]),
    )  # fmt: skip


def _vector(values: np.ndarray) -> Vector:
    x, y, z = values.tolist()
    return x, y, z
