"""Training of the reader of sentences (`bunraku.language.reader`): phrases of single actions are composed into sentences
by a small grammar, run through the layers of the text encoder that stay as they are, and kept; then the reader's own
layers and heads are trained on what was kept.
"""

from __future__ import annotations

import csv
import hashlib
import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bunraku.core.files import atomic_write
from bunraku.core.nn.checkpoints import save_checkpoint
from bunraku.errors import FormatError, OptionError
from bunraku.language.encoders import TEXT_LENGTH, MiniLMEncoder
from bunraku.language.lexicon import actions_of, lexicon
from bunraku.language.reader import DEPTH, FIELDS, KIND, plain_words, quantised
from bunraku_lab.datasets.motions.build import split_of
from bunraku_lab.training.runs.run import AveragedRun, StepSettings, TrainingNote

__all__ = ["Composed", "Composer", "ReaderNetwork", "ReaderTrainConfig", "ReaderTrainer", "make_sentences",
           "packed", "phrases_of", "train_reader"]

NOTHING = "none"
UNKNOWN = -1
"""Of a field about which a sentence may say something that is not known here."""
HELD_OUT = 0.1
"""Share of the phrases of each action that are validated on."""
SHARD = 4096
"""Sentences in a file."""
Fields = dict[str, int]


@dataclass
class Composed:
    """A sentence in pieces.

    Args:
        pieces: Words, and the clause that they belong to; -1 for none.
        said: Of each action that is named its name, its clause and its fields; the clause is -1 if it may be anywhere.
    """

    pieces: list[tuple[str, int]]
    said: list[tuple[str, int, Fields]] = field(default_factory=list)

    @property
    def text(self) -> str:
        """The sentence."""
        return " ".join(piece for piece, _ in self.pieces)


def phrases_of(files: Sequence[Path]) -> dict[str, list[str]]:
    """Phrases by action, of files with an action, a tab and a phrase in each line; a phrase alone names no action.

    Raises:
        FormatError: A file is missing or damaged.
    """
    found: dict[str, list[str]] = defaultdict(list)
    for path in files:
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise FormatError(f"{path}: the phrases cannot be read ({error}); give a file of actions and phrases") from error
        for line in filter(None, lines):
            action, _, phrase = line.rpartition("\t")
            found[action or NOTHING].append(phrase)
    return dict(found)


def drawn(text: str) -> float:
    """A number from 0 to 1, fixed for ever by a text."""
    return int(hashlib.sha256(text.lower().encode()).hexdigest()[:8], 16) / 2**32


def weak_sentences(data: Path, split: str) -> list[tuple[str, tuple[str, ...]]]:
    """Sentences about captured stretches with the actions that all captions of the stretch have in common agreement.

    Args:
        data: Folder with `captions_watched.json` and `captions_asked.tsv`.
        split: Of the clips: "train" or "val".
    """
    clips = json.loads((data / "captions_watched.json").read_text(encoding="utf-8"))["clips"]
    found = []
    with (data / "captions_asked.tsv").open(encoding="utf-8", newline="") as file:
        for key, *asked in csv.reader(file, delimiter="\t", quoting=csv.QUOTE_NONE):
            name, _, index = key.rpartition("#")
            if split_of(name) != split or not index.isdigit() or int(index) >= len(clips.get(name, ())):
                continue
            texts = clips[name][int(index)]["texts"]
            readings = [actions_of(text) for text in texts]
            if readings[0] and all(set(one) == set(readings[0]) for one in readings):
                found += [(text, readings[0]) for text in (*texts, *asked)]
    return found


@cache
def grammar() -> dict[str, Any]:
    """What sentences are made with."""
    read: dict[str, Any] = json.loads(Path(__file__).with_name("reader_grammar.json").read_text(encoding="utf-8"))
    return read


@cache
def _words_of_fields() -> dict[str, frozenset[str]]:
    """Words that may say something of a field."""
    said, small = grammar(), set(grammar()["small words"])
    tables = {"side": said["sides"], "direction": said["directions"], "count": said["counts"],
              "speed": said["speeds"], "posture": said["postures"]}  # fmt: skip
    found = {
        name: frozenset(word for ways in table.values() for way in ways for word in way.split()) - small
        for name, table in tables.items()
    }
    turning = {word for ways in said["turns"].values() for way in ways for word in way.split()}
    return found | {"turn side": frozenset(turning) - small, "degrees": frozenset(turning) - small}


@cache
def _forms() -> dict[str, tuple[str, ...]]:
    """Any form of a verb -> its forms: plain, third person, participle."""
    return {form: (verb, *forms) for verb, forms in lexicon().verbs.items() for form in (verb, *forms[:2])}


class Composer:
    """Makes sentences.

    Args:
        phrases: By action; `NOTHING` for those that name none.
        weak: Sentences that are taken as they are, with their actions.
        seed: Of the draw.
    """

    def __init__(self, phrases: dict[str, list[str]], weak: Sequence[tuple[str, tuple[str, ...]]], seed: int):
        self.phrases, self.weak, self.rng = phrases, weak, np.random.default_rng(seed)
        counts = Counter(action for _, actions in weak for action in actions)
        self.actions = [action for action in phrases if action != NOTHING]
        weights = np.array([1 + min(counts[action] / 100, 9) ** 0.5 for action in self.actions])
        self.weights = weights / weights.sum()
        self.grammar = grammar()

    def pick(self, values: Sequence[Any]) -> Any:
        return values[int(self.rng.integers(len(values)))]

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def sentence(self) -> Composed:
        """A sentence."""
        draw = self.rng.random()
        if self.weak and draw < 0.12:
            text, actions = self.pick(self.weak)
            unknown = dict.fromkeys(FIELDS, UNKNOWN)
            return self.misspelt(Composed([(plain_words(text), -1)], [(action, -1, unknown) for action in actions]))
        count = 1 if draw < 0.55 else 2 if draw < 0.9 else 3
        clauses = [self.clause() for _ in range(count)]
        composed = Composed([(clauses[0][0], 0)], [(action, 0, fields) for action, fields in clauses[0][1]])
        for index, (text, said) in enumerate(clauses[1:], 1):
            kinds = ("joins", "turned joins", "together")
            kind = kinds[int(self.rng.choice(3, p=(0.76, 0.04, 0.2)))] if count == 2 else "joins"
            composed = self.joined(composed, (text, index), kind)
            composed.said += [(action, index, fields) for action, fields in said]
        if count == 1 or self.chance(0.3):
            if self.chance(0.16):
                composed.pieces.insert(0, (self.pick(self.grammar["before"]), -1))
            if self.chance(0.2):
                composed.pieces.append((self.pick(self.grammar["behind"]), -1))
        return self.misspelt(composed)

    def joined(self, first: Composed, second: tuple[str, int], kind: str) -> Composed:
        pieces: list[tuple[str, int]] = []
        for part in self.pick(self.grammar[kind]).split():
            pieces += first.pieces if part == "{0}" else [second] if part == "{1}" else [(part, -1)]
        return Composed(pieces, first.said)

    def misspelt(self, composed: Composed) -> Composed:
        """The sentence with a letter wrong, now and then."""
        if self.chance(0.07):
            at = int(self.rng.integers(len(composed.pieces)))
            words = composed.pieces[at][0].split()
            index = int(self.rng.integers(len(words)))
            word, spot = words[index], int(self.rng.integers(1, max(len(words[index]) - 1, 2)))
            if len(word) > 3:
                swapped = word[:spot] + word[spot + 1 : spot + 2] + word[spot] + word[spot + 2 :]
                words[index] = self.pick((swapped, word[:spot] + word[spot + 1 :], word[:spot] + word[spot - 1 :]))
                composed.pieces[at] = (" ".join(words), composed.pieces[at][1])
        return composed

    def clause(self) -> tuple[str, list[tuple[str, Fields]]]:
        """A clause, and what it says."""
        draw, said = self.rng.random(), self.grammar
        if draw < 0.13:
            return self.gait()
        if draw < 0.17:
            action, fields = "idle", _none()
            text = f"{self.pick(said['held'])} {self.pick(said['stand words'])}" if self.chance(0.6) else self.pick(said["stand words"])
        elif draw < 0.22:
            return self.turn()
        elif draw < 0.25:
            way = "starts" if self.chance(0.4) else "stops"
            gait = self.pick(("walk", "run"))
            text = self.pick(said[way]).format(gait=self.pick(said["gait words"][gait]))
            pair = [("idle", _none()), (gait, _none())]
            return text, pair if way == "starts" else pair[::-1]
        elif draw < 0.33:
            if self.chance(0.25):
                return self.pick(said["moods"]), []
            return self.spoken(plain_words(self.pick(self.phrases[NOTHING]))), []
        else:
            action = self.actions[int(self.rng.choice(len(self.actions), p=self.weights))]
            text, fields = plain_words(self.pick(self.phrases[action])), _none()
            for name, value in (item for item in said["of actions"].items()):
                if action in value:
                    fields[name] = 1 + FIELDS[name].index(value[action])
            words = set(text.lower().split())
            for name, own in _words_of_fields().items():
                if words & own and not fields[name]:
                    fields[name] = UNKNOWN
            text = self.spoken(text)
        return self.modified(text, action, fields)

    def spoken(self, text: str) -> str:
        """A phrase with its first verb in another form, and with a subject."""
        first, _, rest = text.partition(" ")
        forms = _forms().get(first.lower())
        if forms is None or len(forms) < 3 or self.chance(0.4):
            return text
        form = int(self.rng.integers(3))
        before = (
            self.pick(self.grammar["orders"]) if form == 0 else self.pick(self.grammar["subjects"])
        ) if self.chance(0.5) else ""  # fmt: skip
        return f"{before} {'is ' if form == 2 and before else ''}{forms[form]} {rest}".strip()

    def modified(self, text: str, action: str, fields: Fields) -> tuple[str, list[tuple[str, Fields]]]:
        """A clause with more said of it, in one of the fields of which it says nothing."""
        said, part = self.grammar, lexicon().actions[action].part if action in lexicon().actions else ""
        limb = said["parts"].get(part.split()[0] if part else "")
        free = {name for name, value in fields.items() if value == 0}
        if limb and "side" in free and self.chance(0.15):
            side = self.pick(FIELDS["side"])
            way = self.pick(said["sides"][side]).format(part=limb)
            text, fields["side"] = (f"{text} {way}" if self.chance(0.7) else f"{way} {text}"), 1 + FIELDS["side"].index(side)
        if action in said["travels"] and "direction" in free and self.chance(0.3):
            way = self.pick([one for one in FIELDS["direction"] if one != "circle"])
            text, fields["direction"] = f"{text} {self.pick(said['directions'][way])}", 1 + FIELDS["direction"].index(way)
        for name in ("count", "speed"):
            if name in free and self.chance(0.07):
                value = self.pick([one for one in FIELDS[name] if one in said[f"{name}s"]])
                word = self.pick(said[f"{name}s"][value])
                before = name == "speed" and self.chance(0.4)
                text, fields[name] = f"{word} {text}" if before else f"{text} {word}", 1 + FIELDS[name].index(value)
        if "posture" in free and (part or action not in lexicon().actions or action in ("idle", "talk")) and self.chance(0.1):
            posture = self.pick(FIELDS["posture"][:5])
            word, action = self.pick(said["postures"][posture]), said["in posture"].get(f"{action} {posture}", action)
            text = f"{word} {text}" if self.chance(0.5) else f"{text} {word}"
            fields["posture"] = 1 + FIELDS["posture"].index(posture)
        if self.chance(0.07):
            text = f"{text} {self.pick(said['tails'])}"
        return text, [(action, fields)]

    def gait(self) -> tuple[str, list[tuple[str, Fields]]]:
        """Somebody goes somewhere: backwards and sideways are actions of their own, whatever the gait."""
        said, fields = self.grammar, _none()
        action = self.pick(said["gaits"]) if self.chance(0.4) else self.pick(("walk", "walk", "run"))
        text = self.pick(said["gait words"][action])
        if self.chance(0.25):
            text = f"{self.pick(said['held'])} {text}"
        if self.chance(0.65):
            way = self.pick(FIELDS["direction"][:8])
            word = self.pick(said["directions"][way])
            fields["direction"] = 1 + FIELDS["direction"].index(way)
            aside = way in ("left", "right")
            if self.chance(0.25):  # "strafe" turns any gait into a step aside, but not forwards
                text, aside = f"{text} {self.pick(said['strafes'])}", way in ("left", "right")
            text = f"{text} {word}"
            if action == "crouch walk" or (aside or way.startswith("backward")) and "crouch" in text:
                fields["posture"] = 1 + FIELDS["posture"].index("crouching")
            action = "sidestep" if aside else "backward" if way.startswith("backward") else action
        elif self.chance(0.15):
            turned, more = self.turn()
            return f"{text} {turned}", [(action, fields), *more]
        elif self.chance(0.15):
            text, fields["direction"] = f"{text} {self.pick(said['directions']['circle'])}", len(FIELDS["direction"])
            return self.spoken(text), [("circle", fields)]
        return self.modified(self.spoken(text), action, fields)

    def turn(self) -> tuple[str, list[tuple[str, Fields]]]:
        """Somebody turns."""
        said, fields = self.grammar, _none()
        action, side, degrees = self.pick(tuple(said["turns"])), self.pick(("left", "right")), self.pick(said["degrees"])
        way = self.pick(said["turns"][action])
        text = way.format(side=side, s=side[0], degrees=degrees)
        angle = {"turn around": "180", "spin": "360"}.get(action, degrees if "{degrees}" in way else "?")
        fields["degrees"] = 1 + FIELDS["degrees"].index(angle)
        fields["turn side"] = 1 + FIELDS["turn side"].index(side if "{s" in way else "?")
        return self.spoken(text), [(action, fields)]


def _none() -> Fields:
    return dict.fromkeys(FIELDS, 0)


class Layer(nn.Module):
    """A layer of BERT, with the weights of the encoder's."""

    def __init__(self, width: int = 384, wide: int = 1536, heads: int = 12):
        super().__init__()
        self.heads = heads
        self.query, self.key, self.value, self.leave = (nn.Linear(width, width) for _ in range(4))
        self.wide, self.narrow = nn.Linear(width, wide), nn.Linear(wide, width)
        self.norm_a, self.norm_b = nn.LayerNorm(width, eps=1e-12), nn.LayerNorm(width, eps=1e-12)

    def take(self, encoder: MiniLMEncoder, index: int) -> None:
        """Begin as a layer of the encoder."""
        layer = encoder.layer(index)
        for name in ("query", "key", "value", "leave", "wide", "narrow"):
            own, given = getattr(self, name), getattr(layer, name)
            own.weight.data = torch.tensor(np.ascontiguousarray(given.matrix.T))
            own.bias.data = torch.tensor(given.bias)
        for name in ("norm_a", "norm_b"):
            own, given = getattr(self, name), getattr(layer, name)
            own.weight.data, own.bias.data = torch.tensor(given.scale), torch.tensor(given.shift)

    def forward(self, x: Tensor) -> Tensor:
        """Shape (B, L, C) -> (B, L, C)."""
        query, key, value = (
            part(x).unflatten(-1, (self.heads, -1)).transpose(1, 2) for part in (self.query, self.key, self.value)
        )
        mixed = F.scaled_dot_product_attention(query, key, value).transpose(1, 2).flatten(2)
        x = self.norm_a(x + self.leave(mixed))
        return self.norm_b(x + self.narrow(F.gelu(self.wide(x))))  # type: ignore[no-any-return]


class ReaderNetwork(nn.Module):
    """The reader.

    Args:
        actions: How many.
        layers: Behind those of the encoder.
    """

    def __init__(self, actions: int, layers: int = 2):
        super().__init__()
        self.layers = nn.ModuleList(Layer() for _ in range(layers))
        self.query, self.value = nn.Linear(384, actions), nn.Linear(384, actions)
        self.fields = nn.Linear(384, sum(1 + len(values) for values in FIELDS.values()))
        nn.init.zeros_(self.query.weight)
        nn.init.normal_(self.value.weight, std=0.02)
        nn.init.constant_(self.value.bias, -5.0)

    def forward(self, hidden: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Of each action what stands before the logistic function, (B, A), and the attention, (B, L, A); tokens."""
        for layer in self.layers:
            hidden = layer(hidden)
        weight = self.query(hidden).softmax(1)
        return (weight * self.value(hidden)).sum(1), weight, hidden


def packed(network: ReaderNetwork) -> dict[str, np.ndarray]:
    """Its weights as they are read: matrices (in, out) in steps of int8."""
    state: dict[str, np.ndarray] = {}
    for name, value in network.state_dict().items():
        array = value.detach().numpy()
        if array.ndim == 2:
            state[name], state[f"{name}.scale"] = quantised(array.T)
        else:
            state[name] = array
    return state


@dataclass(frozen=True)
class Kept:
    """Sentences of one file, sorted by length.

    Args:
        hidden: Their tokens behind `DEPTH` layers, one after the other, shape (T, 384), float16.
        starts: Where each begins, shape (S + 1,).
        said: A row for each action that is named: sentence, action, first token, one after the last (0, 0: anywhere),
            fields.
    """

    hidden: np.ndarray
    starts: np.ndarray
    said: np.ndarray

    @classmethod
    def read(cls, path: Path) -> Kept:
        """Of a file without its ending."""
        with np.load(path.with_suffix(".npz")) as file:
            return cls(np.load(path.with_suffix(".npy"), mmap_mode="r"), file["starts"], file["said"])

    def batches(self, size: int) -> list[np.ndarray]:
        """Numbers of sentences of the same length, at most `size` together."""
        lengths = np.diff(self.starts)
        groups = [np.flatnonzero(lengths == length) for length in np.unique(lengths)]
        return [group[at : at + size] for group in groups for at in range(0, len(group), size)]

    def tokens(self, rows: np.ndarray) -> Tensor:
        """Of sentences of one length, shape (B, L, 384)."""
        length = int(self.starts[rows[0] + 1] - self.starts[rows[0]])
        at = self.starts[rows][:, None] + np.arange(length)
        return torch.from_numpy(self.hidden[at].astype(np.float32))

    def labels(self, rows: np.ndarray) -> Tensor:
        """The rows of `said` of these sentences, which are counted from 0."""
        low, high = np.searchsorted(self.said[:, 0], [rows[0], rows[-1] + 1])
        chosen = self.said[low:high]
        chosen = chosen[np.isin(chosen[:, 0], rows)].copy()
        chosen[:, 0] = np.searchsorted(rows, chosen[:, 0])
        return torch.from_numpy(chosen)


def keep(path: Path, sentences: Sequence[Composed], actions: Sequence[str], encoder: MiniLMEncoder) -> None:
    """Run sentences through the layers of the encoder that stay, and write them."""
    layers = [Layer() for _ in range(DEPTH)]
    for index, layer in enumerate(layers):
        layer.take(encoder, index)
    number = {action: at for at, action in enumerate(actions)}
    read = []
    for sentence in sentences:
        parts = [(encoder.numbers(piece)[1:-1], clause) for piece, clause in sentence.pieces]
        owner = np.array([-2, *(clause for part, clause in parts for _ in part)][: TEXT_LENGTH - 1] + [-2])
        inner = [one for part, _ in parts for one in part][: TEXT_LENGTH - 2]
        first, *_, last = encoder.numbers("a")
        read.append(([first, *inner, last], owner, sentence.said))
    read.sort(key=lambda one: len(one[0]))
    starts = np.cumsum([0, *(len(numbers) for numbers, _, _ in read)])
    hidden, said = np.empty((starts[-1], 384), np.float16), []
    for row, (_, owner, named) in enumerate(read):
        for action, clause, fields in named:
            own = np.flatnonzero(owner == clause) if clause >= 0 else []
            span = (own[0], own[-1] + 1) if len(own) else (0, 0)
            said.append((row, number[action], *span, *fields.values()))
    kept = Kept(hidden, starts, np.array(said, np.int64))
    with torch.no_grad():
        for rows in kept.batches(128):
            x = torch.tensor(np.stack([encoder.embedded(read[row][0]) for row in rows]))
            for layer in layers:
                x = layer(x)
            hidden[starts[rows[0]] : starts[rows[-1] + 1]] = x.reshape(-1, 384).numpy()
    with atomic_write(path.with_suffix(".npy")) as file:
        np.save(file, hidden)
    with atomic_write(path.with_suffix(".npz")) as file:
        np.savez(file, starts=starts, said=kept.said)


@dataclass(frozen=True, kw_only=True)
class ReaderTrainConfig(StepSettings):
    """Settings of a training run: those of `StepSettings`, and these.

    Args:
        phrases: Files with an action, a tab and a phrase in each line.
        data: Folder with `captions_watched.json` and `captions_asked.tsv`.
        sentences: How many are composed, in files that are made first; what is there is kept.
        layers: Of the reader.
    """

    phrases: tuple[Path, ...] = ()
    data: Path = Path("shared/data")
    out: Path = Path("runs/reader")
    minutes: float = 35.0
    batch: int = 64
    rate: float = 5e-4
    warmup: int = 200
    decay: float = 0.998
    validate_every: int = 500
    sentences: int = 160_000
    layers: int = 2


class ReaderTrainer(AveragedRun[ReaderNetwork]):
    """One training run in memory.

    Args:
        config: Settings.
        actions: Their names, in order.
        shards: Finds the files to train on, which may grow in number.
        held_out: To validate on.
    """

    kind = KIND
    columns = ("loss", "named", "attended", "fields", "rate")

    def __init__(
        self, config: ReaderTrainConfig, actions: Sequence[str], shards: Callable[[], list[Path]], held_out: Sequence[Kept]
    ):
        self.config, self.actions, self.shards, self.held_out = config, list(actions), shards, list(held_out)
        encoder = MiniLMEncoder()

        def prepare(model: ReaderNetwork) -> None:
            for index, layer in enumerate(model.layers):
                layer.take(encoder, DEPTH + index)

        self.set_up(lambda: ReaderNetwork(len(actions), config.layers), prepare)
        self.batches = self._batches()

    def _batches(self) -> Iterator[tuple[Kept, np.ndarray]]:
        """Batches of several files at a time, in any order, again and again."""
        while True:
            paths = self.shards()
            for index in (order := self.rng.permutation(len(paths)))[::4]:
                group = order[list(order).index(index) :][:4]
                kept = [Kept.read(paths[one]) for one in group]
                both = [(one, rows) for one in kept for rows in one.batches(self.config.batch)]
                for at in self.rng.permutation(len(both)):
                    yield both[at]

    def step_loss(self) -> tuple[Tensor, dict[str, float]]:
        """The loss of a batch."""
        parts = self.losses(self.model, *next(self.batches))
        figures = dict(zip(("named", "attended", "fields"), (float(part.detach()) for part in parts), strict=True))
        return parts[0] + 0.3 * parts[1] + 0.3 * parts[2], figures

    def losses(self, model: ReaderNetwork, kept: Kept, rows: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
        """Cross-entropies: of the actions, a sum over actions and a mean over sentences; of the attention of those that
        are named to their clause; and of the fields that are known.
        """
        logits, weight, hidden = model(kept.tokens(rows))
        said = kept.labels(rows)
        row, action = said[:, 0], said[:, 1]
        target = torch.zeros_like(logits)
        target[row, action] = 1
        named = F.binary_cross_entropy_with_logits(logits, target, reduction="sum") / len(rows)
        own = weight[row, :, action]
        at = torch.arange(own.shape[1])[None]
        inside = (at >= said[:, 2:3]) & (at < said[:, 3:4])
        spans = inside.any(1)
        attended = -((own * inside).sum(1)[spans] + 1e-6).log().sum() / len(rows)
        values = model.fields(torch.einsum("nl,nlc->nc", own, hidden[row]))
        fields, start = logits.new_zeros(()), 0
        for index, options in enumerate(FIELDS.values()):
            part = values[:, start : start + 1 + len(options)]
            fields = fields + F.cross_entropy(part, said[:, 4 + index], ignore_index=UNKNOWN, reduction="sum")
            start += 1 + len(options)
        return named, attended, fields / len(rows)

    @torch.no_grad()
    def scored(self) -> tuple[Tensor, Tensor]:
        """What the averaged network says of the held-out sentences before the logistic function, and what is true."""
        self.average.eval()
        logits, truth = [], []
        for kept in self.held_out:
            for rows in kept.batches(256):
                logits.append(self.average(kept.tokens(rows))[0])
                said, target = kept.labels(rows), torch.zeros_like(logits[-1])
                target[said[:, 0], said[:, 1]] = 1
                truth.append(target)
        return torch.cat(logits), torch.cat(truth)

    def validate(self) -> dict[str, float]:
        """How the held-out sentences are read where an action is likelier than not."""
        logits, truth = self.scored()
        said, meant = logits > 0, truth > 0
        named = meant.any(1)
        right = float((said & meant).sum())
        return {
            "exact": float((said == meant).all(1)[named].float().mean()),
            "f1": 2 * right / max(float(said.sum() + meant.sum()), 1.0),
            "silent": float((~said).all(1)[~named].float().mean()),
            "validation": float(F.binary_cross_entropy_with_logits(logits, truth, reduction="sum") / len(logits)),
        }

    def temperature(self) -> float:
        """What the logits are divided by for the best likelihood on the held-out sentences."""
        logits, truth = self.scored()
        tried = np.linspace(0.6, 2.5, 39)
        return float(min(tried, key=lambda one: float(F.binary_cross_entropy_with_logits(logits / one, truth))))

    def write(self, note: TrainingNote) -> Path:
        """Write the checkpoint as it is read: matrices (in, out) in steps of int8."""
        temperature = self.temperature() if self.held_out else 1.0
        config = {"actions": self.actions, "temperature": temperature, **note}
        return save_checkpoint(self.checkpoint, packed(self.average), config, self.kind)


def train_reader(config: ReaderTrainConfig, report: Callable[[dict[str, float]], None] | None = None) -> Path:
    """Train, or go on training, and return the path of the averaged weights. Sentences are made first, and may go on
    being made by another process that calls `make_sentences`.

    Raises:
        OptionError: A setting is out of range, or the run folder belongs to another network.
        FormatError: The phrases or captions are missing or damaged.
    """
    config.prepare()
    make_sentences(config)
    actions = [one for one in phrases_of(config.phrases) if one != NOTHING]
    held = [Kept.read(path) for path in _shards(config.out, "val")]
    return ReaderTrainer(config, actions, lambda: _shards(config.out, "train"), held).learn(report)


def make_sentences(config: ReaderTrainConfig) -> None:
    """Compose sentences and keep them in the run's folder; files that are there are not made again."""
    phrases, encoder = phrases_of(config.phrases), MiniLMEncoder()
    if not phrases.keys() - {NOTHING}:
        raise OptionError("no phrase names an action; give files of actions and phrases")
    actions = [one for one in phrases if one != NOTHING]
    counts = {"val": 1, "train": max(config.sentences // SHARD, 1)}
    for split, count in counts.items():
        own = {action: [one for one in some if (drawn(one) < HELD_OUT) == (split == "val")] for action, some in phrases.items()}
        weak = [one for one in weak_sentences(config.data, split) if set(one[1]) <= set(actions)]
        for index in range(count):
            path = config.out / f"{split}_{index:03}"
            if not path.with_suffix(".npz").is_file():
                composer = Composer({action: some for action, some in own.items() if some}, weak, config.seed * 1000 + index)
                keep(path, [composer.sentence() for _ in range(SHARD)], actions, encoder)


def _shards(folder: Path, split: str) -> list[Path]:
    return sorted(path.with_suffix("") for path in folder.glob(f"{split}_*.npz"))
