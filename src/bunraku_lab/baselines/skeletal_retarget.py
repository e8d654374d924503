"""A skeleton's motion copied onto any mesh: the second half of MDM-SR (section 4.1 of TapMo).

The human skeleton is embedded in the mesh as Pinocchio does it (Baran & Popovic 2007), its bones get the rotations of
the captured or generated body, and the skin follows by bone heat. Rotations are those of the world, off a T-pose, as a
copy is made; whoever does not rest in a T-pose is turned by so much too far, which is the failure that TapMo's figure 9
shows. `aligned` turns the limbs to the T-pose first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.body.layout import JOINT_COUNT, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion
from bunraku.errors import CharacterError
from bunraku.geometry.graph import clean_mesh
from bunraku.geometry.rotations import rotation_between
from bunraku_lab.baselines.bone_heat import bone_heat
from bunraku_lab.baselines.embedding import embedded_human

__all__ = ["RiggedMesh", "bone_turns", "copied_motion", "rig_by_embedding"]

MOST_BONES = 4
"""Joints that move one vertex, as engines have it."""
_LEGS = (1, 4, 7)  # left hip, knee, ankle in SMPL's order


@dataclass(frozen=True, eq=False)
class RiggedMesh:
    """A mesh with the embedded human skeleton.

    Args:
        vertices: Rest positions [m], shape (V, 3).
        joints: Rest positions of SMPL's 22 joints in it [m], shape (22, 3).
        weights: Skinning weights, shape (V, 22), rows sum to 1.
    """

    vertices: np.ndarray
    joints: np.ndarray
    weights: np.ndarray


def rig_by_embedding(vertices: np.ndarray, faces: np.ndarray) -> RiggedMesh:
    """The human skeleton inside a mesh, with bone-heat weights.

    Args:
        vertices: Positions [m], +Y up, facing +Z, shape (V, 3).
        faces: Vertex indices, shape (F, 3).

    Raises:
        CharacterError: The mesh has no surface, or no skeleton can be placed in it.
    """
    mesh = clean_mesh(vertices, faces)
    try:
        skeleton, volume = embedded_human(mesh.vertices, mesh.faces)
        owners, tips = np.array(skeleton.bones()).T
        found = bone_heat(mesh.vertices, mesh.faces, skeleton.points[owners], skeleton.points[tips], owners, volume)
    except (ValueError, RuntimeError, IndexError) as error:  # of the solver, and of volumes without an inside
        raise CharacterError(f"the human skeleton cannot be embedded in this mesh: {error}") from error
    weights = np.zeros((len(mesh.vertices), JOINT_COUNT))
    weights[:, : found.shape[1]] = found
    least = np.partition(weights, -MOST_BONES, axis=1)[:, -MOST_BONES][:, None]
    weights = np.where(weights >= least, weights, 0)
    weights /= weights.sum(axis=1, keepdims=True)
    joints = skeleton.points[:JOINT_COUNT] * mesh.scale + mesh.center
    return RiggedMesh(np.asarray(vertices, float), joints, weights[mesh.index])


def copied_motion(rigged: RiggedMesh, motion: SkeletalMotion, aligned: bool = False) -> np.ndarray:
    """The mesh in each frame of a motion, shape (N, V, 3) [m].

    Args:
        rigged: The mesh and its skeleton.
        motion: Of SMPL's 22 joints on the reference body, whose T-pose is the identity.
        aligned: Turn each bone to its direction in the T-pose before the rotations are copied.
    """
    body = reference_body()
    turns, positions = motion.world()
    scale = _leg(rigged.joints) / _leg(body.joints)
    if aligned:
        turns = turns @ bone_turns(rigged.joints, body.joints)
    roots = rigged.joints[0] + scale * (positions[:, 0] - body.joints[0])
    own = np.empty_like(positions)
    own[:, 0] = roots
    for joint in range(1, JOINT_COUNT):
        parent = JOINT_PARENTS[joint]
        own[:, joint] = own[:, parent] + turns[:, parent] @ (rigged.joints[joint] - rigged.joints[parent])
    out = np.empty((len(motion), len(rigged.vertices), 3))
    shifts = own - np.einsum("njab,jb->nja", turns, rigged.joints)
    for frame in range(len(motion)):
        turn = np.einsum("vj,jab->vab", rigged.weights, turns[frame])
        out[frame] = np.einsum("vab,vb->va", turn, rigged.vertices) + rigged.weights @ shifts[frame]
    return out


def _leg(joints: np.ndarray) -> float:
    hip, knee, ankle = joints[list(_LEGS)]
    return float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))


def bone_turns(own: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """For each joint the least rotation that takes its bone from one rest pose's direction to another's, shape (22, 3,
    3); a joint with several children turns not at all, one with none as its parent does.

    Args:
        own: Joints in the first rest pose, shape (22, 3).
        wanted: In the other, shape (22, 3).
    """
    out = np.tile(np.eye(3), (JOINT_COUNT, 1, 1))
    for joint in range(JOINT_COUNT):
        below = [child for child in range(JOINT_COUNT) if JOINT_PARENTS[child] == joint]
        if len(below) == 1:
            out[joint] = rotation_between(own[below[0]] - own[joint], wanted[below[0]] - wanted[joint])
        elif not below:  # hands and toes go on as what they hang from
            out[joint] = out[JOINT_PARENTS[joint]]
    return out
