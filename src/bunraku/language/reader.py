"""A clause as a small network reads it: which actions it names, and what it says of each.

The network is the text encoder with a small change of each layer (Hu et al. 2021), learned on phrases of each action,
and for each action two attentions over the tokens (Ilse et al. 2018): one finds whether and where the action is named,
the other what is said of it: side, direction, turn, count, speed, posture, height.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bunraku.core.nn.checkpoints import dated_checkpoint, fitting_config, load_checkpoint
from bunraku.core.nn.layers import PostNorm, one_thread, sigmoid, softmax
from bunraku.errors import WeightsError
from bunraku.language.encoders import TEXT_LENGTH, MiniLMEncoder, text_encoder
from bunraku.language.lexicon import actions_of, lexicon, said_phrases, uncovered, words_of
from bunraku.language.prompts import plain_words

KIND = "reader"
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
    "height": (
        "0.2", "0.3", "0.45", "0.6", "0.75", "0.85", "0.95", "1.05", "1.2", "1.3", "1.4", "1.6", "1.75", "2.05",
    ),
    "surface": ("top", "front", "grip"),
}  # fmt: skip
"""What is said of an action, each beside "nothing", which comes first."""
SURE, LIKELIEST = 0.56, 0.38
"""Probability from which an action counts, and the likeliest one where no other does; chosen on held-out phrases and
composed sentences with an earlier reader: what is said is exact for .57 and .55 of them, and nothing is said in .60 and
.80 of those that name nothing; with .5 and .26 it is .60 and .58, but .55 and .70.
"""
GUESSED = 0.1
"""Probability from which the likeliest action is shown as a guess where none is read. Of 336 held-out phrases in which
none is read, 263 are then shown as something, 91 of them as what they name; of 58 that name nothing, 30.
"""
DEALT = 0.6
"""Probability from which something is done with a thing. Measured on 90 fresh clauses: as many are right as from 0.5.
"Holds a plank", at 0.59, is nothing but the exercise.
"""


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

    @property
    def cues(self) -> frozenset[str]:
        """The lexicon's cues for what is said of it; sides of limbs are none."""
        said = [lexicon().reading["fields"].get(f"{name} {value}", "") for name, value in self.fields.items()]
        return frozenset(cue for cues in said for cue in cues.split(", ") if cue)


def dequantised(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """All arrays of a checkpoint as float32: those in steps of int8 have the sizes of their steps beside them."""
    arrays = {}
    for name in state:
        if not name.endswith(".scale"):
            arrays[name] = state[name].astype(np.float32)
            if state[name].dtype == np.int8:
                arrays[name] *= state[f"{name}.scale"]
    return arrays


@dataclass(frozen=True, eq=False)
class Reader:
    """The network, for inference.

    Args:
        actions: Their names, in the order of the heads.
        dealings: What is done with things ("deed touch", "ground deep", "sight far", "take"), whose heads come after.
        weights: Of the changes, "layers.0.query.down" and so on, and of the heads, matrices (in, out).
        shares: What makes a probability, before the logistic function: the factor of what a head says; what is added
            where the lexicon's phrases say the action; what more if it is the network's likeliest, or says that one
            already; what always.
        together: Of each of these, the actions that the same words may name.
        encoder: Whose layers are changed.
    """

    actions: tuple[str, ...]
    weights: Mapping[str, np.ndarray]
    shares: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    dealings: tuple[str, ...] = ()
    together: Mapping[str, Sequence[str]] = field(default_factory=dict)
    encoder: MiniLMEncoder = field(default_factory=lambda: _encoder())

    def _head(self, name: str, x: np.ndarray) -> np.ndarray:
        return np.asarray(x @ self.weights[f"{name}.weight"] + self.weights[f"{name}.bias"])

    def layers(self) -> list[PostNorm]:
        """The layers of the encoder, changed."""
        layers = []
        for index, layer in enumerate(self.encoder.layers):
            changed = {}
            for part in ("query", "key", "value", "leave", "wide", "narrow"):
                name = f"layers.{index}.{part}"
                change = self.weights[f"{name}.down"], self.weights[f"{name}.up"]
                changed[part] = getattr(layer, part)._replace(change=change)
            layers.append(layer._replace(**changed))
        return layers

    def run(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the heads say.

        Args:
            x: What the first layer reads of the tokens, shape (L, 384).

        Returns:
            For each action: before the logistic function, shape (A,); the attention to each token, shape (L, A); and
            its fields, shape (A, F), of each field "nothing" and then its values.
        """
        x = x[None]
        for layer in self.layers():
            x = layer(x)
        x = x[0]
        weight, where = (softmax(self._head(name, x).T).T for name in ("query", "where"))
        return (weight * self._head("value", x)).sum(0), weight, self._head("fields", where.T @ x)

    @lru_cache(maxsize=256)  # noqa: B019 - the reader lives as long as the program
    def heard(self, text: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What `run` says of a text of plain words."""
        with one_thread():
            return self.run(self.encoder.embedded(self.encoder.numbers(text)))

    def read(self, sentence: str, phrased: Sequence[str] = ()) -> list[Frame]:
        """The actions that a sentence names, in order.

        Args:
            sentence: A prompt in English or the name of a clip.
            phrased: The actions that the lexicon's phrases find in it, in order.
        """
        text = plain_words(sentence)
        if not text:
            return []
        logits, weight, fields = self.heard(text)
        logits = logits[: len(self.actions)]
        factor, by_phrase, by_both, always = self.shares
        rows, likeliest = lexicon().actions, self.actions[int(logits.argmax())]
        said = np.isin(self.actions, phrased)
        agreed = np.isin(self.actions, [action for action in phrased if likeliest in (action, *rows[action].covers)])
        sure = sigmoid(factor * logits + by_phrase * said + by_both * agreed + always)
        at = np.arange(len(weight)) @ weight
        frames: list[Frame] = []
        if sure.max() < LIKELIEST:  # actions that mean much the same share what one would have
            sure = sure + said * (np.argsort(np.argsort(-logits)) < 3)
        least = SURE if sure.max() >= SURE else max(sure.max(), LIKELIEST)
        for action in uncovered([self.actions[index] for index in np.flatnonzero(sure >= least)]):
            index = self.actions.index(action)
            frames.append(Frame(action, min(float(sure[index]), 1.0), float(at[index]), _fields(fields[index])))
        return sorted(frames, key=lambda frame: frame.at)

    def dealt(self, sentence: str) -> list[Frame]:
        """What a sentence says that is done with things, in order."""
        text = plain_words(sentence)
        if not text:
            return []
        logits, weight, fields = self.heard(text)
        sure, at, frames = sigmoid(logits), np.arange(len(weight)) @ weight, list[Frame]()
        for number, name in enumerate(self.dealings, len(self.actions)):
            if sure[number] > DEALT:
                frames.append(Frame(name, float(sure[number]), float(at[number]), _fields(fields[number])))
        return sorted(frames, key=lambda frame: frame.at)


@lru_cache(maxsize=4096)
def guess_of(text: str) -> Frame | None:
    """The action that is likeliest by the network alone; None where none is likely (`GUESSED`).

    Args:
        text: In English.
    """
    if not (plain := plain_words(text)):
        return None
    reader = load_reader()
    logits, weight, fields = reader.heard(plain)
    logits = logits[: len(reader.actions)]
    index, (factor, _, _, always) = int(logits.argmax()), reader.shares
    sure = float(sigmoid(factor * logits[index] + always))
    at = float(np.arange(len(weight)) @ weight[:, index])
    return Frame(reader.actions[index], sure, at, _fields(fields[index])) if sure >= GUESSED else None


@lru_cache(maxsize=4096)
def frames_of(text: str) -> tuple[Frame, ...]:
    """The actions that a clause names, by the network and the lexicon's phrases together, in order.

    Args:
        text: In English.
    """
    reader, phrased = load_reader(), actions_of(text)
    pieces = _pieces(text)
    if len(pieces) > 1 and len(reader.encoder.numbers(plain_words(text))) == TEXT_LENGTH:  # no more would be read
        before = pieces[len(pieces) // 2][0]
        at = words_of(text)[1][before][0]
        later = [frame._replace(at=frame.at + before) for frame in frames_of(text[at:])]
        return tuple({frame.action: frame for frame in (*frames_of(text[:at]), *later)}.values())
    frames = reader.read(text, phrased)
    if unlearned := unlearned_in(text):  # the network says of their words what it knows
        kept = [frame for frame in frames if frame.action in phrased]
        frames = kept + [Frame(action, 1.0, said_phrases(text)["actions"][action] + 1, {}) for action in unlearned]
    missing = set(phrased) - {frame.action for frame in frames}
    for before, piece in pieces if missing else ():  # beside others, each is less sure
        alone = [action for action in actions_of(piece) if action in missing]
        more = [frame for frame in reader.read(piece, alone) if frame.action in alone and frame.probability >= SURE]
        frames += [frame._replace(at=frame.at + before) for frame in more]
    frames.sort(key=lambda frame: frame.at)
    if {frame.action for frame in frames}.issubset(phrased):
        frames.sort(key=lambda frame: phrased.index(frame.action))
    return tuple({frame.action: frame for frame in frames}.values())


def unlearned_in(text: str) -> list[str]:
    """The actions that phrases of the lexicon find in a text, and that the network never learned."""
    return [action for action in actions_of(text) if action not in load_reader().actions]


def _pieces(text: str) -> list[tuple[int, str]]:
    """What stands between the words of a text that join things, behind the number of words before it; none where there
    are no such words.
    """
    (words, spans), grammar = words_of(text), lexicon().grammar
    joints = [at for at, word in enumerate(words) if word in grammar["joints"] or word in grammar["to"]]
    bounds = zip([-1, *joints], [*joints, len(words)], strict=True)
    inner = [(before + 1, stop) for before, stop in bounds if stop > before + 1] if joints else []
    return [(start, text[spans[start][0] : spans[stop - 1][1]]) for start, stop in inner]


def nearest(text: str, count: int = 3) -> tuple[str, ...]:
    """Sentences that each say an action of the lexicon, those that are likeliest in a text first."""
    reader, verbs = load_reader(), lexicon().verbs
    said = reader.heard(plain_words(text))[0][: len(reader.actions)]
    likely = [reader.actions[index] for index in np.argsort(-said)]
    names = [action.split() for action in likely if action in lexicon().actions and action.split()[0] in verbs]
    return tuple(" ".join(("a person", verbs[verb][0], *rest)) for verb, *rest in names[:count])


def _fields(said: np.ndarray) -> dict[str, str]:
    values_said, start = {}, 0
    for name, values in FIELDS.items():
        best = int(said[start : start + 1 + len(values)].argmax())
        if best:
            values_said[name] = values[best - 1]
        start += 1 + len(values)
    return values_said


def _encoder() -> MiniLMEncoder:
    encoder = text_encoder()
    assert isinstance(encoder, MiniLMEncoder)
    return encoder


def load_reader(path: str | Path | None = None) -> Reader:
    """The reader of a checkpoint; None takes the shipped one.

    Raises:
        WeightsError: The file is missing, damaged or of another kind.
    """
    return _load(*dated_checkpoint(KIND, path))


@lru_cache(maxsize=1)
def _load(path: Path, changed: int) -> Reader:
    state, config = load_checkpoint(path, KIND)
    with fitting_config(path):
        shares = tuple(map(float, config["shares"]))
        actions, dealings = tuple(config["actions"]), tuple(config["dealings"])  # type: ignore[arg-type]
        reader = Reader(actions, dequantised(state), shares, dealings, config["together"])  # type: ignore[arg-type]
        fits = reader.weights["value.bias"].shape == (len(actions) + len(dealings),)
        if not fits or not reader.layers() or not lexicon().actions.keys() >= {*actions}:
            raise WeightsError(f"{path}: the weights do not fit their actions; train them again")
    return reader
