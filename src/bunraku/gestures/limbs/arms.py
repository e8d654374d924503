"""Hands where a sentence says: at a part of the body, on the floor, or at the end of an arm that goes somewhere."""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.body.reference import reference_body
from bunraku.gestures.catalogue import pose_row, read_parts
from bunraku.gestures.pose import Hand, Pose, vector
from bunraku.gestures.standing import AT, SIDES
from bunraku.language.limbs.phrases import Target
from bunraku.language.limbs.posing import Stance

__all__ = ["ARM", "LOW", "hand_of", "low_place", "postures"]

FILE = Path(__file__).with_name("postures.toml")
ARM = 0.625
"""From the shoulder to the palm of a straight arm [m]."""
RISES = {"hip": -50.0, "chest": -14.0, "shoulder": 0.0, "head": 28.0}
"""How far a straight arm is over the level by the height that its hand has [degrees]."""
LOW = {"knee": "knee", "leg": "ankle", "heel": "ankle", "buttocks": "hip", "floor": ""}
"""Places that hands reach by bending, with the joint that each is at."""


@functools.cache
def postures(section: str) -> dict[str, Pose]:
    rows: dict[str, dict[str, Any]] = tomllib.loads(FILE.read_text(encoding="utf-8"))[section]
    nothing: dict[str, Mapping[str, Any]] = {"hands": {}, "feet": {}}
    return {name: pose_row({"right": row} if section == "hands" else row, nothing) for name, row in rows.items()}


def low_place(target: Target, side: str, positions: np.ndarray) -> np.ndarray | None:
    """Where a hand is on the legs or on the floor, in the world [m], shape (3,); None for other places."""
    sign = dict(SIDES)[side]
    own = target.at_side or side
    if target.at == "floor":
        pelvis = positions[AT["pelvis"]]
        behind = "back" in target.ways or target.by == "behind"
        ahead = -0.3 if behind else 0.3
        return np.array([pelvis[0] + sign * 0.22, 0.03, pelvis[2] + ahead])
    joint = LOW.get(target.at)
    if not joint:
        return None
    if (
        target.at == "knee"
        and not target.at_side
        and abs(np.ptp(positions[[AT["left_knee"], AT["right_knee"]], 1])) > 0.2
    ):
        own = max(("left", "right"), key=lambda name: positions[AT[f"{name}_knee"], 1])  # the knee that is up
    place = positions[AT[f"{own}_{joint}"]]
    hip = positions[AT[f"{own}_hip"]]
    if target.at == "buttocks":
        return place + np.array([0, -0.05, -0.12])
    along = place - hip
    out = np.array([0, 0, 1.0]) - along * along[2] / max(float(along @ along), 1e-6)
    out = out if np.linalg.norm(out) > 0.3 else np.array([0, 1.0, 0])
    return place + 0.075 * out / np.linalg.norm(out) + np.array([0, 0.02, 0])


def hand_of(
    target: Target, side: str, sign: float, stance: Stance, rotations: np.ndarray, positions: np.ndarray
) -> Hand:
    """How a hand is held."""
    hands, parts, ways = postures("hands"), read_parts(), target.ways
    low = low_place(target, side, positions)
    if low is not None:
        down = (0.1, -0.3, 1.0) if target.at == "floor" and "back" not in ways else (-0.2, -0.5, 0.8)
        down = (0.3, -0.3, -1.0) if target.at == "floor" and "back" in ways else down
        return Hand(vector(low * [sign, 1, 1]), down, elbow=(0.8, 0.1, -0.7), on="ground")
    behind = target.by == "behind" and target.at in ("back", "trunk", "hip", "buttocks", "belly")
    if behind or ways >= {"crossed", "back"}:
        return hands["behind"].right
    if target.by == "behind" and target.at in ("head", "back-head", "neck"):
        return parts["back-head"][1].right
    if target.by == "above" and target.at == "head":
        ways = ways | {"up"}
    elif target.at == "hip" and target.by == "on":
        return hands["hip"].right
    elif target.at in parts and target.by in ("on", "front", "under", "above"):
        return _at_part(target, side, parts[target.at][1].right)
    if "crossed" in ways:
        return hands["crossed" if side == "right" else "under"].right
    if target.limb == "elbow" and "bent" not in ways:
        return hands["elbows-front" if ways & {"together", "ahead"} else "elbows"].right
    if ways <= {"bent"}:
        return hands["bent"].right
    if "together" in ways and not ways & {"up", "down"}:
        return hands["together"].right
    return _stretched(target._replace(ways=ways), side, sign, stance, rotations, positions)


def _at_part(target: Target, side: str, hand: Hand) -> Hand:
    """A hand at a part of the body, or in front of it."""
    x, y, z = hand.palm
    if target.at == "shoulder" and target.at_side == side:
        x, hand = 0.2, replace(hand, elbow=(0.8, -0.6, 0.9))
    if target.side == "both":
        x = max(x, 0.03 if "together" in target.ways else 0.07)
        if target.at == "shoulder":
            x = -0.13
    if target.by == "front":
        return replace(hand, palm=(max(x, 0.06), y, z + 0.15), fingers=(-0.5, 0.6, 0.5), faces=(-0.6, 0.1, -0.6))
    return replace(hand, palm=(x, y, z))


def _stretched(
    target: Target, side: str, sign: float, stance: Stance, rotations: np.ndarray, positions: np.ndarray
) -> Hand:
    """A hand of an arm that goes into a direction, straight or bent."""
    ways, far = target.ways, target.amount
    chest, shoulder = rotations[AT["spine3"]], positions[AT[f"{side}_shoulder"]]
    aside = 1.0 if "side" in ways or side in ways else 0.0
    across = 1.0 if {"left", "right"} & ways and side not in ways else 0.0
    aside -= 0.9 * across
    along = float("ahead" in ways) - float("back" in ways)
    if target.by == "level" and not aside and not along:
        along = 1.0
    across_chest = chest[:, 0]  # an arm out to the side goes with the chest
    onward = np.cross(across_chest * [1, 0, 1], [0, 1.0, 0])
    level = sign * aside * across_chest + along * onward / max(float(np.linalg.norm(onward)), 1e-6)
    up = float("up" in ways) - float("down" in ways)
    if target.by == "level":
        rises = RISES[target.at]
    elif level.any():
        rises = 50.0 * up if up else 0.0
        if "back" in ways and not up:
            rises = -32.0
        if target.amount < 1:
            rises = -90 + (90 + rises) * target.amount
        elif target.amount > 1 and up >= 0 and ways & {"up"}:
            rises = 65.0
    else:
        rises = (90.0 if far >= 1 else -90 + 180 * 0.75 * far) if up > 0 else -86.0
        level = np.array([sign * 0.2, 0, 0.25 if far >= 1 or up < 0 else 1.0])
    level = level / max(float(np.linalg.norm(level)), 1e-6)
    rise = np.radians(rises)
    way = np.cos(rise) * level + np.sin(rise) * np.array([0, 1.0, 0])
    if abs(rises) > 85:
        way = np.array([sign * 0.08, np.sign(rises), 0.06])
        way /= np.linalg.norm(way)
    if stance.name == "back":  # ahead of the chest is up
        way = chest @ way
    elif stance.name == "belly":  # and overhead ahead
        overhead = bool(ways & {"ahead", "up"}) and "side" not in ways
        way = chest @ (np.array([sign * 0.12, 1.0, 0.05]) if overhead else np.array([way[0], min(way[1], 0.0), 0.05]))
    reach = ARM * (0.72 if "bent" in ways else 1.2)  # farther than it reaches, so that it stays straight
    goal = shoulder + reach * way
    if "together" in ways:
        goal[0] = positions[AT["spine3"], 0] + sign * 0.02
    goal[1] = max(goal[1], 0.05)
    rest = reference_body().joints.astype(float)[AT["spine3"]]
    palm = chest.T @ (goal - positions[AT["spine3"]]) + rest
    inside = np.array([-sign, 0, 0])
    faces = inside if abs(way[1]) > 0.75 else np.array([0, -1.0, 0])
    if up > 0 and abs(rises) > 60:
        faces = np.array([-0.4 * sign, 0, 0.9])
    elbow = np.array([0.5 * sign, -0.7, -0.5]) if rises < 45 else np.array([sign, 0, 0.1])
    if rises < -60:
        elbow = np.array([0.35 * sign, 0, -1.0])
    fingers, faces, elbow = (chest.T @ one for one in (way, faces, elbow))
    out = np.array([sign, 1, 1])
    return Hand(vector(palm * out), vector(fingers * out), vector(faces * out), vector(elbow * out))
