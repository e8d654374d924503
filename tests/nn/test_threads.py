"""Two calls side by side give what one after the other gives, in the same modes, and tell what went wrong."""

import threading

import pytest
import torch

from bunraku.nn.threads import fitting_threads, one_thread, side_by_side


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def here():
    return threading.get_ident(), torch.is_grad_enabled(), torch.is_inference_mode_enabled(), torch.get_num_threads()


def test_second_call_has_a_thread_of_its_own_where_torch_has_one_to_spare(two_threads):
    assert side_by_side(here, here)[0][0] == side_by_side(here, here)[1][0]
    with fitting_threads(torch.nn.Linear(2, 2)):
        first, second = side_by_side(here, here)
    assert first[0] != second[0] and first[1:] == second[1:] == (True, False, 1)
    assert torch.get_num_threads() == 2


def test_one_thread_stays_one():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    with one_thread():
        first, second = side_by_side(here, here)
    torch.set_num_threads(before)
    assert first == second


def test_modes_go_along(two_threads):
    with one_thread():
        with torch.inference_mode():
            assert {one[2] for one in side_by_side(here, here)} == {True}
        with torch.no_grad():
            assert {one[1:3] for one in side_by_side(here, here)} == {(False, False)}


def test_same_numbers_and_errors(two_threads):
    def fails():
        raise ValueError("the other")

    value = torch.randn(64, 64, generator=torch.Generator().manual_seed(3))
    alone = value @ value, value @ value.T
    with one_thread():
        first, second = side_by_side(lambda: value @ value, lambda: value @ value.T)
        with pytest.raises(ValueError, match="the other"):
            side_by_side(lambda: 1, fails)
        with pytest.raises(ValueError, match="the other"):
            side_by_side(fails, lambda: 1)
    assert torch.equal(first, alone[0]) and torch.equal(second, alone[1])
