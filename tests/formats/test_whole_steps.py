import lzma

import numpy as np
import pytest

from bunraku.formats.whole_steps import lzma_filters, pack_steps, unpack_steps

FILTERS = lzma_filters(6, 1 << 16)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_numbers_of_both_signs_come_back(order):
    values = np.cumsum(np.random.default_rng(0).integers(-900, 900, (200, 7)), axis=0)
    data = pack_steps(values, order, FILTERS)
    np.testing.assert_array_equal(unpack_steps(data, 200, 7, order, FILTERS), values)
    planes = lzma.decompress(data, lzma.FORMAT_RAW, filters=FILTERS)
    assert len(planes) == 4 * values.size and set(planes[-values.size :]) == {0}  # the highest bytes stand together


def test_other_bytes_and_other_shapes_are_refused():
    data = pack_steps(np.ones((5, 3)), 1, FILTERS)
    for bad, rows in ((data, 4), (data, 6), (b"nonsense", 5), (b"", 5)):
        with pytest.raises(ValueError, match="these bytes"):
            unpack_steps(bad, rows, 3, 1, FILTERS)
