import numpy as np
import pytest

from bunraku_lab.datasets.motions.floors import floor_height, posture_fault

FPS = 20.0


def steps(frames, jump=None):
    """The lowest point of somebody who walks, and who jumps half a metre high for half a second where asked."""
    lowest = 0.01 * np.abs(np.sin(np.arange(frames)))
    if jump is not None:
        lowest[jump : jump + 10] += 0.5 * np.sin(np.linspace(0, np.pi, 10))
    return lowest


def test_what_hovers_comes_down_and_what_jumps_stays_up():
    lowest = steps(200, jump=100)
    drift = np.linspace(0.0, 0.12, 200)
    settled = lowest + drift - floor_height(lowest + drift, FPS)
    assert np.abs(np.delete(settled, np.arange(96, 114))).max() < 0.03
    assert settled[100:110].max() == pytest.approx(0.5, abs=0.04)


def test_what_climbs_keeps_its_height():
    lowest = steps(200) + np.linspace(0, 1.5, 200)
    assert np.ptp(floor_height(lowest, FPS)) == 0
    assert floor_height(np.full(50, 0.7), FPS).max() == 0  # high up for good: it hangs


@pytest.mark.parametrize(
    ("texts", "height", "lowest", "words"),
    [
        (["a person sits on a chair"], -0.15, 0.0, "no seat"),
        (["a person sits on a chair"], -0.4, 0.0, None),
        (["someone sits on a high stool"], -0.05, 0.0, None),
        (["a person lies on the back"], -0.1, 0.0, "lies"),
        (["a person walks"], 0.0, 0.2, "nothing is near the ground in 100 %"),
        (["a person climbs a ladder"], 0.0, 0.8, None),
        (["a person walks"], 0.0, 0.0, None),
    ],
)
def test_postures_that_cannot_be_are_named(texts, height, lowest, words):
    fault = posture_fault(texts, np.full(40, height), np.full(40, lowest))
    assert (fault is None) if words is None else (words in fault)
