"""In which frames a body stands, for heights written by hand."""

import numpy as np

from bunraku.geometry.steady import tallest_steady


def test_who_sits_first_stands_later_and_a_leap_is_no_stance():
    heights = np.r_[np.full(60, 0.5), np.linspace(0.5, 1, 20), np.full(60, 1.0)]
    found = tallest_steady(heights, 20.0)
    assert not found[:70].any() and found[90:].all()
    leap = heights.copy()
    leap[110:116] = 1.6
    assert tallest_steady(leap, 20.0)[85:100].all()


def test_who_only_walks_stands_in_all_frames():
    heights = 1 + 0.05 * np.sin(np.arange(100) / 3)
    assert tallest_steady(heights, 20.0).all()


def test_one_frame_is_a_stance():
    assert tallest_steady(np.array([0.0]), 20.0).tolist() == [True]
