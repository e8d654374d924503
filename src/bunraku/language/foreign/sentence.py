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

from bunraku.language.foreign.grouping import OWN, Clause, clauses_of, head_of, with_article
from bunraku.language.foreign.table import Concept, table
from bunraku.language.grammar import conjugate

__all__ = ["english_sentence"]

_ON = frozenset({"stand", "hop", "balance", "jump", "kneel", "lie", "crawl", "sit", "land", "leap", "spin", "turn"})
"""Verbs that are done on a part; others with it."""
_GOES = frozenset({"walk", "run", "go", "come", "sneak", "crawl", "jog", "stroll", "march", "limp", "hurry", "rush"})
_PLACES = frozenset({"chair", "bench", "table", "window", "wall", "tree", "car", "stairs", "door"})
_TOUCHED = frozenset({"touch", "rub", "grab", "hold", "wipe", "wash"})
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
    items = list(clause.items)
    verb = clause.verb
    steps = next((item for item in items if item.kind == "steps"), None)
    if steps and (not verb or head_of(verb) == "step"):
        verb = verb.replace("{step}", "") or " "
        verb = f"{{take}} {steps.value}{verb.rstrip()}"
        items.remove(steps)
    head = head_of(verb)
    if verb.startswith("{turn} around") and any(item.kind == "degrees" or item.value in _SIDEWAYS for item in items):
        verb = "{turn}"
    slot = _SLOT.search(verb)
    given = ""
    phrases: list[tuple[float, str]] = []
    for item in items:
        if item.kind == "part":
            said = _part(item)
            default = slot.group(1) if slot else ""
            bodily = default.removeprefix("the ") in _body() or head in _TOUCHED
            if slot and bodily and not given:
                unsaid = said.removeprefix("the ") == default.removeprefix("the ").rstrip("s") and not item.mark
                given = default if unsaid and not _sided(item) else said
            elif head == "move" and not slot:
                phrases.append((0, said))
            elif _sided(item) or item.value.split("/")[0] not in OWN.get(head, ()):
                phrases.append((1, f"{'on' if head in _ON and not slot else 'with'} {said}"))
        elif item.kind in ("noun", "being"):
            name, _, place = item.value.partition("/")
            if slot and not given and slot.group(1).removeprefix("the ") not in _body():
                given = name if name in _BARE else with_article(name)
            elif name in verb:
                continue
            elif item.kind == "noun" and head in _GOES and name in _PLACES:
                phrases.append((2, f"to the {name}"))
            elif "} up" in verb and head in ("stand", "get"):
                phrases.append((2, place.replace("on ", "from ")))
            else:
                phrases.append((2, place or f"with {with_article(name)}"))
        elif item.kind == "likeness":
            phrases.append((4, f"like {with_article(item.value.split('/')[0])}"))
        elif item.kind == "direction":
            value = item.value
            if value in _SIDEWAYS and head == "turn":
                value = value.removeprefix("to the ")
            double = value == "backward" and "back" in verb.split()
            if not double and value.split()[-1] not in verb.split() and (head, value) not in _SAID:
                phrases.append((3, value))
        elif item.kind in ("manner", "count", "seconds", "degrees", "steps"):
            order = {"steps": 0, "degrees": 3.5, "manner": 4, "count": 5, "seconds": 6}[item.kind]
            if item.value not in verb.split():
                phrases.append((order, item.value))
    verb = _SLOT.sub(given or (slot.group(1) if slot else ""), verb)
    return " ".join([verb, *dict.fromkeys(text for _, text in sorted(phrases, key=lambda phrase: phrase[0]))]).strip()


@functools.cache
def _body() -> frozenset[str]:
    return frozenset(name for row in table()["parts"] for name in row["en"].split("/"))


_SAID = {("raise", "up"), ("lower", "down"), ("lift", "up"), ("climb", "up"), ("sit", "down"), ("fall", "down")}


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
