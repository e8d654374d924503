"""The captions of training, as far as prompts are compared with them: phrases, the forms of their verbs, mirror images.

`captions.json` has the phrases of people, `creature_captions.json` those of creatures, with the verbs in braces.
"""

from __future__ import annotations

import functools
import json
import re
from importlib import resources
from itertools import chain
from typing import Any

from bunraku.language.lexicon import lexicon

_VERB = re.compile(r"\{(\w+)\}")
_SIDED = re.compile(r"\b(?:(left|right)(hand|wards?)?|(counter|anti)?clockwise)\b", re.IGNORECASE)


def conjugate(phrase: str, form: str) -> str:
    """A phrase with its verbs in one form.

    Args:
        phrase: Words with the verbs in braces.
        form: "plain" (walk), "third" (walks) or "gerund" (walking).
    """
    return _VERB.sub(lambda match: _in_form(match.group(1), form), phrase)


def _in_form(verb: str, form: str) -> str:
    """A verb in a form; one that the lexicon does not have by the rules of spelling."""
    if form == "plain":
        return verb
    if verb in lexicon().verbs:
        return lexicon().verbs[verb][form == "gerund"]
    if form == "gerund":
        doubled = len(verb) == 3 and verb[1] in "aeiou" and verb[2] not in "aeiouwxy"  # "wagging"
        return (verb.removesuffix("e") if not verb.endswith("ee") else verb) + verb[-1] * doubled + "ing"
    if verb.endswith("y") and verb[-2] not in "aeiou":
        return verb[:-1] + "ies"
    return verb + ("es" if verb.endswith(("s", "x", "z", "ch", "sh")) else "s")


@functools.cache
def caption_table(name: str) -> dict[str, Any]:
    """What `captions.json`, `creature_captions.json` or another file beside them holds."""
    table: dict[str, Any] = json.loads(resources.files("bunraku.language").joinpath(name).read_text(encoding="utf-8"))
    return table


@functools.cache
def known_phrases() -> tuple[str, ...]:
    """All phrases for people's motions with their verbs in braces, in the order of the file."""
    groups = caption_table("captions.json")["groups"]
    return tuple(dict.fromkeys([phrase for group in groups for phrase in group["phrases"]]))


@functools.cache
def creature_words() -> frozenset[str]:
    """Names of creatures and the phrases for what they do: all that sentences about them are made of."""
    table = caption_table("creature_captions.json")
    kinds = table["kinds"]
    names = [*table["called"], *chain.from_iterable(table["called"].values()), *table["aliases"]]
    names += [name for kind in kinds for name in (*kind["species"], kind.get("name", ""))]
    phrases = [*table["actions"].values(), *[phrases for kind in kinds for phrases in kind["phrases"].values()]]
    return frozenset([*names, *table["actions"], *chain.from_iterable(phrases)])


def is_known_clause(clause: str) -> bool:
    """Whether a clause without a subject is a phrase of people's motions, in the third person, as a gerund or plain."""
    spaces, first = clause.count(" "), clause[:2]
    for phrase in known_phrases():  # only the few that begin and end alike are conjugated
        last = phrase.rpartition(" ")[2]
        ends = "{" in last or clause.endswith(last)
        alike = ends and phrase.count(" ") == spaces and phrase.lstrip("{")[:2] == first
        if alike and clause in (conjugate(phrase, "third"), conjugate(phrase, "gerund"), conjugate(phrase, "plain")):
            return True
    return False


def mirror_words(sentence: str) -> str:
    """The sentence of the mirrored motion: left and right, clockwise and counterclockwise are exchanged."""

    def swap(match: re.Match[str]) -> str:
        word, (side, of, against) = match.group(), match.groups("")
        other = "clockwise" if against else "counterclockwise"
        if side:
            other = ("right" if side.lower() == "left" else "left") + of.lower()
        return other.upper() if word.isupper() else other.capitalize() if word[0].isupper() else other

    return _SIDED.sub(swap, sentence)
