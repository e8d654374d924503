"""A character in the reference body's stance: where its limbs are turned to before a motion is applied."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.anatomy.joints import (
    Joints,
    attach_joints,
    estimated_reference_joints,
    reference_joints,
    refined_joints,
)
from bunraku.anatomy.rest_pose import rest_rotations
from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.geometry.areas import vertex_areas

__all__ = ["flat_feet", "stance_of", "rest_of_limbs"]

PASSES = 2  # turns need joints and joints need turns; both settle at once
SOLE = 0.08  # what is this near to the lowest point, as a share of the foot's length, stands on the ground
FLATTER = 1.2  # how much more of a foot must stand before the foot is turned


def rest_of_limbs(character: Character, handles: Handles, found: Joints) -> tuple[np.ndarray, Joints]:
    """How the rest pose of a body with one limb of each kind differs from the reference body's.

    Args:
        character: In its rest pose.
        handles: Its handles, which all play their own parts.
        found: Its joints as the weights imply them (`find_joints`).

    Returns:
        The turn of each handle that makes up for it (see `rest_rotations`), shape (K, 3, 3), and the joints in the rest
        pose.
    """
    reference = reference_body().handles
    rotations = rest_rotations(handles, found, reference, estimated_reference_joints(), character.height)
    for _ in range(PASSES):
        joints = refined_joints(character, handles, found, rotations)
        rotations = rest_rotations(handles, joints, reference, reference_joints(), character.height)
    rotations = flat_feet(character, handles, rotations)
    return rotations, refined_joints(character, handles, found, rotations)


def stance_of(
    character: Character, handles: Handles, joints: Joints, to_reference: np.ndarray
) -> tuple[Character, Handles]:
    """The character with every handle turned, every joint held and its root where it was, and its handles as they are
    there.

    Args:
        character: In its rest pose.
        handles: Its handles.
        joints: Where they meet.
        to_reference: Turn of each handle, the identity for the root, shape (K, 3, 3).
    """
    rotations, translations = attach_joints(to_reference[None].astype(np.float64), handles, joints)
    still = np.zeros((1, 3)), np.eye(3)[None]
    motion = HandleMotion(translations, rotations, *still)
    vertices = skin(character.vertices, handles.weights, motion.transforms(handles.positions))[0]
    positions = handle_positions(vertices, handles.weights, vertex_areas(vertices, character.faces))
    return replace(character, vertices=vertices, rig=None, source=None, avatar=None), Handles(
        positions, handles.weights, roles=handles.roles
    )


def flat_feet(character: Character, handles: Handles, rotations: np.ndarray) -> np.ndarray:
    """The turns with feet that go along with their shins where that, and not their rest pose, makes them stand flat,
    shape (K, 3, 3).

    Who crouches on the toes has feet that belong to the shins; who sits, or crouches on flat feet, has them on the
    ground already.
    """
    out = rotations.copy()
    areas = character.areas
    for side in ("left", "right"):
        foot = [HANDLE_NAMES.index(f"{side}_{part}") for part in ("ankle", "foot")]
        shin = rotations[HANDLE_NAMES.index(f"{side}_knee")]
        own = character.surface & (handles.weights[:, foot].sum(axis=1) > 0.5)
        if own.sum() < 4 or np.allclose(shin, np.eye(3)):
            continue
        points = character.vertices[own].astype(np.float64)
        if _standing_area(points @ shin.T, areas[own]) > FLATTER * _standing_area(points, areas[own]):
            out[foot] = shin
    return out


def _standing_area(points: np.ndarray, areas: np.ndarray) -> float:
    heights = points[:, 1] - points[:, 1].min()
    return float(areas[heights < SOLE * np.ptp(points, axis=0).max()].sum())
