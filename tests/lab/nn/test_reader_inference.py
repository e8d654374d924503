"""The reader of sentences: numpy against torch, and what is read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bunraku.core.nn.checkpoints import save_checkpoint
from bunraku.errors import WeightsError
from bunraku_lab.nn.reader_inference import KIND, Reader, dequantised, load_reader, plain_words, quantised

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


def test_steps_are_as_near_as_they_can_be() -> None:
    matrix = np.random.default_rng(0).normal(size=(40, 7)).astype(np.float32)
    steps, scale = quantised(matrix)
    again = dequantised({"a": steps, "a.scale": scale})["a"]
    assert np.all(np.abs(again - matrix) <= 0.5001 * scale)


def test_numpy_says_what_torch_says() -> None:
    torch = pytest.importorskip("torch")
    from bunraku_lab.training.reader import ReaderNetwork, packed

    torch.manual_seed(0)
    network = ReaderNetwork(len(ACTIONS)).eval()
    torch.nn.init.normal_(network.query.weight, std=0.1)
    weights = dequantised(packed(network))
    network.load_state_dict({
        name: torch.tensor(value.T if value.ndim == 2 else value) for name, value in weights.items()
    })  # fmt: skip
    hidden = np.random.default_rng(1).normal(size=(9, 384)).astype(np.float32)
    logits, weight, fields = Reader(ACTIONS, weights).run(hidden)
    with torch.no_grad():
        meant, attention, tokens = network(torch.tensor(hidden)[None])
        values = network.fields(torch.einsum("la,lc->ac", attention[0], tokens[0]))
    for own, other in ((logits, meant[0]), (weight, attention[0]), (fields, values)):
        np.testing.assert_allclose(own, other.numpy(), atol=1e-4)


def test_a_sentence_is_read_in_order(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from bunraku_lab.training.reader import ReaderNetwork, packed

    state = packed(ReaderNetwork(len(ACTIONS)))
    state["value.bias"] = np.array([9.0, -9.0, 9.0], np.float32)
    path = save_checkpoint(tmp_path / "reader.safetensors", state, {"actions": ACTIONS, "temperature": 2.0}, KIND)
    reader = load_reader(path)
    found = reader.read("she waves, then walks")
    assert {frame.action for frame in found} == {"walk", "wave"}
    assert [frame.at for frame in found] == sorted(frame.at for frame in found)
    assert not reader.read("") and not reader.read("she walks", least=1.0)


def test_a_checkpoint_of_other_actions_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from bunraku_lab.training.reader import ReaderNetwork, packed

    state = packed(ReaderNetwork(2))
    path = save_checkpoint(tmp_path / "reader.safetensors", state, {"actions": ACTIONS, "temperature": 1.0}, KIND)
    with pytest.raises(WeightsError, match="reader.safetensors"):
        load_reader(path)
