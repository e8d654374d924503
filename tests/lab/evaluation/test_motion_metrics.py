"""The measures of generated motion, its windows and seams, and the report."""

import math
import re

import numpy as np
import pytest

from bunraku.core.motion import HandleMotion
from bunraku.errors import OptionError
from bunraku.generation.features import mirror
from bunraku_lab.evaluation.motion.metrics import (
    diversity,
    fid,
    frechet_distance,
    interval,
    measure_seams,
    multimodal_distance,
    multimodality,
    r_precision,
)
from bunraku_lab.evaluation.motion.samples import (
    LENGTHS,
    candidate_sentences,
    draw_windows,
    window_features,
    window_meaning,
)
from bunraku_lab.evaluation.report import Bar, Report, Table, bar_table, measured_in, percent, reached_bars


def test_r_precision_by_hand():
    motions = np.array([[0.0], [0.0], [0.0], [0.0]])
    candidates = np.array(
        [[[1], [2], [3], [4]], [[2], [1], [3], [4]], [[3], [2], [1], [4]], [[4], [3], [2], [1]]], float
    )
    assert r_precision(motions, candidates) == (0.25, 0.5, 0.75)


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


def test_fid_survives_singular_covariances_and_moves_with_the_mean():
    flat = np.random.default_rng(2).normal(size=(4, 10))  # fewer samples than numbers
    assert fid(flat, flat) == pytest.approx(0, abs=1e-6)
    assert fid(flat, flat + 2) == pytest.approx(40, rel=1e-6)
    with pytest.raises(OptionError, match="at least 2"):
        fid(flat[:1], flat)


def test_distances_by_hand():
    assert multimodal_distance(np.array([[0.0, 0], [3, 4]]), np.array([[0.0, 1], [0, 0]])) == 3
    assert diversity(np.array([[0.0], [6.0]]), np.random.default_rng(0)) == 6
    rows = np.array([[[0.0], [1.0]], [[0.0], [5.0]]])
    assert multimodality(rows, np.random.default_rng(0)) == 3
    with pytest.raises(OptionError, match="at least 2"):
        multimodality(rows[:, :1], np.random.default_rng(0))
    with pytest.raises(OptionError, match="at least 2"):
        diversity(rows[0, :1], np.random.default_rng(0))


def test_interval_by_hand():
    found = interval([1.0, 2.0, 3.0])
    assert found.mean == 2 and found.half == pytest.approx(4.302653 * 1 / math.sqrt(3), rel=1e-5)  # t with two degrees
    assert interval([5.0]).half == 0


def sliding(path):
    """A body that slides along x."""
    frames = len(path)
    position = np.zeros((frames, 3))
    position[:, 0] = path
    return HandleMotion(
        np.zeros((frames, 30, 3)), np.tile(np.eye(3), (frames, 30, 1, 1)), position, np.tile(np.eye(3), (frames, 1, 1))
    )


def test_a_jump_counts_where_it_is():
    even = np.arange(100) * 0.01 + 0.001 * (np.arange(100) % 2)  # steps of 11 and 9 mm, changes of 2 mm
    even[50:] += 0.05
    near, far = measure_seams(sliding(even), [50]), measure_seams(sliding(even), [20])
    assert near.displacement == pytest.approx(59 / 11, abs=0.01) and near.displacement_elsewhere == pytest.approx(
        1, abs=0.01
    )
    assert far.displacement == pytest.approx(1, abs=0.01) and far.displacement_elsewhere == near.displacement
    assert near.jump == pytest.approx(24, abs=0.1) and near.jump_elsewhere == pytest.approx(1, abs=0.1)
    assert measure_seams(sliding(even), []).displacement == 0


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


@pytest.mark.parametrize(
    ("least", "most", "limit", "good", "bad"),
    [(0.7, None, ">= 0.7", 0.7, 0.69), (None, 3, "<= 3", 3, 3.1), (60, 130, "60..130", 100, 131)],
)
def test_bars(least, most, limit, good, bad):
    bar = Bar("title", least, most)
    assert bar.limit == limit and bar.reached(good) and not bar.reached(bad)
    assert not Bar("title").limit


BARS = {
    "share": Bar("a share", least=0.9, show=percent(1)),
    "speed": Bar("its speed", most=0.01, show=measured_in(" m/s", 4)),
    "told": Bar("only told"),
    "none": Bar("not measured", most=0.25, show=measured_in("", 3), show_limit="{:g}".format),
}


def test_figures_are_printed_beside_their_bars():
    result = {"share": 0.95, "speed": 0.02, "told": 12.345, "none": None}
    assert bar_table(BARS, result).text().splitlines() == [
        "measure            value            bar  reached",
        "a share            95.0%       >= 90.0%  yes",
        "its speed     0.0200 m/s  <= 0.0100 m/s  no",
        "only told           12.3",
        "not measured           -        <= 0.25",
    ]
    assert reached_bars(BARS, result) == {"share": True, "speed": False, "none": None}
    assert bar_table(BARS, result, reached={"share": False}).rows[1][-1] == "no"


def test_a_report_in_markdown_is_read_as_the_tables_that_it_holds():
    markdown = pytest.importorskip("markdown")
    report = Report(["3 characters", Table([["name", "share"], ["a|b", "1.5"], ["c", "20"]], title="shares")])
    page = markdown.markdown(report.markdown(), extensions=["tables"])
    cells = re.findall(r"<t[hd](?: style=\"text-align: (\w+);\")?>(.*?)</t[hd]>", page)
    assert page.startswith("<p>3 characters</p>") and "<strong>shares</strong>" in page
    assert [text for _, text in cells] == ["name", "share", "a|b", "1.5", "c", "20"]
    assert [side for side, _ in cells] == ["", "right"] * 3
