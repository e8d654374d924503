"""A page is its picture with lines below it."""

import numpy as np

from bunraku.render.page import page


def test_the_picture_stays_and_text_stands_below():
    picture = np.full((60, 200, 3), 90, np.uint8)
    short = page(picture, "dog", ["one line"])
    assert short.shape[1] == 200 and np.array_equal(short[:60], picture)
    assert (short[60:] < 128).any()
    long = page(picture, "dog", ["many words " * 30])
    assert len(long) > len(short)
    assert (long[-30:] < 128).any() and (long[:, -10:][60:] > 200).all()  # folded, and nothing runs over the edge
