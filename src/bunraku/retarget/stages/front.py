"""Heads that stay above the ground on bodies that lie along their spine.

A bull lowers its head by a turn of the trunk that would drive the snout of a crocodile into the ground; lifted out of
it as a whole, the body would stand on its head.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from bunraku.anatomy.ground import lowest
from bunraku.anatomy.joints import Joints, attach_joints
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.geometry.extremes import extreme_points
from bunraku.geometry.heading import heading
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, matrix_y

__all__ = ["raised_front"]

SINK = 0.01  # a head may be so far under the ground, over the height
STEPS = (0.75, 0.5, 0.25, 0.0)  # shares of the bending that are tried
SOFT = 0.15  # how softly bending is taken out [s]
_FRONT = [HANDLE_NAMES.index(name) for name in ("neck", "head", "head_top", "face")]
_TRUNK = [HANDLE_NAMES.index(name) for name in ("spine1", "spine2", "spine3", "neck", "head", "head_top", "face")]


def raised_front(
    motion: HandleMotion, rotations: np.ndarray, character: Character, handles: Handles, joints: Joints
) -> tuple[HandleMotion, np.ndarray]:
    """A motion with less tilt of the root, and local rotations with less bending of the trunk, in frames in which the
    head of a body that stands as high as at rest would sink into the ground.

    Args:
        motion: Whose root's rotation counts.
        rotations: Of the character's handles, in the root's frame, shape (N, K, 3, 3).
        character: In its rest pose, facing +Z.
        handles: Its handles.
        joints: Where they meet.
    """
    held = np.flatnonzero(character.surface & (handles.weights[:, _FRONT].sum(axis=1) > 0.5))
    if len(held) < 4:
        return motion, rotations
    held = held[extreme_points(character.vertices[held].astype(np.float64))]
    floor = float(character.vertices[character.surface, 1].min()) - SINK * character.height
    tilt, facing = _tilt(motion)
    bends = np.asarray(axis_angle_from_matrix(rotations[:, _TRUNK].astype(np.float64)))

    def bent(share: np.ndarray) -> tuple[HandleMotion, np.ndarray]:
        some = rotations.copy()
        some[:, _TRUNK] = matrix_from_axis_angle(share[:, None, None] * bends)
        return replace(motion, root_rotation=facing @ matrix_from_axis_angle(share[:, None] * tilt)), some

    def sinks(moved: HandleMotion, some: np.ndarray) -> np.ndarray:
        turned, translations = attach_joints(some.astype(np.float64), handles, joints)
        still = np.zeros_like(motion.root_translation)
        posed = replace(moved, rotations=turned, translations=translations, root_translation=still)
        return lowest(character.vertices[held], handles.weights[held], posed, handles.positions) < floor

    low = sinks(motion, rotations)
    if not low.any():
        return motion, rotations
    share = np.where(low, 0.0, 1.0)
    for step in STEPS[:-1]:
        clear = ~sinks(*bent(np.full(len(motion), step)))
        share = np.where(low & clear, np.maximum(share, step), share)
    reach = max(round(2 * SOFT * motion.fps), 1)
    share = minimum_filter1d(share, 2 * reach + 1, mode="nearest")
    return bent(gaussian_filter1d(share, SOFT * motion.fps, mode="nearest"))


def _tilt(motion: HandleMotion) -> tuple[np.ndarray, np.ndarray]:
    """The tilt of the root as axis times angle (N, 3), and its turn about +Y (N, 3, 3)."""
    facing = np.asarray(matrix_y(heading(motion.root_rotation, motion.fps)), np.float64)
    return np.asarray(axis_angle_from_matrix(facing.transpose(0, 2, 1) @ motion.root_rotation)), facing
