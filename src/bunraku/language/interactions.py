"""What a clause says that the body does with a thing: hands touch it or take it and put it somewhere, feet walk on it,
eyes look at it.

The reader's network says which of these is done (`Reader.dealt`), and what is said of it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from bunraku.language.lexicon import actions_of, lexicon, words_of
from bunraku.language.phrasing import body_stems
from bunraku.language.vocabulary import stems


class Contact(NamedTuple):
    """What hands do with a thing."""

    deed: str  # of `[deeds]` in `things.toml`
    hands: str  # "both", "left", "right", or "one" for either
    height: float = 0.0  # where palms meet the thing, for a body of 1.84 m [m]; 0 where the deed itself says it
    surface: str = "front"  # which way the thing faces there: "top", "front" or "grip"
    way: str = ""  # "left" or "right"; "" for straight ahead


class Terrain(NamedTuple):
    """What is walked on, in, or with."""

    ground: str  # of `[grounds]` in `things.toml`
    height: float = 0.0  # where both palms are that push or pull something [m]; 0 for arms that do nothing of the kind


class Place(NamedTuple):
    """Where a thing is."""

    height: str = ""  # of the lexicon's `levels`; "" where nothing is said of it
    way: str = ""  # "left", "right", or "" for straight ahead


class HandlingStep(NamedTuple):
    """One thing that is done with what is handled."""

    does: str  # "take", "hold" or "put"
    place: Place  # where


@dataclass(frozen=True)
class Handling:
    """What is taken, held and put somewhere."""

    steps: tuple[HandlingStep, ...]  # one after the other; all heights are given
    hands: str  # "both", "left", "right", or "one" for either

    @property
    def only_held(self) -> bool:
        """Whether a thing is held all the time."""
        return all(step.does == "hold" for step in self.steps)

    @property
    def said(self) -> bool:
        """Whether more is said than that something is taken from the floor, put down there or carried, as people were
        captured.
        """
        moved = {"take", "put"} <= {step.does for step in self.steps}
        return moved or self.hands in ("left", "right") or any(map(_says_where, self.steps))


class Gaze(NamedTuple):
    """Where a thing is seen."""

    pitch: float = 0.0  # how far the gaze is down [degrees]
    sweep: float = 0.0  # how far it goes to both sides [degrees]
    lean: float = 0.0  # how far the trunk leans over it [degrees]


Interaction = Handling | Contact | Terrain | Gaze
_Kind = TypeVar("_Kind", Handling, Contact, Terrain, Gaze)

_EYES, _AWAY = 1.7, 1.6
"""Height of the eyes of a body of 1.84 m, and how far away a person stands from a thing that hands meet, chosen by eye
[m].
"""
_NEAR = 1.6
"""Tokens between what is done with a thing and an action of the same verb at the most; chosen on the sentences of
tests/language/test_interactions.py.
"""


def read_as(kind: type[_Kind], text: str) -> _Kind | None:
    """What a clause says of one kind of interaction; None where it says nothing of that, or something else beside it.

    Args:
        kind: `Contact`, `Terrain`, `Gaze` or `Handling`.
        text: In English.
    """
    meaning = interaction_of(text)
    return meaning if isinstance(meaning, kind) else None


@functools.lru_cache(maxsize=4096)
def interaction_of(text: str) -> Interaction | None:
    """What a clause says that is done with a thing, or what follows from where a person walks or looks; None where it
    says nothing of that, or something else beside it.

    Args:
        text: In English.
    """
    from bunraku.language.reader import frames_of, load_reader, unlearned_in  # numpy

    reader = load_reader()
    dealt = reader.dealt(text)
    if not dealt or unlearned_in(text):
        return None
    surest, rows = max(dealt, key=lambda frame: frame.probability), lexicon().actions
    kind, _, name = surest.action.partition(" ")
    steps = [frame for frame in dealt if " " not in frame.action] if not name else [surest]
    gestures, beside_it = [one for one in actions_of(text) if rows[one].gesture], lexicon().reading["beside things"]
    same = set(beside_it[kind if name else ""]).union(*(reader.together[frame.action] for frame in steps))
    if kind == "sight" and not set(beside_it["sight"]).issuperset(gestures):
        return None  # "looks at his watch", "looks up at the sky" say a gesture
    for frame in frames_of(text):
        beside = min(abs(frame.at - other.at) for other in steps) > _NEAR
        if beside and frame.action not in same and not rows[frame.action].vague:
            return None
    fields, height = surest.fields, float(surest.fields.get("height", 0.0))
    if kind == "deed":
        words, grammar = set(words_of(text)[0]), lexicon().grammar
        if not words & grammar["things"] and body_stems().intersection(stems(sorted(words - grammar["hands"]))):
            return None  # the own body is touched
        way = fields.get("direction", "")
        hands, surface = fields.get("side", "one"), fields.get("surface", "front")
        return Contact(name, hands, height, surface, way if way in ("left", "right") else "")
    if kind == "ground":
        return Terrain(name, height)
    if kind == "sight":
        return Gaze(*(lexicon().reading["gazes"].get(name) or (math.degrees(math.atan2(_EYES - height, _AWAY)),)))
    places = [HandlingStep(frame.action, _place(frame.fields)) for frame in steps]
    chest = HandlingStep("hold", Place("chest"))
    before, after = [chest] * (places[0].does == "put"), [chest] * (places[-1].does == "take")
    sides = [frame.fields["side"] for frame in steps if "side" in frame.fields]
    return Handling((*before, *places, *after), sides[0] if sides else "one")


def says_more(detail: object) -> bool:
    """Whether it is an interaction, and more than what people were captured doing with things."""
    return isinstance(detail, Interaction) and (not isinstance(detail, Handling) or detail.said)


def _place(fields: dict[str, str]) -> Place:
    height, levels, way = float(fields.get("height", 1.3)), lexicon().levels, fields.get("direction", "")
    level = min(levels, key=lambda name: abs(levels[name] - height))
    return Place(level, way if way in ("left", "right") else "")


def _says_where(step: HandlingStep) -> bool:
    """Whether a step says more than that a thing is taken from the floor, or put down there."""
    usual = ("chest",) if step.does == "hold" else ("floor", "chest")
    return bool(step.place.way) or step.place.height not in usual


def with_names(clauses: Sequence[str]) -> list[str]:
    """Clauses in a row with the thing of the clause before in place of "it", where something is done with that: "walks
    to the window", "opens the window".
    """
    texts: list[str] = []
    last, grammar = "", lexicon().grammar
    for text in clauses:
        words, spans = words_of(text)
        for at in range(1, len(words)):
            if last and words[at] in ("it", "them", "its") and words[at - 1] in lexicon().lemmas:
                of = "'s" if words[at] == "its" else ""
                said = f"{text[: spans[at][0]]}the {last}{of}{text[spans[at][1] :]}"
                text = said if read_as(Contact, said) else text
                break
        texts.append(text)
        last = next((word for word in reversed(words) if word in grammar["things"]), last)
    return texts
