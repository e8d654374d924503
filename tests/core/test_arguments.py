"""Arguments are checked against what annotations say."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from bunraku import OptionError
from bunraku.core.request import checked


@checked
def given(count: int | np.ndarray, *more: float, way: Literal["up", "down"] | None = None, **options: str | None):
    return count, more, way, options


def test_each_of_several_arguments_is_checked_by_itself():
    assert given(1, 2.0, 3, way="up", name="a", other=None) == (1, (2.0, 3), "up", {"name": "a", "other": None})
    assert given(np.zeros(2))[1:] == ((), None, {})
    for args, options, message in (
        (("1",), {}, "count must be int or np.ndarray, not '1'"),
        ((1, 2.0, "3"), {}, r"more\[1\] must be float, not '3'"),
        ((1,), {"name": 4}, "name must be str or None, not 4"),
        ((1,), {"way": 5}, "way must be 'up' or 'down' or None, not 5"),
        ((), {"number": 1}, "given: missing a required argument: 'count'; it takes count, more, way, options"),
    ):
        with pytest.raises(OptionError, match=f"^{message}$"):
            given(*args, **options)
