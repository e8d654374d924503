"""Training of the tagger, which says what words of other languages mean that the table of words does not have."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bunraku.errors import OptionError
from bunraku.language.captions.grammar import conjugate
from bunraku.language.encoders import MiniLMEncoder
from bunraku.language.foreign.sentence import english_sentence
from bunraku.language.foreign.table import Concept, table
from bunraku.language.foreign.tagger import KIND, TaggerConfig, reach_of, units
from bunraku.language.lexicon.reading import actions_of
from bunraku.language.lexicon.tables import lexicon
from bunraku_lab.nn.language.tagger import TaggerNetwork, said_by_sentence, save_tagger
from bunraku_lab.training.language.likeness import MEANT, NOT_MEANT, likeness_of, measure
from bunraku_lab.training.language.pairs import Pair, read_pairs
from bunraku_lab.training.language.table_forms import table_pairs
from bunraku_lab.training.runs.averaged_run import AveragedRun, TrainingNote
from bunraku_lab.training.runs.settings import StepSettings

__all__ = [
    "Lesson",
    "TaggerTrainConfig",
    "TaggerTrainer",
    "batch_of",
    "lessons_of",
    "movements",
    "train_tagger",
    "verbs_of_actions",
]


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
    """One training run in memory.

    Args:
        config: Settings.
        lessons: To train on.
        held_out: To validate on.
    """

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
        silence = said_by_sentence(model(*batch), batch[2])
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
            sure = (said_by_sentence(self.average(*batch), batch[2]) > np.log(2)).numpy()
            for row, lesson in enumerate(lessons):
                names = set(np.flatnonzero(sure[row])) - set(lesson.unsure)
                right += len(names & set(lesson.said))
                found, there = found + len(names), there + len(lesson.said)
                false += bool(names) and not lesson.said
        silent = sum(not lesson.said for lesson in self.held_out)
        return {
            "validation": float(np.mean(losses)),
            "precision": right / max(found, 1),
            "recall": right / max(there, 1),
            "said_of_silent": false / max(silent, 1),
        }

    def write(self, note: TrainingNote) -> Path:
        """Write the checkpoint."""
        notes = {"steps": note["steps"], "minutes": round(note["seconds"] / 60, 1), "lessons": len(self.saying)}
        return save_tagger(self.checkpoint, self.average, notes | note["results"])


def train_tagger(
    config: TaggerTrainConfig,
    report: Callable[[dict[str, float]], None] | None = None,
    progress: Callable[[str, float], None] | None = None,
    encoder: MiniLMEncoder | None = None,
) -> Path:
    """Train, or go on training, and return the path of the averaged weights.

    Args:
        config: The run.
        report: Called with a row of the log at each validation.
        progress: Called with a stage's name and the share done.
        encoder: In place of the built-in text encoder.

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
