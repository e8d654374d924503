"""Training of the tagger, which says what words of other languages mean."""

from __future__ import annotations

import functools
import hashlib
import json
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bunraku.core.files import atomic_write
from bunraku.core.nn.checkpoints import save_checkpoint
from bunraku.errors import FormatError, OptionError
from bunraku.language.captions import conjugate, known_phrases
from bunraku.language.encoders import MiniLMEncoder
from bunraku.language.foreign_tagger import KIND, TaggerConfig, reach_of, units
from bunraku.language.lexicon import actions_of, lexicon, said_phrases, words_of
from bunraku.language.prompts import narrow
from bunraku.language.translation import english_sentence
from bunraku.language.word_table import LANGUAGES, Concept, forms, table
from bunraku_lab.training.runs.run import AveragedRun, StepSettings, TrainingNote

_QUIET = -6.0
"""What each movement is at the beginning, before the logistic function: no word says anything."""


class TaggerNetwork(torch.nn.Module):
    """The network."""

    def __init__(self, config: TaggerConfig):
        super().__init__()
        self.config = config
        self.pieces = torch.nn.EmbeddingBag(config.buckets, config.width, mode="mean")
        self.enter = torch.nn.Linear(4 * config.width, config.hidden)
        self.leave = torch.nn.Linear(config.hidden, len(config.verbs))
        torch.nn.init.normal_(self.pieces.weight, std=0.3)
        torch.nn.init.constant_(self.leave.bias, _QUIET)

    def forward(self, pieces: Tensor, offsets: Tensor, lengths: Tensor, reach: Tensor) -> Tensor:
        """How sure each word is of each movement, before the logistic function, shape (words, V).

        Args:
            pieces: Hashes of all words of all sentences, modulo the buckets, in a row.
            offsets: Where the pieces of each word begin.
            lengths: Words of each sentence, shape (B,).
            reach: Words before and after that count, shape (B,).
        """
        own = self.pieces(pieces, offsets)
        stop = lengths.cumsum(0)
        row = torch.repeat_interleave(torch.arange(len(lengths), device=own.device), lengths)
        low, high = (stop - lengths)[row], stop[row]
        sums = torch.cat([own.new_zeros(1, own.shape[1]), own.cumsum(0)])
        at = torch.arange(len(own), device=own.device)
        first, last = torch.maximum(at - reach[row], low), torch.minimum(at + 1 + reach[row], high)
        before = (sums[at] - sums[first]) / (at - first).clamp(min=1)[:, None]
        after = (sums[last] - sums[at + 1]) / (last - at - 1).clamp(min=1)[:, None]
        whole = (sums[high] - sums[low]) / (high - low)[:, None]
        return self.leave(torch.relu(self.enter(torch.cat([own, before, after, whole], dim=1))))


def sentence_losses(words: Tensor, lengths: Tensor) -> Tensor:
    """Minus the logarithm of the probability that no word of a sentence says a movement, shape (B, V)."""
    row = torch.repeat_interleave(torch.arange(len(lengths), device=words.device), lengths)
    silence = torch.nn.functional.softplus(words)
    return words.new_zeros(len(lengths), words.shape[1]).index_add(0, row, silence)


def save_tagger(path: Path, model: TaggerNetwork, notes: Mapping[str, object]) -> Path:
    """Write the network as it is read: the matrix of pieces in steps of int8."""
    state = {name: value.detach().cpu().numpy() for name, value in model.state_dict().items()}
    matrix = state.pop("pieces.weight")
    scale = np.abs(matrix).max(0) / 127
    state["pieces.steps"] = np.round(matrix / np.maximum(scale, 1e-12)).astype(np.int8)
    state["pieces.scale"] = scale.astype(np.float32)
    network = vars(model.config) | {"verbs": list(model.config.verbs)}
    config: dict[str, object] = {"network": network, "notes": dict(notes)}
    return save_checkpoint(path, state, config, KIND, half=True)


FILES = {"de": "deu.txt", "fr": "fra.txt", "es": "spa.txt", "ja": "jpn.txt", "zh": "cmn.txt"}
"""The file of each language."""
_LONGEST = 16
"""Words of an English sentence that is taken."""


@dataclass(frozen=True)
class Pair:
    """A sentence in two languages.

    Args:
        english: In English.
        other: In the other language.
        language: "de", "fr", "es", "ja" or "zh".
        actions: What the rules find in the English.
    """

    english: str
    other: str
    language: str
    actions: tuple[str, ...] = ()


def drawn_number(sentence: str, draw: str = "split") -> float:
    """A number from 0 to 1 that a sentence draws, always the same in a draw of this name."""
    return int.from_bytes(hashlib.sha256(f"31 {draw} {sentence}".encode()).digest()[:6], "big") / 2**48


def split_of(english: str) -> str:
    """ "held" for a tenth of the English sentences, "val" for a twentieth, "train" for the others."""
    number = drawn_number(english)
    return "held" if number < 0.1 else "val" if number < 0.15 else "train"


def read_pairs(folder: Path, splits: Iterable[str] = ("train",)) -> list[Pair]:
    """The pairs of some splits, each once.

    Args:
        folder: With the five files.
        splits: Of "train", "val" and "held".

    Raises:
        FormatError: A file is missing, or a line of it is not a pair.
    """
    wanted, found = frozenset(splits), []
    known: dict[str, tuple[str, ...]] = {}
    for language, name in FILES.items():
        path = folder / name
        if not path.is_file():
            raise FormatError(
                path, "this file of pairs is missing; give a folder that has it: English, a tab, the other language"
            )
        seen = set()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            parts = line.split("\t")
            if len(parts) < 2:
                raise FormatError(path, f"line {number} is not a pair; it must be English, a tab, the other language")
            english, other = parts[0].strip(), narrow(parts[1].strip())
            if not english or not other or split_of(english) not in wanted or (english, other) in seen:
                continue
            if '"' in english or len(english.split()) > _LONGEST:
                continue
            seen.add((english, other))
            if english not in known:
                known[english] = actions_of(english)
            found.append(Pair(english, other, language, known[english]))
    return found


MEANT, NOT_MEANT = 0.36, 0.28
"""Cosines from which a movement is meant, and under which it is not; what lies between teaches nothing. The
shipped tagger was trained so."""
_CAPTIONS = 6
"""Captions of a movement, the shortest."""
_LEAST = 3
"""Sentences with the same word for the same movement that tell what it means in others."""
Likeness = dict[str, dict[str, float]]
"""The cosine of each movement in each sentence."""


def measure(
    sentences: Iterable[str], path: Path, most: int = 250, encoder: MiniLMEncoder | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> Likeness:  # fmt: skip
    """How near sentences are to captions of what the rules find in them, kept in a file.

    Args:
        sentences: In English.
        path: A JSON file, which is gone on with.
        most: Sentences of each movement, drawn by lot.
        encoder: In place of the built-in one.
    """
    found: Likeness = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    counts: Counter[str] = Counter()
    todo = []
    for sentence in sorted(set(sentences), key=lambda one: drawn_number(one, "likeness")):
        actions = actions_of(sentence)
        if actions and min(counts[action] for action in actions) < most:
            counts.update(actions)
            if sentence not in found:
                todo.append(sentence)
    if not todo:
        return found
    encoder = encoder or MiniLMEncoder()
    captions = _captions(encoder)
    for number, sentence in enumerate(todo, 1):
        vector = encoder.encode([sentence]).pooled[0]
        found[sentence] = {
            action: round(float((captions[action] @ vector).max()), 3)
            for action in actions_of(sentence)
            if action in captions
        }
        progress(number / len(todo))
    with atomic_write(path) as file:
        file.write(json.dumps(found, ensure_ascii=False).encode())
    return found


def _captions(encoder: MiniLMEncoder) -> dict[str, np.ndarray]:
    by_action: dict[str, set[str]] = defaultdict(set)
    for phrase in known_phrases():
        caption = f"a person {conjugate(phrase, 'third')}"
        for action in actions_of(caption):
            by_action[action].add(caption)
    return {
        action: np.concatenate([
            encoder.encode([caption]).pooled
            for caption in sorted(captions, key=lambda one: (len(actions_of(one)), len(one), one))[:_CAPTIONS]
        ])
        for action, captions in by_action.items()
    }  # fmt: skip


def likeness_of(found: Likeness) -> Callable[[str], dict[str, float]]:
    """The cosine of each movement of a sentence: its own, or else the mean of movements said by the same word."""
    by_word: dict[tuple[str, str], list[float]] = defaultdict(list)
    for sentence, cosines in found.items():
        for action, word in _said_by(sentence).items():
            if action in cosines:
                by_word[action, word].append(cosines[action])
    means = {key: float(np.mean(some)) for key, some in by_word.items() if len(some) >= _LEAST}

    def of(sentence: str) -> dict[str, float]:
        if sentence.startswith("a person "):  # a caption
            return dict.fromkeys(actions_of(sentence), 1.0)
        if sentence in found:
            return found[sentence]
        said = _said_by(sentence)
        return {action: means[action, word] for action, word in said.items() if (action, word) in means}

    return of


def _said_by(sentence: str) -> dict[str, str]:
    """The word at which each movement of a sentence begins."""
    words, at = words_of(sentence)[0], said_phrases(sentence)["actions"]
    return {action: words[at[action]] for action in actions_of(sentence)}


_SAID_OF = {"de": "eine Person {}", "fr": "une personne {}", "es": "una persona {}", "ja": "人が{}", "zh": "一个人{}"}
_ENDINGS = {"de": ("t", "en", "te"), "fr": ("e", "ent", "er", "ant"), "es": ("a", "an", "ar", "ando")}
_SURU = "し", "する", "して"
_GODAN = {
    "く": ("いて", "き"), "ぐ": ("いで", "ぎ"), "す": ("して", "し"), "つ": ("って", "ち"), "ぬ": ("んで", "に"),
    "ぶ": ("んで", "び"), "む": ("んで", "み"), "る": ("って", "り"), "う": ("って", "い"),
}  # fmt: skip
"""Ends of a verb with て, and before ます."""


@functools.cache
def table_pairs() -> tuple[Pair, ...]:
    """A sentence for each form of each verb that says one action."""
    found = []
    for language in LANGUAGES:
        for form, kind, english, _ in forms(language):
            if kind != "verb":
                continue
            caption = english_sentence([Concept("verb", english, 0, 1)], language)
            actions = actions_of(caption)
            if len(actions) == 1:
                found += [
                    Pair(caption, _SAID_OF[language].format(said), language, actions)
                    for said in dict.fromkeys(_written(form, language))
                ]  # fmt: skip
    return tuple(found)


def _written(form: str, language: str) -> Iterator[str]:
    """A form of the table as sentences have it."""
    if language == "zh":
        yield form
    elif language == "ja":
        yield from _japanese(form)
    else:
        *others, head = form.split("&")
        *particles, head = head.split("+")
        beside = " ".join(word.rstrip("~") for word in others)
        for ending in _ENDINGS[language] if "~" in head else ("",):
            said = re.sub("~", ending, head)
            for whole in (f"{said} {particles[0]}", particles[0] + said) if particles else (said,):
                yield f"{beside} {whole}".strip()


def _japanese(form: str) -> Iterator[str]:
    if form.endswith("+"):
        yield from (form[:-1] + end for end in _SURU)
    elif "・" in form:
        yield from (form.replace("・る", end) for end in ("る", "て", ""))
    else:
        yield form
        yield from (form[:-1] + end for end in _GODAN.get(form[-1], ()))


@dataclass(frozen=True, kw_only=True)
class TaggerTrainConfig(StepSettings):
    """Settings of a training run: those of `StepSettings`, and these.

    Args:
        pairs: Folder with `deu.txt`, `fra.txt`, `spa.txt`, `jpn.txt` and `cmn.txt`: English, a tab, the other language.
        fewest: Sentences that a movement needs to be learned.
        silent: Share of a batch in which nothing is done.
        encoded: Sentences of each movement whose meaning is measured by the text encoder.
        network: Its sizes; the movements are found by the run.
    """

    pairs: Path = Path("runs/languages")
    out: Path = Path("runs/tagger")
    minutes: float = 4.0
    steps: int = 4000
    batch: int = 256
    rate: float = 4e-3
    warmup: int = 100
    decay: float = 0.998
    weight_decay: float = 1e-4
    validate_every: int = 500
    fewest: int = 12
    silent: float = 0.6
    encoded: int = 250
    network: TaggerConfig = field(default_factory=TaggerConfig)


@dataclass(frozen=True)
class Lesson:
    """A sentence to learn.

    Args:
        pieces: Hashes of the pieces of all its words, modulo the buckets.
        counts: Pieces of each word.
        language: Its language.
        said: Numbers of the movements that it says.
        unsure: Numbers of those that it may say.
    """

    pieces: np.ndarray
    counts: np.ndarray
    language: str
    said: tuple[int, ...]
    unsure: tuple[int, ...]


def verbs_of_actions() -> dict[str, str]:
    """A verb in English for each action, as the table of words has it, that says this action and no other."""
    found: dict[str, str] = {}
    for exact in (True, False):  # "pick up": "{pick} up <something>" before "{stoop}"
        for row in table()["verbs"]:
            said = actions_of(english_sentence([Concept("verb", row["en"], 0, 1)], "de"))
            if len(said) == 1 and (not exact or re.sub("[{}]", "", row["en"]).startswith(said[0])):
                found.setdefault(said[0], row["en"])
    for action, entry in lexicon().actions.items():
        for phrase in entry.said:
            plain = re.fullmatch(r"\{\w+\}( \w+)*", phrase)
            if plain and actions_of(f"a person {conjugate(phrase, 'third')}") == (action,):
                found.setdefault(action, phrase)
    return found


def lessons_of(
    pairs: Sequence[Pair], actions: Sequence[str], buckets: int, likeness: Callable[[str], dict[str, float]]
) -> list[Lesson]:
    """What sentences teach.

    Args:
        pairs: The sentences.
        actions: The movements, by number.
        buckets: Of the network.
        likeness: The cosine of each movement of an English sentence with captions of it.
    """
    number = {action: at for at, action in enumerate(actions)}
    found = []
    for pair in pairs:
        words = units(pair.other, pair.language)
        if not words:
            continue
        cosines = likeness(pair.english) if pair.actions else {}
        known = [action for action in pair.actions if action in number]
        said = tuple(number[action] for action in known if cosines.get(action, 0.0) >= MEANT)
        unsure = tuple(
            number[action] for action in known if NOT_MEANT <= cosines.get(action, NOT_MEANT) < MEANT
        )  # fmt: skip
        pieces = np.array([piece % buckets for word in words for piece in word.pieces], np.int32)
        counts = np.array([len(word.pieces) for word in words], np.int32)
        found.append(Lesson(pieces, counts, pair.language, said, unsure))
    return found


def batch_of(lessons: Sequence[Lesson]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """What the network reads."""
    counts = np.concatenate([lesson.counts for lesson in lessons])
    offsets = np.concatenate([[0], counts.cumsum()[:-1]])
    return (
        torch.from_numpy(np.concatenate([lesson.pieces for lesson in lessons]).astype(np.int64)),
        torch.from_numpy(offsets.astype(np.int64)),
        torch.tensor([len(lesson.counts) for lesson in lessons]),
        torch.tensor([reach_of(lesson.language) for lesson in lessons]),
    )


class TaggerTrainer(AveragedRun[TaggerNetwork]):
    """One training run in memory."""

    kind = KIND
    columns = ("loss", "rate")

    def __init__(self, config: TaggerTrainConfig, lessons: Sequence[Lesson], held_out: Sequence[Lesson] = ()):
        if not any(lesson.said for lesson in lessons):
            raise OptionError("no sentence says a movement; give other pairs")
        self.config, self.held_out = config, list(held_out)
        self.saying = [lesson for lesson in lessons if lesson.said]
        self.silent = [lesson for lesson in lessons if not lesson.said and not lesson.unsure]
        counts = Counter(movement for lesson in self.saying for movement in lesson.said)
        rare = np.array([max(counts[movement] ** -0.5 for movement in lesson.said) for lesson in self.saying])
        self.chances = rare / rare.sum()
        self.set_up(lambda: TaggerNetwork(config.network))

    def step_loss(self) -> tuple[Tensor, dict[str, float]]:
        """The loss of a batch in which rare movements are drawn more often than they are."""
        quiet = round(self.config.silent * self.config.batch) if self.silent else 0
        chosen = self.rng.choice(len(self.saying), self.config.batch - quiet, p=self.chances)
        lessons = [self.saying[at] for at in chosen]
        lessons += [self.silent[at] for at in self.rng.integers(len(self.silent), size=quiet)] if quiet else []
        return self.loss(self.model, lessons), {}

    def loss(self, model: TaggerNetwork, lessons: Sequence[Lesson]) -> Tensor:
        """Cross-entropy of what each sentence says, a mean over sentences."""
        batch = batch_of(lessons)
        silence = sentence_losses(model(*batch), batch[2])
        said, counted = torch.zeros_like(silence), torch.ones_like(silence)
        for row, lesson in enumerate(lessons):
            said[row, list(lesson.said)] = 1
            counted[row, list(lesson.unsure)] = 0
        speaks = -torch.log(-torch.expm1(-silence.clamp(min=1e-6)))
        return (counted * (said * speaks + (1 - said) * silence)).sum() / len(lessons)

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """The loss on what was held out, and how it is read where the network is surer than even."""
        right = found = there = false = 0
        losses = []
        self.average.eval()
        for first in range(0, len(self.held_out), 1024):
            lessons = self.held_out[first : first + 1024]
            losses.append(float(self.loss(self.average, lessons)))
            batch = batch_of(lessons)
            sure = (sentence_losses(self.average(*batch), batch[2]) > np.log(2)).numpy()
            for row, lesson in enumerate(lessons):
                names = set(np.flatnonzero(sure[row])) - set(lesson.unsure)
                right += len(names & set(lesson.said))
                found, there = found + len(names), there + len(lesson.said)
                false += bool(names) and not lesson.said
        silent = sum(not lesson.said for lesson in self.held_out)
        return {
            "validation": float(np.mean(losses)), "precision": right / max(found, 1), "recall": right / max(there, 1),
            "said_of_silent": false / max(silent, 1),
        }  # fmt: skip

    def write(self, note: TrainingNote) -> Path:
        notes = {"steps": note["steps"], "minutes": round(note["seconds"] / 60, 1), "lessons": len(self.saying)}
        return save_tagger(self.checkpoint, self.average, notes | note["results"])


def train_tagger(
    config: TaggerTrainConfig, report: Callable[[dict[str, float]], None] | None = None,
    progress: Callable[[str, float], None] | None = None, encoder: MiniLMEncoder | None = None,
) -> Path:  # fmt: skip
    """Train, or go on training, and return the path of the averaged weights.

    Raises:
        OptionError: A setting is out of range, or the run folder belongs to another network.
        FormatError: The pairs are missing or damaged.
    """
    progress = progress or (lambda stage, done: None)
    config.prepare()
    pairs, held = read_pairs(config.pairs), read_pairs(config.pairs, ["val"])
    said = measure(
        (pair.english for pair in (*pairs, *held) if pair.actions),
        config.out / "likeness.json", config.encoded, encoder, lambda done: progress("sentences", done),
    )  # fmt: skip
    like = likeness_of(said)
    forms = table_pairs()
    actions, network = movements([*pairs, *forms], like, config)
    lessons, held_out = (lessons_of(some, actions, network.buckets, like) for some in ([*pairs, *forms], held))
    return TaggerTrainer(replace(config, network=network), lessons, held_out).learn(report, progress)


def movements(
    pairs: Sequence[Pair], likeness: Callable[[str], dict[str, float]], config: TaggerTrainConfig
) -> tuple[list[str], TaggerConfig]:
    """The actions that enough sentences say, and the network for them."""
    verbs = verbs_of_actions()
    counts: Counter[str] = Counter()
    for pair in pairs:
        if pair.actions:
            cosines = likeness(pair.english)
            counts.update(action for action in pair.actions if cosines.get(action, 0.0) >= MEANT)
    actions = [action for action in lexicon().actions if action in verbs and counts[action] >= config.fewest]
    return actions, replace(config.network, verbs=tuple(verbs[action] for action in actions))
