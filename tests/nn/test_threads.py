"""Two calls side by side give what one after the other gives, and tell what went wrong."""

import threading

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from bunraku.nn.threads import one_thread, side_by_side, usable_threads


@pytest.fixture
def two_threads(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)


def here():
    return threading.get_ident()


def blas():
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


def test_second_call_has_a_thread_of_its_own_where_there_is_a_processor_to_spare(two_threads):
    assert len({*side_by_side(here, here), here()}) == 1
    before = blas()
    with one_thread():
        first, second = side_by_side(here, here)
        assert first == here() != second and blas() == {1}
    assert blas() == before


def test_one_thread_stays_one(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert usable_threads() == 1
    with one_thread():
        assert len({*side_by_side(here, here), here()}) == 1


def test_as_many_threads_as_processors_where_nobody_says(monkeypatch):
    for said in ("", "many", "0"):
        monkeypatch.setenv("OMP_NUM_THREADS", said)
        assert usable_threads() >= 1
    monkeypatch.setenv("OMP_NUM_THREADS", "3,2")
    assert usable_threads() == 3


def test_same_numbers_and_errors(two_threads):
    def fails():
        raise ValueError("the other")

    value = np.random.default_rng(3).standard_normal((64, 64)).astype(np.float32)
    with one_thread():
        alone = value @ value, value @ value.T
        first, second = side_by_side(lambda: value @ value, lambda: value @ value.T)
        with pytest.raises(ValueError, match="the other"):
            side_by_side(lambda: 1, fails)
        with pytest.raises(ValueError, match="the other"):
            side_by_side(fails, lambda: 1)
    assert np.array_equal(first, alone[0]) and np.array_equal(second, alone[1])
