import torch

from bunraku_lab.nn.diffusion.checkpoint import load_denoiser, save_denoiser
from bunraku_lab.nn.diffusion.denoiser import Denoiser
from bunraku_lab.nn.diffusion.denoiser_layers import RetrievedExamples

FEATURES = 6


def noise(*shape, seed=1):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def examples(rows, lengths=(30, 12)):
    return RetrievedExamples(
        noise(rows, len(lengths), max(lengths), FEATURES, seed=2),
        torch.tensor([lengths] * rows),
        noise(rows, len(lengths), 8, seed=3),
    )


def ask(model, encoder, x, lengths, keep=True, found=None):
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
    x = noise(2, 30, FEATURES)
    with torch.no_grad():
        assert torch.equal(ask(new, encoder, x, [30, 17], found=examples(2)), ask(old, encoder, x, [30, 17]))


def test_padding_does_not_reach_real_frames(denoiser, encoder):
    model = denoiser(features=FEATURES, handles=3, examples=2)
    x = noise(1, 40, FEATURES)
    alone, padded = ask(model, encoder, x[:, :20], [20]), ask(model, encoder, x, [20])
    torch.testing.assert_close(padded[:, :20], alone, atol=1e-5, rtol=1e-4)


def test_what_lies_behind_an_example_and_who_has_none(denoiser, encoder):
    model = denoiser(features=FEATURES, handles=3, examples=2)
    x, found = noise(1, 24, FEATURES), examples(1)
    base = ask(model, encoder, x, [24], found=found)
    changed = RetrievedExamples(found.values.clone(), found.lengths, found.pooled)
    changed.values[:, 1, 12:] = 50
    torch.testing.assert_close(ask(model, encoder, x, [24], found=changed), base)
    changed.values[:, 1, 5] = 50
    assert (ask(model, encoder, x, [24], found=changed) - base).abs().max() > 1e-3
    none = ask(model, encoder, x, [24])
    assert (none - base).abs().max() > 1e-3
    empty = RetrievedExamples(found.values, torch.zeros_like(found.lengths), found.pooled)
    torch.testing.assert_close(ask(model, encoder, x, [24], found=empty), none)


def test_who_drops_the_sentence_drops_its_examples(denoiser, encoder):
    model = denoiser(features=FEATURES, handles=3, examples=2)
    x = noise(1, 24, FEATURES)
    torch.testing.assert_close(
        ask(model, encoder, x, [24], keep=False, found=examples(1)), ask(model, encoder, x, [24], keep=False)
    )


def test_a_checkpoint_keeps_its_attention_to_examples(denoiser, encoder, tmp_path):
    model = denoiser(features=FEATURES, handles=3, examples=2)
    other = load_denoiser(save_denoiser(tmp_path / "own.safetensors", model, half=False))
    x, found = noise(1, 24, FEATURES), examples(1)
    torch.testing.assert_close(ask(other, encoder, x, [24], found=found), ask(model, encoder, x, [24], found=found))
