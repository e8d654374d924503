import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from bunraku.diffusion.extractor_config import RADIUS, ExtractorConfig
from bunraku.diffusion.sampling.classifier_guidance import LAST, STRENGTH, ClassifierGuidance, Critic, Spoken, smoothed
from bunraku.diffusion.sampling.noise import Noise
from bunraku.diffusion.sampling.sampler import ROOT
from bunraku.nn.layers import unit

SIZE = 16


@pytest.fixture(scope="module")
def network():
    torch = pytest.importorskip("torch", reason="networks are made with PyTorch")
    from bunraku_lab.nn.diffusion.matching import Extractor
    from bunraku_lab.nn.running.networks import running_extractor

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
