"""What things are: where hands meet them, what is done with them, where they are seen, and what walking there is like.

`things.json` has a section for each:

| section | a row |
| --- | --- |
| `kinds` | a kind of thing (see `Kind`), all else as what it `is`; a noun with a number is so high; `unknown`: others |
| `verbs` | what is done with things, and its verbs |
| `defaults` | what is done where no thing is named |
| `parts` | parts of animals that are as high as their heads |
| `sights` | where things are seen (see `Gaze`), and their nouns |
| `sight verbs` | verbs of looking, `seen` those without "at"; `sight words` before a noun say where it is seen |
| `grounds` | how a person walks there (`[grounds]` of `things.toml`), nouns, words before them ("-": none), own verbs |
| `ground verbs` | verbs of walking there, by the word that they stand for: to cross ice is to walk across it |
| `actions` | actions of the lexicon that are no more than walking or looking there, or handling a thing |

Words with underscores stand in a row. A new thing is one word in the nouns of its kind.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from typing import Any, Generic, NamedTuple, TypeVar

from bunraku.language.lexicon import lexicon

_LONGEST = 3
"""Words of a noun at the most."""
Value = TypeVar("Value")


@dataclass(frozen=True)
class Kind:
    """Things that are alike to the hands."""

    name: str  # Of it
    height: float = 0.0  # where palms meet it, for a body of 1.84 m [m]; 0 for none
    head: float = 0.0  # where its head is [m]; 0 for none
    surface: str = "front"  # which way what is touched faces: "top", "front", or "grip" for a bar or a handle ahead
    hands: str = ""  # by which it is taken: "both", "one", "" for either
    place: bool = False  # things are put there, and taken from there
    # what is done with it (`[deeds]` of `things.toml`) by what its verb says
    deeds: dict[str, str] = field(default_factory=dict)
    # how a person walks with it (`[grounds]` there) by what a verb says
    going: dict[str, str] = field(default_factory=dict)
    kinds: frozenset[str] = frozenset()  # its own name, and those of the kinds that it is


class Gaze(NamedTuple):
    """Where a thing is seen."""

    pitch: float = 0.0  # how far the gaze is down [degrees]
    sweep: float = 0.0  # how far it goes to both sides [degrees]
    lean: float = 0.0  # how far the trunk leans over it [degrees]


class Ground(NamedTuple):
    """A meaning of a word for what is walked on or in."""

    name: str  # of `[grounds]` in `things.toml`
    after: frozenset[str]  # words that stand before it there


class Named(NamedTuple, Generic[Value]):
    """A noun of a text."""

    start: int  # the number of its first word
    stop: int  # the number of the word after its last
    means: Value  # what it is

    @property
    def span(self) -> range:
        """The numbers of its words."""
        return range(self.start, self.stop)


@dataclass(frozen=True)
class Things:
    """The tables, ready to be looked up."""

    kinds: dict[str, Kind]  # what each noun is, with its own height
    verbs: dict[str, str]  # what each form of a verb says is done
    defaults: dict[str, str]  # what is done where no thing is named
    parts: frozenset[str]  # parts of animals that are as high as their heads
    # where what a noun means is seen, the likeliest first, each with the name of the row
    gazes: dict[str, list[tuple[str, Gaze]]]
    unknown: Kind  # what a thing is that no noun says
    level: Gaze  # where such a thing is seen
    looks: dict[str, bool]  # all forms of verbs of looking, and whether what is seen follows without "at"
    ways: dict[str, list[str]]  # names of the rows of `gazes` that a word before a noun says
    grounds: dict[str, list[Ground]]  # what walking is like there
    walks: dict[str, str]  # the word before a ground that each form of a verb of walking stands for; "-" for none
    verb_grounds: dict[str, str]  # the ground that a form of a verb says alone: to wade is to be in water
    actions: dict[str, frozenset[str]]  # actions that are no more than walking or looking there, or handling a thing


@functools.cache
def things() -> Things:
    """The table of the package."""
    file = resources.files("bunraku.language").joinpath("things.json")
    data: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    kinds: dict[str, Kind] = {}
    nouns: dict[str, Kind] = {}
    for name, row in data["kinds"].items():
        kinds[name] = kind = _kind(name, row, kinds.get(row.get("is", ""), Kind("")))
        for said in row.get("nouns", "").split():
            noun, _, height = said.partition("=")
            high = kind
            if height:
                head = kind.head + float(height) - kind.height if kind.head else 0.0
                high = replace(kind, height=float(height), head=head)
            nouns[noun.replace("_", " ")] = high
    gazes: dict[str, list[tuple[str, Gaze]]] = {}
    for name, row in data["sights"].items():
        for said in row["nouns"].split():
            noun, _, pitch = said.partition("=")
            seen = Gaze(float(pitch or row["pitch"]), row.get("sweep", 0.0), row.get("lean", 0.0))
            gazes.setdefault(noun.replace("_", " "), []).append((name, seen))
    grounds: dict[str, list[Ground]] = {}
    for name, row in data["grounds"].items():
        for noun in row["nouns"].split():
            grounds.setdefault(noun.replace("_", " "), []).append(Ground(name, frozenset(row["after"].split())))
    ways: dict[str, list[str]] = {}
    for name, said in data["sight words"].items():
        for word in said.split():
            ways.setdefault(word, []).append(name)
    looks = _by_form({"": data["sight verbs"]})
    seen_verbs = _by_form({"": data["seen"]})
    return Things(
        nouns, _by_form(data["verbs"]), data["defaults"], frozenset(data["parts"].split()), gazes, kinds["unknown"],
        Gaze(float(data["sights"]["level"]["pitch"])), {form: form in seen_verbs for form in looks}, ways, grounds,
        _by_form(data["ground verbs"]),
        _by_form({name: row.get("verbs", "") for name, row in data["grounds"].items()}),
        {name: frozenset(actions) for name, actions in data["actions"].items()},
    )  # fmt: skip


def _kind(name: str, row: dict[str, Any], of: Kind) -> Kind:
    own = {}
    for key in ("height", "head", "surface", "hands", "place"):
        if key in row:
            own[key] = row[key]
    deeds = of.deeds | row.get("deeds", {})
    for what, deed in row.get("deeds", {}).items():
        if not deed:
            del deeds[what]
    return replace(of, name=name, **own, deeds=deeds, going=of.going | row.get("going", {}), kinds=of.kinds | {name})


def _by_form(rows: Mapping[str, str]) -> dict[str, str]:
    """The name of the row of each verb, for the verb, its third person, gerund and past; regular ones of a word that is
    a noun to the lexicon ("hands").
    """
    found, verbs = {}, lexicon().verbs
    for name, said in rows.items():
        for verb in said.split():
            for form in (verb, *verbs.get(verb, (f"{verb}s", f"{verb}ing", f"{verb}ed"))[:3]):
                found[form] = name
    return found


def named_in(table: dict[str, Value], words: Sequence[str], among: range) -> list[Named[Value]]:
    """The nouns of a table among some words, the longest that begin at each."""
    found: list[Named[Value]] = []
    for at in among:
        if found and at < found[-1].stop:
            continue
        for length in range(min(_LONGEST, among.stop - at), 0, -1):
            noun = " ".join(words[at : at + length])
            if noun in table:
                found.append(Named(at, at + length, table[noun]))
                break
    return found
