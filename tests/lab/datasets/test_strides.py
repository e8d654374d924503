"""The speed that feet on the spot mean, for feet whose speed is known."""

import numpy as np
import pytest

from bunraku.core.motion import HandleMotion
from bunraku_lab.datasets.motions.strides import forward_speed, played_on, with_travel


def walker(speed, frames=40, fps=20.0, height=1.0):
    """Two feet of four points under a body: each stands for half a second and moves back with `speed`, then swings
    forward high.
    """
    moments = np.arange(frames) / fps
    vertices = np.zeros((frames, 9, 3))
    vertices[:, 8] = [0, height, 0]
    square = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0, 0.05], [0.05, 0, 0.05]])
    for foot, shift in enumerate((0.0, 0.5)):
        phase = (moments + shift) % 1.0
        stands = phase < 0.5
        z = np.where(stands, -speed * phase, -speed * 0.5 + speed * (phase - 0.5))
        y = np.where(stands, 0, 0.3 * np.sin((phase - 0.5) * 2 * np.pi))
        vertices[:, 4 * foot : 4 * foot + 4] = square + np.stack([np.full(frames, 0.2 * foot), y, z], axis=1)[:, None]
    return vertices


@pytest.mark.parametrize("speed", [0.2, 1.0, 3.0])
def test_standing_feet_tell_the_speed(speed):
    assert forward_speed(walker(speed), np.ones(9, bool), 1.0, 20.0) == pytest.approx(speed, rel=0.05)


def test_who_stands_or_floats_has_no_speed():
    assert forward_speed(walker(0.0), np.ones(9, bool), 1.0, 20.0) == 0
    assert forward_speed(walker(-1.0), np.ones(9, bool), 1.0, 20.0) == 0
    assert forward_speed(np.zeros((1, 9, 3)), np.ones(9, bool), 1.0, 20.0) == 0


def test_travel_is_added_once():
    frames = 11
    still = HandleMotion(
        np.zeros((frames, 2, 3)),
        np.broadcast_to(np.eye(3), (frames, 2, 3, 3)),
        np.zeros((frames, 3)),
        np.broadcast_to(np.eye(3), (frames, 3, 3)),
    )
    moved = with_travel(still, 2.0)
    assert moved.root_translation[-1].tolist() == pytest.approx([0, 0, 1.0])
    assert with_travel(moved, 2.0) is moved and with_travel(still, 0.0) is still


def turning(frames, end):
    """A handle that turns from 0 to `end` and moves on by 0.1 m a frame."""
    from scipy.spatial.transform import Rotation

    rotations = np.tile(np.eye(3), (frames, 2, 1, 1))
    rotations[:, 1] = Rotation.from_euler("x", np.linspace(0, end, frames)[:, None]).as_matrix()
    path = np.outer(np.arange(frames), [0, 0, 0.1])
    return HandleMotion(np.zeros((frames, 2, 3)), rotations, path, np.broadcast_to(np.eye(3), (frames, 3, 3)))


def test_a_loop_is_played_on_without_a_seam():
    loop = played_on(turning(11, 2 * np.pi), 40)
    assert len(loop) == 40  # four rounds of ten: the eleventh frame is the first again
    np.testing.assert_allclose(loop.rotations[10], loop.rotations[0], atol=1e-6)
    np.testing.assert_allclose(np.diff(loop.root_translation[:, 2]), 0.1, atol=1e-5)
    short = played_on(turning(10, 2 * np.pi * 0.9), 40)  # its last frame is one step before the first
    assert len(short) == 40 and np.abs(np.diff(short.rotations[:, 1, 1, 1])).max() < 0.7
    once = turning(10, 1.5)
    assert played_on(once, 40) is once and played_on(loop, 40) is loop
