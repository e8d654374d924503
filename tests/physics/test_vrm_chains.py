"""Springs of VRM as bodies and joints, against VRM's own steps."""

from dataclasses import replace

import numpy as np
from bodies import BARE, character, still

from bunraku.core.vrm_model import VrmCollider, VrmModel, VrmSpring, VrmSpringJoint
from bunraku.physics.simulate import simulate
from bunraku.physics.vrm_chains import VRM_RATE, vrm_rig


class Source:
    """The nodes of a file: those of the rig, in its order."""

    def __init__(self, rig):
        self.tree = type("Tree", (), {"world": rig.transforms, "parents": rig.parents})()
        self.skins = type("Skins", (), {"nodes": list(range(len(rig.names)))})()


def doll(drag=0.4, stiffness=1.0, gravity=0.0, colliders=(), groups=(), chosen=()):
    made = character([[0, 1, 0], [0, 1.5, 0], [0.1, 1.5, 0], [0.2, 1.5, 0]], [-1, 0, 1, 2])
    made = replace(made, source=Source(made.rig))
    joints = tuple(VrmSpringJoint(node, stiffness, gravity, np.array([0, -1.0, 0]), drag, 0.02) for node in (1, 2, 3))
    return made, VrmModel("1.0", "", {}, (VrmSpring("hair", joints, tuple(chosen)),), tuple(colliders), tuple(groups))


def test_a_chain_hangs_on_the_bone_above():
    made, avatar = doll()
    rig = vrm_rig(made, avatar)
    assert [body.bone for body in rig.bodies] == [0, 1, 2] and [body.dynamic for body in rig.bodies] == [
        False,
        True,
        True,
    ]
    assert [joint.bodies for joint in rig.joints] == [(0, 1), (1, 2)]
    assert np.allclose(rig.bodies[1].position, [0.1, 1.5, 0]) and np.allclose(rig.joints[0].position, [0, 1.5, 0])


def test_a_joint_leans_as_vrm_lets_it():
    """Where gravity and stiffness balance: the tail of a chain of one joint, by VRM's own steps."""
    made, avatar = doll(gravity=0.5, drag=0.4)
    one = VrmModel("1.0", "", {}, (VrmSpring("hair", avatar.springs[0].joints[1:], ()),), (), ())
    found = simulate(still(made, 60), vrm_rig(made, one), warmup=0, settings=BARE).animation
    tail = before = np.array([0.1, 0.0])
    for _ in range(600):
        step = (1 - 0.4) * (tail - before) + np.array([1.0, 0]) / VRM_RATE + 0.5 * np.array([0, -1.0]) / VRM_RATE
        before, tail = tail, tail + step
        tail = 0.1 * tail / np.linalg.norm(tail)
    turn = found.world()[0][-1, 2] @ [1, 0, 0]
    assert np.isclose(np.arctan2(-turn[1], turn[0]), np.arctan2(-tail[1], tail[0]), atol=0.02)


def test_colliders_are_for_the_springs_that_name_them():
    shapes = [
        VrmCollider(0, "sphere", np.zeros(3), 0.1),
        VrmCollider(0, "capsule", np.zeros(3), 0.1, np.array([0, 0.5, 0])),
    ]
    shapes.append(VrmCollider(0, "plane", np.zeros(3), 0.0, np.array([0, 1.0, 0])))
    made, avatar = doll(colliders=shapes, groups=((0,), (1,), (2,)), chosen=(1, 2))
    rig = vrm_rig(made, avatar)
    stops = [body for body in rig.bodies if body.mask and not body.dynamic]
    assert [stop.shape for stop in stops] == ["capsule"] and np.isclose(stops[0].size[1], 0.5)
    swings = [body for body in rig.bodies if body.dynamic]
    assert all(body.mask >> stops[0].group & 1 and stops[0].mask >> body.group & 1 for body in swings)
    assert any("planes" in note for note in rig.notes)


def test_a_node_of_two_springs_swings_once():
    made, avatar = doll()
    twice = VrmModel("1.0", "", {}, avatar.springs * 2, (), ())
    rig = vrm_rig(made, twice)
    assert len(rig.dynamic) == 2 and any("several springs" in note for note in rig.notes)
