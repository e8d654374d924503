import numpy as np
import pytest

from bunraku.diffusion.inference.layers import Condition
from bunraku.diffusion.sampling.sampler import Solver
from bunraku.diffusion.sampling.solvers import alphas_cumprod
from bunraku.diffusion.sampling.windows import plan_windows, sample_plans

FEATURES = 6


@pytest.fixture
def model(running):
    return running(features=FEATURES, handles=3)


PLANS = [
    ([1], False), ([196], False), ([197], False), ([2400], False), ([80, 40, 60], False), ([5, 300, 10, 10], False),
    ([240] * 5, False),
    ([10], True), ([120], True), ([1000], True), ([40, 30, 250], True),
]  # fmt: skip


@pytest.mark.parametrize(("lengths", "loop"), PLANS)
def test_windows_share_all_frames_out(lengths, loop):
    plan = plan_windows(lengths, 196, loop=loop)
    total = np.zeros(plan.frames)
    for window in plan.windows:
        assert (
            0 < len(window.frames) <= 196 and int(window.frames.min()) >= 0 and int(window.frames.max()) < plan.frames
        )
        assert loop or bool((np.diff(window.frames) == 1).all())
        np.add.at(total, window.frames, window.share)
    np.testing.assert_allclose(total, 1, atol=1e-6)
    assert plan.frames == sum(lengths) or (not loop and plan.frames == 40 > sum(lengths))
    start = 0
    for row, length in enumerate(lengths):  # the middle of a part is its own sentence's alone
        middle = start + length // 2
        share = sum(float(window.share[window.frames == middle].sum()) for window in plan.windows if window.row == row)
        assert share > 0.98 or length < 4
        start += length


def test_neighbouring_windows_fade_into_each_other():
    plan = plan_windows([80, 100], 196)
    first, second = plan.windows
    assert plan.seams == (80,) and first.frames[-1] == 93 and second.frames[0] == 66
    fall = first.share[66:94]
    np.testing.assert_allclose(fall, 1 - second.share[:28], atol=1e-6)
    assert (
        bool((np.diff(fall) < 0).all()) and np.abs(np.diff(fall)).max() < 0.06 and bool((first.share[:66] == 1).all())
    )


def test_short_parts_are_seen_with_some_of_their_neighbours():
    plan = plan_windows([100, 10, 100], 196)
    assert len(plan.windows[1].frames) == 40 and len(plan_windows([3], 196).windows[0].frames) == 40


@pytest.mark.parametrize("frames", [1, 10, 59, 60, 61, 200])
def test_any_length_can_be_made(model, encoder, frames):
    plans = [plan_windows([frames], 60), plan_windows([frames], 60)]
    for found in sample_plans(model, encoder.encode(["walks", "runs"]), plans, Solver(2)):
        assert found.values.shape[1] == FEATURES and len(found.values) == len(found.adaptation) >= frames
        assert bool(np.isfinite(found.values).all())


def test_a_batch_of_plans_is_what_each_is_alone(model, encoder):
    plans, texts = (
        [plan_windows([50, 30], 60), plan_windows([20], 60), plan_windows([130], 60, loop=True)],
        ["a b", "c", "d e f", "g"],
    )
    found = sample_plans(model, encoder.encode(texts), plans, Solver(3), seeds=[3, 4, 5])
    rows = [texts[:2], texts[2:3], texts[3:]]
    for part, plan, some, seed in zip(found, plans, rows, (3, 4, 5), strict=True):
        alone = sample_plans(model, encoder.encode(some), [plan], Solver(3), seeds=seed)[0]
        np.testing.assert_allclose(part.values, alone.values, atol=2e-4, rtol=1e-4)
        np.testing.assert_allclose(part.adaptation, alone.adaptation, atol=2e-4, rtol=1e-4)


def test_progress_counts_every_step(model, encoder):
    calls = []
    sample_plans(
        model,
        encoder.encode(["walks"]),
        [plan_windows([100], 60)],
        Solver(3, progress=lambda done, total: calls.append((done, total))),
    )
    assert calls == [(1, 3), (2, 3), (3, 3)]


class Waves:
    """The best denoiser there is for smooth Gaussian processes: x0 = sqrt(a) S (a S + (1 - a) I)^-1 x_t, with S their
    covariance.
    """

    visited = ()

    def __init__(self, config):
        self.config, self.curve = config, alphas_cumprod()

    def condition(self, text, mask, pooled, mesh, keep_text, keep_mesh, examples=None):
        return Condition([], None, pooled, pooled, [], None)

    def __call__(self, x, step, lengths, condition, adapts):
        frames, share = x.shape[1], self.curve[step]
        apart = np.arange(frames)[:, None] - np.arange(frames)
        covariance = np.exp(-0.5 * (apart / 8.0) ** 2) + 1e-4 * np.eye(frames)
        gain = share**0.5 * np.linalg.solve(share * covariance + (1 - share) * np.eye(frames), covariance)
        return (gain.T @ x).astype(np.float32), np.zeros((*x.shape[:2], 3, 3), np.float32) if adapts else None


@pytest.mark.parametrize(
    ("lengths", "loop"), [([700], False), ([150, 40, 200, 30, 160], False), ([300], True), ([120], True)]
)
def test_long_motions_have_no_jump_where_windows_meet(config, encoder, lengths, loop):
    model = Waves(config(features=FEATURES, frames=196, handles=3))
    plan = plan_windows(lengths, 196, loop=loop)
    text = encoder.encode(["walks"] * len(lengths))
    values = sample_plans(model, text, [plan], Solver(20, guidance=1.0), seeds=2)[0].values
    frames = len(values)
    if loop:
        values = np.concatenate([values, values[:2]])
    seams = np.zeros(frames + 2 * loop, bool)
    for seam in plan.seams:
        seams[max(seam - 16, 0) : seam + 16] = True
    if loop:
        seams[-16:] = True
    for order in (1, 2):
        change = np.abs(np.diff(values, order, axis=0)).max(-1)
        inside = seams[:-order]
        assert float(change[inside].max()) <= 1.25 * float(change[~inside].max())
    assert float(values.std()) == pytest.approx(1, abs=0.3)
    if frames > 250:
        assert float((values[100:] - values[:-100]).std()) > 0.7  # windows are not copies of one another
