"""Training of the orientation network on two tiny characters."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.anatomy.handles.networks import OrientationConfig
from bunraku.core.geometry.axes import ORIENTATIONS
from bunraku.errors import OptionError
from bunraku_lab.datasets.characters.build import training_character
from bunraku_lab.nn.checkpoints import load_training_state
from bunraku_lab.synthetic.samples import make_sample
from bunraku_lab.training.orientation import (
    UPRIGHT,
    OrientationTrainConfig,
    OrientationTrainer,
    fitted_temperature,
    orientation_results,
    train_orientation,
    validate_orientation,
)

SMALL = OrientationConfig(width=16, layers=1, heads=2, anchors=24)


@pytest.fixture(scope="module")
def characters():
    return [
        training_character(make_sample(name, rigged=True), f"samples/{name}", 300) for name in ("mushroom", "robot")
    ]


def settings(tmp_path, **changes):
    values = {
        "cache": tmp_path / "cache", "out": tmp_path / "run", "minutes": 0, "steps": 6, "batch": 2, "warmup": 2,
        "validate_every": 3,
    }  # fmt: skip
    return OrientationTrainConfig(predictor=SMALL, **(values | changes))


def test_the_loss_is_the_cross_entropy_over_all_24(characters, tmp_path):
    """With all 20 others, it is that of a softmax over the 24 scores."""
    trainer = OrientationTrainer(settings(tmp_path), characters)
    tokens = np.random.default_rng(0).normal(size=(3, 24, 10)).astype(np.float32)
    others = np.array([n for n, (up, _) in enumerate(ORIENTATIONS) if up != "+y"])
    loss, _ = trainer.loss(tokens, others)
    expected = -trainer.model.scores(tokens).log_softmax(-1)[:, UPRIGHT].mean()
    assert float(loss.detach()) == pytest.approx(float(expected.detach()), abs=1e-5)


def test_it_learns(characters, tmp_path):
    trainer = OrientationTrainer(settings(tmp_path, steps=150, rate=3e-3, decay=0.8), characters)
    before = orientation_results(validate_orientation(trainer.model, characters, 1).reshape(-1, 24))
    while trainer.progress() < 1:
        trainer.train_step()
    after = orientation_results(validate_orientation(trainer.average, characters, 1).reshape(-1, 24))
    assert after["loss"] < before["loss"] - 0.5


@pytest.mark.parametrize("last", ["write", "save_state"])
def test_a_kill_between_the_files_of_the_last_step_costs_nothing(characters, tmp_path, last):
    cache = tmp_path / "cache" / "samples"
    cache.mkdir(parents=True)
    for character in characters:
        character.save(cache / f"{character.name.split('/')[1]}.npz")
    whole = train_orientation(settings(tmp_path, out=tmp_path / "whole", reference_share=0.0))
    killed = settings(tmp_path, out=tmp_path / "killed", reference_share=0.0)
    trainer = OrientationTrainer(killed, characters)
    for step in range(6):
        trainer.train_step()
        if step == 2:
            trainer.save({})
    done = getattr(trainer, last)

    def ended(*words):
        done(*words)
        raise KeyboardInterrupt

    setattr(trainer, last, ended)
    with pytest.raises(KeyboardInterrupt):
        trainer.save({})
    path = train_orientation(killed)
    assert path.read_bytes()[-2000:] == whole.read_bytes()[-2000:]
    state, other = (load_training_state(one.with_name("state.safetensors")) for one in (path, whole))
    assert state.step == other.step == 6
    assert all(torch.equal(value, other.models["model"][name]) for name, value in state.models["model"].items())


def test_no_characters_is_one_sentence(tmp_path):
    with pytest.raises(OptionError, match="build the cache first"):
        OrientationTrainer(settings(tmp_path), [])


def test_results_and_temperature_against_hand_computed_ones():
    logs = np.full((4, 24), -8.0)
    logs[0, UPRIGHT] = 0  # right
    logs[1, ORIENTATIONS.index(("+y", "-z"))] = 0  # faces backwards
    logs[2, ORIENTATIONS.index(("+z", "-y"))] = 0  # lies
    logs[3, UPRIGHT] = 0
    logs -= np.log(np.exp(logs).sum(1, keepdims=True))
    results = orientation_results(logs)
    assert (results["up"], results["both"]) == (0.75, 0.5)
    assert results["front"] == 0.5  # the fronts of the one that lies tie, and +x comes first
    assert fitted_temperature(logs) > 2  # half of it is wrong and sure of it
    sure = logs[[0, 3]]
    assert fitted_temperature(sure) == pytest.approx(0.5)


def test_a_run_may_begin_with_given_weights(characters, tmp_path):
    given = OrientationTrainer(settings(tmp_path, out=tmp_path / "given", seed=5), characters)
    path = given.save({})
    trainer = OrientationTrainer(settings(tmp_path, start=path), characters)
    for name, weight in trainer.model.state_dict().items():
        assert torch.allclose(weight, given.average.state_dict()[name], atol=2e-3)  # stored in half precision
    wide = OrientationConfig(width=32, layers=1, heads=2, anchors=24)
    with pytest.raises(OptionError, match="another shape"):
        OrientationTrainer(replace(settings(tmp_path, start=path), predictor=wide), characters)
