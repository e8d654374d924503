"""What things are: where hands meet them, what is done with them, where they are seen, and what walking there is like.

`things.json` says it for words of things, animals and places:

| section | a row |
| --- | --- |
| `kinds` | a kind of thing (see `Kind`), all else as what it `is`; a noun with a number is so high; `unknown`: others |
| `verbs` | what is done with things, and its verbs |
| `defaults` | what is done where no thing is named |
| `parts` | parts of animals that are as high as their heads |
| `sights` | where things are seen (see `Sight`), and their nouns |
| `sight verbs` | verbs of who looks, `seen` those without "at"; `sight words` before a noun say where it is seen |
| `grounds` | how somebody walks there (`[grounds]` of `things.toml`), nouns, words before them ("-": none), own verbs |
| `ground verbs` | verbs of who walks there, by the word that they stand for: who crosses ice walks across it |
| `actions` | actions of the lexicon that are no more than walking, or looking, there |

Words with underscores stand in a row. A new thing is one word in the nouns of its kind.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from typing import Any, Generic, NamedTuple, TypeVar

from bunraku.language.lexicon import lexicon

__all__ = ["Ground", "Kind", "Named", "Gaze", "Things", "named_in", "things"]

_LONGEST = 3
"""Words of a noun at the most."""
Value = TypeVar("Value")


@dataclass(frozen=True)
class Kind:
    """Things that are alike to the hands.

    Args:
        name: Of it.
        height: Where palms meet it, for a body of 1.84 m [m]; 0 for none.
        head: Where its head is [m]; 0 for none.
        surface: Which way what is touched faces: "top", "front", or "grip" for a bar or a handle ahead.
        hands: By which it is taken: "both", "one", "" for either.
        place: Things are put there, and taken from there.
        deeds: What is done with it (`[deeds]` of `things.toml`) by what its verb says.
        going: How somebody walks with it (`[grounds]` there) by what a verb says.
        kinds: Its own name, and those of the kinds that it is.
    """

    name: str
    height: float = 0.0
    head: float = 0.0
    surface: str = "front"
    hands: str = ""
    place: bool = False
    deeds: dict[str, str] = field(default_factory=dict)
    going: dict[str, str] = field(default_factory=dict)
    kinds: frozenset[str] = frozenset()


class Gaze(NamedTuple):
    """Where a thing is seen by who looks at it.

    Args:
        pitch: How far the gaze is down [degrees].
        sweep: How far it goes to both sides [degrees].
        lean: How far the trunk leans over it [degrees].
    """

    pitch: float = 0.0
    sweep: float = 0.0
    lean: float = 0.0


class Ground(NamedTuple):
    """A word for what somebody walks on or in.

    Args:
        name: Of `[grounds]` in `things.toml`.
        after: Words that stand before it there.
    """

    name: str
    after: frozenset[str]


class Named(NamedTuple, Generic[Value]):
    """A noun of a text.

    Args:
        start: The number of its first word.
        stop: The number of the word after its last.
        means: What it is.
    """

    start: int
    stop: int
    means: Value


@dataclass(frozen=True)
class Things:
    """The tables, ready to be looked up.

    Args:
        kinds: What each noun is, with its own height.
        verbs: What each form of a verb says is done.
        defaults: What is done where no thing is named.
        parts: Parts of animals that are as high as their heads.
        sights: Where what a noun means is seen, the likeliest first, each with the name of the sight.
        unknown: What a thing is that no noun says.
        level: Where such a thing is seen.
        looks: All forms of verbs of who looks, and whether what is seen follows without "at".
        ways: Names of the sights that a word before a noun says.
        grounds: What walking is like there.
        walks: The word before a ground that each form of a verb of walking stands for; "-" for none.
        treads: How somebody walks by a form of a verb alone: who wades is in water.
        actions: Actions that are no more than walking, or looking, there.
    """

    kinds: dict[str, Kind]
    verbs: dict[str, str]
    defaults: dict[str, str]
    parts: frozenset[str]
    sights: dict[str, tuple[tuple[str, Gaze], ...]]
    unknown: Kind
    level: Gaze
    looks: dict[str, bool]
    ways: dict[str, list[str]]
    grounds: dict[str, tuple[Ground, ...]]
    walks: dict[str, str]
    treads: dict[str, str]
    actions: dict[str, frozenset[str]]


@functools.cache
def things() -> Things:
    """The table of the package."""
    file = resources.files("bunraku.language").joinpath("things.json")
    data: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    kinds: dict[str, Kind] = {}
    nouns: dict[str, Kind] = {}
    for name, row in data["kinds"].items():
        kinds[name] = kind = _kind(name, row, kinds.get(row.get("is", "")))
        for noun in row.get("nouns", "").split():
            word, _, height = noun.partition("=")
            nouns[_spaced(word)] = _as_high(kind, float(height)) if height else kind
    sights: dict[str, list[tuple[str, Gaze]]] = {}
    for name, row in data["sights"].items():
        for noun in row["nouns"].split():
            word, _, pitch = noun.partition("=")
            seen = Gaze(float(pitch or row["pitch"]), row.get("sweep", 0.0), row.get("lean", 0.0))
            sights.setdefault(_spaced(word), []).append((name, seen))
    grounds: dict[str, list[Ground]] = {}
    for name, row in data["grounds"].items():
        for noun in row["nouns"].split():
            grounds.setdefault(_spaced(noun), []).append(Ground(name, frozenset(row["after"].split())))
    verbs, walks = (
        {form: what for what, some in data[table].items() for verb in some.split() for form in _forms(verb)}
        for table in ("verbs", "ground verbs")
    )
    seen = data["seen"].split()
    treads = {
        form: name
        for name, row in data["grounds"].items()
        for verb in row.get("verbs", "").split()
        for form in _forms(verb)
    }
    looks = {form: verb in seen for verb in data["sight verbs"].split() for form in _forms(verb)}
    ways: dict[str, list[str]] = {}
    for name, some in data["sight words"].items():
        for word in some.split():
            ways.setdefault(word, []).append(name)
    same = {name: frozenset(actions) for name, actions in data["actions"].items()}
    return Things(
        nouns, verbs, data["defaults"], frozenset(data["parts"].split()),
        {noun: tuple(found) for noun, found in sights.items()}, kinds["unknown"],
        Gaze(float(data["sights"]["level"]["pitch"])), looks, ways,
        {noun: tuple(found) for noun, found in grounds.items()}, walks, treads, same,
    )  # fmt: skip


def _spaced(noun: str) -> str:
    return noun.replace("_", " ")


def _kind(name: str, row: dict[str, Any], of: Kind | None) -> Kind:
    of = of or Kind("")
    own = {key: row.get(key, getattr(of, key)) for key in ("height", "head", "surface", "hands", "place")}
    deeds = {what: deed for what, deed in (of.deeds | row.get("deeds", {})).items() if deed}
    return Kind(name, **own, deeds=deeds, going=of.going | row.get("going", {}), kinds=of.kinds | {name})


def _as_high(kind: Kind, height: float) -> Kind:
    return replace(kind, height=height, head=kind.head + height - kind.height if kind.head else 0.0)


def _forms(verb: str) -> tuple[str, ...]:
    """A verb, its third person, gerund and past; regular ones of a word that is a noun to the lexicon ("hands")."""
    return (verb, *lexicon().verbs.get(verb, (f"{verb}s", f"{verb}ing", f"{verb}ed"))[:3])


def named_in(table: dict[str, Value], words: Sequence[str], start: int, stop: int) -> list[Named[Value]]:
    """The nouns of a table among the words from one number to another, the longest that begin at each."""
    found: list[Named[Value]] = []
    at = start
    while at < stop:
        for length in range(min(_LONGEST, stop - at), 0, -1):
            noun = " ".join(words[at : at + length])
            if noun in table:
                found.append(Named(at, at + length, table[noun]))
                at += length - 1
                break
        at += 1
    return found
