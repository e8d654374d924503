"""Chains as the avatars of other programs have them: springs and colliders of VRM, rigid bodies and joints of MMD."""

from __future__ import annotations

import numpy as np

from bunraku.core.mmd_model import MmdModel, MmdSdef
from bunraku.core.vrm_model import VrmCollider, VrmModel, VrmSpring, VrmSpringJoint
from bunraku.physics.chains.chain import Chain
from bunraku.physics.chains.laid import Chained
from bunraku.physics.chains.vrm_fit import fitted_springs

__all__ = ["mmd_avatar", "vrm_avatar"]

_DOWN = np.array([0.0, -1, 0])


def mmd_avatar(made: Chained) -> MmdModel:
    """The rigid bodies and joints of a character's chains, by the bones of its rig; the writer makes the rest."""
    rig = made.rig()
    none = np.zeros((0, 3))
    return MmdModel(
        made.character.name, "", "PMX 2.0", (), (), rig.bodies, rig.joints, np.zeros(0, np.uint8),
        MmdSdef(np.zeros(0, np.int64), none, none, none),
    )  # fmt: skip


def vrm_avatar(made: Chained) -> VrmModel:
    """The springs and colliders of a character's chains, by the bones of its rig."""
    rig = made.character.rig
    assert rig is not None
    colliders = []
    for body in made.colliders:
        half = 0.5 * body.size[1] * body.rotation[:, 1]
        middle = body.position - rig.positions[body.bone]
        colliders.append(VrmCollider(body.bone, "capsule", middle - half, float(body.size[0]), middle + half))
    springs = []
    for chain, end, values in zip(made.chains, made.ends, fitted_springs(made), strict=True):
        rooms = [_room(point, made) for point in chain.points[1:]]
        joints = [
            VrmSpringJoint(int(bone), float(stiffness), float(gravity), _DOWN, float(drag), _radius(chain, link, room))
            for link, (bone, room, (stiffness, drag, gravity)) in enumerate(
                zip(chain.bones, rooms, values, strict=True)
            )
        ]
        joints.append(VrmSpringJoint(end, 1.0, 0.0, _DOWN, float(values[-1, 1]), 0.0))
        # what lies within a collider at rest would be thrown out of it
        springs.append(VrmSpring(chain.name, tuple(joints), (0,) if colliders and min(rooms) > 0 else ()))
    groups = (tuple(range(len(colliders))),) if colliders else ()
    return VrmModel("1.0", made.character.name, {}, tuple(springs), tuple(colliders), groups)


def _radius(chain: Chain, link: int, room: float) -> float:
    return float(np.clip(min(0.6 * chain.width[link], room), 0.0, 0.04))


def _room(point: np.ndarray, made: Chained) -> float:
    """How far a point is from the nearest collider at rest [m]; far where there are none."""
    out = np.inf
    for body in made.colliders:
        along = body.rotation[:, 1]
        half = 0.5 * body.size[1]
        at = np.clip((point - body.position) @ along, -half, half)
        out = min(out, float(np.linalg.norm(point - body.position - at * along) - body.size[0]))
    return out
