"""Training of the reader of sentences (`bunraku.language.reader`): sentences are composed while it learns, run through
the text encoder with a small change of each of its layers (Hu et al. 2021), and the change and the heads are learned.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bunraku.core.nn import layers as numpy_layers
from bunraku.core.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku.errors import OptionError
from bunraku.language.encoders import TEXT_LENGTH, MiniLMEncoder
from bunraku.language.lexicon import actions_of, lexicon
from bunraku.language.reader import FIELDS, KIND, dequantised
from bunraku_lab.training.reader_sentences import (
    HELD_OUT,
    NOTHING,
    UNKNOWN,
    Composed,
    Composer,
    dealings_of,
    drawn,
    labelled_sentences,
    phrases_of,
    watched_sentences,
)
from bunraku_lab.training.runs.run import AveragedRun, StepSettings, TrainingNote

POOL = 4096
"""Sentences that are composed at a time, and sorted into batches of one length each."""
DROPPED = 0.1
"""Share of hidden states that are left out in training (Srivastava et al. 2014), as in BERT."""
_KEPT = (torch.rand(2**22, generator=torch.Generator().manual_seed(0)) > DROPPED).float() / (1 - DROPPED)
"""What values are multiplied by that are kept or left out."""
STEPS = 31
"""Steps of a weight on either side of zero. A wheel packs them into 0.64 MB, and 127 into 0.93; what the heads say
changes by 0.06 in the mean, where it spans some 15.
"""
TOGETHER = 0.02
"""Share of an action's phrases that say something done with a thing from which the same words may name both; chosen on
"picks up a ball and throws it", which is not all handling: 2 of 181 phrases of throwing say that something is taken.
"""


class Changed(nn.Module):
    """A linear layer of the encoder, and a change of low rank, which alone is learned."""

    matrix: Tensor
    bias: Tensor

    def __init__(self, given: numpy_layers.Linear, rank: int):
        super().__init__()
        assert given.bias is not None
        self.register_buffer("matrix", torch.tensor(np.ascontiguousarray(given.matrix.T)), persistent=False)
        self.register_buffer("bias", torch.tensor(given.bias), persistent=False)
        out, enter = self.matrix.shape
        self.down = nn.Parameter(torch.randn(rank, enter) / enter**0.5)
        self.up = nn.Parameter(torch.zeros(out, rank))

    def forward(self, x: Tensor) -> Tensor:
        """Shape (..., in) -> (..., out)."""
        return F.linear(x, self.matrix, self.bias) + F.linear(F.linear(x, self.down), self.up)


class Layer(nn.Module):
    """A layer of the encoder, changed."""

    def __init__(self, given: numpy_layers.PostNorm, rank: int):
        super().__init__()
        self.heads = given.heads
        self.query, self.key, self.value = (Changed(layer, rank) for layer in (given.query, given.key, given.value))
        self.leave, self.wide, self.narrow = (Changed(layer, rank) for layer in (given.leave, given.wide, given.narrow))
        self.norms = [(torch.tensor(layer.scale), torch.tensor(layer.shift)) for layer in (given.norm_a, given.norm_b)]
        self.epsilon = given.norm_a.epsilon

    def forward(self, x: Tensor) -> Tensor:
        """Shape (B, L, C) -> (B, L, C)."""
        query, key, value = (
            part(x).unflatten(-1, (self.heads, -1)).transpose(1, 2) for part in (self.query, self.key, self.value)
        )
        mixed = F.scaled_dot_product_attention(query, key, value).transpose(1, 2).flatten(2)
        x = x + self.thinned(self.leave(mixed))
        x = F.layer_norm(x, x.shape[-1:], *self.norms[0], self.epsilon)
        x = x + self.thinned(self.narrow(F.gelu(self.wide(x))))
        return F.layer_norm(x, x.shape[-1:], *self.norms[1], self.epsilon)

    def thinned(self, x: Tensor) -> Tensor:
        """With some values left out in training. A new draw would take a twelfth of a step."""
        if not self.training:
            return x
        start = int(torch.randint(len(_KEPT) - x.numel(), ()))
        return x * _KEPT[start : start + x.numel()].view_as(x)


class ReaderNetwork(nn.Module):
    """The reader.

    Args:
        actions: How many.
        encoder: Whose layers it changes.
        rank: Of the changes.
    """

    def __init__(self, actions: int, encoder: MiniLMEncoder, rank: int = 16):
        super().__init__()
        self.layers = nn.ModuleList(Layer(layer, rank) for layer in encoder.layers)
        self.query, self.value, self.where = (nn.Linear(384, actions) for _ in range(3))
        self.fields = nn.Linear(384, sum(1 + len(values) for values in FIELDS.values()))
        for attention in (self.query, self.where):
            nn.init.zeros_(attention.weight)
        nn.init.normal_(self.value.weight, std=0.02)
        nn.init.constant_(self.value.bias, -5.0)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Of each action what stands before the logistic function, (B, A), the attention to what names it, (B, L, A),
        and to what is said of it; tokens.
        """
        for layer in self.layers:
            x = layer(x)
        weight = self.query(x).softmax(1)
        return (weight * self.value(x)).sum(1), weight, self.where(x).softmax(1), x


def quantised(matrix: np.ndarray, axis: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A matrix in steps, int8, and the size of the steps, float32, the same along an axis."""
    scale = np.maximum(np.abs(matrix).max(axis, keepdims=True), 1e-12) / STEPS
    return np.round(matrix / scale).astype(np.int8), scale.astype(np.float32)


def packed(network: ReaderNetwork) -> dict[str, np.ndarray]:
    """Its weights as they are read: matrices (in, out) in steps of int8."""
    state: dict[str, np.ndarray] = {}
    for name, value in network.state_dict().items():
        array = value.detach().numpy()
        if array.ndim == 2:
            state[name], state[f"{name}.scale"] = quantised(array.T, int(name.endswith(".up")))
        else:
            state[name] = array
    return state


class Batch(NamedTuple):
    """Sentences of one length.

    Args:
        x: What the first layer reads of their tokens, shape (B, L, 384).
        said: A row for each action that is named: sentence, action, first token, one after the last (0, 0: anywhere),
            fields.
        open: Whether a sentence may name an action that is not among these, shape (B, A).
        texts: The sentences.
    """

    x: Tensor
    said: Tensor
    open: Tensor
    texts: tuple[str, ...]


def batches(sentences: Sequence[Composed], actions: Sequence[str], encoder: MiniLMEncoder, size: int) -> list[Batch]:
    """Sentences by their lengths, at most `size` together."""
    names = [{action, "actions" if action in lexicon().actions else "dealings"} for action in actions]
    number = {action: at for at, action in enumerate(actions)}
    first, *_, last = encoder.numbers("a")
    by_length: dict[int, list[tuple[list[int], np.ndarray, Composed]]] = {}
    for sentence in sentences:
        parts = [(encoder.numbers(piece)[1:-1], clause) for piece, clause in sentence.pieces]
        owner = np.array([-2, *(clause for part, clause in parts for _ in part)][: TEXT_LENGTH - 1] + [-2])
        inner = [piece_number for part, _ in parts for piece_number in part][: TEXT_LENGTH - 2]
        by_length.setdefault(len(owner), []).append(([first, *inner, last], owner, sentence))
    made = []
    for alike in by_length.values():
        for start in range(0, len(alike), size):
            rows, said = alike[start : start + size], []
            for row, (_, owner, sentence) in enumerate(rows):
                for action, clause, fields in sentence.said:
                    tokens = np.flatnonzero((owner == clause) & (clause >= 0))
                    if clause >= 0 and not len(tokens):
                        continue  # cut off
                    span = (tokens[0], tokens[-1] + 1) if len(tokens) else (0, 0)
                    said.append((row, number[action], *span, *fields.values()))
            x = torch.from_numpy(np.stack([encoder.embedded(numbers) for numbers, _, _ in rows]))
            labels = torch.tensor(said, dtype=torch.int64).reshape(-1, 4 + len(FIELDS))
            more = torch.tensor([[bool(sentence.open & kinds) for kinds in names] for _, _, sentence in rows])
            made.append(Batch(x, labels, more, tuple(sentence.text for _, _, sentence in rows)))
    return made


@dataclass(frozen=True, kw_only=True)
class ReaderTrainConfig(StepSettings):
    """Settings of a training run: those of `StepSettings`, and these.

    Args:
        phrases: Files with an action, a tab and a phrase in each line.
        sentences: Files with an object of JSON in each line, a sentence with all that it says.
        dealings: File with labels in JSON, a tab and a clause about things in each line; None for none.
        data: Folder with `captions_watched.json` and `captions_asked.tsv`.
        rank: Of the changes of the encoder's layers.
        held_out: Sentences to validate on.
        begin: A checkpoint of a reader to begin with, whose actions may be others; None begins with the
            encoder.
    """

    phrases: tuple[Path, ...] = ()
    sentences: tuple[Path, ...] = ()
    dealings: Path | None = None
    data: Path = Path("shared/data")
    out: Path = Path("runs/reader")
    minutes: float = 20.0
    batch: int = 64
    rate: float = 6e-4
    warmup: int = 100
    decay: float = 0.995
    validate_every: int = 400
    rank: int = 16
    held_out: int = 1536
    begin: Path | None = None


class ReaderTrainer(AveragedRun[ReaderNetwork]):
    """One training run in memory. The checkpoint is that of the validation with the lowest loss.

    Args:
        config: Settings.
        actions: Their names, in order, those of what is done with things last, which are none of the lexicon's.
        composer: Makes the sentences to learn.
        held_out: Sentences to validate on.
        together: Of what is done with things, the actions that the same words may name.
    """

    kind = KIND
    columns = ("loss", "named", "attended", "fields", "rate")

    def __init__(
        self,
        config: ReaderTrainConfig,
        actions: Sequence[str],
        composer: Composer,
        held_out: Sequence[Composed],
        together: dict[str, list[str]],
    ):
        self.config, self.actions, self.composer = config, list(actions), composer
        self.count = len(lexicon().actions.keys() & set(actions))
        self.encoder, self.best, self.together = MiniLMEncoder(), np.inf, together
        self.held_out = batches(held_out, actions, self.encoder, 128)
        self.set_up(lambda: ReaderNetwork(len(actions), self.encoder, config.rank), self._begin)
        self.batches = self._batches()

    def _begin(self, model: ReaderNetwork) -> None:
        if self.config.begin is None:
            return
        state, config = load_checkpoint(self.config.begin, KIND)
        before: list[str] = [*config["actions"], *config.get("dealings", ())]  # type: ignore[misc]
        kept = [action for action in before if action in self.actions]
        with torch.no_grad():
            for name, value in dequantised(state).items():
                given, own = torch.tensor(value.T if value.ndim == 2 else value), model.state_dict()[name]
                if name.startswith(("query", "value", "where")):
                    own[list(map(self.actions.index, kept))] = given[list(map(before.index, kept))]
                else:
                    own.copy_(given)

    def _batches(self) -> Iterator[Batch]:
        while True:
            pool = [self.composer.sentence() for _ in range(POOL)]
            made = batches(pool, self.actions, self.encoder, self.config.batch)
            for at in self.rng.permutation(len(made)):
                yield made[at]

    def step_loss(self) -> tuple[Tensor, dict[str, float]]:
        """The loss of a batch."""
        parts = self.losses(self.model, next(self.batches))
        figures = dict(zip(("named", "attended", "fields"), (float(part.detach()) for part in parts), strict=True))
        return parts[0] + 0.3 * parts[1] + 0.5 * parts[2], figures

    def losses(self, model: ReaderNetwork, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
        """Cross-entropies: of the actions, a sum over actions and a mean over sentences; of the attention of those that
        are named to their clause; and of the fields that are known.
        """
        logits, weight, where, hidden = model(batch.x)
        said, count = batch.said, len(batch.x)
        row, action = said[:, 0], said[:, 1]
        named = (self._sure(batch) * _crossed(logits, _target(logits, said))).sum() / count
        at = torch.arange(weight.shape[1])[None]
        inside = (at >= said[:, 2:3]) & (at < said[:, 3:4])
        spans = inside.any(1)
        attended = logits.new_zeros(())
        for attention in (weight[row, :, action], where[row, :, action]):
            attended = attended - ((attention * inside).sum(1)[spans] + 1e-6).log().sum() / count
        values = model.fields(torch.einsum("nl,nlc->nc", attention, hidden[row]))
        fields, start = logits.new_zeros(()), 0
        for index, options in enumerate(FIELDS.values()):
            part = values[:, start : start + 1 + len(options)]
            fields = fields + F.cross_entropy(part, said[:, 4 + index], ignore_index=UNKNOWN, reduction="sum")
            start += 1 + len(options)
        return named, attended, fields / count

    def _sure(self, batch: Batch) -> Tensor:
        """What is known of each action of a sentence: that it is named, or that it is not; shape (B, A)."""
        return (~batch.open | (_target(batch.open, batch.said) > 0)).float()

    @torch.no_grad()
    def scored(self) -> tuple[Tensor, Tensor, Tensor]:
        """What the averaged network says of the held-out sentences before the logistic function, what is true, and 1
        where that is known.
        """
        self.average.eval()
        logits = [self.average(batch.x)[0] for batch in self.held_out]
        truth = [_target(said, batch.said) for said, batch in zip(logits, self.held_out, strict=True)]
        return torch.cat(logits), torch.cat(truth), torch.cat([self._sure(batch) for batch in self.held_out])

    def validate(self) -> dict[str, float]:
        """How the held-out sentences are read where an action is likelier than not."""
        logits, truth, sure = self.scored()
        meant = truth > 0
        said = (logits > 0) & ((sure > 0) | meant)
        named = meant.any(1)
        right = float((said & meant).sum())
        return {
            "exact": float((said == meant).all(1)[named].float().mean()),
            "f1": 2 * right / max(float(said.sum() + meant.sum()), 1.0),
            "silent": float((~said).all(1)[~named].float().mean()),
            "validation": float((sure * _crossed(logits, truth)).sum() / len(logits)),
        }

    def shares(self) -> list[float]:
        """What makes probabilities of the network and the lexicon's phrases together (`Reader.shares`): the logistic
        regression on the held-out sentences.
        """
        logits, truth, sure = (scored[:, : self.count] for scored in self.scored())
        texts = [text for batch in self.held_out for text in batch.texts]
        actions = self.actions[: self.count]
        phrased = torch.tensor([[action in said for action in actions] for said in map(actions_of, texts)])
        agreed = phrased & (logits == logits.max(1, keepdim=True).values)
        shares = torch.tensor([1.0, 0.0, 0.0, 0.0], requires_grad=True)
        search = torch.optim.LBFGS([shares], max_iter=100)

        def loss() -> Tensor:
            search.zero_grad()
            said = shares[0] * logits + shares[1] * phrased + shares[2] * agreed + shares[3]
            value = (sure * _crossed(said, truth)).mean()
            value.backward()  # type: ignore[no-untyped-call]
            return value

        search.step(loss)  # type: ignore[no-untyped-call, arg-type]
        return [round(float(share), 4) for share in shares.detach()]

    def write(self, note: TrainingNote) -> Path:
        """Write the checkpoint as it is read, unless an earlier one is better."""
        loss = note["results"].get("validation", np.inf)
        if loss > self.best and self.checkpoint.is_file():
            return self.checkpoint
        self.best = loss
        shares = self.shares() if self.held_out else [1.0, 0.0, 0.0, 0.0]
        config = {
            "actions": self.actions[: self.count], "dealings": self.actions[self.count :], "shares": shares,
            "together": self.together, **note,
        }  # fmt: skip
        return save_checkpoint(self.checkpoint, packed(self.average), config, self.kind)


def _crossed(logits: Tensor, truth: Tensor) -> Tensor:
    return F.binary_cross_entropy_with_logits(logits, truth, reduction="none")


def _target(logits: Tensor, said: Tensor) -> Tensor:
    target = torch.zeros(logits.shape)
    target[said[:, 0], said[:, 1]] = 1
    return target


def train_reader(config: ReaderTrainConfig, report: Callable[[dict[str, float]], None] | None = None) -> Path:
    """Train, or go on training, and return the path of the averaged weights.

    Raises:
        OptionError: A setting is out of range, or the run folder belongs to another network.
        FormatError: The phrases or captions are missing or damaged.
    """
    config.prepare()
    phrases = phrases_of(config.phrases)
    actions = [action for action in phrases if action != NOTHING]
    if not actions:
        raise OptionError("no phrase names an action; give files of actions and phrases")
    dealings = dealings_of(config.dealings) if config.dealings else {}
    labelled = labelled_sentences(config.sentences, actions)
    composers = {}
    for split in ("train", "val"):
        own_phrases = {
            action: chosen
            for action, listed in phrases.items()
            if (chosen := [phrase for phrase in listed if (drawn(phrase) < HELD_OUT) == (split == "val")])
        }
        watched = watched_sentences(config.data, split)
        watched = [row for row in watched if {action for action, _, _ in row.said} <= set(actions)]
        own = {text: said for text, said in dealings.items() if (drawn(text) < HELD_OUT) == (split == "val")}
        whole = [sentence for sentence in labelled if (drawn(sentence.text) < HELD_OUT) == (split == "val")]
        composers[split] = Composer(own_phrases, watched, config.seed * 1000, own, whole)
    held_out = [composers["val"].sentence() for _ in range(config.held_out)]
    names = sorted({name for said in dealings.values() for name, _ in said})
    dealt = {action: [name for text in phrases[action] for name, _ in dealings.get(text, ())] for action in actions}
    together = {
        name: [act for act in actions if dealt[act].count(name) >= TOGETHER * len(phrases[act])] for name in names
    }
    return ReaderTrainer(config, [*actions, *names], composers["train"], held_out, together).learn(report)
