"""To the reference body: from a character's handle motion, from the motion of its own rig, or from a mesh that
moves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.anatomy.joints import downwards, reference_parts
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.layout import HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.body.reference import capped, reference_body
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import register, skin
from bunraku.retarget.rig_parts import RigParts

_TAIL = [HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")]


def motion_to_reference(motion: HandleMotion, anatomy: Anatomy, own: bool = False) -> HandleMotion:
    """A handle motion of a character as the one of the reference body that `fit_motion` of such a motion without its
    ground stages takes back to the character's.

    Limbs turn back from the character's rest directions, parts that the character lacks move with their parents, and
    what its parts do beyond stiff joints is carried over in the reference's scale. Of several limbs that play one part,
    the first counts. The root's path keeps its height over the floor that the character's rest pose stands on.

    Args:
        anatomy: Of the character, in the pose that the motion is relative to.
        own: The motion stays one of this very body. Otherwise it becomes a person's: parts stay closer to their joints,
            there is no tail, and the reference body stands on y = 0.
    """
    handles, joints = anatomy.handles, anatomy.joints
    parents, present = reference_parts(handles, joints)
    rotations = motion.rotations.astype(np.float64) @ anatomy.rotations.transpose(0, 2, 1)
    stiff = anatomy.attached(motion.rotations.astype(np.float64))[1]
    residual = (motion.translations - stiff) / anatomy.scale * present[:, None]
    residual[:, 0] = 0
    for handle in downwards(HANDLE_PARENTS):
        if not present[handle] and handle:
            rotations[:, handle] = rotations[:, max(int(parents[handle]), 0)]
    translations = reference_anatomy().attached(rotations)[1] + capped(residual, own)
    path = motion.root_translation - np.array([0, anatomy.rise, 0])
    path = (path - (motion.root_rotation - np.eye(3)) @ anatomy.lever) / anatomy.scale
    result = replace(motion, rotations=rotations, translations=translations, root_translation=path)
    return result if own else _as_person(result)


def _as_person(motion: HandleMotion) -> HandleMotion:
    """The motion without a tail, and moved along Y so that the reference body stands on y = 0."""
    body = reference_body()
    rotations, translations = motion.rotations.copy(), motion.translations.copy()
    rotations[:, _TAIL], translations[:, _TAIL] = np.eye(3), 0
    result = replace(motion, rotations=rotations, translations=translations)
    lowest = skin(body.vertices, body.handle_weights, result.transforms(body.handles.positions))[..., 1].min(axis=1)
    floor = np.array([0, np.quantile(lowest, 0.05), 0], np.float32)
    return replace(result, root_translation=motion.root_translation - floor)


def bones_to_handles(parts: RigParts, world_rotations: np.ndarray, positions: np.ndarray, fps: float) -> HandleMotion:
    """Motion of the rig's 30 handles at a rate [1/s]; each moves as its first bone. The bones' world rotations (N, J,
    3, 3) are from the rest pose, and their heads are at `positions` (N, J, 3) [m].
    """
    assert parts.character.rig is not None
    rest, h = parts.character.rig.positions, parts.handles.positions.astype(np.float64)
    pelvis = int(parts.leads[0])
    root = world_rotations[:, pelvis]
    back = np.swapaxes(root, -1, -2)
    rotations = np.tile(np.eye(3), (len(world_rotations), len(h), 1, 1))
    translations = np.zeros((len(world_rotations), len(h), 3))
    positions = positions - parts.rise
    centre = positions[:, pelvis] + np.einsum("nij,j->ni", root, h[0] - rest[pelvis])
    for handle in range(1, len(h)):
        bone = int(parts.leads[handle])
        if bone < 0:
            continue
        index = positions[:, bone] + np.einsum("nij,j->ni", world_rotations[:, bone], h[handle] - rest[bone])
        rotations[:, handle] = back @ world_rotations[:, bone]
        translations[:, handle] = np.einsum("nij,nj->ni", back, index - centre) + h[0] - h[handle]
    return HandleMotion(translations, rotations, centre - h[0], root, fps)


def handle_animation(animation: RigAnimation) -> Animation:
    """The same animation on 30 handles, those of the rig; bones of one part become one. CharacterError where the names
    of its bones do not tell which parts they move.
    """
    parts = animation.parts or RigParts.of(animation.character)
    motion = bones_to_handles(parts, *animation.world(), animation.fps)
    return Animation(animation.character, parts.handles, motion, animation.reference)


def handle_motion_of_mesh(
    rest: np.ndarray, posed: np.ndarray, weights: np.ndarray, positions: np.ndarray, areas: np.ndarray, fps: float
) -> HandleMotion:
    """Handle motion of a mesh that moves, by weighted rigid registration (section A.2). Handles without weight stay at
    the identity.

    The root handle's motion is the global one; it is taken off before the other handles are registered, so theirs are
    local.

    Args:
        rest: Rest vertices [m], shape (V, 3).
        posed: Moved vertices of each frame [m], shape (N, V, 3).
        weights: Handle weights, shape (V, K).
        positions: Handle positions [m], shape (K, 3).
        areas: Surface area that each vertex stands for, shape (V,).
        fps: Frames a second [1/s].
    """
    mass = weights * areas[:, None]
    rotations, translations = register(rest, posed, mass[:, :1], positions[:1])
    root_rotation, root_translation = rotations[:, 0], translations[:, 0]
    local = np.einsum("nji,nvj->nvi", root_rotation, posed - positions[0] - root_translation[:, None]) + positions[0]
    rotations, translations = register(rest, local, mass, positions)
    still = mass.sum(axis=0) <= 1e-6 * areas.sum()
    still[0] = True
    rotations[:, still], translations[:, still] = np.eye(3), 0
    return HandleMotion(translations, rotations, root_translation, root_rotation, fps)
