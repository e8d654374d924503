"""Features of motion, and splicing of motions."""

import numpy as np
import pytest

from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_MIRROR
from bunraku.core.geometry.rotations import heading, matrix_from_axis_angle, matrix_y
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.generation.composition import join_point, splice
from bunraku.generation.features import FEATURE_SIZE, FeatureStatistics, decode, encode, feature_weights, mirror


def smooth_motion(frames=60, seed=0, fps=20.0, canonical=False):
    random = np.random.default_rng(seed)
    time = np.arange(frames) / fps

    def wave(*shape):
        return np.tensordot(
            np.sin(time[:, None] * random.uniform(1, 5, 4) + random.uniform(0, 6, 4)),
            random.normal(0, 0.3, (4, *shape)),
            1,
        )

    translations, vectors = wave(HANDLE_COUNT, 3), wave(HANDLE_COUNT, 3)
    translations[:, 0], vectors[:, 0] = 0, 0
    root = matrix_y(3 * time + 2.5) @ matrix_from_axis_angle(wave(3))
    position = np.cumsum(wave(3) * 0.1, axis=0) + [4, 0, -7]
    motion = HandleMotion(translations, matrix_from_axis_angle(vectors), position, root, fps)
    return _canonical(motion) if canonical else motion


def _canonical(motion):
    """The same motion moved to x = z = 0 and turned to face +Z at its first frame."""
    turn = matrix_y(-heading(motion.root_rotation, motion.fps)[:1])[0]
    position = (motion.root_translation - motion.root_translation[0] * [1, 0, 1]) @ turn.T
    return HandleMotion(motion.translations, motion.rotations, position, turn @ motion.root_rotation, motion.fps)


@pytest.mark.parametrize("fps", [20.0, 30.0])
def test_decode_undoes_encode_up_to_the_start(fps):
    motion = smooth_motion(200, fps=fps)
    features = encode(motion)
    assert features.shape == (200, FEATURE_SIZE) == (200, 271) and features.dtype == np.float32
    back, want = decode(features, fps), _canonical(motion)
    for name in ("translations", "rotations", "root_translation", "root_rotation"):
        np.testing.assert_allclose(getattr(back, name), getattr(want, name), atol=2e-5)


def test_features_ignore_where_and_which_way_the_motion_starts():
    motion = smooth_motion()
    turn = matrix_y(np.array(-2.0))
    moved = HandleMotion(
        motion.translations, motion.rotations, motion.root_translation @ turn.T + [9, 0, 1], turn @ motion.root_rotation
    )
    np.testing.assert_allclose(encode(moved), encode(motion), atol=2e-4)


def test_a_cut_of_the_features_is_the_cut_of_the_motion():
    features = encode(smooth_motion(100))
    whole, part = decode(features), decode(features[30:])
    turn = matrix_y(-features[1:31, 0].astype(float).sum(keepdims=True) / 20)[0]
    np.testing.assert_allclose(part.root_rotation, turn @ whole.root_rotation[30:], atol=1e-4)
    offset = (whole.root_translation[30:] - whole.root_translation[30] * [1, 0, 1]) @ turn.T
    np.testing.assert_allclose(part.root_translation, offset, atol=1e-4)


def test_mirrored_features_pose_the_mirrored_mesh():
    motion = smooth_motion(40, canonical=True)
    random = np.random.default_rng(1)
    flip, order = np.array([-1, 1, 1.0]), list(HANDLE_MIRROR)
    positions = random.normal(size=(HANDLE_COUNT, 3))
    positions = 0.5 * (positions + positions[order] * flip)
    vertices = random.normal(size=(50, 3)).astype(np.float32)
    weights = random.dirichlet(np.ones(HANDLE_COUNT), 50)
    posed = skin(vertices, weights, decode(encode(motion)).transforms(positions))
    reflected = skin(
        (vertices * flip).astype(np.float32), weights[:, order], decode(mirror(encode(motion))).transforms(positions)
    )
    np.testing.assert_allclose(reflected, posed * flip, atol=2e-4)
    np.testing.assert_array_equal(mirror(mirror(encode(motion))), encode(motion))


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 0, 1]])
def test_heading_of_a_lying_or_flipping_body_is_finite_and_smooth(axis):
    angle = np.linspace(0, 4 * np.pi, 160)
    flips = matrix_y(np.array(0.7)) @ matrix_from_axis_angle(angle[:, None] * np.array(axis, float))
    found = heading(flips)
    assert np.isfinite(found).all() and np.abs(np.diff(found)).max() < 0.2
    np.testing.assert_allclose(np.cos(found - 0.7), 1, atol=1e-3)
    upside_down = np.broadcast_to(matrix_from_axis_angle(np.array([np.pi, 0, 0])), (10, 3, 3))
    assert np.isfinite(heading(upside_down)).all()


def test_heading_follows_turns_past_half_a_circle():
    angle = np.linspace(0, 9, 120)
    np.testing.assert_allclose(heading(matrix_y(angle))[5:-5], angle[5:-5], atol=1e-3)


def test_statistics_are_mirror_symmetric_bounded_and_invertible():
    clip = encode(smooth_motion())
    clip[:, -9:] = 0.5
    statistics = FeatureStatistics.measure([clip, clip[:10]])
    assert (statistics.std >= 0.0299).all()
    np.testing.assert_allclose(statistics.mean, mirror(statistics.mean), atol=1e-6)
    np.testing.assert_allclose(statistics.std, np.abs(mirror(statistics.std)), rtol=1e-5)
    np.testing.assert_allclose(statistics.restore(statistics.normalise(clip)), clip, atol=1e-5)
    weights = feature_weights()
    assert weights.mean() == pytest.approx(1, abs=1e-5)
    np.testing.assert_array_equal(weights, np.abs(mirror(weights)))


def test_join_point_and_splice_of_a_wave_leave_no_jump(features):
    wave = features("left_elbow", frames=60, period=20)
    i, j, distance = join_point(wave, wave, feature_weights())
    joined = splice(wave, wave, i, j)
    assert distance < 1e-3 and len(joined) == i + len(wave) - j
    inside = np.abs(np.diff(wave, axis=0)).max()
    assert np.abs(np.diff(joined, axis=0)).max() < 1.05 * inside
    np.testing.assert_array_equal(joined[:i], wave[:i])
    np.testing.assert_array_equal(joined[-20:], wave[-20:])
