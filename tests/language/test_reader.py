"""The reader of clauses: numpy against torch, and what is read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bunraku.core.nn.checkpoints import save_checkpoint
from bunraku.errors import WeightsError
from bunraku.gestures.catalogue import things_file
from bunraku.gestures.interactions import read_terrain_gaits
from bunraku.language.encoders import MiniLMEncoder
from bunraku.language.interactions import interaction_of
from bunraku.language.lexicon import lexicon
from bunraku.language.parse import parse
from bunraku.language.prompts import plain_words
from bunraku.language.reader import KIND, Reader, dequantised, frames_of, load_reader

ACTIONS = ("walk", "jump", "wave")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("Walk_BackL45", "Walk Back L 45"), ("HTTPRun", "HTTP Run"), ("Armature|Idle-Loop", "Armature Idle Loop"),
        ("a person walks, then jumps", "a person walks, then jumps"), ("  ", ""),
    ],
)  # fmt: skip
def test_names_of_clips_become_words(given: str, words: str) -> None:
    assert plain_words(given) == words


def test_numpy_says_what_torch_says() -> None:
    torch = pytest.importorskip("torch")
    from bunraku_lab.training.reader import ReaderNetwork, packed

    torch.manual_seed(0)
    encoder = MiniLMEncoder()
    network = ReaderNetwork(len(ACTIONS), encoder, rank=3).eval()
    for name, weight in network.named_parameters():
        if name.endswith(".up") or name in ("query.weight", "where.weight"):
            torch.nn.init.normal_(weight, std=0.05)
    weights = dequantised(packed(network))
    network.load_state_dict({
        name: torch.tensor(value.T if value.ndim == 2 else value) for name, value in weights.items()
    })  # fmt: skip
    x = encoder.embedded(encoder.numbers("a person walks to a xylophone"))
    logits, weight, fields = Reader(ACTIONS, weights, encoder=encoder).run(x)
    with torch.no_grad():
        meant, attention, where, tokens = network(torch.tensor(x)[None])
        values = network.fields(torch.einsum("la,lc->ac", where[0], tokens[0]))
    for own, other in ((logits, meant[0]), (weight, attention[0]), (fields, values)):
        np.testing.assert_allclose(own, other.numpy(), atol=1e-3)


def test_a_checkpoint_of_other_actions_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from bunraku_lab.training.reader import ReaderNetwork, packed

    state = packed(ReaderNetwork(2, MiniLMEncoder(), rank=2))
    config = {"actions": ACTIONS, "dealings": [], "shares": [1.0, 0.0, 0.0, 0.0], "together": {}}
    path = save_checkpoint(tmp_path / "reader.safetensors", state, config, KIND)
    with pytest.raises(WeightsError, match="reader.safetensors"):
        load_reader(path)


def test_every_action_is_one_of_the_lexicon_and_every_deed_and_ground_is_made() -> None:
    reader = load_reader()
    named: dict[str, set[str]] = {"deed": set(), "ground": set(), "sight": set()}
    for dealing in reader.dealings:
        kind, _, name = dealing.partition(" ")
        if name:
            named[kind].add(name)
    assert named["deed"] == set(things_file()["deeds"]) and named["ground"] == set(read_terrain_gaits())
    assert lexicon().actions.keys() >= {*reader.actions}


@pytest.mark.parametrize(
    ("prompt", "actions"),
    [
        ("a person waves with both hands", ("wave both",)), ("rifle idle to crouch", ("idle", "crouch idle")),
        ("front flip to kick", ("flip", "kick")), ("is doing left arm circles", ("arm circle",)),
    ],
)  # fmt: skip
def test_nothing_is_dropped_without_a_word(prompt: str, actions: tuple[str, ...]) -> None:
    sentence = parse(prompt)
    single = [part for clause in sentence.clauses for part in clause.parts or (clause,)]
    assert tuple(frame.action for clause in single for frame in clause.frames) == actions


def test_an_action_that_the_network_never_learned_is_found_by_its_phrases(monkeypatch: pytest.MonkeyPatch) -> None:
    learned = load_reader()
    fewer = replace(learned, actions=tuple("handle" if name == "touch" else name for name in learned.actions))
    monkeypatch.setattr("bunraku.language.reader.load_reader", lambda: fewer)
    (frame,) = frames_of.__wrapped__("a person taps the temple")
    assert frame.action == "touch" and interaction_of.__wrapped__("a person taps the temple") is None


def test_all_of_a_long_sentence_is_read() -> None:
    walk = "walks along the road with a heavy bag on the back and a hat on the head"
    frames = frames_of(f"a person {walk} while {walk}, then sits down on a bench, then waves to a friend")
    assert [frame.action for frame in frames][-2:] == ["sit", "wave"]
