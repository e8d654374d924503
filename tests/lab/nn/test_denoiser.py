import pytest
import torch

from bunraku.diffusion.denoiser_config import PRESETS
from bunraku.errors import WeightsError
from bunraku_lab.nn.diffusion.checkpoint import load_denoiser, save_denoiser

FEATURES = 6


@pytest.fixture
def model(denoiser):
    return denoiser(features=FEATURES, handles=3)


@pytest.fixture
def ask(model, encoder):
    def ask(x, step, lengths, sentences, mesh=None, keep=True):
        text = encoder.encode(sentences)
        kept = torch.full((len(x),), keep)
        condition = model.condition(
            text.tokens, text.mask, text.pooled, mesh, kept, torch.full((len(x),), mesh is not None)
        )
        return model(x, torch.tensor(step), torch.tensor(lengths), condition)

    return ask


def noise(*shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(1))


def test_shapes_and_padding_does_not_reach_real_frames(ask):
    x = noise(1, 30, FEATURES)
    motion, adaptation = ask(x, [500], [18], ["walks forward"])
    assert motion.shape == (1, 30, FEATURES) and adaptation.shape == (1, 30, 3, 3)
    other = x.clone()
    other[:, 18:] = 100
    torch.testing.assert_close(ask(other, [500], [18], ["walks forward"])[0][:, :18], motion[:, :18])
    torch.testing.assert_close(ask(x[:, :18], [500], [18], ["walks forward"])[0], motion[:, :18], atol=1e-5, rtol=1e-4)


def test_each_condition_changes_the_answer(ask):
    x, mesh = noise(1, 20, FEATURES), noise(1, 12)
    base = ask(x, [300], [20], ["walks"])
    others = [
        ask(x, [700], [20], ["walks"]), ask(x, [300], [20], ["runs"]), ask(x, [300], [20], ["walks"], mesh),
        ask(x, [300], [20], ["walks"], keep=False), ask(x + 0.1, [300], [20], ["walks"]),
    ]  # fmt: skip
    for other in others:
        assert (other[0] - base[0]).abs().max() > 1e-3 and (other[1] - base[1]).abs().max() > 1e-4


def test_a_dropped_sentence_says_nothing(ask):
    x = noise(1, 20, FEATURES)
    torch.testing.assert_close(
        ask(x, [300], [20], ["walks"], keep=False), ask(x, [300], [20], ["jumps over a wall"], keep=False)
    )


def test_a_batch_is_its_rows_alone(ask):
    x = noise(2, 24, FEATURES)
    both = ask(x, [10, 900], [24, 13], ["walks", "jumps up and down"])
    first = ask(x[:1], [10], [24], ["walks"])
    second = ask(x[1:, :13], [900], [13], ["jumps up and down"])
    for index in range(2):
        torch.testing.assert_close(both[index][:1], first[index], atol=1e-5, rtol=1e-4)
        torch.testing.assert_close(both[index][1:, :13], second[index], atol=1e-5, rtol=1e-4)


def test_attention_written_out_for_training_agrees_with_torchs(model, encoder):
    text = encoder.encode(["walks", "jumps up"])
    yes = torch.ones(2, dtype=torch.bool)
    arguments = (noise(2, 20, FEATURES), torch.tensor([3, 800]), torch.tensor([20, 9]))
    answers = []
    for training in (True, False):
        with torch.set_grad_enabled(training):
            answers.append(model(*arguments, model.condition(text.tokens, text.mask, text.pooled, None, yes, ~yes))[0])
    torch.testing.assert_close(answers[0][0], answers[1][0], atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(answers[0][1, :9], answers[1][1, :9], atol=1e-5, rtol=1e-4)


def test_a_new_model_neither_adapts_nor_explodes(config):
    from bunraku_lab.nn.diffusion.denoiser import Denoiser

    model = Denoiser(config(features=FEATURES))
    no = torch.zeros(1, dtype=torch.bool)
    motion, adaptation = model(
        noise(1, 20, FEATURES), torch.tensor([500]), torch.tensor([20]), model.condition(None, None, None, None, no, no)
    )
    assert motion.abs().max() < 1 and not adaptation.any()
    assert (
        PRESETS["paper"].width == 512
        and PRESETS["paper"].layers == 8
        and PRESETS["paper"].heads == 4
        and PRESETS["paper"].frames == 196
    )


def test_a_checkpoint_builds_its_own_network(model, tmp_path):
    path = save_denoiser(tmp_path / "d.safetensors", model, {"steps": 3, "characters": 5}, half=False)
    back = load_denoiser(path)
    assert back.config == model.config and back.notes["steps"] == 3 and back.knows_meshes and not model.knows_meshes
    assert all(torch.equal(value, back.state_dict()[name]) for name, value in model.state_dict().items())


def test_a_checkpoint_of_another_network_is_one_clear_error(model, tmp_path):
    from dataclasses import asdict

    from bunraku.nn.checkpoints import save_checkpoint

    for name, config in {"wide": asdict(model.config) | {"width": 32}, "odd": {"nonsense": 1}, "none": {}}.items():
        save_checkpoint(tmp_path / f"{name}.safetensors", model.state_dict(), config, "diffusion")
        with pytest.raises(WeightsError, match=f"{name}.*disagree"):
            load_denoiser(tmp_path / f"{name}.safetensors")
