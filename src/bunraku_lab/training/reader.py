"""Training of the reader of sentences (`bunraku_lab.nn.reader_inference`): composed sentences are run through the
layers of the text encoder that stay as they are, and kept; then the reader's own layers and heads are trained on what
was kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bunraku.core.files import atomic_write
from bunraku.core.nn.checkpoints import save_checkpoint
from bunraku.errors import OptionError
from bunraku.language.encoders import TEXT_LENGTH, MiniLMEncoder
from bunraku_lab.nn.reader_inference import DEPTH, FIELDS, KIND, quantised
from bunraku_lab.training.reader_sentences import (
    HELD_OUT,
    NOTHING,
    UNKNOWN,
    Composed,
    Composer,
    drawn,
    phrases_of,
    weak_sentences,
)
from bunraku_lab.training.runs.run import AveragedRun, StepSettings, TrainingNote

__all__ = [
    "Kept",
    "ReaderNetwork",
    "ReaderTrainConfig",
    "ReaderTrainer",
    "keep",
    "make_sentences",
    "packed",
    "train_reader",
]

SHARD = 4096
"""Sentences in a file."""
DROPPED = 0.1
"""Share of hidden states that are left out in training (Srivastava et al. 2014), as in BERT."""


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
        x = self.norm_a(x + F.dropout(self.leave(mixed), DROPPED, self.training))
        return self.norm_b(x + F.dropout(self.narrow(F.gelu(self.wide(x))), DROPPED, self.training))  # type: ignore[no-any-return]


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
        hidden = F.dropout(hidden, DROPPED, self.training)
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
    layers = [Layer().eval() for _ in range(DEPTH)]
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
            own = np.flatnonzero((owner == clause) & (clause >= 0))
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
    rate: float = 3e-4
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
        self,
        config: ReaderTrainConfig,
        actions: Sequence[str],
        shards: Callable[[], list[Path]],
        held_out: Sequence[Kept],
    ):
        self.config, self.actions, self.shards, self.held_out = config, list(actions), shards, list(held_out)
        encoder = MiniLMEncoder()

        def prepare(model: ReaderNetwork) -> None:
            for index, layer in enumerate(model.layers):
                assert isinstance(layer, Layer)
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
        own = {
            action: chosen
            for action, some in phrases.items()
            if (chosen := [one for one in some if (drawn(one) < HELD_OUT) == (split == "val")])
        }
        weak = [one for one in weak_sentences(config.data, split) if set(one[1]) <= set(actions)]
        for index in range(count):
            path = config.out / f"{split}_{index:03}"
            if not path.with_suffix(".npz").is_file():
                composer = Composer(own, weak, config.seed * 1000 + index)
                keep(path, [composer.sentence() for _ in range(SHARD)], actions, encoder)


def _shards(folder: Path, split: str) -> list[Path]:
    return sorted(path.with_suffix("") for path in folder.glob(f"{split}_*.npz"))
