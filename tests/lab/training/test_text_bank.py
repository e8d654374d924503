"""Sentences of a run are the same numbers in each of its sittings."""

import torch

from bunraku.language.encoders import MiniLMEncoder
from bunraku_lab.training.rows.text_bank import TextBank


def test_what_is_kept_is_what_the_first_sitting_learned_from(tmp_path):
    sentences = ["a person walks", "a person waves", "somebody jumps over the fence and laughs"]
    first = TextBank(MiniLMEncoder(), sentences, tmp_path / "captions.safetensors")
    second = TextBank(MiniLMEncoder(), sentences, tmp_path / "captions.safetensors")
    ours, theirs = first(sentences), second(sentences)
    assert torch.equal(ours.tokens, theirs.tokens) and torch.equal(ours.mask, theirs.mask)
    assert torch.equal(ours.pooled, theirs.pooled)


def test_what_is_not_kept_does_not_depend_on_what_was_asked_for_before():
    bank, later = TextBank(MiniLMEncoder(), ["jumps"]), TextBank(MiniLMEncoder(), ["jumps"])
    later(["a person turns around twice and then sits down on the floor"])
    together = bank(["a person turns around twice and then sits down on the floor", "kicks", "jumps"])
    apart = later(["kicks"])
    assert torch.equal(together.tokens[1][together.mask[1]], apart.tokens[0][apart.mask[0]])
    assert torch.equal(together.pooled[1], apart.pooled[0])
