"""From rigid bodies back to bones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.core.rig_animation import RigAnimation, bone_order
from bunraku.physics.apparel_rig import ApparelRig

__all__ = ["joints_moved", "posed", "stretched"]

SHORT = 5e-3  # bones that are nearer to their parents than this have no length to keep [m]


def joints_moved(parents: np.ndarray, rig: ApparelRig) -> np.ndarray:
    """Joints that dynamic bodies move, and all joints below them, shape (J,), bool."""
    out = np.zeros(len(parents), bool)
    out[[rig.bodies[index].bone for index in rig.dynamic if 0 <= rig.bodies[index].bone < len(out)]] = True
    for bone in bone_order(parents):
        out[bone] |= parents[bone] >= 0 and bool(out[parents[bone]])
    return out


def posed(
    animation: RigAnimation, rig: ApparelRig, bodies: np.ndarray, body_rotations: np.ndarray, positions: np.ndarray
) -> RigAnimation:
    """The animation with the bones of dynamic bodies where these are; bones below follow as they are keyed.

    A bone takes the rotation of the first of its bodies. It goes where a body of mode 1 goes; one of mode 2 is held at
    its parent.

    Args:
        animation: Of N frames.
        rig: The bodies.
        bodies: Which of them are dynamic, shape (D,).
        body_rotations: World rotations of these from rest, shape (N, D, 3, 3).
        positions: Their centres [m], shape (N, D, 3).
    """
    skeleton = animation.character.rig
    assert skeleton is not None
    rest, parents = skeleton.positions, skeleton.parents
    rotations, translations = animation.rotations.astype(float), animation.translations.astype(float)
    movers: dict[int, tuple[int, int]] = {}
    for column, index in sorted(enumerate(bodies), key=lambda item: item[1]):
        movers.setdefault(rig.bodies[index].bone, (int(column), int(index)))
    world, heads = np.array(rotations), rest + translations
    for bone in bone_order(parents):
        parent = int(parents[bone])
        above = world[:, parent] if parent >= 0 else np.eye(3)
        offset = rest[bone] - (rest[parent] if parent >= 0 else 0)
        start = heads[:, parent] if parent >= 0 else np.zeros(3)
        if bone in movers:
            column, index = movers[bone]
            body = rig.bodies[index]
            world[:, bone] = body_rotations[:, column]
            rotations[:, bone] = np.swapaxes(above, -1, -2) @ body_rotations[:, column]
            if body.mode == 1:
                heads[:, bone] = positions[:, column] + body_rotations[:, column] @ (rest[bone] - body.position)
                translations[:, bone] = np.einsum("...ji,...j->...i", above, heads[:, bone] - start) - offset
                continue
        else:
            world[:, bone] = above @ rotations[:, bone]
        heads[:, bone] = start + np.einsum("...ij,...j->...i", above, offset + translations[:, bone])
    return replace(animation, rotations=rotations, translations=translations)


def stretched(animation: RigAnimation, rig: ApparelRig, bodies: np.ndarray) -> float:
    """The largest change of the distance between a bone that a body moves and its parent, over that distance at
    rest.
    """
    skeleton = animation.character.rig
    assert skeleton is not None
    bones = np.array(
        sorted({rig.bodies[index].bone for index in bodies if 0 <= rig.bodies[index].bone < len(skeleton.parents)}),
        np.int64,
    )
    bones = bones[skeleton.parents[bones] >= 0]
    above = skeleton.parents[bones]
    rest = np.linalg.norm(skeleton.positions[bones] - skeleton.positions[above], axis=1)
    bones, above, rest = bones[rest > SHORT], above[rest > SHORT], rest[rest > SHORT]
    if not len(bones):
        return 0.0
    heads = animation.world()[1]
    length = np.linalg.norm(heads[:, bones] - heads[:, above], axis=-1)
    return float(np.abs(length / rest - 1).max())
