"""English from the words of a sentence, in the style of the captions: "a person walks forward, then waves with the left
hand".

Order, sides and numbers are kept; how the words of one clause stand in it is English: verb, what it is done to,
direction, manner, how often.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import replace

from bunraku.language.captions.grammar import conjugate
from bunraku.language.foreign.grouping import OWN, Clause, clauses_of, head_of, with_article
from bunraku.language.foreign.table import Concept, table
from bunraku.language.lexicon.reading import actions_of, goes_ahead

__all__ = ["english_sentence"]

_ON = frozenset({"stand", "hop", "balance", "jump", "kneel", "lie", "crawl", "sit", "land", "leap", "spin", "turn"})
"""Verbs that are done on a part; others with it."""
_PLACES = frozenset({"chair", "bench", "table", "window", "wall", "tree", "car", "stairs", "door"})
_CLIMBED = frozenset({"stairs", "ladder", "tree", "wall"})
_TOUCHED = frozenset({"stretch", "touch", "rub", "grab", "hold", "wipe", "wash"})
_BARE = frozenset({"something", "water", "music"})
_SLOT = re.compile(r"<([^>]*)>")
_SIDEWAYS = ("to the left", "to the right")


def english_sentence(concepts: Sequence[Concept], language: str) -> str:
    """The sentence; "" where no word of it is in the table.

    Args:
        concepts: What a scan found.
        language: "de", "fr", "es", "ja" or "zh".
    """
    clauses = clauses_of(concepts, language)
    return _joined(clauses) if any(clause.verb or clause.items for clause in clauses) else ""


def _joined(clauses: list[Clause]) -> str:
    subject = next((clause.subject for clause in clauses if clause.subject), "person")
    text = subject if subject.startswith(("a ", "an ")) else with_article(subject)
    plural = " and " in text
    last = next((index for index in range(len(clauses) - 1, 0, -1) if clauses[index].link == "and"), 0)
    verb = ""
    for index, clause in enumerate(clauses):
        if not clause.verb and any(item.kind == "part" for item in clause.items):
            clause = replace(clause, verb=verb)  # "raises the left arm, then raises the right arm"
        verb = clause.verb or verb
        phrase = _phrase(clause)
        own = f"{with_article(clause.subject)} " if index and clause.subject and clause.subject != subject else ""
        if not index:
            text += " " + conjugate(phrase, "plain" if plural else "third")
        elif clause.link == "while" and clause.verb:
            text += " while " + conjugate(phrase, "gerund")
        else:
            form = "plain" if plural and not own else "third"
            listed = clause.link == "comma" and index < last and clause.verb
            link = " and " if clause.link == "and" else ", " if listed else ", then "
            text += link + own + conjugate(phrase, form)
    return re.sub(r"\bt-pose\b", "T-pose", " ".join(text.split()))


def _phrase(clause: Clause) -> str:
    """A clause without its subject, the verb in braces."""
    items, verb = list(clause.items), clause.verb
    steps = next((item for item in items if item.kind == "steps"), None)
    if steps and (not verb or head_of(verb) == "step"):  # "takes three steps back"
        verb = f"{{take}} {steps.value}{verb.replace('{step}', '').rstrip()}"
        items.remove(steps)
    if verb.startswith("{turn} around") and any(item.kind == "degrees" or item.value in _SIDEWAYS for item in items):
        verb = "{turn}"
    head, slot = head_of(verb), _SLOT.search(verb)
    given = None
    if slot:
        given = _object(items, slot.group(1), head)
        verb = _SLOT.sub(_named(given, slot.group(1)) if given else slot.group(1), verb)
    phrases = [_said(item, verb, head, bool(slot)) for item in items if item is not given]
    described = dict.fromkeys(text for _, text in sorted(phrases, key=lambda phrase: phrase[0]) if text)
    return " ".join([verb, *described]).strip()


def _object(items: Sequence[Concept], default: str, head: str) -> Concept | None:
    """What a verb is done to: a part of the body where that is usual, or else a thing or somebody."""
    bodily = default.removeprefix("the ") in _body()
    if bodily or head in _TOUCHED:
        part = next((item for item in items if item.kind == "part"), None)
        if part:
            return part
    kinds = ("noun",) if bodily else ("noun", "being")
    return next((item for item in items if item.kind in kinds), None)


def _named(item: Concept, default: str) -> str:
    if item.kind == "part":
        said = _part(item)
        unsaid = said.removeprefix("the ") == default.removeprefix("the ").rstrip("s") and not item.mark
        return default if unsaid and not _sided(item) else said
    name = item.value.partition("/")[0]
    return name if name in _BARE else with_article(name)


def _said(item: Concept, verb: str, head: str, slot: bool) -> tuple[float, str]:
    """What a word adds after the verb, and its place there."""
    words = verb.split()
    if item.kind == "part":
        if head == "move" and not slot:
            return 0, _part(item)
        if not _sided(item) and item.value.split("/")[0] in OWN.get(head, ()):
            return 1, ""
        return 1, f"{'on' if head in _ON and not slot else 'with'} {_part(item)}"
    if item.kind in ("noun", "being"):
        name, _, position = item.value.partition("/")
        if name in words or (name == "water" and slot):
            return 2, ""
        if head == "climb" and name in _CLIMBED:
            return 1, "the stairs" if name == "stairs" else with_article(name)
        if item.kind == "noun" and name in _PLACES and goes_ahead(actions_of(conjugate(f"{{{head}}} to", "third"))):
            return 2, f"to the {name}"
        if "} up" in verb and head in ("stand", "get"):
            return 2, position.replace("on ", "from ")
        return 2, position or f"with {with_article(name)}"
    if item.kind == "likeness":
        return 4, f"like {with_article(item.value.split('/')[0])}"
    if item.kind == "direction":
        value = item.value.removeprefix("to the ") if item.value in _SIDEWAYS and head == "turn" else item.value
        double = (value == "backward" and "back" in words) or value.split()[-1] in words or (head, value) in _DOUBLE
        return 3, "" if double else value
    order = {"steps": 0, "degrees": 3.5, "manner": 4, "count": 5, "seconds": 6}.get(item.kind)
    return (order, item.value) if order is not None and item.value not in words else (9, "")


@functools.cache
def _body() -> frozenset[str]:
    return frozenset(name for row in table()["parts"] for name in row["en"].split("/"))


_DOUBLE = {("raise", "up"), ("lower", "down"), ("lift", "up"), ("climb", "up"), ("sit", "down"), ("fall", "down")}


def _sided(item: Concept) -> bool:
    return item.value.startswith(("left ", "right ", "both ", "one "))


def _part(item: Concept) -> str:
    """ "the left hand", "both hands", "one leg", "the arms"."""
    side, _, rest = item.value.rpartition(" ") if _sided(item) and "/" not in item.value else ("", "", item.value)
    if not side and _sided(item):
        side, rest = item.value.split(" ", 1)
    one, _, many = rest.partition("/")
    if side == "both":
        return f"both {many or one + 's'}"
    if side == "one":
        return f"one {one}"
    name = many if item.mark == "plural" and not side else one
    return f"the {side} {name}" if side else f"the {name}"
