"""The push that the simulation ends with, on a ball that wears a sheet."""

import numpy as np
import pytest
import trimesh

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.body.layout import JOINT_COUNT
from bunraku_lab.datasets.apparel.push_out import PushOut, inside_shares

RADIUS, FRAMES = 0.3, 24


def worn():
    """A ball of 0.6 m and a sheet that hangs down beside it, 5 cm away, held at its top."""
    ball = trimesh.creation.icosphere(4, RADIUS)
    across, down = np.meshgrid(np.linspace(-0.15, 0.15, 13), np.linspace(0.3, -0.2, 21))
    sheet = np.stack([across, down, np.full_like(across, RADIUS + 0.05)], axis=-1).reshape(-1, 3)
    index = np.arange(len(sheet)).reshape(across.shape) + len(ball.vertices)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    faces = np.concatenate([ball.faces, quads[:, :3], quads[:, [0, 2, 3]]])
    rest = np.concatenate([ball.vertices, sheet]).astype(np.float32)
    weights = np.zeros((len(rest), JOINT_COUNT), np.float32)
    weights[:, 0] = 1
    apparel = np.arange(len(rest)) >= len(ball.vertices)
    joints = np.zeros((JOINT_COUNT, 3))
    return ClothedCharacter(
        rest, faces, joints, weights, apparel, np.where(apparel, 0, -1), np.zeros(1), np.full(1, 0.9)
    )


def swung(clothed, deepest):
    """The sheet swings into the ball and out again, the more the farther down; the ball stands still."""
    pose = np.concatenate([np.tile(np.eye(3), (JOINT_COUNT, 1, 1)), clothed.joints[..., None]], axis=2)
    loose = np.flatnonzero(clothed.apparel)
    low = np.clip((0.25 - clothed.rest[loose, 1]) / 0.45, 0, 1)
    way = np.zeros((FRAMES, len(loose), 3))
    way[:, :, 2] = -deepest * np.sin(np.linspace(0, np.pi, FRAMES))[:, None] * low
    return np.repeat(pose[None], FRAMES, axis=0).astype(np.float32), loose, way.astype(np.float16)


def test_apparel_leaves_the_body():
    clothed = worn()
    transforms, loose, before = swung(clothed, 0.12)
    after = PushOut(clothed)(transforms, loose, before)
    assert after.dtype == np.float16 and after.shape == before.shape
    rigid, deep, left = inside_shares(clothed, transforms, loose, before, after)
    assert rigid == 0 and deep > 0.03 and left < 0.1 * deep
    # by hand: no vertex is nearer to the middle than the radius, less what is let be
    assert np.linalg.norm(clothed.rest[loose] + after.astype(float), axis=-1).min() > RADIUS - 0.007
    assert np.linalg.norm(clothed.rest[loose] + before.astype(float), axis=-1).min() < RADIUS - 0.02
    # smooth in time: no frame jumps farther from its neighbours than some millimetres more than before
    jerk = [np.abs(np.diff(offsets.astype(float), 2, axis=0)).max() for offsets in (before, after)]
    assert jerk[1] < jerk[0] + 0.01


def test_what_is_outside_stays():
    clothed = worn()
    transforms, loose, offsets = swung(clothed, 0.03)
    np.testing.assert_allclose(PushOut(clothed)(transforms, loose, offsets), offsets, atol=1e-3)


def test_shares_by_hand():
    """All of the sheet 8 cm towards the middle: the vertices within the radius less 1 cm are counted."""
    clothed = worn()
    transforms, loose, before = swung(clothed, 0.0)
    before[:, :, 2] = -0.08
    moved = clothed.rest[loose] - [0, 0, 0.08]
    wanted = (np.linalg.norm(moved, axis=1) < RADIUS - 0.01).mean()
    rigid, deep, again = inside_shares(clothed, transforms[:2], loose, before[:2], before[:2])
    assert (rigid, again) == (0, deep) and deep == pytest.approx(wanted, abs=0.02)
