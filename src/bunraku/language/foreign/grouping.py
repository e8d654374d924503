"""The words of a sentence grouped: numbers with what they count, sides with their parts, and all with their verbs, in
the order in which things happen.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from bunraku.language.foreign.table import Concept, table

__all__ = ["OWN", "Clause", "clauses_of", "head_of", "with_article"]

OWN = {
    "wave": ("hand", "arm"), "clap": ("hand",), "kick": ("foot", "leg"), "nod": ("head",), "punch": ("fist", "hand"),
    "box": ("fist", "hand"), "point": ("finger", "hand"), "bow": ("head", "body"), "salute": ("hand",),
    "walk": ("foot", "leg"), "stomp": ("foot",), "crouch": ("knee",), "shrug": ("shoulder",), "hit": ("hand", "fist"),
    "grab": ("hand",), "step": ("foot", "leg"), "jump": ("leg", "body"), "dance": ("body",), "turn": ("body",),
    "bend": ("back", "body"), "stoop": ("back", "body"), "wag": ("tail",), "flap": ("wing",), "greet": ("hand",),
}  # fmt: skip
"""Parts that go without saying with a verb, unless the sentence names their side."""
_ADJECTIVES_ONLY = frozenset({"old", "young", "big", "small"})
_COUNT = {"1": "once", "2": "twice"}
_NAMES = ("", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


@dataclass
class Clause:
    """A verb with what belongs to it.

    Args:
        link: The connector before it: "then", "and", "while", "comma", or "".
        subject: Who does it, where that is said anew.
        verb: In English with braces; "" where the verb before it goes on.
        items: Parts, directions, manners and the like.
    """

    link: str = ""
    subject: str = ""
    verb: str = ""
    items: list[Concept] = field(default_factory=list)


def clauses_of(concepts: Sequence[Concept], language: str) -> list[Clause]:
    """What a sentence says in the order in which it happens, a clause for each verb.

    Args:
        concepts: What a scan found.
        language: "de", "fr", "es", "ja" or "zh".
    """
    words = [concept for concept in concepts if concept.kind not in ("ignored", "unknown") or concept.value in _MARKERS]
    words = _parts(_measures(words), part_first=language in ("fr", "es"))
    return _ordered(_clauses(words, language), asian=language in ("ja", "zh"))


def _name(number: str) -> str:
    return _NAMES[int(number)] if number.isdigit() and 0 < int(number) < len(_NAMES) else number


def with_article(noun: str) -> str:
    """ "a dog", "an old man"."""
    return ("an " if noun[0] in "aeiou" else "a ") + noun


_MARKERS = frozenset("用把将在向往朝")
"""Chinese words before what belongs to the verb after it."""


def _measures(words: Sequence[Concept]) -> list[Concept]:
    """Numbers with what they count: "three steps", "twice", "90 degrees"; sides said of one part as "both"."""
    found: list[Concept] = []
    index = 0
    while index < len(words):
        word = words[index]
        after = words[index + 1] if index + 1 < len(words) else None
        if word.kind == "times":
            word = replace(word, kind="count", value=_times(word.value.split()[0]))
        elif word.kind == "number" and after and after.kind == "unit":
            kind = "count" if after.value in ("times", "turns") else after.value
            word = replace(word, kind=kind, value=_measure(word.value, after.value), stop=after.stop)
            index += 1
        elif word.kind == "number" and after and after.kind == "part" and word.value in ("1", "2"):
            word = replace(word, kind="side", value="one" if word.value == "1" else "both")
        elif word.kind == "unit":
            if word.value != "steps":
                index += 1
                continue
            word = replace(word, kind="steps", value="a step")
        elif word.kind == "side":
            pair = words[index : index + 3]
            if [one.kind for one in pair] == ["side", "and", "side"] and pair[0].value != pair[2].value:
                word, index = replace(word, value="both"), index + 2
        found.append(word)
        index += 1
    return found


def _times(number: str) -> str:
    return _COUNT.get(number) or f"{_name(number)} times"


def _measure(number: str, unit: str) -> str:
    if unit in ("times", "turns"):
        return _times(number)
    if unit == "steps":
        return "one step" if number == "1" else f"{_name(number)} steps"
    return f"{'for ' if unit == 'seconds' else ''}{number} {unit}"


def _parts(words: Sequence[Concept], part_first: bool) -> list[Concept]:
    """Sides joined with their parts: "the left hand"; a side alone is a direction."""
    found: list[Concept] = []
    skip: set[int] = set()
    kinds = {index: word for index, word in enumerate(words) if not (word.kind == "number" or word.value in _MARKERS)}
    for index, word in enumerate(words):
        if word.kind != "side":
            continue
        ways = ((-1, 1) if word.value in ("left", "right") else (1, -1)) if part_first else (1, -1)
        for way in ways:
            near = index + way
            if near in kinds and kinds[near].kind == "part" and near not in skip:
                part = kinds[near]
                skip.update((index, near))
                value = f"{word.value} {part.value}"
                found.append(Concept("part", value, min(word.start, part.start), max(word.stop, part.stop), part.mark))
                break
    last = ""  # the part that a side alone goes back to: "el brazo izquierdo y luego el derecho"
    for index, word in enumerate(words):
        last = word.value if word.kind == "part" else "" if word.kind == "verb" else last
        if index in skip:
            continue
        if word.kind == "side" and last and word.value in ("left", "right"):
            found.append(replace(word, kind="part", value=f"{word.value} {last}"))
        elif word.kind == "side":
            near = index - 1 if part_first else index + 1
            verb = words[near] if 0 <= near < len(words) else None  # 左手を振る, "salue de la main gauche"
            if verb and verb.kind == "verb" and head_of(verb.value) in OWN:
                value = f"{word.value} {OWN[head_of(verb.value)][0]}/"
                found.append(replace(word, kind="part", value=value))
            elif word.value in ("left", "right"):
                found.append(replace(word, kind="direction", value=f"to the {word.value}"))
        else:
            found.append(word)
    return sorted(found, key=lambda word: word.start)


def head_of(verb: str) -> str:
    """The verb alone: "raise" of "{raise} <the arms>"."""
    match = re.search(r"\{(\w+)\}", verb)
    return match.group(1) if match else ""


def _clauses(words: Sequence[Concept], language: str) -> list[Clause]:
    """Verbs with what belongs to each."""
    clauses = [Clause()]
    waiting: list[Concept] = []  # Chinese: what stands before its verb
    ahead, like = False, False
    for index, word in enumerate(words):
        now = clauses[-1]
        if word.kind == "ignored":
            ahead = True
        elif word.kind in ("then", "and", "while", "before", "after", "first", "comma", "stop"):
            now.items += waiting
            waiting, ahead = [], False
            kind = "comma" if word.kind == "stop" else word.kind
            if word.mark == "inside":
                now.link = "then" if len(clauses) > 1 else now.link
                continue
            if kind == "first":
                continue
            if kind == "comma" and language == "ja":
                continue
            if now.verb or now.items:
                clauses.append(Clause(link=kind))
            elif kind in ("while", "before", "after") or not now.link or now.link == "comma":
                now.link = kind
        elif word.kind == "verb":
            if now.verb and _same(now.verb, word.value):
                if len(word.value) > len(now.verb):
                    now.verb = word.value
                continue
            if now.verb in ("{walk}", "{go}") and word.mark == "adverb":
                now.verb = word.value
                continue
            if now.verb == "{go}" and (word.mark == "infinitive" or language == "zh") and not now.items:
                now.verb = word.value
                continue
            if now.verb:
                link = "while" if word.mark == "gerund" else "then" if language in ("ja", "zh") else "and"
                clauses.append(Clause(link=link))
                now = clauses[-1]
            now.verb = word.value
            now.items += waiting
            waiting, ahead = [], False
            if language == "ja" and index + 1 < len(words):
                after = words[index + 1].kind
                if after not in ("then", "and", "while", "before", "after", "stop") and _verb_later(words, index):
                    clauses.append(Clause(link="then"))
        elif word.kind == "like":
            if language == "ja" and now.items and now.items[-1].kind in ("being", "noun"):
                now.items[-1] = replace(now.items[-1], kind="likeness")
            elif language == "ja" and now.subject and not now.verb:
                now.items.append(replace(word, kind="likeness", value=now.subject))
                now.subject = ""
            else:
                like = True
        elif word.kind in ("being", "noun") and like:
            (waiting if ahead else now.items).append(replace(word, kind="likeness"))
            like = False
        elif word.kind == "being" and not now.subject and not (now.verb and "<" in now.verb):
            now.subject = word.value
        elif word.kind == "number":
            continue
        elif language == "zh" and now.verb and (ahead or word.kind in ("direction", "manner")):
            waiting.append(word)
        else:
            now.items.append(word)
    clauses[-1].items += waiting
    return _adjectives([clause for clause in clauses if clause.verb or clause.items or clause.subject])


def _same(one: str, other: str) -> bool:
    return head_of(one) == head_of(other) and (one.startswith(other) or other.startswith(one))


def _verb_later(words: Sequence[Concept], index: int) -> bool:
    return any(word.kind == "verb" for word in words[index + 1 :])


def _adjectives(clauses: list[Clause]) -> list[Clause]:
    """Manners said of the subject before or after it go in front of its name; verbless beginnings join what follows."""
    rows = {row["en"].split("/")[0]: row["en"].split("/")[1] for row in table()["manners"]}
    while len(clauses) > 1 and not clauses[0].verb and not any(item.kind == "steps" for item in clauses[0].items):
        first, second = clauses[0], clauses[1]
        subject = " and ".join(with_article(one) for one in (first.subject, second.subject) if one)
        link = first.link if first.link in ("while", "before", "after") else ""
        clauses[:2] = [Clause(link, subject or "", second.verb, first.items + second.items)]
    for clause in clauses:
        kept = []
        for item in clause.items:
            adverb = item.value.split("/")[0]
            if item.kind == "manner" and adverb in _ADJECTIVES_ONLY:
                if clause.subject and not clause.subject.startswith(("a ", "an ")):
                    clause.subject = f"{rows[adverb]} {clause.subject}"
            elif item.kind == "manner":
                kept.append(replace(item, value=adverb))
            else:
                kept.append(item)
        clause.items = kept
    return clauses


def _ordered(clauses: list[Clause], asian: bool) -> list[Clause]:
    """Clauses in the order in which things happen: "before" and "after" become "then"."""
    found: list[Clause] = []
    index = 0
    while index < len(clauses):
        clause = clauses[index]
        after = clauses[index + 1] if index + 1 < len(clauses) else None
        if asian and after and after.link == "before" and after.verb:  # "before" stands after its verb
            found += [replace(after, link=clause.link, subject=clause.subject or after.subject)]
            found += [replace(clause, link="then", subject="")]
            index += 2
            continue
        if not asian and clause.link in ("before", "after"):
            if not found and after:  # "bevor er springt, läuft er"
                first, second = (after, clause) if clause.link == "before" else (clause, after)
                subject = clause.subject or after.subject
                found += [replace(first, link="", subject=subject), replace(second, link="then", subject="")]
                index += 2
                continue
            if found and clause.link == "after":
                last = found.pop()
                found += [replace(clause, link=last.link, subject=last.subject), replace(last, link="then", subject="")]
                index += 1
                continue
            clause = replace(clause, link="then" if found else "")
        found.append(clause)
        index += 1
    if len(found) > 1:
        first, second = found[:2]
        leads = first.link == "while" and second.link != "while"  # "während er läuft, winkt er"
        if leads or (asian and second.link == "while" and first.link != "while"):  # 歩きながら手を振る
            subject = first.subject or second.subject
            found[:2] = [replace(second, link="", subject=subject), replace(first, link="while", subject="")]
    return found
