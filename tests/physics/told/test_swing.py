"""How vertices swing by their chains: against values by hand, and against the simulation of the same bodies."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bodies import body, character, joint, still

from bunraku.apparel.displacement.own_pendulum import OwnPendulum
from bunraku.apparel.swing import SWING_NUMBERS, Swing
from bunraku.core.character import Rig
from bunraku.physics.apparel_rig import ApparelRig
from bunraku.physics.settings import PhysicsSettings
from bunraku.physics.simulate import simulate
from bunraku.physics.told.swing import vertex_swing

_TURN = np.radians(20.0)


def hung(points, heads, bones, bodies, joints):
    """A doll whose vertices hang whole on the bones that are named, and what physics move of it."""
    doll = character(heads, np.arange(len(heads)) - 1)
    rig = Rig(doll.rig.names, doll.rig.parents, doll.rig.transforms, np.array(bones)[:, None], np.ones((len(bones), 1)))
    vertices = np.array(points, np.float32)
    faces = np.array([[0, 0, 0]])
    return replace(doll, vertices=vertices, faces=faces, rig=rig), ApparelRig(tuple(bodies), tuple(joints))


def links(limits, damping=0.5):
    """Links of 20 cm below a head at 2 m, with some limits [rad], and a vertex at the end of each."""
    heads = [[0, 2, 0], *([0, 2 - 0.2 * link, 0] for link in range(len(limits)))]
    size = np.array([0.02, 0.0, 0.0])
    bodies = [body("root", 0, [0, 2, 0], 0)]
    joints = []
    for link, limit in enumerate(limits):
        middle = [0, 1.9 - 0.2 * link, 0]
        far = np.full(3, limit)
        bodies.append(
            body(f"link {link}", link + 1, middle, size=size, linear_damping=damping, angular_damping=damping)
        )
        joints.append(joint(link, link + 1, heads[link + 1], angle_lower=-far, angle_upper=far))
    points = [[0, 2.1, 0], *([0, 1.8 - 0.2 * link, 0] for link in range(len(limits)))]
    return hung(points, heads, range(len(limits) + 1), bodies, joints)


def test_two_like_links_share_the_turn():
    doll, rig = links([_TURN, _TURN])
    swing = vertex_swing(doll, rig)
    np.testing.assert_allclose(swing.share, [0, 1, 1])
    # by hand: half of a turn about 2 m, half about 1.8 m
    np.testing.assert_allclose(swing.lever[1:], [[0, -0.1, 0], [0, -0.3, 0]], atol=1e-6)
    np.testing.assert_allclose(swing.away[1:], [[0, -0.2, 0], [0, -0.3, 0]], atol=1e-6)
    np.testing.assert_allclose(swing.upper[2], 2 * _TURN, atol=1e-6)
    np.testing.assert_allclose(swing.lower[2], -2 * _TURN, atol=1e-6)


def test_a_locked_link_turns_nothing():
    doll, rig = links([0.0, _TURN])
    swing = vertex_swing(doll, rig)
    assert np.abs(swing.lever[1]).max() < 2e-3  # of 20 cm
    np.testing.assert_allclose(swing.lever[2], [0, -0.2, 0], atol=2e-3)
    np.testing.assert_allclose(swing.upper[2], _TURN, atol=1e-6)


def test_limits_count_by_axes():
    """A strand that swings to one side only: about its z axis, and by no more than the file says."""
    doll, rig = links([_TURN])
    one = replace(rig.joints[0], angle_lower=np.array([0, 0, -0.1]), angle_upper=np.array([0, 0, 0.5]))
    swing = vertex_swing(doll, replace(rig, joints=(one,)))
    assert swing.lower[1] == pytest.approx([0, 0, -0.5], abs=1e-6)  # B in A turns the other way round
    assert swing.upper[1] == pytest.approx([0, 0, 0.1], abs=1e-6)


def test_rows_and_back():
    doll, rig = links([_TURN, 0.3])
    swing = vertex_swing(doll, rig)
    rows = swing.rows()
    assert rows.shape == (3, SWING_NUMBERS)
    np.testing.assert_array_equal(Swing.of_rows(rows).rows(), rows)
    np.testing.assert_array_equal(Swing.of_rows(rows).upper, swing.upper)
    stiffer = swing.dialled(4.0)
    np.testing.assert_allclose(stiffer.upper, swing.upper / 2)
    np.testing.assert_allclose(stiffer.spring, 4 * swing.spring)


@pytest.mark.parametrize("limits", [[np.pi], [0.15], [0.3, 0.3, 0.3]])
def test_pendulums_swing_as_the_simulation_has_it(limits):
    """The head is shaken from side to side; the ends of the strand go where MuJoCo takes them."""
    doll, rig = links(limits, damping=0.7)
    times = np.arange(120) / 30
    animation = still(doll, len(times))
    moved = animation.translations.copy()
    moved[:, 0, 0] = 0.15 * (1 - np.cos(5.0 * times))
    animation = replace(animation, translations=moved)
    settings = PhysicsSettings(limbs=False)
    truth = simulate(animation, rig, warmup=0, settings=settings).animation.vertices()[:, 1:]
    carried = doll.vertices[1:] + moved[:, :1]
    swing = vertex_swing(doll, rig).take(np.arange(1, len(doll.vertices)))
    turns = np.tile(np.eye(3), (len(carried[0]), 1, 1))
    own = OwnPendulum(swing, carried[0], turns)
    found = np.stack([own.advance(positions, turns) for positions in carried])
    rigid = np.linalg.norm(truth - carried, axis=-1).mean()
    assert rigid > 0.01
    assert np.linalg.norm(carried + found - truth, axis=-1).mean() < 0.4 * rigid
