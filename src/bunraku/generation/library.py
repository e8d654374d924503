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

__all__ = ["Clip", "Source", "all_clips", "clip", "features_of", "motion_of", "search"]

_NAME, _TAG, _SENTENCE, _ACTION = 3.0, 2.0, 1.0, 2.0
"""What a word counts for that stands in the name, in a tag or in the sentence of a clip, and an action in common."""
_BEGUN = 0.5
"""Share of that for a word of which the beginning is typed."""
_LETTERS = 2
"""Fewest letters that begin a word."""


@dataclass(frozen=True)
class Source:
    """Where clips are from.

    Args:
        begins: How the names of their stretches begin.
        credit: Who is to be named.
        terms: What may be done with them.
    """

    begins: tuple[str, ...]
    credit: str
    terms: str


@dataclass(frozen=True)
class Clip:
    """A clip of the library.

    Args:
        name: Its name.
        sentence: What is done in it.
        seconds: How long it lasts [s].
        loops: Whether it can be played on without an end.
        tags: What it is found by: a kind first, then the actions of the lexicon that are done.
        source: Who it is from, on which terms.
        stretch: The stretch of the examples that it is.
    """

    name: str
    sentence: str
    seconds: float
    loops: bool
    tags: tuple[str, ...]
    source: Source
    stretch: str

    def motion(self, seconds: float | None = None, loop: bool = False) -> HandleMotion:
        """Its motion, of the reference body, 20 frames a second; `bunraku.transfer` puts it on a character.

        Args:
            seconds: How long it is to last [s]: one that loops is played on, others are held at their end, and what is
                longer is cut. None for as long as it lasts.
            loop: Of one that loops, as many whole rounds as come nearest to that, so that its last frame goes on with
                its first; others are as without.

        Raises:
            OptionError: It cannot last so long.
            WeightsError: The examples are missing or broken.
        """

        return motion_of(self.stretch, seconds, loop)


@functools.cache
def all_clips() -> tuple[Clip, ...]:
    """All clips, by kind and name."""
    table = tomllib.loads(resources.files("bunraku.generation").joinpath("library.toml").read_text(encoding="utf-8"))
    sources = [Source(tuple(row["begins"]), row["credit"], row["terms"]) for row in table["source"]]
    found = []
    for name, row in table["clips"].items():
        source = next(one for one in sources if row["of"].startswith(one.begins))
        tags = tuple(row["tags"])
        found.append(Clip(name, row["says"], float(row["seconds"]), row["loops"], tags, source, row["of"]))
    return tuple(found)


def clip(name: str) -> Clip:
    """The clip of a name.

    Raises:
        OptionError: There is none; the sentence names some like it.
    """
    found = next((one for one in all_clips() if one.name == name), None)
    if found is None:
        like = search(name.replace("-", " "))[:3] or all_clips()[:3]
        raise OptionError(f"there is no clip '{name[:40]}'; there are {', '.join(one.name for one in like)} and more")
    return found


@dataclass(frozen=True)
class _Words:
    """The stems of a clip's words, and its actions."""

    name: frozenset[str]
    tags: frozenset[str]
    sentence: frozenset[str]
    actions: frozenset[str]

    def worth(self, word: str) -> float:
        """What a typed word counts for."""
        best = 0.0
        for words, worth in ((self.name, _NAME), (self.tags, _TAG), (self.sentence, _SENTENCE)):
            if word in words:
                best = max(best, worth)
            elif len(word) >= _LETTERS and any(one.startswith(word) for one in words):
                best = max(best, worth * _BEGUN)
        return best


def _stems(text: str) -> frozenset[str]:
    from bunraku.language.lexicon import words_of
    from bunraku.language.vocabulary import FUNCTION_WORDS, stem

    return frozenset(stem(word) for word in words_of(text)[0] if word.isalnum() and word not in FUNCTION_WORDS)


@functools.cache
def _index() -> tuple[tuple[_Words, ...], Counter[str], Counter[str]]:
    """The words of each clip, and in how many each stem and each action is."""
    from bunraku.language.lexicon import actions_of

    rows = tuple(
        _Words(
            _stems(one.name.replace("-", " ")), frozenset[str]().union(*map(_stems, one.tags)), _stems(one.sentence),
            frozenset((*actions_of(one.sentence), *one.tags[1:])),
        )
        for one in all_clips()
    )  # fmt: skip
    stems = Counter(word for row in rows for word in row.name | row.tags | row.sentence)
    return rows, stems, Counter(action for row in rows for action in row.actions)


def search(text: str = "", tags: Sequence[str] = ()) -> list[Clip]:
    """Clips by words, that of this very name first, then the most fitting.

    Words are English or of a language that the table of words has, and may have typing errors or be only begun. They
    count by how few clips have them; a clip that does what the text says counts however it says so
    (`language.lexicon`).

    Args:
        text: What is looked for; empty for all.
        tags: Tags that each must have.
    """
    from bunraku.language.lexicon import actions_of, words_of
    from bunraku.language.understood import understood
    from bunraku.language.vocabulary import FUNCTION_WORDS

    text = " ".join(text.replace("-", " ").split())
    some = [(one, row) for one, row in zip(all_clips(), _index()[0], strict=True) if set(tags) <= set(one.tags)]
    if not text:
        return [one for one, _ in some]
    found = _found(text, some)
    if not found and any(word not in FUNCTION_WORDS for word in words_of(text)[0]):
        english = understood(text[:1000]).english
        found = [] if english == text else _found(english, some)
    if not found:
        wanted = set(actions_of(text))
        found = [(1.0, one) for one, row in some if wanted & row.actions]
    name = text.lower().replace(" ", "-")
    return [one for _, one in sorted(found, key=lambda pair: (pair[1].name != name, -pair[0], pair[1].name))]


def _found(text: str, some: Sequence[tuple[Clip, _Words]]) -> list[tuple[float, Clip]]:
    from bunraku.language.lexicon import actions_of

    rows, stems, actions = _index()
    typed, wanted = _stems(text), frozenset(actions_of(text)) - {"other"}
    found = []
    for one, row in some:
        score = sum(row.worth(word) * math.log(1 + len(rows) / (1 + stems[word])) for word in typed)
        score += sum(_ACTION * math.log(1 + len(rows) / (1 + actions[action])) for action in wanted & row.actions)
        if score > 0:
            found.append((score, one))
    return found


_EASE = 0.3
"""Share of a pose's change that is left from frame to frame where a clip is held at its end."""


def motion_of(stretch: str, seconds: float | None = None, loop: bool = False) -> HandleMotion:
    """The motion of a stretch on the reference body, for `Clip.motion`."""
    from bunraku.generation.features import decode

    return decode(features_of(stretch, seconds, loop))


def features_of(stretch: str, seconds: float | None = None, loop: bool = False) -> np.ndarray:
    """What the denoiser sees of a stretch (see `generation.features`), shape (N, 271), as long as it is to last.

    Args:
        stretch: A name of the examples (`Clip.stretch`).
        seconds: As of `Clip.motion`.
        loop: As of `Clip.motion`.

    Raises:
        OptionError: It cannot last so long.
        WeightsError: The examples are missing or broken.
    """
    from bunraku.generation.pack import FPS, load_examples
    from bunraku.generation.splicing import held, played

    SECONDS.check(seconds, "seconds")
    pack = load_examples()
    if pack is None:
        raise WeightsError("the clips are stretches of examples.safetensors, which is missing; install Bunraku again")
    number = _numbers(pack).get(stretch)
    if number is None:
        raise WeightsError(f"the examples have no stretch {stretch}; install Bunraku again")
    values, rounds = pack.features(number), pack.examples[number].loop
    if loop and rounds:
        return _rounds(values, rounds, len(values) if seconds is None else round(seconds * FPS))
    if seconds is None:
        return values
    frames = max(round(seconds * FPS), 1)
    if len(values) < frames:
        still = np.zeros(3, values.dtype)
        values = played(values, rounds, frames) if rounds else held(values, frames - len(values), still, _EASE)
    return values[:frames]


def _rounds(values: np.ndarray, loop: tuple[int, int], frames: int) -> np.ndarray:
    """As many whole rounds of a loop as come nearest to so many frames: all that are played on are alike."""
    from bunraku.generation.splicing import played

    start, length = loop[0], loop[0] - loop[1]
    count = max(round(frames / length), 1)
    return played(values, loop, start + count * length)[start : start + count * length]


@functools.lru_cache(maxsize=2)
def _numbers(pack: ExamplePack) -> dict[str, int]:
    """Which example each stretch is."""
    return {one.name: number for number, one in enumerate(pack.examples)}
