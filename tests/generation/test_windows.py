"""Long motions in windows, and given paths of the root."""

import math

import numpy as np
import pytest

from bunraku.core.body.layout import HANDLE_COUNT
from bunraku.core.geometry.rotations import matrix_from_axis_angle, matrix_y
from bunraku.core.motion import HandleMotion
from bunraku.core.nn.layers import Condition
from bunraku.core.travel import closed_loop, in_place, moved, placed_at, repeated
from bunraku.generation.candidates import arrive
from bunraku.generation.features import FEATURE_SIZE, decode
from bunraku.generation.sampler import Solver, alphas_cumprod, plan_windows, sample_plans
from bunraku_lab.evaluation.motion.metrics import posed_positions

FEATURES = 6


@pytest.fixture
def model(running):
    return running(features=FEATURES, handles=3)


@pytest.mark.parametrize("frames", [1, 10, 59, 60, 61, 200])
def test_any_length_can_be_made(model, encoder, frames):
    plans = [plan_windows([frames], 60), plan_windows([frames], 60)]
    for found in sample_plans(model, encoder.encode(["walks", "runs"]), plans, Solver(2)):
        assert found.values.shape[1] == FEATURES and len(found.values) == len(found.adaptation) >= frames
        assert bool(np.isfinite(found.values).all())


def test_progress_counts_every_step(model, encoder):
    calls = []
    sample_plans(
        model, encoder.encode(["walks"]), [plan_windows([100], 60)],
        Solver(3, progress=lambda done, total: calls.append((done, total))),
    )  # fmt: skip
    assert calls == [(1, 3), (2, 3), (3, 3)]


class Waves:
    """The best denoiser there is for smooth Gaussian processes: x0 = sqrt(a) S (a S + (1 - a) I)^-1 x_t, with S their
    covariance.
    """

    visited = ()

    def __init__(self, config):
        self.config, self.curve = config, alphas_cumprod()

    def condition(self, text, mask, pooled, mesh, keep_text, keep_mesh, examples=None):
        return Condition([], None, pooled, pooled, [], None)

    def __call__(self, x, step, lengths, condition, adapts):
        frames, share = x.shape[1], self.curve[step]
        apart = np.arange(frames)[:, None] - np.arange(frames)
        covariance = np.exp(-0.5 * (apart / 8.0) ** 2) + 1e-4 * np.eye(frames)
        gain = share**0.5 * np.linalg.solve(share * covariance + (1 - share) * np.eye(frames), covariance)
        return (gain.T @ x).astype(np.float32), np.zeros((*x.shape[:2], 3, 3), np.float32) if adapts else None


@pytest.mark.parametrize(
    ("lengths", "loop"), [([700], False), ([150, 40, 200, 30, 160], False), ([300], True), ([120], True)]
)
def test_long_motions_have_no_jump_where_windows_meet(config, encoder, lengths, loop):
    model = Waves(config(features=FEATURES, frames=196, handles=3))
    plan = plan_windows(lengths, 196, loop=loop)
    text = encoder.encode(["walks"] * len(lengths))
    values = sample_plans(model, text, [plan], Solver(20, guidance=1.0), seeds=2)[0].values
    frames = len(values)
    if loop:
        values = np.concatenate([values, values[:2]])
    seams = np.zeros(frames + 2 * loop, bool)
    for seam in plan.seams:
        seams[max(seam - 16, 0) : seam + 16] = True
    if loop:
        seams[-16:] = True
    for order in (1, 2):
        change = np.abs(np.diff(values, order, axis=0)).max(-1)
        inside = seams[:-order]
        assert float(change[inside].max()) <= 1.25 * float(change[~inside].max())
    assert float(values.std()) == pytest.approx(1, abs=0.3)
    if frames > 250:
        assert float((values[100:] - values[:-100]).std()) > 0.7  # windows are not copies of one another


FPS = 20.0


def walk(frames=61, turn=0.0, speed=1.0, sway=0.05, period=20):
    """A walk along +Z that turns at a rate [rad/s] and sways once a period; 20 frames more give the same pose."""
    time = np.arange(frames) / FPS
    angle = turn * time
    way = np.cumsum(np.stack([np.sin(angle), 0 * time, np.cos(angle)], -1) * speed / FPS, axis=0)
    way += (
        np.einsum("nij,j->ni", matrix_y(angle), [1.0, 0, 0])
        * (sway * np.sin(2 * math.pi * np.arange(frames) / period))[:, None]
    )
    bend = np.zeros((frames, HANDLE_COUNT, 3))
    bend[:, 5, 0] = 0.5 * np.sin(2 * math.pi * np.arange(frames) / period)
    return HandleMotion(np.zeros((frames, HANDLE_COUNT, 3)), matrix_from_axis_angle(bend), way, matrix_y(angle), FPS)


def positions(root):
    """Where root velocities lead, by `decode`, with a frame before them."""
    features = np.zeros((len(root) + 1, FEATURE_SIZE))
    features[:, [4, 8]] = 1
    features[:, 10:].reshape(len(root) + 1, -1, 9)[..., [3, 7]] = 1
    features[1:, :3] = root
    motion = decode(features, FPS)
    return motion.root_translation[-1, [0, 2]], motion.root_rotation[-1]


def test_a_loop_ends_facing_as_it_starts_and_travels_only_on_purpose():
    slow, fast = np.zeros((2, 40, 3), np.float32)
    slow[:, 0], slow[:, 2], fast[:, 0], fast[:, 2] = 0.1, 0.1, 3.0, 2.0
    position, rotation = positions(arrive(slow, FPS, None, None))
    np.testing.assert_allclose(position, 0, atol=1e-5)
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-5)
    slow[:, 2] = 1.0
    position, rotation = positions(arrive(slow, FPS, None, None))
    assert position[1] > 1.9
    _, rotation = positions(arrive(fast, FPS, None, None))  # 6 rad become one whole turn
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-5)


def test_moving_keeps_the_motion_and_puts_it_in_place():
    motion = walk()
    other = moved(motion, 0.7, np.array([3.0, 0.0, -2.0]))
    apart = np.linalg.norm(np.diff(posed_positions(motion), axis=0), axis=-1)
    np.testing.assert_allclose(np.linalg.norm(np.diff(posed_positions(other), axis=0), axis=-1), apart, atol=1e-5)
    back = placed_at(other, 4, motion, 4)
    np.testing.assert_allclose(back.root_translation, motion.root_translation, atol=1e-5)
    np.testing.assert_allclose(back.root_rotation, motion.root_rotation, atol=1e-5)


@pytest.mark.parametrize("turn", [0.0, 0.8])
def test_rounds_of_a_loop_go_on_from_each_other(turn):
    longer = walk(201, turn)
    whole = longer.take(slice(60, 121))  # three rounds of the sway
    found = repeated(whole, 60, 80)
    np.testing.assert_allclose(posed_positions(found), posed_positions(longer), atol=2e-4)


def test_a_nearly_closed_loop_is_closed():
    nearly = walk(58, 0.0, speed=0.02)
    found = closed_loop(nearly, walk(61, 0.0, speed=0.0))
    assert np.array_equal(found.rotations[0], found.rotations[-1]) and np.array_equal(
        found.translations[0], found.translations[-1]
    )
    np.testing.assert_allclose(found.root_translation[-1], found.root_translation[0], atol=1e-6)
    np.testing.assert_allclose(found.rotations[:40], nearly.rotations[:40], atol=1e-6)


@pytest.mark.parametrize("loop", [False, True])
def test_on_the_spot_the_way_goes_and_the_sway_stays(loop):
    found = in_place(walk(121), loop).root_translation
    assert np.ptp(found[:, 2]) < 0.02  # two metres and more before
    assert 0.08 < np.ptp(found[:, 0]) <= 0.11
    if loop:
        np.testing.assert_allclose(found[0], found[-1], atol=1e-5)
