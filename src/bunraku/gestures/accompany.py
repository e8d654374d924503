"""How pelvis, trunk and head go with the hands of who stands: a hand that goes out ahead takes its shoulder with it.

Linear, and fitted to captured people who stand and use their hands. What is not in these numbers (bows, shifts of the
weight, looks) does not follow from where hands are, and comes from captured people (`standing`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.geometry.rotations import matrix_y
from bunraku.gestures.pose import HANGING
from bunraku.gestures.standing import SIDES
from bunraku.gestures.tracks import HandTrack, Tracks

__all__ = ["FOLLOWS", "accompanied"]

FOLLOWS = {
    "turn": (23.8, -4.5, -37.3),
    "lean left": (18.4, -2.6, -29.2),
    "lean side": (-6.4, 3.2, 10.1),
    "head left": (-1.6, 5.3, 46.1),
}
"""Degrees for each metre by which the left hand is farther out, up and ahead; the right one's are the contrary. Of 131
captured stretches (16 minutes) they explain, left out of the fit, 22, 46, 13 and 22 % of the variance.
"""
MOST = 22.0
"""How far each goes at the most [degrees]."""


def accompanied(tracks: Tracks, share: np.ndarray, free: dict[str, np.ndarray]) -> Tracks:
    """Key poses in which pelvis, trunk and head go with the hands.

    Args:
        tracks: L key poses.
        share: How far, in each, shape (L,).
        free: By side, whether a hand touches nothing of the body, shape (L,): it stays where it is while the chest that
            carries it turns.
    """
    angles = {name: np.zeros(len(share)) for name in FOLLOWS}
    for side, sign in SIDES:
        hand = tracks.hands[side]
        away = np.where(hand.rests[:, None], 0, hand.palm - HANGING.palm)
        for name, factors in FOLLOWS.items():
            angles[name] += sign * (away @ np.array(factors))
    angles = {name: share * np.clip(own, -MOST, MOST) for name, own in angles.items()}
    none = np.zeros(len(share))
    lean = np.stack([none, angles["lean left"], angles["lean side"]], axis=1)
    back = -np.radians(angles["turn"] + angles["lean left"])
    hands = {
        side: _turned(tracks.hands[side], np.where(free[side] & (tracks.hands[side].on == 1), sign * back, 0))
        for side, sign in SIDES
    }
    head = np.stack([none, angles["head left"], none], axis=1)
    return replace(
        tracks, lean=tracks.lean + lean, head=tracks.head + head, turn=tracks.turn + angles["turn"], hands=hands
    )


def _turned(hand: HandTrack, angle: np.ndarray) -> HandTrack:
    """A hand about the vertical through the trunk, by an angle towards its own side [rad], shape (L,)."""
    about = matrix_y(np.where(hand.rests, 0, angle))
    palm = (about @ hand.palm[..., None])[..., 0]
    return replace(hand, palm=palm, ways=hand.ways @ np.swapaxes(about, -1, -2))
