import math

import numpy as np
import pytest
from scipy.linalg import sqrtm

from bunraku.errors import OptionError
from bunraku_lab.evaluation.motion.metrics import (
    diversity,
    fid,
    frechet_distance,
    interval,
    multimodal_distance,
    multimodality,
    r_precision,
)


def test_r_precision_by_hand():
    motions = np.array([[0.0], [0.0], [0.0], [0.0]])
    candidates = np.array(
        [[[1], [2], [3], [4]], [[2], [1], [3], [4]], [[3], [2], [1], [4]], [[4], [3], [2], [1]]], float
    )
    assert r_precision(motions, candidates) == (0.25, 0.5, 0.75)


def test_an_extractor_without_an_opinion_finds_nothing():
    assert r_precision(np.ones((5, 3)), np.ones((5, 32, 3))) == (0, 0, 0)


def test_frechet_distance_of_gaussians_in_closed_form():
    # one dimension: (m - n)^2 + (s - t)^2
    assert frechet_distance(np.array([1.0]), np.array([[4.0]]), np.array([-2.0]), np.array([[25.0]])) == pytest.approx(
        9 + 9
    )
    # covariances that commute: the same, axis by axis, in any frame
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(5, 5)))[0]
    a, b = np.array([1.0, 2, 3, 4, 0]), np.array([2.0, 2, 1, 0.5, 3])
    one, other = turn @ np.diag(a**2) @ turn.T, turn @ np.diag(b**2) @ turn.T
    assert frechet_distance(np.zeros(5), one, np.ones(5), other) == pytest.approx(5 + ((a - b) ** 2).sum())
    assert frechet_distance(a, one, a, one) == pytest.approx(0, abs=1e-9)


def test_frechet_distance_agrees_with_the_matrix_root_of_scipy():
    random = np.random.default_rng(1)
    a, b = (random.normal(size=(50, 6)) @ random.normal(size=(6, 6)) for _ in range(2))
    root = np.real(sqrtm(np.cov(a.T) @ np.cov(b.T)))
    want = ((a.mean(0) - b.mean(0)) ** 2).sum() + np.trace(np.cov(a.T) + np.cov(b.T) - 2 * root)
    assert fid(a, b) == pytest.approx(want, rel=1e-6)
    assert fid(a, b) == pytest.approx(fid(b, a))


def test_fid_survives_singular_covariances_and_moves_with_the_mean():
    flat = np.random.default_rng(2).normal(size=(4, 10))  # fewer samples than numbers
    assert fid(flat, flat) == pytest.approx(0, abs=1e-6)
    assert fid(flat, flat + 2) == pytest.approx(40, rel=1e-6)
    with pytest.raises(OptionError, match="at least 2"):
        fid(flat[:1], flat)


def test_fid_of_samples_comes_to_that_of_their_gaussians():
    random = np.random.default_rng(3)
    assert fid(random.normal(size=(40_000, 2)), 1 + 3 * random.normal(size=(40_000, 2))) == pytest.approx(
        2 + 2 * 4, rel=0.03
    )


def test_distances_by_hand():
    assert multimodal_distance(np.array([[0.0, 0], [3, 4]]), np.array([[0.0, 1], [0, 0]])) == 3
    assert diversity(np.array([[0.0], [6.0]]), np.random.default_rng(0)) == 6
    rows = np.array([[[0.0], [1.0]], [[0.0], [5.0]]])
    assert multimodality(rows, np.random.default_rng(0)) == 3
    with pytest.raises(OptionError, match="at least 2"):
        multimodality(rows[:, :1], np.random.default_rng(0))
    with pytest.raises(OptionError, match="at least 2"):
        diversity(rows[0, :1], np.random.default_rng(0))


def test_diversity_uses_no_motion_twice():
    points = np.eye(40) * np.sqrt(0.5)  # every two are 1 apart, and none is from itself
    assert diversity(points, np.random.default_rng(0), pairs=300) == pytest.approx(1)


def test_interval_by_hand():
    found = interval([1.0, 2.0, 3.0])
    assert found.mean == 2 and found.half == pytest.approx(4.302653 * 1 / math.sqrt(3), rel=1e-5)  # t with two degrees
    assert interval([5.0]).half == 0


def test_intervals_cover_the_truth_as_often_as_they_say():
    random = np.random.default_rng(4)
    found = [interval(random.normal(size=20)) for _ in range(800)]
    assert np.mean([abs(one.mean) <= one.half for one in found]) == pytest.approx(0.95, abs=0.025)
