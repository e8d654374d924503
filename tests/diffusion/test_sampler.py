from collections import Counter

import pytest
import torch

from bunraku.diffusion.sampling.sampler import (
    GUIDED_FROM,
    LED_UNTIL,
    Known,
    Solver,
    Steering,
    Window,
    guided,
    sample,
    sample_windows,
    starting_noise,
    token_share,
)
from bunraku.diffusion.sampling.solvers import alphas_cumprod, ancestral, dpm_solver, sampling_steps

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
        num_train_timesteps=1000,
        beta_schedule="squaredcos_cap_v2",
        prediction_type="sample",
        algorithm_type="dpmsolver++",
        solver_order=2,
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
    torch.testing.assert_close(
        ancestral(lambda x, step: truth, noise, list(range(999, -1, -1)), torch.Generator().manual_seed(0)), truth
    )


def test_both_samplers_draw_from_the_right_distribution():
    # For x0 ~ N(mean, deviation^2) the best predictor is known, so the samples must have that mean and deviation.
    mean, deviation, curve = 0.8, 0.5, alphas_cumprod()

    def best(x, step):
        share = float(curve[step])
        return mean + share**0.5 * deviation**2 / (share * deviation**2 + 1 - share) * (x - share**0.5 * mean)

    noise = starting_noise(1, 200, 100, 5)
    for values in (
        dpm_solver(best, noise, sampling_steps(50)),
        ancestral(best, noise, sampling_steps(200), torch.Generator().manual_seed(6)),
    ):
        assert float(values.mean()) == pytest.approx(mean, abs=0.02) and float(values.std()) == pytest.approx(
            deviation, abs=0.03
        )


def test_guidance():
    a, b = torch.randn(2, 8, 4), torch.randn(2, 8, 4)
    torch.testing.assert_close(guided(a, b, 1.0), a)
    torch.testing.assert_close(guided(a, b, 0.0), b)
    torch.testing.assert_close(guided(a, b, 6.0, rescale=1.0).std((1, 2)), a.std((1, 2)))


def test_guidance_of_one_is_the_conditional_model(model, encoder):
    text = encoder.encode(["a figure walks"])
    near = sample(model, text, 24, Solver(4, guidance=1.0 + 1e-7))  # still both passes
    alone = sample(model, text, 24, Solver(4, guidance=1.0)).values
    torch.testing.assert_close(alone, near.values, atol=1e-4, rtol=1e-4)
    assert (sample(model, text, 24, Solver(4, guidance=3.0)).values - near.values).abs().max() > 1e-2


def test_guidance_acts_in_the_noisy_steps_alone(model, encoder):
    seen = Counter()
    hook = model.register_forward_hook(
        lambda _, given, __: seen.update({(int(given[1][0]), given[0].shape[1]): len(given[0])})
    )
    try:
        sample(model, encoder.encode(["a person walks"]), 24, Solver(8, guidance=3.0))
    finally:
        hook.remove()
    assert {step >= GUIDED_FROM for step, _ in seen} == {True, False}
    for (step, _), rows in seen.items():  # with and without the sentence; the last step has a second, longer grid
        assert rows == (2 if step >= GUIDED_FROM else 1)


def test_seeds_batches_and_prompts(model, encoder):
    text = encoder.encode(["a figure walks", "a figure jumps over the fence"])
    one, again, other = (sample(model, text, 30, Solver(5), seed=seed).values for seed in (4, 4, 5))
    assert torch.equal(one, again) and (one - other).abs().max() > 1e-2
    alone = sample(model, encoder.encode(["a figure walks"]), 30, Solver(5), seed=4).values
    torch.testing.assert_close(one[:1], alone, atol=1e-4, rtol=1e-4)
    swapped = sample(model, encoder.encode(["a figure runs"]), 30, Solver(5), seed=4).values
    assert (swapped - alone).abs().max() > 1e-2


def test_a_mesh_feature_reaches_the_motion_and_the_adaptation(model, encoder):
    text = encoder.encode(["a figure walks"])
    plain, meshed = (sample(model, text, 20, Solver(3), mesh_features=mesh) for mesh in (None, torch.ones(1, 12)))
    assert plain.adaptation.shape == (1, 20, 3, 3)
    assert (plain.values - meshed.values).abs().max() > 1e-3 and (
        plain.adaptation - meshed.adaptation
    ).abs().max() > 1e-3


@pytest.mark.parametrize("method", ["dpm", "ddpm"])
def test_known_frames_are_kept(model, encoder, method):
    values = torch.randn(1, 24, FEATURES)
    share = torch.zeros(24)
    share[:6] = share[20:] = 1
    found = sample(model, encoder.encode(["walks"]), 24, Solver(6, method=method), known=Known(values, share)).values
    torch.testing.assert_close(found[:, :6], values[:, :6])
    torch.testing.assert_close(found[:, 20:], values[:, 20:])
    assert (found[:, 6:20] - values[:, 6:20]).abs().max() > 0.1


def test_tokens_are_trusted_least_at_their_edges():
    assert token_share(6, 4).tolist() == [0.25, 0.75, 0.75, 0.25, 0.25, 0.75]
    for patch in (2, 3, 4, 5, 8):  # a frame at the edge of one grid is inside the other's token
        share = token_share(40, patch)
        assert float((share + token_share(40 + patch // 2, patch)[patch // 2 :]).min()) >= 0.5


@pytest.mark.parametrize("method", ["dpm", "ddpm"])
def test_known_features_are_kept(model, encoder, method):
    values, share = torch.randn(2, 24, FEATURES), torch.zeros(24, FEATURES)
    share[:, :2] = share[5, 3] = 1
    text, known = encoder.encode(["walks", "runs"]), Known(values, share)
    found = sample(model, text, 24, Solver(6, method=method), known=known).values
    kept = share.bool().expand(2, -1, -1)
    torch.testing.assert_close(found[kept], values[kept])
    assert (found - values)[~kept].abs().max() > 0.1
    free = sample(model, encoder.encode(["walks", "runs"]), 24, Solver(6, method=method)).values
    assert (found - free)[~kept].abs().max() > 0.01  # the rest is made to fit


def test_lengths_of_a_batch_are_padded(model, encoder):
    text = encoder.encode(["walks", "runs", "waves"])
    found = sample(model, text, [24, 40, 10], Solver(4))
    assert found.values.shape == (3, 40, FEATURES) and not found.values[0, 24:].any() and not found.values[2, 10:].any()
    assert not found.adaptation[0, 24:].any()
    alone = sample(model, encoder.encode(["walks"]), 24, Solver(4)).values
    torch.testing.assert_close(found.values[:1, :24], alone, atol=1e-4, rtol=1e-4)


def test_padding_does_not_count_in_rescaling(model, encoder):
    text = encoder.encode(["walks", "runs"])
    found = sample(model, text, [24, 40], Solver(4, guidance=4.0, rescale=0.7)).values
    alone = sample(model, encoder.encode(["walks"]), 24, Solver(4, guidance=4.0, rescale=0.7)).values
    torch.testing.assert_close(found[:1, :24], alone, atol=1e-4, rtol=1e-4)


def test_a_guide_is_where_the_motion_starts_from_and_others_beside_it_are_as_without(model, encoder):
    noise = starting_noise(2, 40, FEATURES, 5).flatten(0, 1)
    windows = [Window(torch.arange(row * 40, row * 40 + 40), torch.ones(40), row) for row in range(2)]
    text = encoder.encode(["a person waves", "a person kicks"])
    truth = torch.sin(torch.arange(80)[:, None] / 5 + torch.arange(FEATURES))
    share = torch.cat([torch.ones(40, 1), torch.zeros(40, 1)])
    until = torch.full((80, 1), LED_UNTIL)

    def draw(share, until=until):
        return sample_windows(model, text, windows, noise, Solver(20), Steering(guide=(truth, share, until))).values

    led, beside = draw(share).split(40)
    _, alone = sample_windows(model, text, windows, noise, Solver(20)).values.split(40)
    torch.testing.assert_close(beside, alone, atol=1e-4, rtol=1e-4)
    asked, _ = draw(share * (1 - 1e-6)).split(40)  # here the network is asked at each step, and overwritten
    torch.testing.assert_close(led, asked, atol=1e-3, rtol=1e-3)

    kept, beside = draw(share, torch.zeros(80, 1)).split(40)  # to the end
    torch.testing.assert_close(kept, truth[:40].float(), atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(beside, alone, atol=1e-4, rtol=1e-4)

    steps = sampling_steps(20)
    first = next(step for step in steps if step < LED_UNTIL)
    level = alphas_cumprod()[first]
    seen = []
    watched = model.forward

    def watch(x, *rest, **options):
        seen.append(x.clone())
        return watched(x, *rest, **options)

    model.forward = watch
    guide = (truth[:40], share[:40], until[:40])
    sample_windows(model, text, windows[:1], noise[:40], Solver(20), Steering(guide=guide))
    start = level.sqrt() * truth[:40] + (1 - level).sqrt() * noise[:40]
    torch.testing.assert_close(seen[0][0], start.float(), atol=1e-4, rtol=1e-4)
