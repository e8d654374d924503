import numpy as np
import pytest

from bunraku.diffusion.features import mirror
from bunraku.errors import OptionError
from bunraku_lab.evaluation.motion.windows import (
    LENGTHS,
    candidate_sentences,
    draw_windows,
    window_features,
    window_meaning,
)


def clips(**frames):
    random = np.random.default_rng(0)
    return {
        name: {"features": random.normal(size=(count, 271)), "texts": [text]} for name, (count, text) in frames.items()
    }


ARCHIVE = clips(a=(300, "walk"), b=(90, "a person turns right while walking"), c=(39, "jump"), d=(60, "boxing"))


def test_windows_lie_in_their_clips():
    windows = draw_windows(ARCHIVE, 300, np.random.default_rng(1))
    assert {window.clip for window in windows} == {"a", "b", "d"}  # c has less than 2 s
    for window in windows:
        values = window_features(ARCHIVE, window)
        assert values.shape == (window.frames, 271) and window.frames in LENGTHS
        whole = ARCHIVE[window.clip]["features"][window.start : window.start + window.frames]
        assert np.array_equal(values, mirror(whole) if window.mirrored else whole)
        assert window.frames >= 0.6 * min(len(ARCHIVE[window.clip]["features"]), 196) - 20
    assert 100 < sum(window.mirrored for window in windows) < 200
    assert draw_windows(ARCHIVE, 300, np.random.default_rng(1)) == windows


def test_mirrored_windows_have_mirrored_words():
    windows = [window for window in draw_windows(ARCHIVE, 200, np.random.default_rng(1)) if window.clip == "b"]
    for window in windows:
        assert ("left" in window.sentence) == window.mirrored and ("right" in window.sentence) != window.mirrored
    assert window_meaning("a person turns right while walking", True) == window_meaning(
        "a person turns left while walking"
    )
    assert len({window.meaning for window in windows}) == 2


def test_candidates_mean_something_else():
    windows = draw_windows(ARCHIVE, 60, np.random.default_rng(2))
    meaning = {window.sentence: window.meaning for window in windows}
    rows = candidate_sentences(windows, ARCHIVE, 3, np.random.default_rng(0))
    for window, row in zip(windows, rows, strict=True):
        assert row[0] == window.sentence and len({meaning[sentence] for sentence in row}) == 3
    with pytest.raises(OptionError, match="fewer than the 32 candidates"):
        candidate_sentences(windows, ARCHIVE, 32, np.random.default_rng(0))


def test_clips_that_are_all_too_short_are_said():
    with pytest.raises(OptionError, match="no clip has the 40 frames"):
        draw_windows(clips(c=(39, "jump")), 5, np.random.default_rng(0))
