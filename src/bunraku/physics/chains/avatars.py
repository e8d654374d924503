"""Chains as the avatars of other programs have them: springs and colliders of VRM, rigid bodies and joints of MMD.

A spring of VRM has no limits, no ties and no mass. So its numbers are not converted but fitted: the chains are
simulated here in a motion that sways and turns, and each gets the stiffness, drag and gravity with which VRM's own
steps come nearest to that.
"""

from __future__ import annotations

import numpy as np

from bunraku.core.mmd_model import MmdModel, MmdSdef
from bunraku.core.rig_animation import RigAnimation
from bunraku.core.vrm_model import VrmCollider, VrmModel, VrmSpring, VrmSpringJoint
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.physics.chains.chain import Chain
from bunraku.physics.chains.laid import Chained
from bunraku.physics.chains.moving import steady_simulation
from bunraku.physics.vrm_steps import VrmValues, vrm_tails

__all__ = ["mmd_avatar", "vrm_avatar"]

SECONDS = 5.0
_GRID = np.array([(stiffness, drag, gravity) for stiffness in (0.05, 0.2, 0.5, 1.0, 2.0, 4.0)
                  for drag in (0.05, 0.12, 0.25, 0.45, 0.7) for gravity in (0.0, 0.06, 0.13, 0.3)])  # fmt: skip
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
    values = _fitted(made)
    springs = []
    for chain, end, (stiffness, drag, gravity) in zip(made.chains, made.ends, values, strict=True):
        rooms = [_room(point, made) for point in chain.points[1:]]
        joints = [
            VrmSpringJoint(int(bone), float(stiffness), float(gravity), _DOWN, float(drag), _radius(chain, link, room))
            for link, (bone, room) in enumerate(zip(chain.bones, rooms, strict=True))
        ]
        joints.append(VrmSpringJoint(end, 1.0, 0.0, _DOWN, float(drag), 0.0))
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


def _fitted(made: Chained) -> np.ndarray:
    """Stiffness, drag and gravity of each chain, shape (C, 3)."""
    moved = _swaying(made)
    rotations, places = moved.world()
    ours = steady_simulation(moved, made.rig()).animation.world()[1]
    rig = made.character.rig
    assert rig is not None
    out = np.zeros((len(made.chains), 3))
    moving: dict[int, tuple[np.ndarray, np.ndarray]] = {}  # world of the links as VRM's steps have them
    for number, (chain, end) in enumerate(zip(made.chains, made.ends, strict=True)):
        holder = int(chain.holder)
        turns, heads = rotations[:, holder], places[:, chain.bones[0]]
        if holder in moving:  # hung on a link: as that goes in the simulation
            turns, heads = moving[holder][0], ours[:, chain.bones[0]]
        rest = np.diff(chain.points, axis=0)
        values = VrmValues(_GRID[:, 0], _GRID[:, 1], _GRID[:, 2])
        tails = vrm_tails(turns, heads, rest, values, moved.fps)  # (S, N, R, 3)
        true = ours[:, [*chain.bones[1:], end]]
        error = np.linalg.norm(tails - true, axis=-1).mean(axis=(1, 2))
        out[number] = _GRID[int(error.argmin())]
        for bone in chain.bones:
            moving[int(bone)] = (rotations[:, holder], places[:, bone])
    return out


def _swaying(made: Chained) -> RigAnimation:
    """A body that bends, turns and goes to and fro, all of it made of a few sines."""
    rig = made.character.rig
    assert rig is not None
    frames = round(SECONDS * 30)
    time = np.arange(frames) / 30
    count = len(rig.names)
    rotations = np.tile(np.eye(3), (frames, count, 1, 1))
    translations = np.zeros((frames, count, 3))
    top = int(np.flatnonzero(rig.parents < 0)[0])
    size = made.character.height
    holders = {int(chain.holder) for chain in made.chains}
    links = {int(bone) for chain in made.chains for bone in chain.bones}
    for bone in sorted(({top} | holders) - links):
        share = 1.0 if bone == top else 0.7
        angles = np.stack(
            [
                0.25 * np.sin(2 * np.pi * 0.9 * time),
                0.6 * np.sin(2 * np.pi * 0.4 * time),
                0.2 * np.sin(2 * np.pi * 0.6 * time),
            ],
            axis=1,
        )
        rotations[:, bone] = matrix_from_axis_angle(share * angles)
    translations[:, top] = size * np.stack(
        [
            0.1 * np.sin(2 * np.pi * 0.5 * time),
            0.02 * np.sin(2 * np.pi * 1.9 * time),
            0.25 * np.sin(2 * np.pi * 0.3 * time),
        ],
        axis=1,
    )
    return RigAnimation(made.character, rotations, translations, 30.0)
