from dataclasses import replace

import numpy as np
import pytest

from bunraku.diffusion.examples.attended import ExampleBank, take_of
from bunraku.diffusion.extractor_config import ExtractorConfig
from bunraku.diffusion.features import FeatureStatistics, mirror

AXES = np.eye(4)


@pytest.fixture
def statistics(pack):
    return FeatureStatistics.measure([pack.features(index) for index in range(2)])


@pytest.fixture
def bank(pack, encoder, statistics):
    torch = pytest.importorskip("torch", reason="networks are made with PyTorch")
    from bunraku_lab.nn.diffusion.matching import Extractor
    from bunraku_lab.nn.running.networks import running_extractor

    torch.manual_seed(3)
    sizes = {"width": 16, "layers": 1, "heads": 2, "feedforward": 16, "embedding": 4, "text_size": 8, "pooled_size": 8}
    ranker = running_extractor(Extractor(ExtractorConfig(**sizes, text_encoder="words")))
    return ExampleBank(pack, ranker, encoder, statistics, count=2)


def test_the_nearest_by_vectors_alone_each_once_on_the_nearer_side(bank):
    assert bank.nearest(AXES[0]) == [(0, False), (1, False)]
    assert bank.nearest(AXES[3])[0] == (1, True)
    assert bank.nearest((AXES[2] + 0.5 * AXES[1]) / 1.25**0.5) == [(0, True), (1, False)]


def test_what_is_left_out_is_not_found(bank):
    assert bank.nearest(AXES[0], {"wave"}) == [(1, False)]
    assert bank.nearest(AXES[0], {"wave", "kick"}) == []


def test_gestures_made_by_code_are_not_attended_to(bank, pack):
    made = replace(pack, examples=(replace(pack.examples[0], name="gesture_wave"), pack.examples[1]))
    other = ExampleBank(made, bank.ranker, bank.encoder, bank.statistics, 2)
    assert other.nearest(AXES[0]) == [(1, False)]


def test_values_are_in_network_units_with_the_vector_of_their_own_sentence(bank, pack, encoder, statistics):
    text = encoder.encode(["kicks hard", "waves"])
    found = bank(text, [{"wave"}, {"kick"}])
    assert found.lengths.tolist() == [[30, 0], [40, 0]]
    assert found.values.shape == (2, 2, 40, 271) and found.pooled.shape == (2, 2, 8)
    kick = statistics.normalise(pack.features(1))
    own = found.values[0, 0, :30]
    side = min((kick, statistics.normalise(mirror(pack.features(1)))), key=lambda one: np.abs(one - own).max())
    np.testing.assert_allclose(own, side, atol=0.02)
    said = "a person kicks with the right leg" if side is kick else "a person kicks with the left leg"
    np.testing.assert_allclose(found.pooled[0, 0], encoder.encode([said]).pooled[0])
    assert not found.values[0, 1].any() and not found.values[0, 0, 30:].any()


def test_takes():
    names = ("cmu_13_29_jacks@40", "cmu_13_29@0#12", "snu_WalkSad05@0", "snu_WalkSad11", "hdm_kick", "turn_cmu_02_01")
    found = [take_of(name) for name in names]
    assert found == ["cmu_13_29", "cmu_13_29", "snu_WalkSad", "snu_WalkSad", "hdm_kick", "cmu_02_01"]


def test_the_sampler_retrieves_for_the_sentence_from_the_shipped_examples(running):
    """Motions of a network that attends to examples differ from those that it makes where none is usable."""
    from bunraku.diffusion.examples import attended
    from bunraku.diffusion.sampling.sampler import Solver, sample
    from bunraku.language.encoders import text_encoder

    name = "all-MiniLM-L6-v2+cues"
    encoder = text_encoder(name)
    sizes = {"text_encoder": name, "text_size": encoder.token_size, "pooled_size": encoder.pooled_size}
    model = running(examples=2, **sizes)
    text = encoder.encode(["a person does a cartwheel"])
    statistics = FeatureStatistics(model.mean, model.std)
    bank = attended.example_bank(model.config, statistics)
    assert attended.example_bank(model.config, statistics) is bank
    found = bank(text)
    assert found.values.shape[:2] == (1, 2) and (found.lengths > 0).all()
    one = sample(model, text, 40, Solver(2), seed=1).values
    assert np.array_equal(one, sample(model, text, 40, Solver(2), seed=1).values)
    model.layers[1].examples.leave.matrix[:] = 0
    assert np.abs(one - sample(model, text, 40, Solver(2), seed=1).values).max() > 1e-3
