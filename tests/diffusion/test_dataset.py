import json

import numpy as np
import pytest

from bunraku.bodies.layout import HANDLE_NAMES
from bunraku.diffusion.dataset import ClipSet, join_point, load_clips, splice
from bunraku.diffusion.features import ROOT_SIZE, FeatureStatistics, feature_weights
from bunraku.errors import FormatError


def entry(features, text, split="train"):
    return {"features": features, "texts": [text], "split": split}


@pytest.fixture
def clips(features):
    found = {
        "wave": entry(features("left_elbow"), "a person waves with the left hand"),
        "kick": entry(features("right_knee", frames=90), "kick"),
        "walk": entry(features("spine1", frames=37), "walk"),
    }
    statistics = FeatureStatistics.measure([clip["features"] for clip in found.values()])
    return lambda **how: ClipSet(found, statistics, **{"frames": 120, **how})


def activity(values, statistics, handle):
    start = ROOT_SIZE + 9 * (HANDLE_NAMES.index(handle) - 1)
    return float(statistics.restore(values)[:, start + 3 : start + 9].std(0).max())


def test_a_batch_is_a_function_of_its_seed_and_number(clips):
    in_order, any_order = clips(), clips()
    first = [in_order.batch(3, number, 6, 0.3) for number in range(6)]
    for number in (5, 0, 3):
        again = any_order.batch(3, number, 6, 0.3)
        np.testing.assert_array_equal(again.values, first[number].values)
        assert again.sentences == first[number].sentences and (again.lengths == first[number].lengths).all()
    other = clips().batch(4, 0, 6, 0.3)
    assert other.sentences != first[0].sentences or other.values.shape != first[0].values.shape


def test_batches_are_padded_with_zeros_and_finite(clips):
    for number in range(4):
        batch = clips().batch(0, number, 5, 0.3)
        assert batch.values.dtype == np.float32 and batch.values.shape[1] == batch.lengths.max() <= 120 and np.isfinite(batch.values).all()
        for row, length in zip(batch.values, batch.lengths, strict=True):
            assert not row[length:].any() and row[length - 1].any()


def test_a_mirrored_motion_gets_the_mirrored_words(clips):
    found, random, sides = clips(), np.random.default_rng(0), set()
    for _ in range(60):
        values, sentence = found.draw(random)
        if "hand" in sentence:
            left, right = (activity(values, found.statistics, f"{side}_elbow") for side in ("left", "right"))
            side = "left" if left > right else "right"
            sides.add(side)
            assert side in sentence and max(left, right) > 5 * min(left, right)
    assert sides == {"left", "right"}


def test_join_point_and_splice_of_a_wave_leave_no_jump(features):
    wave = features("left_elbow", frames=60, period=20)
    i, j, distance = join_point(wave, wave, feature_weights())
    joined = splice(wave, wave, i, j)
    assert distance < 1e-3 and len(joined) == i + len(wave) - j
    inside = np.abs(np.diff(wave, axis=0)).max()
    assert np.abs(np.diff(joined, axis=0)).max() < 1.05 * inside
    np.testing.assert_array_equal(joined[:i], wave[:i])
    np.testing.assert_array_equal(joined[-20:], wave[-20:])


def test_clips_that_loop_are_lengthened_without_a_jump(clips):
    found, random = clips(), np.random.default_rng(1)
    longest = 0
    for _ in range(40):
        values, _ = found.draw(random)
        longest = max(longest, len(values))
        clip = max(np.abs(np.diff(one.values, axis=0)).max() for one in found.clips)
        assert np.abs(np.diff(values, axis=0)).max() < 1.05 * clip
    assert longest == 120


def test_composed_sentences_name_both_parts(clips):
    found, random = clips(), np.random.default_rng(2)
    sentences = {found.draw(random, compose=1.0)[1] for _ in range(80)}
    assert any("walk" in one and "kick" in one and ("then" in one or "and" in one) for one in sentences)


def test_folders_are_read_by_split_and_faults_are_named(swings):
    clips = load_clips(swings)
    assert len(clips) == 12 and clips["waves_0"]["features"].shape == (60, 271) and clips["waves_0"]["texts"] == ["the figure waves"]
    assert sorted(load_clips(swings, splits={"test"})) == ["bows_2", "kicks_2", "nods_2", "waves_2"]
    (swings / "bows_0.npz").write_bytes((swings / "bows_0.npz").read_bytes()[:300])
    with pytest.raises(FormatError, match=r"bows_0\.npz.*bunraku data motions"):
        load_clips(swings)
    index = json.loads((swings / "index.json").read_text())
    index["clips"]["../secret"] = {"texts": ["x"]}
    (swings / "index.json").write_text(json.dumps(index))
    with pytest.raises(FormatError, match="plain name"):
        load_clips(swings)
    (swings / "index.json").write_text("[1")
    with pytest.raises(FormatError, match="missing or damaged"):
        load_clips(swings)
