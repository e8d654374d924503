"""From a character's own rig to the reference body: the way back of `fit_rig`."""

from __future__ import annotations

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.motion import HandleMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.retarget.reference import motion_to_reference
from bunraku.retarget.rig_parts import RigParts

__all__ = ["bones_to_handles", "handle_animation", "rig_to_reference"]


def bones_to_handles(parts: RigParts, world_rotations: np.ndarray, positions: np.ndarray, fps: float) -> HandleMotion:
    """Motion of the rig's 30 handles; each moves as its first bone.

    Args:
        parts: The rig.
        world_rotations: World rotation of each bone from its rest pose, shape (N, J, 3, 3).
        positions: Where its head is [m], shape (N, J, 3).
        fps: Frames a second [1/s].
    """
    assert parts.character.rig is not None
    rest, h = parts.character.rig.positions, parts.handles.positions.astype(np.float64)
    pelvis = int(parts.leads[0])
    root = world_rotations[:, pelvis]
    back = np.swapaxes(root, -1, -2)
    rotations, translations = (
        np.tile(np.eye(3), (len(world_rotations), len(h), 1, 1)),
        np.zeros((len(world_rotations), len(h), 3)),
    )
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
    """The same animation on 30 handles, those of the rig; bones of one part become one.

    Raises:
        CharacterError: The names of its bones do not tell which parts they move.
    """
    parts = RigParts.of(animation.character)
    motion = bones_to_handles(parts, *animation.world(), animation.fps)
    return Animation(animation.character, parts.handles, motion, animation.reference)


def rig_to_reference(
    parts: RigParts, rotations: np.ndarray, positions: np.ndarray, fps: float, own: bool = False
) -> HandleMotion:
    """Motion of a rig's bones as handle motion of the reference body.

    Args:
        parts: The rig, facing +Z.
        rotations: World rotation of each bone from its rest pose, shape (N, J, 3, 3).
        positions: Where its head is [m], shape (N, J, 3).
        fps: Frames a second [1/s].
        own: See `motion_to_reference`.
    """
    return motion_to_reference(bones_to_handles(parts, rotations, positions, fps), parts.anatomy, own)
