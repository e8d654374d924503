import os
import signal

import pytest
import torch

from bunraku.diffusion.denoiser import load_denoiser
from bunraku.diffusion.train import TrainingConfig, train_diffusion
from bunraku.diffusion.trainer import Trainer
from bunraku.errors import FormatError, OptionError
from bunraku.nn.checkpoints import load_training_state


@pytest.fixture
def settings(swings, tmp_path):
    return lambda **how: TrainingConfig(**{"data": swings, "out": tmp_path / "run", "minutes": None, "steps": 4, "batch": 4, "device": "cpu", **how})


def weights(path):
    return load_training_state(path / "state.safetensors")


def test_a_run_that_was_stopped_goes_on_to_the_same_weights(settings, tmp_path, config, encoder, monkeypatch):
    train_diffusion(settings(out=tmp_path / "whole"), config(), encoder)
    update = Trainer.update

    def update_then_stop(self, example):
        losses = update(self, example)
        if self.step == 2:
            os.kill(os.getpid(), signal.SIGTERM)  # what a batch system sends
        return losses

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "update", update_then_stop)
        train_diffusion(settings(), config(), encoder)
    assert weights(tmp_path / "run").step == 2
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    path = train_diffusion(settings(), config(), encoder)
    whole, parts = weights(tmp_path / "whole"), weights(tmp_path / "run")
    assert whole.step == parts.step == 4
    for name in ("model", "average"):
        assert all(torch.equal(value, parts.models[name][key]) for key, value in whole.models[name].items())
    model = load_denoiser(path)
    assert model.notes["steps"] == 4 and not model.knows_meshes and model.mean.abs().sum() > 0
    assert (tmp_path / "run" / "log.csv").read_text().startswith("step,")


def test_mesh_features_are_trained_when_a_bank_is_given(settings, config, encoder, tmp_path):
    import numpy as np

    bank = tmp_path / "bank.npz"
    np.savez(bank, features=np.random.default_rng(0).normal(size=(5, 12)).astype(np.float32))
    assert load_denoiser(train_diffusion(settings(mesh_bank=bank, steps=1), config(), encoder)).knows_meshes
    np.savez(bank, features=np.zeros((5, 3)))
    with pytest.raises(FormatError, match=r"bank\.npz.*\(characters, 12\)"):
        train_diffusion(settings(mesh_bank=bank), config(), encoder)


def test_training_learns(settings, config, encoder):
    """The motion loss of the four motions falls well below that of the mean pose, which is about their variance."""
    import csv

    path = train_diffusion(settings(steps=120, batch=8, learning_rate=3e-3, warmup=10, bf16=False, validate_every=60, compose=0.0), config(), encoder)
    with (path.parent / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows] == ["20", "60", "120"]
    assert float(rows[-1]["motion"]) < 0.5 * float(rows[0]["motion"])


def test_wrong_settings_are_clear(settings, config, encoder, tmp_path):
    for how, words in {"preset": ("huge", "unknown"), "batch": (0, "positive"), "steps": (-1, "positive"), "minutes": (-5.0, "positive")}.items():
        with pytest.raises(OptionError, match=words[1]):
            train_diffusion(settings(**{how: words[0]}), config(), encoder)
    with pytest.raises(FormatError, match="bunraku data motions"):
        train_diffusion(settings(data=tmp_path / "nowhere"), config(), encoder)
    train_diffusion(settings(steps=1), config(), encoder)
    with pytest.raises(OptionError, match="another network"):
        train_diffusion(settings(steps=1), config(width=32), encoder)
