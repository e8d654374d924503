import pytest
import torch

from bunraku.diffusion.sampler import Known, ancestral, dpm_solver, guided, sample, starting_noise, token_share
from bunraku.diffusion.schedule import alphas_cumprod, sampling_steps
from bunraku.diffusion.windows import hold, plan_windows, sample_long

FEATURES = 6


@pytest.fixture
def model(denoiser):
    return denoiser(features=FEATURES, handles=3)


def toy(x, step):
    """A smooth, bounded predictor of x0 that depends on x_t and t."""
    return torch.tanh(0.7 * x.roll(1, 1) + 0.2) * (1 + step / 1000)


@pytest.mark.filterwarnings("ignore:__array__ implementation")
@pytest.mark.parametrize("count", [1, 10, 20, 50])
def test_dpm_solver_walks_the_path_of_diffusers(count):
    scheduling = pytest.importorskip("diffusers.schedulers.scheduling_dpmsolver_multistep")
    scheduler = scheduling.DPMSolverMultistepScheduler(
        num_train_timesteps=1000, beta_schedule="squaredcos_cap_v2", prediction_type="sample", algorithm_type="dpmsolver++", solver_order=2
    )
    scheduler.set_timesteps(timesteps=sampling_steps(count))
    noise = starting_noise(2, 12, 5, seed=3)
    x, path = noise, []
    for step in scheduler.timesteps:
        path.append(x)
        x = scheduler.step(toy(x, int(step)), step, x).prev_sample
    ours = []

    def watch(x, step):
        ours.append(x)
        return toy(x, step)

    torch.testing.assert_close(dpm_solver(watch, noise, sampling_steps(count)), x, atol=2e-4, rtol=2e-4)
    for mine, theirs in zip(ours, path, strict=True):
        torch.testing.assert_close(mine, theirs, atol=2e-4, rtol=2e-4)


def test_both_samplers_find_what_an_oracle_knows():
    truth, noise = torch.randn(2, 30, 4, generator=torch.Generator().manual_seed(0)), starting_noise(2, 30, 4, 1)
    for steps in (1, 5, 20):
        torch.testing.assert_close(dpm_solver(lambda x, step: truth, noise, sampling_steps(steps)), truth)
    torch.testing.assert_close(ancestral(lambda x, step: truth, noise, list(range(999, -1, -1)), torch.Generator().manual_seed(0)), truth)


def test_both_samplers_draw_from_the_right_distribution():
    # For x0 ~ N(mean, deviation^2) the best predictor is known, so the samples must have that mean and deviation.
    mean, deviation, curve = 0.8, 0.5, alphas_cumprod()

    def best(x, step):
        share = float(curve[step])
        return mean + share**0.5 * deviation**2 / (share * deviation**2 + 1 - share) * (x - share**0.5 * mean)

    noise = starting_noise(1, 200, 100, 5)
    for values in (dpm_solver(best, noise, sampling_steps(50)), ancestral(best, noise, sampling_steps(200), torch.Generator().manual_seed(6))):
        assert float(values.mean()) == pytest.approx(mean, abs=0.02) and float(values.std()) == pytest.approx(deviation, abs=0.03)


def test_guidance():
    a, b = torch.randn(2, 8, 4), torch.randn(2, 8, 4)
    torch.testing.assert_close(guided(a, b, 1.0), a)
    torch.testing.assert_close(guided(a, b, 0.0), b)
    torch.testing.assert_close(guided(a, b, 6.0, rescale=1.0).std((1, 2)), a.std((1, 2)))


def test_guidance_of_one_is_the_conditional_model(model, encoder):
    text = encoder.encode(["a figure walks"])
    near = sample(model, text, 24, guidance=1.0 + 1e-7, steps=4)  # still both passes
    torch.testing.assert_close(sample(model, text, 24, guidance=1.0, steps=4).values, near.values, atol=1e-4, rtol=1e-4)
    assert (sample(model, text, 24, guidance=3.0, steps=4).values - near.values).abs().max() > 1e-2


def test_seeds_batches_and_prompts(model, encoder):
    text = encoder.encode(["a figure walks", "a figure jumps over the fence"])
    one, again, other = (sample(model, text, 30, steps=5, seed=seed).values for seed in (4, 4, 5))
    assert torch.equal(one, again) and (one - other).abs().max() > 1e-2
    alone = sample(model, encoder.encode(["a figure walks"]), 30, steps=5, seed=4).values
    torch.testing.assert_close(one[:1], alone, atol=1e-4, rtol=1e-4)
    swapped = sample(model, encoder.encode(["a figure runs"]), 30, steps=5, seed=4).values
    assert (swapped - alone).abs().max() > 1e-2


def test_a_mesh_feature_reaches_the_motion_and_the_adaptation(model, encoder):
    text = encoder.encode(["a figure walks"])
    plain, meshed = sample(model, text, 20, steps=3), sample(model, text, 20, steps=3, mesh_features=torch.ones(1, 12))
    assert plain.adaptation.shape == (1, 20, 3, 3)
    assert (plain.values - meshed.values).abs().max() > 1e-3 and (plain.adaptation - meshed.adaptation).abs().max() > 1e-3


@pytest.mark.parametrize("method", ["dpm", "ddpm"])
def test_known_frames_are_kept(model, encoder, method):
    values = torch.randn(1, 24, FEATURES)
    share = torch.zeros(24)
    share[:6] = share[20:] = 1
    found = sample(model, encoder.encode(["walks"]), 24, steps=6, known=Known(values, share), method=method).values
    torch.testing.assert_close(found[:, :6], values[:, :6])
    torch.testing.assert_close(found[:, 20:], values[:, 20:])
    assert (found[:, 6:20] - values[:, 6:20]).abs().max() > 0.1


def test_tokens_are_trusted_least_at_their_edges():
    assert token_share(6, 4).tolist() == [0.25, 0.75, 0.75, 0.25, 0.25, 0.75]
    for patch in (2, 3, 4, 5, 8):  # a frame at the edge of one grid is inside the other's token
        share = token_share(40, patch)
        assert float((share + token_share(40 + patch // 2, patch)[patch // 2 :]).min()) >= 0.5


def test_progress_counts_every_step(model, encoder):
    calls = []
    sample_long(model, encoder.encode(["walks"]), 100, steps=3, progress=lambda done, total: calls.append((done, total)))
    assert [done for done, _ in calls] == list(range(1, len(calls) + 1)) and calls[-1][0] == calls[-1][1] == 3 * len(plan_windows(100, 60, 20))


@pytest.mark.parametrize("frames", [1, 196, 197, 364, 365, 1000, 2400])
def test_windows_cover_all_frames_and_overlap(frames):
    windows = plan_windows(frames, 196, 28)
    assert windows[0][0] == 0 and windows[-1][1] >= frames > windows[-1][1] - len(windows) - 1
    assert all(0 < stop - start <= 196 for start, stop in windows)
    assert all(before[1] - after[0] == 28 for before, after in zip(windows, windows[1:], strict=False))


def test_the_hold_falls_smoothly():
    share = hold(28, 100, 12)
    assert share[:16].eq(1).all() and share[28:].eq(0).all() and bool((share.diff() <= 0).all()) and share.diff().abs().max() < 0.15


@pytest.mark.parametrize("frames", [1, 10, 59, 60, 61, 200])
def test_any_length_can_be_made(model, encoder, frames):
    found = sample_long(model, encoder.encode(["walks", "runs"]), frames, steps=2)
    assert found.values.shape == (2, frames, FEATURES) and found.adaptation.shape == (2, frames, 3, 3)
    assert bool(torch.isfinite(found.values).all())


class Waves(torch.nn.Module):
    """The best denoiser there is for smooth Gaussian processes: x0 = sqrt(a) S (a S + (1 - a) I)^-1 x_t, with S their covariance."""

    def __init__(self, config):
        super().__init__()
        self.config = config
        self.curve = alphas_cumprod().float()
        self.register_buffer("mean", torch.zeros(config.features))

    def condition(self, text, mask, pooled, mesh, keep_text, keep_mesh):
        return text, mask, pooled

    def forward(self, x, step, lengths, condition):
        frames, share = x.shape[1], self.curve[step[0]]
        apart = torch.arange(frames)[:, None] - torch.arange(frames)
        covariance = torch.exp(-0.5 * (apart / 8.0) ** 2) + 1e-4 * torch.eye(frames)
        gain = share.sqrt() * torch.linalg.solve(share * covariance + (1 - share) * torch.eye(frames), covariance)
        return gain.T @ x, torch.zeros(*x.shape[:2], 3, 3)


def test_long_motions_have_no_jump_where_windows_meet(config, encoder):
    model = Waves(config(features=FEATURES, frames=196, handles=3))
    frames = 700
    values = sample_long(model, encoder.encode(["walks"]), frames, steps=20, guidance=1.0, seed=2).values[0]
    seams = torch.zeros(frames, dtype=torch.bool)
    for start, _ in plan_windows(frames, 196, 28)[1:]:
        seams[start - 2 : start + 30] = True
    for order in (1, 2):
        change = values.diff(n=order, dim=0).abs().amax(-1)
        inside = seams[:-order]
        assert float(change[inside].max()) <= 1.25 * float(change[~inside].max())
    assert float(values.std()) == pytest.approx(1, abs=0.3)
    assert float((values[100:] - values[:-100]).std()) > 0.7  # windows are not copies of one another
