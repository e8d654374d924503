"""Training of the denoiser, from other weights too."""

import csv
import os
import signal
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.errors import FormatError, OptionError
from bunraku.generation.denoiser import DenoiserConfig
from bunraku_lab.nn.checkpoints import load_training_state
from bunraku_lab.nn.denoiser import Denoiser, load_denoiser, save_denoiser
from bunraku_lab.training.diffusion.train import TrainingConfig, rescaled, start_from, train_diffusion
from bunraku_lab.training.diffusion.trainer import Trainer


@pytest.fixture
def settings(swings, tmp_path):
    return lambda **how: TrainingConfig(
        **{"data": swings, "out": tmp_path / "run", "minutes": None, "steps": 4, "batch": 4, "device": "cpu", **how}
    )


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

    bank = tmp_path / "bank.npz"
    np.savez(bank, features=np.random.default_rng(0).normal(size=(5, 12)).astype(np.float32))
    assert load_denoiser(train_diffusion(settings(mesh_bank=bank, steps=1), config(), encoder)).knows_meshes
    np.savez(bank, features=np.zeros((5, 3)))
    with pytest.raises(FormatError, match=r"bank\.npz.*\(characters, 12\)"):
        train_diffusion(settings(mesh_bank=bank), config(), encoder)


def test_text_tokens_are_dropped_in_training_alone(settings, config, encoder, swings):
    """Of all tokens about as many as asked for; sentence vectors stay, and noise and steps are those without it."""
    from bunraku.generation.features import FeatureStatistics
    from bunraku_lab.nn.text import tensors_of
    from bunraku_lab.training.rows.clip_rows import ClipSet
    from bunraku_lab.training.rows.clips import load_clips

    found = load_clips(swings)
    statistics = FeatureStatistics.measure([entry["features"] for entry in found.values()])
    batch = ClipSet(found, statistics, frames=60).batch(0, 0, 64)
    text = tensors_of(encoder.encode(batch.sentences))
    plain, dropping = (Trainer(settings(drop_tokens=share), config(), statistics) for share in (0.0, 0.3))
    whole, less = (trainer.example(batch, text, [0, 1]) for trainer in (plain, dropping))
    assert torch.equal(whole.text.mask, text.mask) and torch.equal(whole.text.pooled, less.text.pooled)
    assert torch.equal(whole.noise, less.noise) and torch.equal(whole.keep_text, less.keep_text)
    assert not (less.text.mask & ~text.mask).any()
    assert 0.6 < float(less.text.mask.sum() / text.mask.sum()) < 0.8
    assert torch.equal(dropping.example(batch, text, [0, 1], train=False).text.mask, text.mask)


def test_training_learns(settings, config, encoder):
    """The motion loss of the four motions falls well below that of the mean pose, which is about their variance."""

    path = train_diffusion(
        settings(steps=90, batch=8, learning_rate=6e-3, warmup=5, bf16=False, validate_every=30, compose=0.0),
        config(),
        encoder,
    )
    with (path.parent / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows] == ["20", "30", "60", "90"]
    assert float(rows[-1]["motion"]) < 0.6 * float(rows[0]["motion"])


def test_wrong_settings_are_clear(settings, config, encoder, tmp_path):
    for how, words in {
        "preset": ("huge", "unknown"),
        "batch": (0, "positive"),
        "steps": (-1, "positive"),
        "minutes": (-5.0, "positive"),
    }.items():
        with pytest.raises(OptionError, match=words[1]):
            train_diffusion(settings(**{how: words[0]}), config(), encoder)
    with pytest.raises(FormatError, match="bunraku data motions"):
        train_diffusion(settings(data=tmp_path / "nowhere"), config(), encoder)
    train_diffusion(settings(steps=1), config(), encoder)
    with pytest.raises(OptionError, match="another network"):
        train_diffusion(settings(steps=1), config(width=32), encoder)


def test_curves_for_tensorboard(settings, config, encoder, tmp_path):
    events = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    train_diffusion(settings(steps=4, validate_every=2), config(), encoder)
    found = events.EventAccumulator(str(tmp_path / "run" / "events")).Reload()
    assert {"motion", "velocity", "rate", "validation", "steps_per_second"} <= set(found.Tags()["scalars"])
    assert [event.step for event in found.Scalars("motion")] == [2, 4]


def test_without_tensorboard_one_line_says_so(settings, config, encoder, tmp_path, monkeypatch, capsys):

    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    train_diffusion(settings(steps=1), config(), encoder)
    assert capsys.readouterr().out.replace("\n", " ").count("no TensorBoard curves") == 1
    assert not (tmp_path / "run" / "events").exists()


TINY = DenoiserConfig(
    width=32, layers=2, heads=2, feedforward=48, frames=24, frames_per_token=4, text_size=8, pooled_size=8
)


def denoiser(config=TINY, seed=0):
    torch.manual_seed(seed)
    model = Denoiser(config).eval()
    with torch.no_grad():
        for value in model.parameters():
            value.add_(0.05 * torch.randn_like(value))
        model.mean.copy_(torch.randn(config.features))
        model.std.copy_(torch.rand(config.features) + 0.5)
    return model


def predict(model, values):
    """Clean motion in plain units, in and out."""
    yes = torch.ones(len(values), dtype=torch.bool)
    condition = model.condition(None, None, None, None, ~yes, ~yes)
    lengths = torch.full((len(values),), values.shape[1])
    with torch.no_grad():
        out, _ = model((values - model.mean) / model.std, torch.full((len(values),), 300), lengths, condition)
    return out * model.std + model.mean


def test_other_units_same_motion():
    old, new = denoiser(), denoiser(seed=1)
    values = torch.randn(2, 16, TINY.features)
    expected = predict(old, values)
    assert not torch.allclose(predict(new, values), expected, atol=0.1)
    new.load_state_dict(rescaled(old, new.mean, new.std))
    torch.testing.assert_close(predict(new, values), expected, atol=2e-4, rtol=1e-4)


def test_start_from_a_checkpoint(tmp_path):
    old, new = denoiser(), denoiser(replace(TINY, adaptation_mesh=True), seed=1)
    path = save_denoiser(tmp_path / "old.safetensors", old, half=False)
    head = new.adaptation_out.weight.clone()
    mean = new.mean.clone()
    start_from(path, new)
    values = torch.randn(1, 16, TINY.features)
    torch.testing.assert_close(predict(new, values), predict(old, values), atol=2e-4, rtol=1e-4)
    assert torch.equal(new.adaptation_out.weight, head) and torch.equal(new.mean, mean)


def test_another_network_is_refused(tmp_path):
    path = save_denoiser(tmp_path / "old.safetensors", denoiser())
    with pytest.raises(OptionError, match="whose width differ"):
        start_from(path, denoiser(replace(TINY, width=48)))
    with pytest.raises(OptionError, match="pooled_size differ"):
        start_from(path, denoiser(replace(TINY, pooled_size=8 + 30)))
