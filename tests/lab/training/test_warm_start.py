from dataclasses import replace

import pytest
import torch

from bunraku.diffusion.denoiser_config import DenoiserConfig
from bunraku.errors import OptionError
from bunraku_lab.nn.diffusion.checkpoint import save_denoiser
from bunraku_lab.nn.diffusion.denoiser import Denoiser
from bunraku_lab.training.diffusion.warm_start import rescaled, start_from

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


def test_attention_to_examples_starts_without_effect(tmp_path):
    """A network with examples begins as the one that it starts from."""
    old, new = denoiser(), Denoiser(replace(TINY, examples=2)).eval()
    new.mean.copy_(old.mean)
    new.std.copy_(old.std)
    start_from(save_denoiser(tmp_path / "old.safetensors", old, half=False), new)
    new.adaptation_out.load_state_dict(old.adaptation_out.state_dict())
    values = torch.randn(2, 16, TINY.features)
    torch.testing.assert_close(predict(new, values), predict(old, values), atol=1e-6, rtol=1e-5)
    assert new.example_in.weight.shape == (32, 2 * 4 * TINY.features)
