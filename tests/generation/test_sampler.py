"""The sampler: solvers, few steps, and guidance by a classifier."""

from collections import Counter

import numpy as np
import pytest

from bunraku.core.geometry.curves import gaussian
from bunraku.core.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku.core.nn.layers import unit
from bunraku.generation.candidates import SPREAD, STRENGTH, ClassifierGuidance, Critic, SamplingSettings, Spoken
from bunraku.generation.denoiser import FEW_STEPS_KIND, fingerprint, load_denoiser_of_few_steps
from bunraku.generation.extractor import RADIUS, ExtractorConfig
from bunraku.generation.sampler import (
    GUIDED_FROM,
    LED_UNTIL,
    ROOT,
    Noise,
    Solver,
    Steering,
    Window,
    alphas_cumprod,
    dpm_solver,
    guided,
    row_noise,
    sample_windows,
    sampling_steps,
)
from bunraku.language.encoders import TextBatch
from bunraku_lab.evaluation.motion.samples import sample

FEATURES = 6


@pytest.fixture
def model(running):
    return running(features=FEATURES, handles=3)


def noise_of(rows, frames, features, seed):
    return np.stack([row_noise(frames, features, seed, row) for row in range(rows)])


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
        num_train_timesteps=1000, beta_schedule="squaredcos_cap_v2", prediction_type="sample",
        algorithm_type="dpmsolver++", solver_order=2,
    )  # fmt: skip
    scheduler.set_timesteps(timesteps=sampling_steps(count))
    torch = pytest.importorskip("torch")
    noise = noise_of(2, 12, 5, seed=3)
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
    truth, noise = normal(2, 30, 4), noise_of(2, 30, 4, 1)
    for steps in (1, 5, 20):
        close(dpm_solver(lambda x, step: truth, noise, sampling_steps(steps)), truth)


def test_the_sampler_draws_from_the_right_distribution():
    # For x0 ~ N(mean, deviation^2) the best predictor is known, so the samples must have that mean and deviation.
    mean, deviation, curve = 0.8, 0.5, alphas_cumprod()

    def best(x, step):
        share = float(curve[step])
        return mean + share**0.5 * deviation**2 / (share * deviation**2 + 1 - share) * (x - share**0.5 * mean)

    noise = noise_of(1, 200, 100, 5)
    values = dpm_solver(best, noise, sampling_steps(50))
    assert float(values.mean()) == pytest.approx(mean, abs=0.02)
    assert float(values.std()) == pytest.approx(deviation, abs=0.03)


def test_guidance():
    a, b = normal(2, 8, 4), normal(2, 8, 4, seed=1)
    close(guided(a, b, 1.0), a)
    close(guided(a, b, 0.0), b)
    close(guided(a, b, 6.0, rescale=1.0).std((1, 2)), a.std((1, 2)), rtol=1e-5)


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
    found = sample(model, encoder.encode(["walks"]), 24, Solver(6), known=(values, share)).values
    close(found[:, :6], values[:, :6])
    close(found[:, 20:], values[:, 20:])
    assert np.abs(found[:, 6:20] - values[:, 6:20]).max() > 0.1


def test_known_features_are_kept(model, encoder):
    values, share = normal(2, 24, FEATURES), np.zeros((24, FEATURES), np.float32)
    share[:, :2] = share[5, 3] = 1
    text, known = encoder.encode(["walks", "runs"]), (values, share)
    found = sample(model, text, 24, Solver(6), known=known).values
    kept = np.broadcast_to(share > 0, values.shape)
    close(found[kept], values[kept])
    assert np.abs(found - values)[~kept].max() > 0.1
    free = sample(model, encoder.encode(["walks", "runs"]), 24, Solver(6)).values
    assert np.abs(found - free)[~kept].max() > 0.01  # the rest is made to fit


def test_a_guide_is_where_the_motion_starts_from_and_others_beside_it_are_as_without(model, encoder):
    noise = noise_of(2, 40, FEATURES, 5).reshape(80, -1)
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


VISITED = [999, 700, 400, 90]


@pytest.fixture
def teacher(tmp_path, denoiser):
    """Path of a small denoiser."""
    from bunraku_lab.nn.denoiser import save_denoiser

    return save_denoiser(tmp_path / "diffusion.safetensors", denoiser(features=6, handles=3), half=False)


def changed(teacher, visited=VISITED, of=None, **matrices):
    """Path of changes to the matrices that are named, with "__" for each dot."""
    state = load_checkpoint(teacher, "diffusion")[0]
    config = {"of": of or fingerprint(state), "visited": visited, "guidance": 3.5}
    parts = {
        f"{name.replace('__', '.')}.{part}": value
        for name, pair in matrices.items()
        for part, value in zip(("up", "down"), pair, strict=True)
    }
    return save_checkpoint(teacher.with_name("few-steps.safetensors"), parts, config, FEW_STEPS_KIND)


def told(rows):
    random = np.random.default_rng(5)
    tokens = random.normal(size=(rows, 3, 8)).astype(np.float32)
    return TextBatch(tokens, np.ones((rows, 3), bool), random.normal(size=(rows, 8)).astype(np.float32))


def test_changes_of_another_denoiser_are_left_alone(teacher):
    assert load_denoiser_of_few_steps(teacher, changed(teacher, of="0" * 32)) is None


def test_a_sampler_goes_by_ddim_through_these_steps_and_asks_the_sentence_alone(teacher):
    """Against DDIM written out: x' = alpha' x0 + sigma' (x - alpha x0) / sigma; guidance would need a second row."""
    few = load_denoiser_of_few_steps(teacher, changed(teacher))
    text, seen = told(2), []

    class Watched:
        def __getattr__(self, name):
            return getattr(few, name)

        def __call__(self, x, step, lengths, condition, adapts=True):
            found = few(x, step, lengths, condition, adapts)
            seen.append((step, x.copy(), found[0]))
            return found

    sample(Watched(), text, 4, Solver(20, guidance=5.0), seed=3)
    runs = [one for one in seen if one[1].shape[1] == 4]  # the last step looks again, half a token later
    assert [step for step, _, _ in runs[::2]] == VISITED and all(len(x) == 1 for _, x, _ in runs)
    curve = alphas_cumprod()
    for (step, x, x0), (after, there, _) in zip(runs[::2], runs[2::2], strict=False):
        alpha, sigma = (np.sqrt(share) for share in (curve[step], 1 - curve[step]))
        noise = (x - alpha * x0) / sigma
        np.testing.assert_allclose(there, np.sqrt(curve[after]) * x0 + np.sqrt(1 - curve[after]) * noise, atol=1e-3)


def test_who_asks_for_steps_or_guidance_gets_the_denoiser_itself(teacher):
    changed(teacher)
    assert SamplingSettings(checkpoint=teacher).denoiser.visited == tuple(VISITED)
    for how in ({"steps": 8}, {"guidance": 2.0}):
        assert SamplingSettings(checkpoint=teacher, **how).denoiser.visited == ()
    teacher.with_name("few-steps.safetensors").unlink()
    assert SamplingSettings(checkpoint=teacher).denoiser.visited == ()


SIZE = 16


@pytest.fixture(scope="module")
def network():
    torch = pytest.importorskip("torch", reason="networks are made with PyTorch")
    from bunraku_lab.nn.text import Extractor, running_extractor

    torch.manual_seed(0)
    config = ExtractorConfig(width=16, layers=1, heads=2, feedforward=16, embedding=8, features=SIZE, dropout=0.0)
    return running_extractor(Extractor(config))


def vector(seed):
    return unit(Noise(seed).draw(16)[:8])


def values(frames):
    return Noise(frames).draw(frames, SIZE)


def pull_of(network, stretches, **options):
    return ClassifierGuidance(network, np.zeros(SIZE, np.float32), np.ones(SIZE, np.float32), stretches, **options)


def cosine(network, x0, goal):
    return float(network.motion(x0[None], np.array([len(x0)]))[0] @ goal) / RADIUS


def test_what_is_pulled_comes_nearer_to_its_own_sentence_and_keeps_its_root(network):
    x0 = values(80)
    stretches = [Spoken((0, 30), vector(1)), Spoken((30, 80), vector(2))]
    found = pull_of(network, stretches)(x0, 500)
    for one in stretches:
        part = slice(*one.frames)
        assert cosine(network, found[part], one.vector) > cosine(network, x0[part], one.vector) + 0.01
        assert float(np.sqrt(((found - x0)[part] ** 2).mean())) == pytest.approx(STRENGTH, rel=1e-4)
    assert np.array_equal(found[:, ROOT], x0[:, ROOT])


def test_the_gradient_is_that_of_the_cosine(network):
    x0, goal = values(24), vector(3)
    found = pull_of(network, []).gradients(x0, [Spoken((0, 24), goal)])[0]
    slopes, step = np.zeros((24, SIZE), np.float32), 0.02
    for frame in range(24):
        for feature in range(ROOT.stop, SIZE):
            way = np.zeros((24, SIZE), np.float32)
            way[frame, feature] = step
            slopes[frame, feature] = (cosine(network, x0 + way, goal) - cosine(network, x0 - way, goal)) / (2 * step)
    expected = gaussian(slopes, SPREAD)  # smoothing is linear
    assert np.abs(found - expected).max() < 0.02 * np.abs(expected).max()


def test_a_critic_pulls_each_sentence_of_each_motion_in_its_own_frames(network, running):
    model = running(features=SIZE, handles=3)
    told = {"a": vector(1), "b": vector(2)}
    share, until = np.zeros((460, 1), np.float32), np.full((460, 1), 600)
    share[:40] = 1
    pull = Critic(network, told).guidance(
        model, [["a", "b"], ["b", "a"]], [[40, 20], [396, 4]], [60, 400], (share, share, until)
    )
    found = [(one.frames, one.until, bool(one.vector is told["a"])) for one in pull.stretches]
    # the first is given down to step 600; a long one goes in pieces of at most 196 frames; four frames say nothing
    assert sorted(found) == [
        ((0, 40), 600, True), ((40, 60), 1000, False),
        ((60, 192), 1000, False), ((192, 324), 1000, False), ((324, 456), 1000, False),
    ]  # fmt: skip
