"""The clip library: captured and made motions by name and tag, for any character."""

from __future__ import annotations

import functools
import math
import tomllib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.core.request import SECONDS
from bunraku.errors import OptionError, WeightsError

if TYPE_CHECKING:
    from bunraku.generation.pack import ExamplePack

_NAME, _TAG, _SENTENCE, _ACTION = 3.0, 2.0, 1.0, 2.0
"""Weight of a word in the name, in a tag or in the sentence of a clip, and of a common action."""
_BEGUN = 0.5  # share of that for a word of which the beginning is typed
_LETTERS = 2  # fewest letters that begin a word


@dataclass(frozen=True)
class Source:
    """Source of clips: how the names of their stretches begin, the credit that is due, and the terms of use."""

    begins: tuple[str, ...]
    credit: str
    terms: str


@dataclass(frozen=True)
class Clip:
    """A clip of the library.

    Args:
        name: Its name.
        sentence: What is done in it.
        seconds: Its length [s].
        loops: Whether it can be repeated without an end.
        tags: Words to find it by: a kind first, then the actions of the lexicon that are done.
        source: Its source and terms.
        stretch: The stretch of the examples that it is.
    """

    name: str
    sentence: str
    seconds: float
    loops: bool
    tags: tuple[str, ...]
    source: Source
    stretch: str

    @property
    def facts(self) -> dict[str, object]:
        """What people and programs are told of it, in values that JSON has."""
        return {
            "name": self.name, "sentence": self.sentence, "seconds": self.seconds, "loops": self.loops,
            "tags": list(self.tags), "credit": self.source.credit, "terms": self.source.terms,
        }  # fmt: skip

    def motion(self, seconds: float | None = None, loop: bool = False) -> HandleMotion:
        """Its motion, of the reference body, 20 frames a second; `bunraku.transfer` puts it on a character.

        Args:
            seconds: Wanted length [s]: a loop is repeated, other clips are held at their end, and what is longer is
                cut. None for the clip's own.
            loop: Of a loop, as many whole rounds as come nearest to that, so that its first frame follows its last;
                others are as without.

        Raises:
            OptionError: It cannot last so long.
            WeightsError: The examples are missing or broken.
        """
        from bunraku.generation.features import decode

        return decode(features_of(self.stretch, seconds, loop))


@functools.cache
def all_clips() -> tuple[Clip, ...]:
    """All clips, by kind and name."""
    table = tomllib.loads(resources.files("bunraku.generation").joinpath("library.toml").read_text(encoding="utf-8"))
    sources = [Source(tuple(row["begins"]), row["credit"], row["terms"]) for row in table["source"]]
    clips = []
    for name, row in table["clips"].items():
        source = next(candidate for candidate in sources if row["of"].startswith(candidate.begins))
        tags = tuple(row["tags"])
        clips.append(Clip(name, row["says"], float(row["seconds"]), row["loops"], tags, source, row["of"]))
    return tuple(clips)


def clip(name: str) -> Clip:
    """The clip of a name.

    Raises:
        OptionError: There is none; the sentence names similar ones.
    """
    match = next((entry for entry in all_clips() if entry.name == name), None)
    if match is None:
        like = search(name.replace("-", " "))[:3] or all_clips()[:3]
        raise OptionError(
            f"there is no clip '{name[:40]}'; there are {', '.join(entry.name for entry in like)} and more"
        )
    return match


@dataclass(frozen=True)
class _Words:
    """The stems of a clip's words, and its actions."""

    name: frozenset[str]
    tags: frozenset[str]
    sentence: frozenset[str]
    actions: frozenset[str]

    def worth(self, word: str) -> float:
        """Weight of a typed word."""
        best = 0.0
        for words, worth in ((self.name, _NAME), (self.tags, _TAG), (self.sentence, _SENTENCE)):
            if word in words:
                best = max(best, worth)
            elif len(word) >= _LETTERS and any(longer.startswith(word) for longer in words):
                best = max(best, worth * _BEGUN)
        return best


def _stems(text: str) -> frozenset[str]:
    from bunraku.language.lexicon import words_of
    from bunraku.language.vocabulary import FUNCTION_WORDS, stem

    return frozenset(stem(word) for word in words_of(text)[0] if word.isalnum() and word not in FUNCTION_WORDS)


@functools.cache
def _index() -> tuple[tuple[_Words, ...], Counter[str], Counter[str]]:
    """The words of each clip, and the number of clips with each stem and each action."""
    from bunraku.language.lexicon import actions_of

    rows = tuple(
        _Words(
            _stems(entry.name.replace("-", " ")), frozenset[str]().union(*map(_stems, entry.tags)),
            _stems(entry.sentence), frozenset((*actions_of(entry.sentence), *entry.tags[1:])),
        )
        for entry in all_clips()
    )  # fmt: skip
    stems = Counter(word for row in rows for word in row.name | row.tags | row.sentence)
    return rows, stems, Counter(action for row in rows for action in row.actions)


def search(text: str = "", tags: Sequence[str] = ()) -> list[Clip]:
    """Clips by words, that of this very name first, then the most fitting.

    Words are English or of a language that the table of words has, and may have typing errors or be only begun. They
    count by how few clips have them; a clip that does what the text says counts however it says so
    (`language.lexicon`).

    Args:
        text: Wanted; empty for all.
        tags: Tags that each must have.
    """
    from bunraku.language.lexicon import actions_of, words_of
    from bunraku.language.understood import understood
    from bunraku.language.vocabulary import FUNCTION_WORDS

    text = " ".join(text.replace("-", " ").split())
    tagged = [(entry, row) for entry, row in zip(all_clips(), _index()[0], strict=True) if set(tags) <= set(entry.tags)]
    if not text:
        return [entry for entry, _ in tagged]
    found = _found(text, tagged)
    if not found and any(word not in FUNCTION_WORDS for word in words_of(text)[0]):
        english = understood(text[:1000]).english
        found = [] if english == text else _found(english, tagged)
    if not found:
        wanted = set(actions_of(text))
        found = [(1.0, entry) for entry, row in tagged if wanted & row.actions]
    name = text.lower().replace(" ", "-")
    return [entry for _, entry in sorted(found, key=lambda pair: (pair[1].name != name, -pair[0], pair[1].name))]


def _found(text: str, entries: Sequence[tuple[Clip, _Words]]) -> list[tuple[float, Clip]]:
    from bunraku.language.lexicon import actions_of

    rows, stems, actions = _index()
    typed, wanted = _stems(text), frozenset(actions_of(text)) - {"other"}
    scored = []
    for entry, row in entries:
        score = sum(row.worth(word) * math.log(1 + len(rows) / (1 + stems[word])) for word in typed)
        score += sum(_ACTION * math.log(1 + len(rows) / (1 + actions[action])) for action in wanted & row.actions)
        if score > 0:
            scored.append((score, entry))
    return scored


_EASE = 0.3  # share of a pose's change that is left from frame to frame where a clip is held at its end


def features_of(stretch: str, seconds: float | None = None, loop: bool = False) -> np.ndarray:
    """Features of a stretch of the examples, shape (N, 271); other arguments as of `Clip.motion`.

    Raises:
        OptionError: It cannot last so long.
        WeightsError: The examples are missing or broken.
    """
    from bunraku.generation.composition import held, played
    from bunraku.generation.pack import FPS, load_examples

    SECONDS.check(seconds, "seconds")
    pack = load_examples()
    if pack is None:
        raise WeightsError("the clips are stretches of examples.safetensors, which is missing; install Bunraku again")
    number = _numbers(pack).get(stretch)
    if number is None:
        raise WeightsError(f"the examples have no stretch {stretch}; install Bunraku again")
    values, rounds = pack.features(number), pack.examples[number].loop
    if loop and rounds:  # as many whole rounds as come nearest to this: all that are repeated are alike
        start, length = rounds[0], rounds[0] - rounds[1]
        stop = start + length * max(round((len(values) if seconds is None else round(seconds * FPS)) / length), 1)
        return played(values, rounds, stop)[start:stop]
    if seconds is None:
        return values
    frames = max(round(seconds * FPS), 1)
    if len(values) < frames:
        still = np.zeros(3, values.dtype)
        values = played(values, rounds, frames) if rounds else held(values, frames - len(values), still, _EASE)
    return values[:frames]


@functools.lru_cache(maxsize=2)
def _numbers(pack: ExamplePack) -> dict[str, int]:
    """The index of each stretch."""
    return {example.name: number for number, example in enumerate(pack.examples)}
