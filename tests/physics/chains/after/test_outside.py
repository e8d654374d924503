"""Chains that have sunk into the body are turned out of it, and stay bones."""

import numpy as np
import trimesh

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.character import Character, Rig, top_influences
from bunraku.core.rig_animation import RigAnimation
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.physics.chains.after.outside import outside
from bunraku.physics.chains.from_shape import shape_chains
from bunraku.physics.chains.laid import with_chains

JOINTS = np.arange(JOINT_COUNT)
RADIUS, FRAMES = 0.3, 20


def worn():
    """A ball of 0.6 m and a strip that hangs down beside it, 4 cm away, held at its top; chains over the strip."""
    ball = trimesh.creation.icosphere(4, RADIUS)
    across, down = np.meshgrid(np.linspace(-0.04, 0.04, 5), np.linspace(0.25, -0.25, 26))
    strip = np.stack([across, down, np.full_like(across, RADIUS + 0.04)], axis=-1).reshape(-1, 3)
    index = np.arange(len(strip)).reshape(across.shape) + len(ball.vertices)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    faces = np.concatenate([ball.faces, quads[:, :3], quads[:, [0, 2, 3]]])
    rest = np.concatenate([ball.vertices, strip]).astype(np.float32)
    weights = np.zeros((len(rest), JOINT_COUNT), np.float32)
    weights[:, JOINT_NAMES.index("spine3")] = 1
    apparel = np.arange(len(rest)) >= len(ball.vertices)
    joints = np.zeros((JOINT_COUNT, 3))
    clothed = ClothedCharacter(
        rest, faces, joints, weights, apparel, np.where(apparel, 0, -1), np.zeros(1), np.full(1, 0.9)
    )
    transforms = np.tile(np.eye(4), (JOINT_COUNT, 1, 1))
    rig = Rig(JOINT_NAMES, np.array(JOINT_PARENTS), transforms, *top_influences(weights, 4))
    body = Character("ball", rest, faces, rig)
    return clothed, with_chains(body, shape_chains(clothed), JOINTS), body


def swung(made, body, angle):
    """The first links of the chains turn towards the ball by an angle [rad], and back."""
    still = RigAnimation(
        body, np.tile(np.eye(3), (FRAMES, JOINT_COUNT, 1, 1)), np.zeros((FRAMES, JOINT_COUNT, 3)), 30.0
    )
    moved = made.on(still)
    rotations = np.array(moved.rotations)
    angles = angle * np.sin(np.linspace(0, np.pi, FRAMES))
    for chain in made.chains:
        rotations[:, chain.bones[0]] = matrix_from_axis_angle(angles[:, None] * [1.0, 0, 0])
    return RigAnimation(moved.character, rotations, moved.translations, 30.0)


def test_a_strip_leaves_the_ball():
    clothed, made, body = worn()
    before = swung(made, body, 1.2)
    after = outside(before, made.chains, clothed, JOINTS)
    deep = [
        (RADIUS - np.linalg.norm(one.vertices()[:, clothed.apparel], axis=-1)).max(axis=1) for one in (before, after)
    ]
    assert deep[0].max() > 0.02
    assert deep[1].max() < 0.4 * deep[0].max()
    np.testing.assert_array_equal(after.translations, before.translations)  # no bone is longer than it was
    body_bones = np.arange(JOINT_COUNT)
    np.testing.assert_array_equal(after.rotations[:, body_bones], before.rotations[:, body_bones])
    turns = after.rotations.astype(float)
    np.testing.assert_allclose(turns @ np.swapaxes(turns, -1, -2), np.broadcast_to(np.eye(3), turns.shape), atol=1e-5)


def test_what_is_outside_stays():
    clothed, made, body = worn()
    before = swung(made, body, -0.3)
    assert outside(before, made.chains, clothed, JOINTS) is before


def test_a_strip_leaves_a_limb_that_comes_near():
    """A second ball, a hand that is far away at rest, comes from the front as the strip lies on the first one."""
    clothed, _, _ = worn()
    hand = JOINT_NAMES.index("left_wrist")
    ball = trimesh.creation.icosphere(3, 0.1)
    away = np.array([2.0, 0, 0])
    count = len(clothed.rest)
    weights = np.concatenate([clothed.weights, np.eye(JOINT_COUNT, dtype=np.float32)[[hand] * len(ball.vertices)]])
    rest = np.concatenate([clothed.rest, (ball.vertices + away).astype(np.float32)])
    faces = np.concatenate([clothed.faces, ball.faces + count])
    apparel = np.concatenate([clothed.apparel, np.zeros(len(ball.vertices), bool)])
    joints = np.zeros((JOINT_COUNT, 3))
    joints[hand] = away
    both = ClothedCharacter(
        rest, faces, joints, weights, apparel, np.where(apparel, 0, -1), np.zeros(1), np.full(1, 0.9)
    )
    transforms = np.tile(np.eye(4), (JOINT_COUNT, 1, 1))
    transforms[hand, :3, 3] = away
    body = Character("balls", rest, faces, Rig(JOINT_NAMES, np.array(JOINT_PARENTS), transforms, *top_influences(
        weights, 4)))  # fmt: skip
    made = with_chains(body, shape_chains(both), JOINTS)
    translations = np.zeros((FRAMES, JOINT_COUNT, 3))
    centre = np.array([0, -0.22, RADIUS + 0.04 + 0.08])  # 2 cm into the strip's lower end
    translations[:, hand] = centre - away
    still = RigAnimation(body, np.tile(np.eye(3), (FRAMES, JOINT_COUNT, 1, 1)), translations, 30.0)
    before = made.on(still)
    after = outside(before, made.chains, both, JOINTS)
    depths = [
        (0.1 - np.linalg.norm(one.vertices()[:, both.apparel] - centre, axis=-1)).max() for one in (before, after)
    ]
    assert depths[0] > 0.015
    assert depths[1] < 0.5 * depths[0]
