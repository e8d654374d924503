from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from bunraku.diffusion.denoiser_config import PRESETS
from bunraku.diffusion.sampling.sampler import Solver, sample
from bunraku_lab.nn.diffusion.checkpoint import build_denoiser, load_denoiser, save_denoiser
from bunraku_lab.nn.diffusion.denoiser import Denoiser
from bunraku_lab.nn.diffusion.mdm_denoiser import EncoderDenoiser
from bunraku_lab.nn.running.networks import running_denoiser


@pytest.fixture
def model(config):
    torch.manual_seed(0)
    made = EncoderDenoiser(replace(config(), architecture="encoder")).eval().requires_grad_(False)
    for value in made.parameters():
        value.copy_(torch.randn(value.shape) * (0.3 if value.ndim < 2 else value.shape[-1] ** -0.5))
    return made


def condition(model, encoder, sentences, mesh=None, keep=True):
    text = encoder.encode(sentences)
    rows = torch.full((len(sentences),), keep)
    return model.condition(text.tokens, text.mask, text.pooled, mesh, rows, torch.full_like(rows, mesh is not None))


def test_it_has_about_as_many_parameters():
    ours, mdm = (
        sum(value.numel() for value in kind(PRESETS["small"]).parameters()) for kind in (Denoiser, EncoderDenoiser)
    )
    assert 0.9 < mdm / ours < 1.05


def test_one_token_stands_for_the_sentence(model, encoder):
    memory, mask, _ = condition(model, encoder, ["walk", "walk far away and back"])
    assert memory.shape == (2, 1, 16) and mask.shape == (2, 1, 1, 1) and bool(mask.all())


def test_sentence_step_and_mesh_all_matter_and_word_order_does_not(model, encoder):
    torch.manual_seed(1)
    x, step, lengths = torch.randn(1, 30, 271), torch.tensor([500]), torch.tensor([30])

    def run(sentence, at=step, mesh=None, keep=True):
        return model(x, at, lengths, condition(model, encoder, [sentence], mesh, keep))[0]

    first = run("turn left then right")
    assert not torch.allclose(first, run("jump"), atol=1e-3)
    assert not torch.allclose(first, run("turn left then right", torch.tensor([10])), atol=1e-3)
    assert not torch.allclose(first, run("turn left then right", mesh=torch.randn(1, 12)), atol=1e-3)
    assert torch.allclose(run("walk", keep=False), run("jump", keep=False))
    assert torch.allclose(
        first, run("turn right then left"), atol=1e-4
    )  # a bag of words here: only the pooled vector is seen


def test_padding_does_not_matter(model, encoder):
    torch.manual_seed(1)
    x, given = torch.randn(1, 22, 271), condition(model, encoder, ["walk"])
    alone = model(x, torch.tensor([300]), torch.tensor([22]), given)[0]
    padded = torch.cat([x, torch.randn(1, 20, 271)], 1)
    assert torch.allclose(model(padded, torch.tensor([300]), torch.tensor([22]), given)[0][:, :22], alone, atol=1e-4)


def test_training_and_sampling_see_the_same_network(model, encoder):
    torch.manual_seed(1)
    x, given = torch.randn(2, 30, 271), condition(model, encoder, ["walk", "jump"])
    lengths, step = torch.tensor([30, 17]), torch.tensor([3, 900])
    with torch.enable_grad():
        train = model(x, step, lengths, given)[0]
    with torch.no_grad():
        assert torch.allclose(model(x, step, lengths, given)[0][0], train[0], atol=1e-4)


def test_it_is_saved_built_and_sampled_like_the_other(model, encoder, tmp_path):
    path = save_denoiser(tmp_path / "mdm.safetensors", model, {"steps": 5}, half=False)
    again = load_denoiser(path)
    assert isinstance(again, EncoderDenoiser) and isinstance(build_denoiser(model.config), EncoderDenoiser)
    text = encoder.encode(["walk", "jump up"]).arrays()
    first, second = (sample(running_denoiser(one), text, 40, Solver(3), seed=4) for one in (model, again))
    assert first.values.shape == (2, 40, 271) and first.adaptation.shape == (2, 40, 30, 3)
    np.testing.assert_allclose(first.values, second.values, atol=1e-4)


def test_the_weights_to_compare_with_are_of_this_kind():
    path = Path(__file__).parents[3] / "benchmarks/weights/mdm.safetensors"
    if not path.is_file():
        pytest.skip("the weights of benchmarks are not in this checkout")
    model = load_denoiser(path)
    assert isinstance(model, EncoderDenoiser)
    assert (model.notes["preset"], model.notes["steps"]) == ("mdm", 5000)
