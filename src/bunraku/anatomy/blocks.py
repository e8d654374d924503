"""The rest pose of a figure of rigid blocks, whose joints its handles are (`handles.blocks`)."""

from __future__ import annotations

import numpy as np

from bunraku.anatomy.joints import Joints, reference_joints
from bunraku.anatomy.rest_pose import upright
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.character import Character, Handles
from bunraku.geometry.rotations import rotation_between
from bunraku.geometry.surface import surface_points
from bunraku.handles.blocks.contacts import away_from
from bunraku.handles.blocks.rigid import joint_parents

__all__ = ["WHOLE_LIMBS", "block_joints", "block_rest", "pieces"]

STANDS = 35.0  # legs that point no farther from straight down stand as they are [degrees]
POINTS = 2000  # spread over a limb to see where it points

WHOLE_LIMBS = tuple(
    tuple(HANDLE_NAMES.index(f"{side}_{part}") for part in limb)
    for side in ("left", "right")
    for limb in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
)
"""The handles of each arm and leg, from the body to the wrist or ankle."""


def block_joints(handles: Handles) -> Joints:
    """Where the blocks of rigid handles meet: where the handles stand."""
    blocks = np.asarray(handles.weights.any(axis=0))
    present = blocks.copy()
    present[0] = True
    return Joints(handles.positions.astype(np.float64), joint_parents(blocks), present)


def pieces(limb: tuple[int, ...], joints: Joints) -> list[tuple[int, int]]:
    """The pieces of an arm or a leg, each as its handle and the one where it ends: the next that is present, or the
    wrist or ankle.
    """
    there = [handle for handle in limb if joints.present[handle]]
    if not there:
        return []
    ends = [*there[1:], limb[-1]]
    return [(handle, end) for handle, end in zip(there, ends, strict=True) if handle != limb[-1]]


def block_rest(character: Character, handles: Handles) -> tuple[np.ndarray, Joints]:
    """How the rest pose of rigid blocks differs from the reference body's.

    Arms, and the front legs of animals, are turned wholly, as those of bodies that bend are; the legs of who stands
    upright where they do not stand.

    Args:
        character: In its rest pose.
        handles: Its rigid handles.

    Returns:
        The turn of each handle, shape (K, 3, 3), and the joints.
    """
    joints, known = block_joints(handles), reference_joints().positions
    out = np.tile(np.eye(3), (len(handles.positions), 1, 1))
    held, stands = handles.weights.argmax(axis=1), upright(handles)
    for limb in WHOLE_LIMBS:
        leg = HANDLE_NAMES[limb[0]].endswith("hip")
        if leg and not stands:
            continue
        above = np.eye(3)
        for handle, end in pieces(limb, joints):
            if joints.present[end] and end != handle:
                own = joints.positions[end] - joints.positions[handle]
            else:
                faces = character.faces[held[character.faces[:, 0]] == handle]
                own = away_from(surface_points(character.vertices, faces, POINTS)[0], joints.positions[handle])
            if leg and np.degrees(np.arctan2(np.hypot(own[0], own[2]), -own[1])) < STANDS:
                continue
            above = rotation_between(above @ own, known[end] - known[handle]) @ above
            out[handle] = above
        if not leg and joints.present[limb[-1]]:
            out[limb[-1]] = above
    return out, joints
