"""How far pelvis, trunk and head of captured people go with their hands: the numbers of `bunraku.gestures.perform`.

Stretches of people who stand and use their hands, each about its own mean and in the mirror too, are fitted by ridge
regression: angles in degrees by where both hands are in the frame of the chest, in metres. Both sides are alike, so a
row has three numbers, those of the left hand.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from bunraku.core.geometry.curves import gaussian
from bunraku.core.geometry.rotations import axis_angle_from_matrix
from bunraku.core.motion import SkeletalMotion
from bunraku.gestures.standing import AT, SIDES, mirrored

__all__ = ["Accompaniment", "accompaniment", "gesticulates"]

_NAMES = ("turn", "lean left", "lean side", "head left")
SMOOTH = 0.15
"""Deviation of the mean over time [s]."""
RIDGE = 0.02
"""Of the variance of where hands are."""
FOLDS = 5
SHORTEST, STANDS, UPRIGHT, BUSY = 2.0, 0.12, 0.75, 0.12
"""Of who stands and uses the hands: the stretch [s], how far feet go at the most [m], the height of the pelvis at the
least [m], and the mean speed of the wrists [m/s].
"""


class Accompaniment(NamedTuple):
    """What was fitted.

    Args:
        follows: By name, degrees for each metre by which the left hand is farther out, up and ahead.
        explained: By name, the share of the variance that is explained in stretches that were left out of the fit.
    """

    follows: Mapping[str, tuple[float, float, float]]
    explained: Mapping[str, float]


def gesticulates(motion: SkeletalMotion) -> bool:
    """Whether somebody stands and uses the hands all through a stretch."""
    positions = motion.world()[1]
    if len(motion) < SHORTEST * motion.fps or positions[:, 0, 1].min() < UPRIGHT:
        return False
    ankles, wrists = (positions[:, [AT[f"{side}_{part}"] for side, _ in SIDES]] for part in ("ankle", "wrist"))
    goes = np.ptp(np.percentile(ankles[..., [0, 2]], [3, 97], axis=0), axis=0).max()
    steps = np.diff(wrists - positions[:, :1], axis=0)
    return bool(goes < STANDS and np.linalg.norm(steps, axis=-1).mean() * motion.fps > BUSY)


def accompaniment(stretches: Iterable[SkeletalMotion]) -> Accompaniment:
    """Fit to stretches of people who stand and use their hands (`gesticulates`).

    Args:
        stretches: Of the reference body's 22 joints.
    """
    rows = [[_row(one) for one in (motion, mirrored(motion))] for motion in stretches]
    pairs = [tuple(np.concatenate(parts) for parts in zip(*both, strict=True)) for both in rows]
    hands, angles = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    fold = np.repeat(np.arange(len(pairs)) % FOLDS, [len(own) for own, _ in pairs])
    predicted = np.zeros_like(angles)
    for left_out in range(FOLDS):
        here = fold == left_out
        if here.any() and not here.all():
            predicted[here] = hands[here] @ _fitted(hands[~here], angles[~here])
    left, own = ((values**2).sum(axis=0) for values in (angles - predicted, angles))
    explained = np.where(own > 0, 1 - left / np.where(own > 0, own, 1), 0)
    factors = _fitted(hands, angles)[:3].T
    follows = {name: (float(x), float(y), float(z)) for name, (x, y, z) in zip(_NAMES, factors, strict=True)}
    return Accompaniment(follows, dict(zip(_NAMES, explained.tolist(), strict=True)))


def _fitted(hands: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Coefficients (6, 4)."""
    ridge = RIDGE * len(hands) * hands.var() * np.eye(hands.shape[1])
    return np.asarray(np.linalg.solve(hands.T @ hands + ridge, hands.T @ angles))


def _row(motion: SkeletalMotion) -> tuple[np.ndarray, np.ndarray]:
    """Where both hands are, left first, (N, 6) [m], and the angles (N, 4) [degrees], smooth and about their means."""
    world, positions = (value.astype(float) for value in motion.world())
    chest = world[:, AT["spine3"]]
    hands = []
    for side, _ in SIDES:
        away = positions[:, AT[f"{side}_wrist"]] - positions[:, AT["spine3"]]
        hands.append((away[:, None] @ chest)[:, 0])
    trunk = np.degrees(axis_angle_from_matrix(np.swapaxes(world[:, 0], -1, -2) @ chest))
    head = np.degrees(axis_angle_from_matrix(np.swapaxes(chest, -1, -2) @ world[:, AT["head"]]))
    facing = world[:, 0, :, 2]
    turn = np.degrees(np.unwrap(np.arctan2(facing[:, 0], facing[:, 2])))
    angles = np.stack([turn, trunk[:, 1], trunk[:, 2], head[:, 1]], axis=1)
    both = [gaussian(values, SMOOTH * motion.fps) for values in (np.concatenate(hands, axis=1), angles)]
    return both[0] - both[0].mean(axis=0), both[1] - both[1].mean(axis=0)
