"""Where things are for the hands: `[places]` of `things.toml` by their names, and heights between them."""

from __future__ import annotations

import functools
import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from bunraku.geometry.rotations import matrix_y
from bunraku.gestures.catalogue import hand_row, pose_row
from bunraku.gestures.pose import HANGING, Hand, Pose, vector
from bunraku.gestures.standing import SIDES

__all__ = ["PlaceRow", "place_pose", "read_places", "things_file"]

ASIDE = {"left": 1.0, "aside": 1.0, "right": -1.0, "": 0.0}
"""To the left or to the right; what is put elsewhere goes to the left, and in the mirror image to the right."""
AWAY = 68.0
"""How far from straight ahead a place aside is [degrees]."""
HIPS, CHEST, HEAD = 18.0, 26.0, 14.0
"""How far pelvis, chest and head turn towards it [degrees]."""
OVER = 0.06
"""How far the pelvis goes to that side [m]."""


class PlaceRow(NamedTuple):
    """How somebody is at a place for things: both hands there, one hand there, the other one then, and the body."""

    both: Hand
    one: Hand
    other: Hand
    pose: Pose


@functools.cache
def things_file() -> dict[str, Any]:
    """The tables of `things.toml`."""
    return tomllib.loads(Path(__file__).with_name("things.toml").read_text(encoding="utf-8"))


@functools.cache
def read_places() -> dict[str, PlaceRow]:
    """The places of `[places]` by their names, the lowest first."""
    return {name: _place(row) for name, row in things_file()["places"].items()}


def _place(row: dict[str, Any]) -> PlaceRow:
    pose = {kind: value for kind, value in row.items() if kind not in ("both", "one", "other")}
    other = hand_row(row["other"]) if "other" in row else HANGING
    return PlaceRow(hand_row(row["both"]), hand_row(row["one"]), other, pose_row(pose, {"hands": {}, "feet": {}}))


def _at_height(height: float) -> PlaceRow:
    """The place whose palm is so high [m], between the two nearest."""
    rows = list(read_places().values())
    heights = [row.one.palm[1] for row in rows]
    after = int(np.clip(np.searchsorted(heights, height), 1, len(rows) - 1))
    share = float(np.clip((height - heights[after - 1]) / (heights[after] - heights[after - 1]), 0, 1))
    first, last = rows[after - 1], rows[after]
    both, one, pose = (_mixed(getattr(first, part), getattr(last, part), share) for part in ("both", "one", "pose"))
    return PlaceRow(both, one, (last if share > 0.5 else first).other, pose)


def _mixed(one: Any, other: Any, share: float) -> Any:
    """A hand or a pose between two: numbers and vectors go over, what else there is stays the first's."""
    found = {}
    for part in fields(one):
        own, there = getattr(one, part.name), getattr(other, part.name)
        if isinstance(own, tuple):
            found[part.name] = tuple((1 - share) * a + share * b for a, b in zip(own, there, strict=True))
        elif isinstance(own, float | int):
            found[part.name] = (1 - share) * own + share * there
    return replace(one, **found)


def place_pose(height: str | float, way: str, hands: str, held: bool = False) -> Pose:
    """Somebody with both hands, or one of them, at a place.

    Args:
        height: Of the palms, by its name or in metres.
        way: "left", "right", "aside" for either of them; "" for straight ahead.
        hands: "both", "left", "right", or "one" for the right one.
        held: Whether hands go along with the chest where they are straight ahead.
    """
    row = read_places()[height] if isinstance(height, str) else _at_height(height)
    side = ASIDE[way]
    base, own = row.pose, row.both if hands == "both" else row.one
    turned = matrix_y(np.array(np.radians(side * AWAY)))
    carrier: Literal["chest", "ground"] = "chest" if held and not side else "ground"

    def placed(hand: Hand, sign: float) -> Hand:
        out = np.array([sign, 1, 1])
        palm, fingers, faces, elbow = (
            vector(out * (turned @ (out * np.array(one)))) for one in (hand.palm, hand.fingers, hand.faces, hand.elbow)
        )
        return Hand(palm, fingers, faces, elbow, on=carrier)

    made = {}
    for name, sign in SIDES:
        used = hands in ("both", name) or (hands == "one" and name == "right")
        made[name] = placed(own, sign) if used else row.other
    hips = matrix_y(np.array(np.radians(side * HIPS))) @ np.array(base.hips) + [side * OVER, 0, 0]
    lean, head = base.lean, base.head
    return replace(
        base, right=made["right"], left=made["left"], hips=vector(hips), turn=side * HIPS,
        lean=(lean[0], lean[1] + side * CHEST, lean[2]), head=(head[0], head[1] + side * HEAD, head[2]),
    )  # fmt: skip
