"""Parts whose edges are drawn out or folded, and no others."""

from dataclasses import replace

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.body.layout import JOINT_COUNT
from bunraku.core.character import Character, Rig
from bunraku.core.rig_animation import RigAnimation
from bunraku.physics.chains.after.torn import eased, own_way, tears, torn_parts

FRAMES = 10


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
    still = np.tile(clothed.rest, (FRAMES, 1, 1))
    shown = still.copy()
    shown[:, clothed.part == 0] += [0, 3, 0]  # moves whole
    shown[5:, (clothed.part == 1) & (clothed.rest[:, 1] > 2)] += [0, 4, 0]  # breaks in the midst in half of the frames
    share = tears(clothed, shown.__getitem__, still.__getitem__, FRAMES)
    # five edges along, and four across the squares of that row, of 56, are too long
    np.testing.assert_allclose([share[0], share[1]], [0, 0.5 * 9 / 56], atol=1e-6)
    assert set(torn_parts(clothed, shown.__getitem__, still.__getitem__, FRAMES)) == {1}


def test_what_the_body_tears_alone_does_not_count():
    clothed = sheets()
    moved = np.tile(clothed.rest, (FRAMES, 1, 1))
    moved[:, (clothed.part == 1) & (clothed.rest[:, 1] > 2)] += [0, 4, 0]
    assert not torn_parts(clothed, moved.__getitem__, moved.__getitem__, FRAMES)


def test_torn_places_go_over_to_the_skin_and_what_is_far_goes_its_own_way():
    clothed = sheets()
    still = np.tile(clothed.rest, (FRAMES, 1, 1))
    shown = still.copy()
    shown[:, (clothed.part == 1) & (clothed.rest[:, 1] > 2)] += [0, 4, 0]
    own = own_way(clothed, shown.__getitem__, still.__getitem__, FRAMES, {1})
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
    translations = np.zeros((FRAMES, 2, 3))
    translations[:, 1] = [0, 0, 1]
    moved = RigAnimation(
        Character("sheets", clothed.rest, clothed.faces, grown),
        np.tile(np.eye(3), (FRAMES, 2, 1, 1)),
        translations,
        30.0,
    )
    own = np.linspace(0, 1, count, dtype=np.float32)
    up = eased(moved, bare, own).vertices()[0, :, 2] - clothed.rest[:, 2]
    np.testing.assert_allclose(up, own, atol=1e-6)
