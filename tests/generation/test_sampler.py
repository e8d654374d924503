"""The sampler: solvers, few steps, and guidance by a classifier."""

import math
from collections import Counter

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from bunraku.core.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku.core.nn.layers import unit
from bunraku.errors import WeightsError
from bunraku.generation.candidates import SamplingSettings
from bunraku.generation.classifier_guidance import LAST, STRENGTH, ClassifierGuidance, Critic, Spoken, smoothed
from bunraku.generation.denoiser import FEW_STEPS_KIND, fingerprint, load_denoiser, load_denoiser_of_few_steps
from bunraku.generation.extractor import RADIUS, ExtractorConfig
from bunraku.generation.layers import TRAINING_STEPS
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
    token_share,
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
    found = sample(model, encoder.encode(["walks"]), 24, Solver(6), known=(values, share)).values
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
    text, known = encoder.encode(["walks", "runs"]), (values, share)
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


def thin(rows, columns, seed=0):
    random = np.random.default_rng(seed)
    return random.normal(size=(rows, 2)).astype(np.float32), random.normal(size=(2, columns)).astype(np.float32)


def told(rows):
    random = np.random.default_rng(5)
    tokens = random.normal(size=(rows, 3, 8)).astype(np.float32)
    return TextBatch(tokens, np.ones((rows, 3), bool), random.normal(size=(rows, 8)).astype(np.float32))


def test_matrices_get_their_changes_and_no_others(teacher):
    up, down = thin(16, 16)
    few = load_denoiser_of_few_steps(teacher, changed(teacher, step_in__0__weight=(up, down)))
    plain = load_denoiser(teacher)
    assert few.visited == tuple(VISITED) and plain.visited == ()
    np.testing.assert_allclose(few.step_in[0].matrix, plain.step_in[0].matrix + (up @ down).T, atol=1e-5)
    np.testing.assert_array_equal(few.motion_out.matrix, plain.motion_out.matrix)


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


@pytest.mark.parametrize("visited", [[], [90, 400], [400, 400], [1000, 3], [4.5], "all"])
def test_steps_that_do_not_fall_are_refused(teacher, visited):
    with pytest.raises(WeightsError, match=r"few-steps\.safetensors.*falling diffusion steps"):
        load_denoiser_of_few_steps(teacher, changed(teacher, visited=visited))


def test_changes_of_other_sizes_are_refused(teacher):
    with pytest.raises(WeightsError, match=r"'motion_out\.weight' is no matrix"):
        load_denoiser_of_few_steps(teacher, changed(teacher, motion_out__weight=thin(7, 16)))
    with pytest.raises(WeightsError, match="is no matrix"):
        load_denoiser_of_few_steps(teacher, changed(teacher, nothing=thin(7, 16)))


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
    from bunraku_lab.nn.running import running_extractor
    from bunraku_lab.nn.text import Extractor

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
    expected = smoothed(slopes)  # smoothing is linear
    assert np.abs(found - expected).max() < 0.02 * np.abs(expected).max()


def test_smoothing_is_a_gaussian_whose_ends_are_held():
    x = values(40)
    np.testing.assert_allclose(smoothed(x, 2.0), gaussian_filter1d(x, 2.0, axis=0, mode="nearest"), atol=1e-5)


def test_what_is_given_and_what_are_details_stay(network):
    x0 = values(40)
    given = pull_of(network, [Spoken((0, 40), vector(1), until=600)])
    assert np.array_equal(given(x0, 700), x0)
    assert not np.array_equal(given(x0, 599), x0)
    assert np.array_equal(given(x0, LAST - 1), x0)


def test_a_stretch_is_pulled_alike_whatever_stands_beside_it(network):
    x0 = values(60)
    alone = pull_of(network, [Spoken((0, 20), vector(1))])(x0, 500)
    beside = pull_of(network, [Spoken((20, 60), vector(2)), Spoken((0, 20), vector(1))])(x0, 500)
    np.testing.assert_allclose(beside[:20], alone[:20], atol=1e-5, rtol=1e-4)


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


def test_few_predictions_are_guided_more_than_once(network, running):
    x0, spoken = np.random.default_rng(3).normal(size=(40, SIZE)).astype(np.float32), [Spoken((0, 40), vector(1))]
    once, twice = pull_of(network, spoken), pull_of(network, spoken, rounds=2)
    np.testing.assert_allclose(twice(x0, 500), once(once(x0, 500), 500), atol=1e-6)
    model = running(features=SIZE, handles=3)
    rounds = [
        Critic(network, {"a": vector(1)}).guidance(model, [["a"]], [[40]], [40], None, steps).rounds
        for steps in (1, 4, 8, 20)
    ]
    assert rounds == [2, 2, 2, 1]
