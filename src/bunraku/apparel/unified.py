"""One set of body joints for all characters: SMPL's 22, as `bodies.layout` names them.

Rigs differ in twist bones, helpers, fingers and names, so learning needs joints that mean the same everywhere (MMDMC
aligns its characters with SMPL-H for that). We take the 22 that the rest of Bunraku speaks: every motion file becomes a
motion of them, `RigParts` finds them in MMD, VRM and other rigs, and the motions of the data set turn nothing else.
MMD's standard bones would add a centre, twist and toe bones that VRM characters and motion capture do not have, and
SMPL-H's fingers stand still in the captures.

Every other bone of a body goes along with one of the 22; bones that physics move (apparel) count for the joint that
they hang on, and what they do beside it is the hidden truth that networks are to find.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.apparel.mask import moved_joints
from bunraku.body.layout import HANDLE_PARENTS, JOINT_COUNT, JOINT_PARENTS
from bunraku.core.character import Character
from bunraku.core.mmd_model import mmd_model
from bunraku.core.rig_animation import RigAnimation, bone_order
from bunraku.errors import CharacterError
from bunraku.retarget.rig_parts import RigParts
from bunraku.skeletons.bone_names import NO_HANDLE

__all__ = ["UnifiedBody"]


@dataclass(frozen=True, eq=False)
class UnifiedBody:
    """A character's rig as SMPL's 22 joints.

    Args:
        parts: The rig's bones as parts of the reference body.
        joints: Where the joints are in the rest pose [m], shape (22, 3); joints that the rig lacks lie between their
            neighbours.
        weights: Skinning weights of the vertices for the joints, shape (V, 22), float32, rows sum to 1.
        bones: The bone that each joint is, shape (22,); of a joint that the rig lacks, that of the joint above it.
        joint_of: The joint that each bone goes along with, shape (J,).
        moved: Bones that physics move and those below them, shape (J,), bool.
    """

    parts: RigParts
    joints: np.ndarray
    weights: np.ndarray
    bones: np.ndarray
    joint_of: np.ndarray
    moved: np.ndarray

    @classmethod
    def of(cls, character: Character) -> UnifiedBody:
        """Read a character's rig.

        Raises:
            CharacterError: There is no rig, or it is not that of a person.
        """
        parts = RigParts.of(character)
        if not parts.humanoid or character.rig is None:
            raise CharacterError(
                f"{character.name}: its rig has no pelvis, arms and legs that are known; apparel data need a person's"
            )
        rig = character.rig
        known = moved_joints(character)
        moved = np.zeros(len(rig.names), bool) if known is None else known
        joint_of = _joints_of_bones(parts, moved)
        weights = np.zeros((len(character.vertices), JOINT_COUNT), np.float32)
        np.add.at(weights, (np.arange(len(weights))[:, None], joint_of[rig.indices]), rig.weights)
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
        bones = _leads(parts, joint_of, moved)
        present = bones >= 0
        for joint in range(1, JOINT_COUNT):
            if not present[joint]:
                bones[joint] = bones[JOINT_PARENTS[joint]]
        return cls(parts, _positions(rig.positions[bones], present), weights, bones, joint_of, moved)

    def transforms(self, animation: RigAnimation) -> np.ndarray:
        """T of Eq. 1: rotation from the rest pose and position of each joint, `[R | t]`, shape (N, 22, 3, 4), float32.

        A vertex of one joint goes to `R (v - J) + t` (Eq. 4).
        """
        affine = animation.transforms()[:, self.bones].astype(np.float64)
        affine[..., 3] += np.einsum("njab,jb->nja", affine[..., :3], self.joints)
        return affine.astype(np.float32)

    def deviations(self, animation: RigAnimation) -> np.ndarray:
        """What each bone does beside its joint, as affine transforms whose zeros mean nothing, shape (N, J, 3, 4),
        float32.
        """
        affine = animation.transforms()
        return affine - affine[:, self.bones[self.joint_of]]


def _joints_of_bones(parts: RigParts, moved: np.ndarray) -> np.ndarray:
    assert parts.character.rig is not None
    parents, model = parts.parents, mmd_model(parts.character)
    out = np.full(len(parents), -1)
    for bone in bone_order(parents):
        handle, parent = int(parts.parts[bone]), int(parents[bone])
        if not moved[bone] and handle != NO_HANDLE:
            while handle >= JOINT_COUNT:
                handle = HANDLE_PARENTS[handle]
            out[bone] = handle
        elif parent >= 0:
            out[bone] = out[parent]
    if model is not None and len(model.bones) == len(out):
        for bone, entry in enumerate(model.bones):  # helpers of MMD that turn wholly with another bone
            append = entry.append
            if (
                append is not None
                and append.rotation
                and abs(append.ratio - 1) < 1e-6
                and not moved[bone]
                and parts.parts[bone] == NO_HANDLE
            ):
                out[bone] = out[append.bone]
    return np.maximum(out, 0)


def _leads(parts: RigParts, joint_of: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The bone that is each joint, -1 for none, shape (22,)."""
    out = parts.leads[:JOINT_COUNT].copy()
    for joint, bone in enumerate(out):
        if bone >= 0 and (moved[bone] or joint_of[bone] != joint):
            out[joint] = -1
    if out[0] < 0:
        raise CharacterError(
            f"{parts.character.name}: physics move the pelvis of its rig; apparel data need a body that follows the "
            "motion"
        )
    return out


def _positions(positions: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Joints that are missing lie half way between the joint above and the next one below that are there, or where the
    one above is.
    """
    out = positions.copy()
    for joint in range(1, JOINT_COUNT):
        if not present[joint]:
            above = out[JOINT_PARENTS[joint]]
            below, line = joint, [other for other in range(joint + 1, JOINT_COUNT) if JOINT_PARENTS[other] == joint]
            while line and not present[below]:
                below = line[0]
                line = [other for other in range(below + 1, JOINT_COUNT) if JOINT_PARENTS[other] == below]
            out[joint] = (above + positions[below]) / 2 if present[below] else above
    return out
