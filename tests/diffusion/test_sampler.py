from collections import Counter

import numpy as np
import pytest

from bunraku.diffusion.sampling.noise import Noise, starting_noise
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
    token_share,
)
from bunraku.diffusion.sampling.solvers import alphas_cumprod, dpm_solver, sampling_steps

FEATURES = 6


@pytest.fixture
def model(running):
    return running(features=FEATURES, handles=3)


def normal(*shape, seed=0):
    return Noise(seed).draw(*shape)


def close(one, other, atol=1e-5, rtol=1.3e-6):
    np.testing.assert_allclose(one, other, atol=atol, rtol=rtol)


def toy(x, step):
    """A smooth, bounded predictor of x0 that depends on x_t and t."""
    return np.tanh(0.7 * np.roll(x, 1, 1) + 0.2) * (1 + step / 1000)


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
    torch = pytest.importorskip("torch")
    noise = starting_noise(2, 12, 5, seed=3)
    x, path = torch.from_numpy(noise), []
    for step in scheduler.timesteps:
        path.append(x)
        x = scheduler.step(torch.from_numpy(toy(x.numpy(), int(step))), step, x).prev_sample
    ours = []

    def watch(x, step):
        ours.append(x)
        return toy(x, step)

    close(dpm_solver(watch, noise, sampling_steps(count)), x, atol=2e-4, rtol=2e-4)
    for mine, theirs in zip(ours, path, strict=True):
        close(mine, theirs, atol=2e-4, rtol=2e-4)


def test_the_sampler_finds_what_an_oracle_knows():
    truth, noise = normal(2, 30, 4), starting_noise(2, 30, 4, 1)
    for steps in (1, 5, 20):
        close(dpm_solver(lambda x, step: truth, noise, sampling_steps(steps)), truth)


def test_the_sampler_draws_from_the_right_distribution():
    # For x0 ~ N(mean, deviation^2) the best predictor is known, so the samples must have that mean and deviation.
    mean, deviation, curve = 0.8, 0.5, alphas_cumprod()

    def best(x, step):
        share = float(curve[step])
        return mean + share**0.5 * deviation**2 / (share * deviation**2 + 1 - share) * (x - share**0.5 * mean)

    noise = starting_noise(1, 200, 100, 5)
    values = dpm_solver(best, noise, sampling_steps(50))
    assert float(values.mean()) == pytest.approx(mean, abs=0.02)
    assert float(values.std()) == pytest.approx(deviation, abs=0.03)


def test_guidance():
    a, b = normal(2, 8, 4), normal(2, 8, 4, seed=1)
    close(guided(a, b, 1.0), a)
    close(guided(a, b, 0.0), b)
    close(guided(a, b, 6.0, rescale=1.0).std((1, 2)), a.std((1, 2)), rtol=1e-5)


def test_guidance_of_one_is_the_conditional_model(model, encoder):
    text = encoder.encode(["a figure walks"])
    near = sample(model, text, 24, Solver(4, guidance=1.0 + 1e-7))  # still both passes
    alone = sample(model, text, 24, Solver(4, guidance=1.0)).values
    close(alone, near.values, atol=1e-4, rtol=1e-4)
    assert np.abs(sample(model, text, 24, Solver(4, guidance=3.0)).values - near.values).max() > 1e-2


def test_guidance_acts_in_the_noisy_steps_alone(model, encoder):
    seen, plain = Counter(), model.hidden

    def hidden(x, step, *rest):
        seen.update({(step, x.shape[1]): len(x)})
        return plain(x, step, *rest)

    model.hidden = hidden
    sample(model, encoder.encode(["a person walks"]), 24, Solver(8, guidance=3.0))
    assert {step >= GUIDED_FROM for step, _ in seen} == {True, False}
    for (step, _), rows in seen.items():  # with and without the sentence; the last step has a second, longer grid
        assert rows == (2 if step >= GUIDED_FROM else 1)


def test_seeds_batches_and_prompts(model, encoder):
    text = encoder.encode(["a figure walks", "a figure jumps over the fence"])
    one, again, other = (sample(model, text, 30, Solver(5), seed=seed).values for seed in (4, 4, 5))
    assert np.array_equal(one, again) and np.abs(one - other).max() > 1e-2
    alone = sample(model, encoder.encode(["a figure walks"]), 30, Solver(5), seed=4).values
    close(one[:1], alone, atol=1e-4, rtol=1e-4)
    swapped = sample(model, encoder.encode(["a figure runs"]), 30, Solver(5), seed=4).values
    assert np.abs(swapped - alone).max() > 1e-2


def test_a_mesh_feature_reaches_the_motion_and_the_adaptation(model, encoder):
    text = encoder.encode(["a figure walks"])
    plain, meshed = (
        sample(model, text, 20, Solver(3), mesh_features=mesh) for mesh in (None, np.ones((1, 12), np.float32))
    )
    assert plain.adaptation.shape == (1, 20, 3, 3)
    assert (
        np.abs(plain.values - meshed.values).max() > 1e-3 and np.abs(plain.adaptation - meshed.adaptation).max() > 1e-3
    )


def test_known_frames_are_kept(model, encoder):
    values = normal(1, 24, FEATURES)
    share = np.zeros(24, np.float32)
    share[:6] = share[20:] = 1
    found = sample(model, encoder.encode(["walks"]), 24, Solver(6), known=Known(values, share)).values
    close(found[:, :6], values[:, :6])
    close(found[:, 20:], values[:, 20:])
    assert np.abs(found[:, 6:20] - values[:, 6:20]).max() > 0.1


def test_tokens_are_trusted_least_at_their_edges():
    assert token_share(6, 4).tolist() == [0.25, 0.75, 0.75, 0.25, 0.25, 0.75]
    for patch in (2, 3, 4, 5, 8):  # a frame at the edge of one grid is inside the other's token
        share = token_share(40, patch)
        assert float((share + token_share(40 + patch // 2, patch)[patch // 2 :]).min()) >= 0.5


def test_known_features_are_kept(model, encoder):
    values, share = normal(2, 24, FEATURES), np.zeros((24, FEATURES), np.float32)
    share[:, :2] = share[5, 3] = 1
    text, known = encoder.encode(["walks", "runs"]), Known(values, share)
    found = sample(model, text, 24, Solver(6), known=known).values
    kept = np.broadcast_to(share > 0, values.shape)
    close(found[kept], values[kept])
    assert np.abs(found - values)[~kept].max() > 0.1
    free = sample(model, encoder.encode(["walks", "runs"]), 24, Solver(6)).values
    assert np.abs(found - free)[~kept].max() > 0.01  # the rest is made to fit


def test_lengths_of_a_batch_are_padded(model, encoder):
    text = encoder.encode(["walks", "runs", "waves"])
    found = sample(model, text, [24, 40, 10], Solver(4))
    assert found.values.shape == (3, 40, FEATURES) and not found.values[0, 24:].any() and not found.values[2, 10:].any()
    assert not found.adaptation[0, 24:].any()
    alone = sample(model, encoder.encode(["walks"]), 24, Solver(4)).values
    close(found.values[:1, :24], alone, atol=1e-4, rtol=1e-4)


def test_padding_does_not_count_in_rescaling(model, encoder):
    text = encoder.encode(["walks", "runs"])
    found = sample(model, text, [24, 40], Solver(4, guidance=4.0, rescale=0.7)).values
    alone = sample(model, encoder.encode(["walks"]), 24, Solver(4, guidance=4.0, rescale=0.7)).values
    close(found[:1, :24], alone, atol=1e-4, rtol=1e-4)


def test_a_guide_is_where_the_motion_starts_from_and_others_beside_it_are_as_without(model, encoder):
    noise = starting_noise(2, 40, FEATURES, 5).reshape(80, -1)
    windows = [Window(np.arange(row * 40, row * 40 + 40), np.ones(40, np.float32), row) for row in range(2)]
    text = encoder.encode(["a person waves", "a person kicks"])
    truth = np.sin(np.arange(80)[:, None] / 5 + np.arange(FEATURES)).astype(np.float32)
    share = np.concatenate([np.ones((40, 1), np.float32), np.zeros((40, 1), np.float32)])
    until = np.full((80, 1), LED_UNTIL)

    def draw(share, until=until):
        return sample_windows(model, text, windows, noise, Solver(20), Steering(guide=(truth, share, until))).values

    led, beside = np.split(draw(share), 2)
    _, alone = np.split(sample_windows(model, text, windows, noise, Solver(20)).values, 2)
    close(beside, alone, atol=1e-4, rtol=1e-4)
    asked, _ = np.split(
        draw(share * np.float32(1 - 1e-6)), 2
    )  # here the network is asked at each step, and overwritten
    close(led, asked, atol=1e-3, rtol=1e-3)

    kept, beside = np.split(draw(share, np.zeros((80, 1))), 2)  # to the end
    close(kept, truth[:40], atol=1e-3, rtol=1e-3)
    close(beside, alone, atol=1e-4, rtol=1e-4)

    steps = sampling_steps(20)
    first = next(step for step in steps if step < LED_UNTIL)
    level = alphas_cumprod()[first]
    seen = []
    watched = model.hidden

    def watch(x, *rest):
        seen.append(x.copy())
        return watched(x, *rest)

    model.hidden = watch
    guide = (truth[:40], share[:40], until[:40])
    sample_windows(model, text, windows[:1], noise[:40], Solver(20), Steering(guide=guide))
    start = level**0.5 * truth[:40] + (1 - level) ** 0.5 * noise[:40]
    close(seen[0][0], start, atol=1e-4, rtol=1e-4)
