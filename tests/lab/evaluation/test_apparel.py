"""What learned apparel is measured by, against values computed by hand."""

import numpy as np
import pytest

from bunraku.apparel.body import UnifiedBody
from bunraku.apparel.physics.clothed_from_file import clothed_from_file
from bunraku.core.skinning import skin
from bunraku_lab.evaluation.apparel.chains import chain_row, chain_summary
from bunraku_lab.evaluation.apparel.clips import TrueClip, edge_score, point_distance
from bunraku_lab.evaluation.apparel.rivals import best_skinning
from bunraku_lab.evaluation.apparel.table import APPAREL_BARS, _rest_table
from bunraku_lab.synthetic.wardrobe import wardrobe_character


def test_distance_by_hand():
    truth = np.zeros((2, 2, 3))
    moved = np.array([[[3.0, 4, 0], [0, 0, 0]], [[0, 0, 1], [0, 2, 0]]])
    assert point_distance(moved, truth).tolist() == [2.5, 1.5]


def test_edge_score_by_hand():
    rest = np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0], [1, 2, 0]])
    moved = np.array([[[0.0, 0, 0], [1.1, 0, 0], [1.1, 1, 0], [5, 5, 5]]])
    # edges 1 -> 1.1 (10 %), 2 -> 1 (50 %); the last one has no length and does not count
    assert edge_score(moved, rest, np.array([[0, 1], [1, 2], [2, 3]])) == pytest.approx(0.7)
    assert edge_score(rest[None], rest, np.array([[0, 1], [1, 2]])) == 1


def test_the_best_weights_are_found_for_all_vertices_at_once():
    """Those that made the vertices; and shaken ones better than by these."""
    random = np.random.default_rng(1)
    rest = random.normal(size=(6, 3))
    affine = np.tile(np.eye(3, 4), (20, 5, 1, 1)) + 0.4 * random.normal(size=(20, 5, 3, 4))
    weights = random.dirichlet(np.ones(5) * 0.3, 6)
    truth = np.asarray(skin(rest, weights, affine), np.float64)
    np.testing.assert_allclose(best_skinning(rest, truth, affine), weights, atol=1e-3)
    shaken = truth + 0.3 * random.normal(size=truth.shape)
    found = best_skinning(rest, shaken, affine)
    assert found.min() >= 0 and np.allclose(found.sum(axis=1), 1)
    assert np.square(skin(rest, found, affine) - shaken).sum() <= np.square(truth - shaken).sum()


def test_the_keys_are_those_that_programs_read():
    assert {
        "mask_iou", "pmd_apparel_rest_6s_over_rigid", "els_minus_truth",
        "drift_60s",
        "inside_over_truth", "real_over_rigid",
    } <= set(APPAREL_BARS)  # fmt: skip


def test_a_row_is_over_rigid_and_in_centimetres():
    row = {"rigid": 0.1, "els_truth": 0.98}
    ours = {"learned": 0.05, "learned_2s": 0.04, "learned_els": 0.9, "safe": 0.06}
    assert _rest_table([row | ours])["learned"] == {
        "PMD_a": pytest.approx(5), "first 2 s": pytest.approx(4), "over rigid": pytest.approx(0.5),
        "ELS": pytest.approx(0.9), "inside [%]": None,
    }  # fmt: skip


def test_without_clips_there_is_no_table_of_them():
    assert _rest_table([]) == {}


def test_chains_of_a_clip_are_measured_against_its_truth():
    """Chains start where the truth starts, nothing flies, and a clip that stands still is no further off than sagging
    makes it."""
    character = wardrobe_character(810_003)
    body = UnifiedBody.of(character)
    clothed = clothed_from_file(character, body)
    transforms = np.concatenate([np.tile(np.eye(3), (22, 1, 1)), body.joints[..., None]], axis=2)
    frames = np.tile(transforms.astype(np.float32), (12, 1, 1, 1))
    clip = TrueClip("one", "still", clothed, frames, np.zeros(0, np.int64), np.zeros((12, 0, 3), np.float32))
    row = chain_row(clip)
    assert row["rigid"] < 1e-5 and row["lost"] == 0
    assert row["els_truth"] > 0.999
    assert row["chains"] < 0.03 * np.ptp(clothed.rest[:, 1])
    assert 0 <= row["inside_chains"] <= 1 and 0 <= row["inside_rigid"] <= 1
    some = {"inside_chains": 0.02, "inside_rigid": 0.04, "inside_truth": 0.01}
    assert chain_summary([row | some, row | some])["chains_inside_over_rigid"] == pytest.approx(0.5)
    summary = chain_summary([row | {"rigid": 0.02, "chains": 0.01}, row | {"rigid": 0.04, "chains": 0.04, "lost": 2}])
    assert summary["chains_over_rigid"] == pytest.approx(5 / 6)
    assert summary["chains_mean_ratio"] == pytest.approx(0.75) and summary["chains_fly_aways"] == 1
    assert chain_summary([]) == {}
