"""What follows chains: cloth over legs, out of the body, whole, and without tears."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from bunraku.apparel.chains.body_collisions import BindToSkin, PushOutOfBody
from bunraku.apparel.chains.chain import Chain, LaidShape, parameters_of_laid
from bunraku.apparel.chains.chain_rig import Chained, with_chains
from bunraku.apparel.chains.cloth_repairs import DressedChains, MendTears, SmoothNeighbours, on_skin
from bunraku.apparel.chains.from_shape import shape_chains
from bunraku.apparel.chains.moving import steady_simulation
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.physics.rig import PhysicsSettings
from bunraku.core.animation import RigAnimation
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.character import Character, Rig, top_influences
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle

JOINTS = np.arange(JOINT_COUNT)
RADIUS, OUTSIDE_FRAMES = 0.3, 20


def worn(kind="cape"):
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
        rest, faces, joints, weights, apparel, np.where(apparel, 0, -1), np.zeros(1), np.full(1, 0.9), kinds=(kind,)
    )
    transforms = np.tile(np.eye(4), (JOINT_COUNT, 1, 1))
    rig = Rig(JOINT_NAMES, np.array(JOINT_PARENTS), transforms, *top_influences(weights, 4))
    body = Character("ball", rest, faces, rig)
    return clothed, with_chains(body, shape_chains(clothed), JOINTS), body


def swung(made, body, angle):
    """The first links of the chains turn towards the ball by an angle [rad], and back."""
    still = RigAnimation(
        body, np.tile(np.eye(3), (OUTSIDE_FRAMES, JOINT_COUNT, 1, 1)), np.zeros((OUTSIDE_FRAMES, JOINT_COUNT, 3)), 30.0
    )
    moved = made.on(still)
    rotations = np.array(moved.rotations)
    angles = angle * np.sin(np.linspace(0, np.pi, OUTSIDE_FRAMES))
    for chain in made.chains:
        rotations[:, chain.bones[0]] = matrix_from_axis_angle(angles[:, None] * [1.0, 0, 0])
    return RigAnimation(moved.character, rotations, moved.translations, 30.0)


def test_a_strip_leaves_the_ball():
    clothed, made, body = worn()
    before = swung(made, body, 0.4)
    after = PushOutOfBody()(before, DressedChains(made, clothed, JOINTS, body.rig))
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


def test_a_lock_is_pushed_no_farther_than_it_swings():
    clothed, made, body = worn("hair")
    before = swung(made, body, 1.2)
    after = PushOutOfBody()(before, DressedChains(made, clothed, JOINTS, body.rig))
    for chain in made.chains:
        turns = np.swapaxes(before.rotations[:, chain.bones], 2, 3) @ after.rotations[:, chain.bones]
        angles = np.linalg.norm(axis_angle_from_matrix(turns.astype(float)), axis=-1)
        assert (angles < chain.limits + 1e-3).all() and angles.max() > 0.5 * chain.limits[0]


@pytest.mark.parametrize("kind", ["cape", "hair"])
def test_what_stays_in_the_body_goes_with_the_skin(kind):
    clothed, made, body = worn(kind)
    before = swung(made, body, 1.2)
    still = RigAnimation(
        body, np.tile(np.eye(3), (OUTSIDE_FRAMES, JOINT_COUNT, 1, 1)), np.zeros((OUTSIDE_FRAMES, JOINT_COUNT, 3)), 30.0
    )
    after = BindToSkin()(before, still, DressedChains(made, clothed, JOINTS, body.rig))
    first, last = (
        (RADIUS - np.linalg.norm(one.vertices()[:, clothed.apparel], axis=-1)).max() for one in (before, after)
    )
    assert first > 0.02 and last < 0.5 * first


def test_a_strip_on_a_ball_that_tips_over_lies_on_it():
    clothed, made, body = worn()
    tips = np.tile(np.eye(3), (30, JOINT_COUNT, 1, 1))
    tips[:, 0] = matrix_from_axis_angle(np.linspace(0, -np.pi / 2, 30)[:, None] * [1.0, 0, 0])
    moved = made.on(RigAnimation(body, tips, np.zeros((30, JOINT_COUNT, 3)), 30.0))
    deep = []
    for chained in (replace(made, colliders=()), made):
        shown = steady_simulation(moved, chained.rig(), settings=PhysicsSettings(limbs=False)).animation.vertices()
        deep.append((RADIUS - np.linalg.norm(shown[-1, clothed.apparel], axis=-1)).max())
    assert deep[0] > 0.03
    assert deep[1] < 0.01


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
    translations = np.zeros((OUTSIDE_FRAMES, JOINT_COUNT, 3))
    centre = np.array([0, -0.22, RADIUS + 0.04 + 0.08])  # 2 cm into the strip's lower end
    translations[:, hand] = centre - away
    still = RigAnimation(body, np.tile(np.eye(3), (OUTSIDE_FRAMES, JOINT_COUNT, 1, 1)), translations, 30.0)
    before = made.on(still)
    after = PushOutOfBody()(before, DressedChains(made, both, JOINTS, body.rig))
    depths = [
        (0.1 - np.linalg.norm(one.vertices()[:, both.apparel] - centre, axis=-1)).max() for one in (before, after)
    ]
    assert depths[0] > 0.015
    assert depths[1] < 0.5 * depths[0]


COLUMNS, SEAM_FRAMES = 8, 3


def skirt():
    """Columns of one link all round, each on a bone of its own beneath a root, and which are neighbours."""
    turn = np.linspace(0, 2 * np.pi, COLUMNS, endpoint=False)
    out = np.stack([np.sin(turn), np.zeros(COLUMNS), np.cos(turn)], axis=1)
    transforms = np.tile(np.eye(4), (COLUMNS + 1, 1, 1))
    transforms[1:, :3, 3] = 0.2 * out + [0, 1, 0]
    names = ("root", *(f"skirt_0_{column}" for column in range(COLUMNS)))
    points = np.concatenate([[[0, 1, 0]], 0.3 * out + [0, 0.5, 0]])
    indices = np.zeros((len(points), 4), np.int32)
    indices[:, 0] = np.arange(len(points))
    weights = np.tile(np.array([1, 0, 0, 0], np.float32), (len(points), 1))
    rig = Rig(names, np.array([-1, *[0] * COLUMNS]), transforms, indices, weights)
    faces = np.array([[0, one, one % COLUMNS + 1] for one in range(1, COLUMNS + 1)])
    chains = [
        Chain(
            name, "skirt", np.array([column + 1]), np.stack([0.2 * way + [0, 1, 0], 0.3 * way + [0, 0.5, 0]]), 0,
            np.full(1, 0.05), 0.01, parameters_of_laid("skirt", LaidShape(0.5, np.inf, 0.03, 0.9)),
        )
        for column, (name, way) in enumerate(zip(names[1:], out, strict=True))
    ]  # fmt: skip
    near = [(column, (column + 1) % COLUMNS, 0.5) for column in range(COLUMNS)]
    return Character("skirt", points.astype(np.float32), faces, rig), chains, near, out


def turned(angles):
    """The animation whose columns turn outwards by angles [rad], shape (COLUMNS,), and what comes of it together."""
    character, chains, near, out = skirt()
    axes = np.cross([0.0, -1.0, 0.0], out)
    rotations = np.tile(np.eye(3), (SEAM_FRAMES, COLUMNS + 1, 1, 1))
    rotations[:, 1:] = matrix_from_axis_angle(angles[:, None] * axes)
    given = RigAnimation(character, rotations, np.zeros((SEAM_FRAMES, COLUMNS + 1, 3)))
    made = DressedChains(Chained(character, tuple(chains), (), (), (), tuple(near)), None, None, None)
    found = axis_angle_from_matrix(SmoothNeighbours()(given, made).rotations[:, 1:].astype(float))
    return (found * axes).sum(axis=-1), np.linalg.norm(found, axis=-1)


def test_a_column_that_goes_its_own_way_is_drawn_back_by_its_neighbours():
    angles = np.zeros(COLUMNS)
    angles[2] = 0.8
    angle, _ = turned(angles)
    assert (angle[:, 2] < 0.5).all() and (angle[:, 2] > 0.1).all()
    assert (angle[:, [1, 3]] > 0.05).all()
    assert (np.abs(angle[:, 6]) < 0.15).all()


TEAR_FRAMES = 10


def sheets():
    """Three sheets side by side that do not touch: the body, and two parts."""
    x, y = np.meshgrid(np.arange(5.0), np.arange(5.0))
    sheet = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    index = np.arange(25).reshape(5, 5)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
    rest = np.concatenate([sheet + [10 * number, 0, 0] for number in range(3)]).astype(np.float32)
    part = np.repeat([-1, 0, 1], 25)
    weights = np.eye(JOINT_COUNT, dtype=np.float32)[np.zeros(75, int)]
    blank = np.zeros(2, np.float32)
    return ClothedCharacter(
        rest, np.concatenate([faces + 25 * number for number in range(3)]), np.zeros((JOINT_COUNT, 3)), weights,
        part >= 0, part, blank, blank,
    )  # fmt: skip


def test_a_torn_part_is_told_from_a_whole_one():
    clothed = sheets()
    still = np.tile(clothed.rest, (TEAR_FRAMES, 1, 1))
    shown = still.copy()
    shown[:, clothed.part == 0] += [0, 3, 0]  # moves whole
    shown[5:, (clothed.part == 1) & (clothed.rest[:, 1] > 2)] += [0, 4, 0]  # breaks in the midst in half of the frames
    share = MendTears().torn_shares(clothed, shown.__getitem__, still.__getitem__, TEAR_FRAMES)
    # five edges along, and four across the squares of that row, of 56, are too long
    np.testing.assert_allclose([share[0], share[1]], [0, 0.5 * 9 / 56], atol=1e-6)
    assert MendTears().torn_parts(clothed, shown.__getitem__, still.__getitem__, TEAR_FRAMES) == {1}


def test_torn_places_go_over_to_the_skin_and_what_is_far_goes_its_own_way():
    clothed = sheets()
    still = np.tile(clothed.rest, (TEAR_FRAMES, 1, 1))
    shown = still.copy()
    shown[:, (clothed.part == 1) & (clothed.rest[:, 1] > 2)] += [0, 0.9, 0]
    own = MendTears().free_shares(clothed, shown.__getitem__, still.__getitem__, TEAR_FRAMES, {1})
    rows = clothed.part == 1
    np.testing.assert_array_equal(own[~rows], 1)
    np.testing.assert_array_equal(own[rows & np.isin(clothed.rest[:, 1], (2, 3))], 0)
    np.testing.assert_array_equal(own[rows & (clothed.rest[:, 1] < 2)], 1)


def test_eased_vertices_go_with_the_rig_that_is_given():
    clothed = sheets()
    count = len(clothed.rest)
    transforms = np.tile(np.eye(4), (2, 1, 1))
    one = np.zeros((count, 1), np.int32)
    bare = Rig(("body", "link"), np.array([-1, 0]), transforms, one, np.ones((count, 1), np.float32))
    grown = replace(bare, indices=one + 1)
    translations = np.zeros((TEAR_FRAMES, 2, 3))
    translations[:, 1] = [0, 0, 1]
    moved = RigAnimation(
        Character("sheets", clothed.rest, clothed.faces, grown), np.tile(np.eye(3), (TEAR_FRAMES, 2, 1, 1)),
        translations, 30.0,
    )  # fmt: skip
    own = np.linspace(0, 1, count, dtype=np.float32)
    up = on_skin(moved, bare, own).vertices()[0, :, 2] - clothed.rest[:, 2]
    np.testing.assert_allclose(up, own, atol=1e-6)
