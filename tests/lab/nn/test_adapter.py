"""The adaptation's last layer in a file of its own."""

from dataclasses import replace

import pytest
import torch

from bunraku.diffusion.denoiser_config import DenoiserConfig
from bunraku.errors import WeightsError
from bunraku_lab.nn.diffusion.adapter import adapted_denoiser, frozen_digest, save_adapter
from bunraku_lab.nn.diffusion.checkpoint import load_denoiser, save_denoiser
from bunraku_lab.nn.diffusion.denoiser import Denoiser

SMALL = DenoiserConfig(width=16, heads=2, layers=1)


def test_a_layer_comes_back_on_the_weights_that_it_is_of(tmp_path):
    """Also where it sees the mesh, which the weights' own layer does not, so that it is wider."""
    torch.manual_seed(0)
    plain = Denoiser(SMALL)
    path = save_denoiser(tmp_path / "plain.safetensors", plain)
    learned = Denoiser(replace(SMALL, adaptation_mesh=True, adaptation_frame="joints"))
    kept = {name: value for name, value in load_denoiser(path).state_dict().items() if "adaptation_out" not in name}
    learned.load_state_dict(kept, strict=False)
    with torch.no_grad():
        learned.adaptation_out.weight.fill_(0.25)
    assert frozen_digest(learned) == frozen_digest(load_denoiser(path))
    layer = save_adapter(tmp_path / "layer.safetensors", learned, {"steps": 3})
    assert layer.stat().st_size < path.stat().st_size / 2
    found = load_denoiser(adapted_denoiser(layer, path, tmp_path / "out.safetensors"))
    assert found.config == learned.config and found.notes["adaptation"] == {"steps": 3}
    for name, value in learned.state_dict().items():
        assert torch.equal(found.state_dict()[name], value), name


def test_a_layer_of_other_weights_is_refused(tmp_path):
    torch.manual_seed(0)
    layer = save_adapter(tmp_path / "layer.safetensors", Denoiser(SMALL), {})
    other = save_denoiser(tmp_path / "other.safetensors", Denoiser(SMALL))
    with pytest.raises(WeightsError, match="other weights"):
        adapted_denoiser(layer, other, tmp_path / "out.safetensors")
