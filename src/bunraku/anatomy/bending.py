"""How a foot or a hand is moved: by bending its limb, a chain of two bones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.anatomy.joints import Joints
from bunraku.anatomy.legs import Leg
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import posed_points
from bunraku.geometry.rotations import matrix_from_axis_angle

__all__ = ["carry", "local_motion", "move_feet"]

STRAIGHT = 0.99  # how far a leg is stretched at the most, over its length
SOFT = 0.94  # from where on stretching slows down, so that knees do not snap


def move_feet(
    motion: HandleMotion,
    handles: Handles,
    joints: Joints,
    legs: list[Leg],
    shifts: np.ndarray,
    slopes: np.ndarray | None = None,
) -> HandleMotion:
    """The motion with feet moved by bending their legs; feet keep their slope unless slopes are given.

    A leg is a chain of two bones: its knee stays in the plane in which it was bent. It is never stretched beyond its
    length, so a foot may stop short of where it should be. A leg of one rigid block points to where its foot should be.

    Args:
        motion: Of the character.
        handles: Its handles.
        joints: Where they meet.
        legs: The legs whose feet are moved, L.
        shifts: How far each ankle moves [m], shape (N, L, 3).
        slopes: How each foot turns about its ankle, in the world, shape (N, L, 3, 3); None for not at all.
    """
    moved = [number for number in range(len(legs)) if np.abs(shifts[:, number]).max() > 1e-9]
    if not moved:
        return motion
    world = motion.transforms(handles.positions).astype(np.float64)
    for number in moved:
        slope = np.tile(np.eye(3), (len(world), 1, 1)) if slopes is None else slopes[:, number]
        _move_foot(world, legs[number], joints, shifts[:, number], slope, motion)
    return local_motion(world, motion, handles)


def _move_foot(
    world: np.ndarray, leg: Leg, joints: Joints, shift: np.ndarray, slope: np.ndarray, motion: HandleMotion
) -> None:
    """Bend one leg, in place."""
    hip, knee, ankle = (
        world[:, handle, :, :3] @ joint + world[:, handle, :, 3]
        for handle, joint in zip((leg.upper, leg.lower, leg.end), leg.joints, strict=True)
    )
    goal = ankle + shift
    if leg.lower == leg.upper:
        carry(world, leg.upper, joints, hip, hip, _between(_unit(ankle - hip), _unit(goal - hip)))
        return
    thigh, shin = np.linalg.norm(knee - hip, axis=1), np.linalg.norm(ankle - knee, axis=1)
    before, wanted = np.linalg.norm(ankle - hip, axis=1), np.linalg.norm(goal - hip, axis=1)
    length = thigh + shin
    reach = before + _soft(wanted / length) * length - _soft(before / length) * length
    reach = np.clip(reach, np.abs(thigh - shin) + 1e-3 * length, np.maximum(before, STRAIGHT * length))
    line, toward = _unit(ankle - hip), _unit(goal - hip)
    goal = hip + toward * reach[:, None]
    swing = _between(line, toward)
    aside = knee - hip - ((knee - hip) * line).sum(axis=1, keepdims=True) * line
    along = (thigh**2 - shin**2 + reach**2) / (2 * reach)
    out = np.sqrt(np.maximum(thigh**2 - along**2, 0))[:, None]
    more = out - np.linalg.norm(aside, axis=1, keepdims=True)
    bent = (
        hip
        + toward * along[:, None]
        + _unit(np.einsum("nij,nj->ni", swing, aside + more * _bend(aside, line, motion))) * out
    )
    for handle, pivot, target, before_turn, after_turn in (
        (leg.upper, hip, hip, knee - hip, bent - hip),
        (leg.lower, knee, bent, ankle - knee, goal - bent),
    ):
        swung = np.einsum("nij,nj->ni", swing, _unit(before_turn))
        carry(world, handle, joints, pivot, target, _between(swung, _unit(after_turn)) @ swing)
    for handle in leg.foot:
        carry(world, handle, joints, ankle, goal, slope)


def carry(
    world: np.ndarray, handle: int, joints: Joints, pivot: np.ndarray, target: np.ndarray, turned: np.ndarray
) -> None:
    """Turn a handle, and absent ones that go along with it, about a pivot that moves to a target."""
    along = [handle, *(int(other) for other in np.flatnonzero((joints.parents == handle) & ~joints.present))]
    for each in along:
        world[:, each, :, 3] = np.einsum("nij,nj->ni", turned, world[:, each, :, 3] - pivot) + target
        world[:, each, :, :3] = turned @ world[:, each, :, :3]


def _soft(share: np.ndarray) -> np.ndarray:
    """A stretch that slows down from SOFT on and ends at STRAIGHT."""
    room = STRAIGHT - SOFT
    return np.where(share > SOFT, STRAIGHT - room * np.exp(-(np.maximum(share, SOFT) - SOFT) / room), share)


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-12))


def _bend(aside: np.ndarray, line: np.ndarray, motion: HandleMotion) -> np.ndarray:
    """Where the knee points, square to the line from hip to ankle, shape (N, 3); where it is straight, as in the clip's
    bent frames.

    Args:
        aside: From the line to the knee [m], shape (N, 3).
        line: From hip to ankle, shape (N, 3).
        motion: For the root's rotation: what a knee does in its frame is usual for it.
    """
    own = np.einsum("nji,nj->ni", motion.root_rotation, aside)
    size = np.linalg.norm(own, axis=1)
    mean = own.mean(axis=0)
    usual = mean / np.linalg.norm(mean) if np.linalg.norm(mean) > 0.3 * size.mean() else np.array([0, 0, 1.0])
    helps = np.einsum("nij,j->ni", motion.root_rotation, usual)
    helps -= (helps * line).sum(axis=1, keepdims=True) * line
    return _unit(aside + 0.3 * size.mean() * np.exp(-((size / max(0.5 * size.mean(), 1e-9)) ** 2))[:, None] * helps)


def _between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, (start * end).sum(axis=1))
    return np.asarray(matrix_from_axis_angle(axis / np.maximum(sine, 1e-12)[:, None] * angle[:, None]))


def local_motion(world: np.ndarray, motion: HandleMotion, handles: Handles) -> HandleMotion:
    """A motion with the same root and other world transforms of its handles."""
    h = handles.positions.astype(np.float64)
    root = motion.root_rotation.astype(np.float64)
    rotations = root.transpose(0, 2, 1)[:, None] @ world[..., :3]
    centres = posed_points(world, h)
    translations = np.einsum("nji,nkj->nki", root, centres - h[0] - motion.root_translation[:, None]) + h[0] - h
    rotations[:, 0], translations[:, 0] = np.eye(3), 0
    return replace(motion, rotations=rotations, translations=translations)
