"""The denoiser: layers, noise, files, and the adapter."""

from dataclasses import replace

import pytest
import torch

from bunraku.errors import WeightsError
from bunraku.generation.denoiser import PRESETS, DenoiserConfig
from bunraku.generation.sampler import generator
from bunraku_lab.nn.denoiser import (
    Denoiser,
    RetrievedExamples,
    adapted_denoiser,
    frozen_digest,
    load_denoiser,
    save_adapter,
    save_denoiser,
)

FEATURES = 6


def layer_noise(*shape, seed=1):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def examples(rows, lengths=(30, 12)):
    return RetrievedExamples(
        layer_noise(rows, len(lengths), max(lengths), FEATURES, seed=2),
        torch.tensor([lengths] * rows),
        layer_noise(rows, len(lengths), 8, seed=3),
    )


def ask_layers(model, encoder, x, lengths, keep=True, found=None):
    text = encoder.encode(["walks"] * len(x))
    kept = torch.full((len(x),), keep)
    condition = model.condition(text.tokens, text.mask, text.pooled, None, kept, ~torch.ones_like(kept), found)
    return model(x, torch.full((len(x),), 400), torch.tensor(lengths), condition)[0]


def test_attention_to_examples_begins_without_effect(denoiser, encoder):
    """A network that gets it says the very same, to the bit, as the one whose weights it takes over."""
    old = denoiser(features=FEATURES, handles=3)
    new = Denoiser(denoiser(features=FEATURES, handles=3, examples=2).config).eval()
    missing, unexpected = new.load_state_dict(old.state_dict(), strict=False)
    assert missing and not unexpected
    x = layer_noise(2, 30, FEATURES)
    with torch.no_grad():
        assert torch.equal(
            ask_layers(new, encoder, x, [30, 17], found=examples(2)), ask_layers(old, encoder, x, [30, 17])
        )


def test_what_lies_behind_an_example_and_who_has_none(denoiser, encoder):
    model = denoiser(features=FEATURES, handles=3, examples=2)
    x, found = layer_noise(1, 24, FEATURES), examples(1)
    base = ask_layers(model, encoder, x, [24], found=found)
    changed = RetrievedExamples(found.values.clone(), found.lengths, found.pooled)
    changed.values[:, 1, 12:] = 50
    torch.testing.assert_close(ask_layers(model, encoder, x, [24], found=changed), base)
    changed.values[:, 1, 5] = 50
    assert (ask_layers(model, encoder, x, [24], found=changed) - base).abs().max() > 1e-3
    none = ask_layers(model, encoder, x, [24])
    assert (none - base).abs().max() > 1e-3
    empty = RetrievedExamples(found.values, torch.zeros_like(found.lengths), found.pooled)
    torch.testing.assert_close(ask_layers(model, encoder, x, [24], found=empty), none)


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
    from bunraku_lab.nn.denoiser import Denoiser

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

    from bunraku.core.nn.checkpoints import save_checkpoint

    for name, config in {"wide": asdict(model.config) | {"width": 32}, "odd": {"nonsense": 1}, "none": {}}.items():
        save_checkpoint(tmp_path / f"{name}.safetensors", model.state_dict(), config, "diffusion")
        with pytest.raises(WeightsError, match=f"{name}.*disagree"):
            load_denoiser(tmp_path / f"{name}.safetensors")


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


def test_noise_by_seed_is_what_torch_draws():
    for shape in ((3, 271), (120, 271), (7, 5), (4, 4)):
        for seed, row in ((0, 0), (7, 3), (2**40 + 5, 1), (-3, 2)):
            ours = generator(seed, row)
            theirs = torch.Generator().manual_seed((seed + row * 0x9E3779B97F4A7C15) % 2**63)
            for _ in range(2):
                torch.testing.assert_close(
                    torch.from_numpy(ours.draw(*shape)), torch.randn(*shape, generator=theirs), atol=2e-6, rtol=0
                )
