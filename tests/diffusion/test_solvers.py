import math

import numpy as np
import pytest

from bunraku.diffusion.denoiser_config import TRAINING_STEPS
from bunraku.diffusion.sampling.solvers import alphas_cumprod, sampling_steps


def test_the_curve_is_the_cosine_of_nichol_and_dhariwal():
    curve = alphas_cumprod()
    start = math.cos(0.008 / 1.008 * math.pi / 2) ** 2
    for step in (0, 1, 250, 500, 900, 997):
        assert float(curve[step]) == pytest.approx(
            math.cos(((step + 1) / TRAINING_STEPS + 0.008) / 1.008 * math.pi / 2) ** 2 / start, rel=1e-6
        )
    assert bool((np.diff(curve) < 0).all()) and 0 < float(curve[-1]) < 1e-5
    assert float(curve[-1] / curve[-2]) == pytest.approx(0.001)  # the capped beta


@pytest.mark.parametrize("count", [1, 2, 7, 20, 400, 999, 1000])
def test_steps_fall_and_never_repeat(count):
    steps = sampling_steps(count)
    assert len(steps) == count and all(a > b for a, b in zip(steps, steps[1:], strict=False))
    assert count < 20 or (steps[0] == 999 and 0 <= steps[-1] <= 5)


def test_few_steps_are_even_between_ends_of_their_own():
    """By hand from the cosine curve: its share of signal is cos^2(pi (t + 0.008) / 2), lambda its logit's half."""
    time = (np.array(sampling_steps(4)) + 1) / 1000
    ratio = -np.log(np.tan((time + 0.008) / 1.008 * np.pi / 2))
    np.testing.assert_allclose(ratio, np.linspace(-3.5, 2.0, 4), atol=0.06)
    between = sampling_steps(12)
    assert sampling_steps(4)[0] < between[0] < 999 and 5 < between[-1] < sampling_steps(4)[-1]


def test_steps_are_even_in_the_log_of_the_ratio():
    curve, steps = alphas_cumprod(), sampling_steps(20)
    ratio = [0.5 * math.log(float(curve[step] / (1 - curve[step]))) for step in steps]
    gaps = [
        after - before for before, after in zip(ratio[4:], ratio[5:], strict=False)
    ]  # single steps are far apart at the very start
    assert max(gaps) < 1.25 * 10 / 19 and min(gaps) > 0.75 * 10 / 19
    assert sampling_steps(1000) == list(range(999, -1, -1))
