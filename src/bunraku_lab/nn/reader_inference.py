"""A sentence as frames, read by a small network: which actions it names, in which order, and what it says of each.

The network is the text encoder up to `DEPTH`, two layers of its kind that were trained on phrases of each action, and
for each action an attention over the tokens (Ilse et al. 2018). What is attended to says whether the action is
named, where, and with which side, direction, turn, count, speed and posture.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bunraku.core.nn.checkpoints import dated, fitting_config, load_checkpoint
from bunraku.core.nn.layers import Linear, Norm, PostNorm, sigmoid, softmax
from bunraku.errors import WeightsError
from bunraku.language.encoders import MiniLMEncoder, text_encoder
from bunraku_lab.nn.checkpoints import lab_checkpoint

__all__ = ["DEPTH", "FIELDS", "KIND", "Frame", "Reader", "dequantised", "load_reader", "plain_words", "quantised"]

KIND = "reader"
DEPTH = 4
"""Layers of the text encoder that are taken as they are; the reader has its own behind them."""
FIELDS: dict[str, tuple[str, ...]] = {
    "side": ("left", "right", "both"),
    "direction": (
        "forward", "backward", "left", "right", "forward-left", "forward-right", "backward-left", "backward-right",
        "up", "down", "circle",
    ),
    "turn side": ("left", "right", "?"),
    "degrees": ("45", "90", "135", "180", "360", "?"),
    "count": ("1", "2", "3", "4", "5", "6", "7", "8", "9", "10"),
    "speed": ("slow", "fast"),
    "posture": ("sitting", "kneeling", "lying", "crouching", "all fours", "hanging"),
}  # fmt: skip
"""What is said of an action, each beside "nothing", which comes first."""
_STEPS = 127


class Frame(NamedTuple):
    """An action that a sentence names.

    Args:
        action: Its name.
        probability: That it is named, 0 to 1.
        at: Where, in tokens.
        fields: What is said of it, by the names of `FIELDS`; nothing unsaid.
    """

    action: str
    probability: float
    at: float
    fields: dict[str, str]


def plain_words(text: str) -> str:
    """A sentence or the name of a clip with a space between all words: "Walk_BackL45" is "Walk Back L 45"."""
    out: list[str] = []
    for at, letter in enumerate(text):
        before, after = text[at - 1 : at], text[at + 1 : at + 2]
        joined = (
            (letter.isupper() and (before.islower() or (before.isupper() and after.islower())))
            or (letter.isdigit() and before.isalpha())
            or (letter.isalpha() and before.isdigit())
        )  # fmt: skip
        out.append(" " + letter if joined else " " if letter in "_-|/\\@()[]" else letter)
    return " ".join("".join(out).split())


def quantised(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A matrix in steps, int8, and the size of the steps of each column, float32."""
    scale = np.maximum(np.abs(matrix).max(0), 1e-12) / _STEPS
    return np.round(matrix / scale).astype(np.int8), scale.astype(np.float32)


def dequantised(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """All arrays of a checkpoint as float32: those of `quantised` have the sizes of their steps beside them."""
    found = {}
    for name in (name for name in state if not name.endswith(".scale")):
        found[name] = state[name].astype(np.float32)
        if state[name].dtype == np.int8:
            found[name] *= state[f"{name}.scale"]
    return found


@dataclass(frozen=True)
class Reader:
    """The network, for inference.

    Args:
        actions: Their names, in the order of the heads.
        weights: Of layers "layers.0.query.weight" and so on, matrices (in, out), and of the heads.
        heads: Of attention in a layer.
        temperature: Divides what the action heads say, so that probabilities are calibrated.
        epsilon: Of the layers' norms.
        encoder: Gives the tokens.
    """

    actions: tuple[str, ...]
    weights: Mapping[str, np.ndarray]
    heads: int = 12
    temperature: float = 1.0
    epsilon: float = 1e-12
    encoder: MiniLMEncoder = field(default_factory=lambda: _encoder())

    def _linear(self, name: str) -> Linear:
        return Linear(self.weights[f"{name}.weight"], self.weights[f"{name}.bias"])

    def _norm(self, name: str) -> Norm:
        return Norm(self.weights[f"{name}.weight"], self.weights[f"{name}.bias"], self.epsilon)

    def layers(self) -> list[PostNorm]:
        """The layers behind those of the encoder."""
        count = len({name.split(".")[1] for name in self.weights if name.startswith("layers.")})
        found = []
        for name in (f"layers.{index}" for index in range(count)):
            query, key, value, leave, wide, narrow = (
                self._linear(f"{name}.{part}") for part in ("query", "key", "value", "leave", "wide", "narrow")
            )
            norm_a, norm_b = self._norm(f"{name}.norm_a"), self._norm(f"{name}.norm_b")
            found.append(PostNorm(query, key, value, leave, self.heads, norm_a, wide, narrow, norm_b))
        return found

    def run(self, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the heads say.

        Args:
            hidden: Tokens behind `DEPTH` layers of the encoder, shape (L, 384).

        Returns:
            For each action: before the logistic function, shape (A,); the attention to each token, shape (L, A); and
            its fields, shape (A, F), of each field "nothing" and then its values.
        """
        x = hidden[None]
        for layer in self.layers():
            x = layer(x)
        said, weight = self._linear("value")(x[0]), softmax(self._linear("query")(x[0]).T).T
        return (weight * said).sum(0), weight, self._linear("fields")(weight.T @ x[0])

    def read(self, sentence: str, least: float = 0.5) -> list[Frame]:
        """The actions that a sentence names, in order.

        Args:
            sentence: A prompt in English or the name of a clip.
            least: The probability from which an action counts.
        """
        text = plain_words(sentence)
        if not text:
            return []
        logits, weight, fields = self.run(self.encoder.hidden(text, DEPTH))
        sure = sigmoid(logits / self.temperature)
        found = [
            Frame(self.actions[index], float(sure[index]), float(weight[:, index] @ np.arange(len(weight))),
                  _fields(fields[index]))
            for index in np.flatnonzero(sure >= least)
        ]  # fmt: skip
        return sorted(found, key=lambda frame: frame.at)


def _fields(said: np.ndarray) -> dict[str, str]:
    found, start = {}, 0
    for name, values in FIELDS.items():
        best = int(said[start : start + 1 + len(values)].argmax())
        if best:
            found[name] = values[best - 1]
        start += 1 + len(values)
    return found


def _encoder() -> MiniLMEncoder:
    encoder = text_encoder()
    assert isinstance(encoder, MiniLMEncoder)
    return encoder


def load_reader(path: str | Path | None = None) -> Reader:
    """The reader of a checkpoint; None looks for "reader" (`lab_checkpoint`).

    Raises:
        WeightsError: The file is missing, damaged or of another kind.
    """
    return _load(*dated(lab_checkpoint(KIND) if path is None else Path(path)))


@lru_cache(maxsize=1)
def _load(path: Path, changed: int) -> Reader:
    state, config = load_checkpoint(path, KIND)
    with fitting_config(path):
        reader = Reader(tuple(config["actions"]), dequantised(state), temperature=float(config["temperature"]))
        if reader.weights["value.bias"].shape != (len(reader.actions),) or not reader.layers():
            raise WeightsError(f"{path}: the weights do not fit their actions; train them again")
    return reader
