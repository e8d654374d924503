"""A clip of a character whose skeleton is the same: bones are copied by their names, so fingers, props and capes move
too.
"""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character
from bunraku.core.rig_animation import RigAnimation

__all__ = ["copied_bones"]

ALIKE, MOST = (
    5.0,
    20.0,
)  # bones of one skeleton rest in directions that differ by so much in the mean, and at the most [degrees]


def copied_bones(
    source: Character, world_rotations: np.ndarray, positions: np.ndarray, fps: float, character: Character
) -> RigAnimation | None:
    """The clip on another character of the same skeleton, or None where it is another one.

    Skeletons are the same when every bone that moves a vertex of the character is there by name, below the same bone,
    and rests in the same direction. Bones keep their rotations against their parents; what moves them off their
    positions is scaled by the size of the skeleton.

    Args:
        source: The character of the clip.
        world_rotations: World rotation of each of its bones from the rest pose, shape (N, J, 3, 3).
        positions: Where its head is [m], shape (N, J, 3).
        fps: Frames a second [1/s].
        character: The one to be moved.
    """
    if source.rig is None or character.rig is None:
        return None
    theirs, own = source.rig, character.rig
    indices = {name: bone for bone, name in enumerate(theirs.names)}
    partner = np.array([indices.get(name, -1) for name in own.names])
    used = np.unique(own.indices[own.weights > 0])
    needed = set(used.tolist())
    for bone in used.tolist():
        while own.parents[bone] >= 0 and int(own.parents[bone]) not in needed:
            bone = int(own.parents[bone])
            needed.add(bone)
    ratios, angles = [], []
    for bone in needed:
        above = int(own.parents[bone])
        if partner[bone] < 0 or (above >= 0) != (theirs.parents[partner[bone]] >= 0):
            return None
        if above < 0:
            continue
        if partner[above] != theirs.parents[partner[bone]]:
            return None
        mine, other = (
            own.positions[bone] - own.positions[above],
            theirs.positions[partner[bone]] - theirs.positions[partner[above]],
        )
        lengths = np.linalg.norm(mine), np.linalg.norm(other)
        if min(lengths) > 1e-3 * character.height * min(1.0, source.height / character.height):
            ratios.append(lengths[0] / lengths[1])
            angles.append(np.degrees(np.arccos(np.clip(mine @ other / (lengths[0] * lengths[1]), -1, 1))))
    if len(ratios) < 2 or float(np.mean(angles)) > ALIKE or float(np.max(angles)) > MOST:
        return None
    local = RigAnimation.of_world(source, world_rotations, positions, fps)
    rotations = np.tile(np.eye(3, dtype=np.float32), (len(world_rotations), len(own.names), 1, 1))
    translations = np.zeros((len(world_rotations), len(own.names), 3), np.float32)
    there = partner >= 0
    rotations[:, there] = local.rotations[:, partner[there]]
    translations[:, there] = local.translations[:, partner[there]] * float(np.median(ratios))
    return RigAnimation(character, rotations, translations, fps)
