"""Captions: short motion labels as sentences that people type, and the grammar that makes them."""

from __future__ import annotations

import functools
import json
import random
import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from itertools import chain
from typing import Any

__all__ = [
    "CaptionGroup",
    "caption",
    "caption_clauses",
    "caption_group",
    "caption_variants",
    "conjugate",
    "creature_clauses",
    "creature_names",
    "creature_variants",
    "creature_words",
    "fill",
    "is_known_clause",
    "is_stative",
    "known_clauses",
    "known_phrases",
    "mirror_words",
    "normalise_label",
    "person_phrases",
    "sentence_forms",
]


_VERB = re.compile(r"\{(\w+)\}")
_DOUBLED = {
    "beg", "begin", "bob", "chat", "chop", "clap", "cut", "dig", "dip", "drag", "drop", "fit", "flap", "flip", "flop",
    "get", "grab", "hit", "hop", "hug", "jab", "jog", "jut", "let", "lug", "mop", "nap", "nod", "pad", "pat", "peg",
    "pin", "plan", "plod", "pop", "put", "ram", "rip", "rub", "run", "scan", "scrub", "set", "shrug", "shut",
    "sidestep", "sip", "sit", "skip", "slam", "slap", "slip", "snap", "spar", "spin", "squat", "stab", "step", "stop",
    "strut", "stun", "swat", "swim", "tap", "tip", "trip", "trot", "wag", "whip", "win", "wrap", "zigzag",
}  # fmt: skip
_GERUNDS = {
    "lie": "lying",
    "die": "dying",
    "be": "being",
    "tiptoe": "tiptoeing",
    "panic": "panicking",
    "boogie": "boogieing",
    "mimic": "mimicking",
}
_THIRD = {"be": "is", "do": "does", "go": "goes", "have": "has", "undergo": "undergoes"}

_ALWAYS = ("a person {third}", "a person is {gerund}", "{plain}", "{third}", "{gerund}")
_SOMETIMES = (
    "someone {third}", "the character {third}", "a human {third}", "the person {third}", "he {third}", "she {third}",
    "a man {third}", "a woman {third}", "somebody {third}", "the figure {third}", "it {third}",
    "the character is {gerund}",
    "someone is {gerund}", "a character {gerund}", "he is {gerund}", "she is {gerund}", "a person {gerund}",
    "make the character {plain}",
    "can you make it {plain}", "please {plain}", "let the person {plain}", "make it {plain}", "this person {third}",
    "a guy {third}",
)  # fmt: skip
# of the second list, a few for each phrase: all of them for all would be tens of thousands of sentences to encode
_DRAWN = 4


def _gerund(verb: str) -> str:
    if verb in _GERUNDS:
        return _GERUNDS[verb]
    if verb in _DOUBLED:
        return verb + verb[-1] + "ing"
    if verb.endswith("e") and not verb.endswith(("ee", "oe", "ye")):
        return verb[:-1] + "ing"
    return verb + "ing"


def _third(verb: str) -> str:
    if verb in _THIRD:
        return _THIRD[verb]
    if verb.endswith(("s", "x", "z", "ch", "sh")):
        return verb + "es"
    if verb.endswith("y") and verb[-2] not in "aeiou":
        return verb[:-1] + "ies"
    return verb + "s"


def conjugate(phrase: str, form: str) -> str:
    """A phrase with its verbs in one form.

    Args:
        phrase: Words with the verbs in braces.
        form: "plain" (walk), "third" (walks) or "gerund" (walking).
    """
    change: dict[str, Callable[[str], str]] = {"plain": str, "third": _third, "gerund": _gerund}
    return _VERB.sub(lambda match: change[form](match.group(1)), phrase)


def is_stative(phrase: str) -> bool:
    """Whether the progressive of a phrase is no English: nobody "is being angry"."""
    return phrase.startswith("{be}")


def fill(frame: str, phrase: str) -> str:
    """A frame such as "someone is {gerund}" with the phrase in that form."""
    return _VERB.sub(lambda match: conjugate(phrase, match.group(1)), frame)


def sentence_forms(phrase: str) -> list[str]:
    """A phrase as sentences about people: third person, progressive, imperative, gerund, and a few more drawn by its
    spelling.

    Args:
        phrase: Words with the verbs in braces.
    """
    first = zlib.crc32(phrase.encode())
    frames = [*_ALWAYS, *(_SOMETIMES[(first + 5 * step) % len(_SOMETIMES)] for step in range(_DRAWN))]
    return [fill(frame, phrase) for frame in frames if not (is_stative(phrase) and "gerund" in frame)]


_MIRRORED = {
    "left": "right",
    "lefthand": "righthand",
    "leftward": "rightward",
    "leftwards": "rightwards",
    "clockwise": "counterclockwise",
    "anticlockwise": "clockwise",
}
_MIRRORED = {value: key for key, value in _MIRRORED.items() if key != "anticlockwise"} | _MIRRORED
_SIDE = re.compile(r"\b(" + "|".join(sorted(_MIRRORED, key=len, reverse=True)) + r")\b", re.IGNORECASE)
_HUMAN = re.compile(r"^(a|the|one) (person|human|man|woman|figure|character|persons|humans)\b|^someone\b")


@dataclass(frozen=True)
class CaptionGroup:
    """Labels of one meaning.

    Args:
        name: The first label, which names the group.
        phrases: Rewordings with verbs in braces; none for a label that the file does not know.
        weight: How often to draw its clips, 1 for most, less where a label says little.
    """

    name: str
    phrases: tuple[str, ...]
    weight: float = 1.0


def normalise_label(label: str) -> str:
    """A label in lower case with single spaces and no full stop."""
    return " ".join(label.lower().replace("_", " ").split()).rstrip(" .")


@functools.cache
def _table(name: str) -> dict[str, Any]:
    table: dict[str, Any] = json.loads(resources.files("bunraku.language").joinpath(name).read_text(encoding="utf-8"))
    return table


@functools.cache
def _groups() -> dict[str, CaptionGroup]:
    found: dict[str, CaptionGroup] = {}
    for entry in _table("captions.json")["groups"]:
        group = CaptionGroup(entry["labels"][0], tuple(entry["phrases"]), float(entry["weight"]))
        found.update(dict.fromkeys(entry["labels"], group))
    return found


def caption_group(label: str) -> CaptionGroup:
    """The group of a label; a label that the file does not know is a group of its own."""
    label = normalise_label(label)
    return _groups().get(label) or CaptionGroup(label, ())


@functools.cache
def known_phrases() -> tuple[str, ...]:
    """All phrases for people's motions with their verbs in braces, in the order of the file."""
    return tuple(dict.fromkeys([phrase for group in _groups().values() for phrase in group.phrases]))


@functools.cache
def creature_words() -> frozenset[str]:
    """Names of creatures and the phrases for what they do: all that sentences about them are made of."""
    table = _table("creature_captions.json")
    kinds = table["kinds"]
    names = [*table["called"], *chain.from_iterable(table["called"].values()), *table["aliases"]]
    names += [name for kind in kinds for name in (*kind["species"], kind.get("name", ""))]
    phrases = [*table["actions"].values(), *[own for kind in kinds for own in kind["phrases"].values()]]
    return frozenset([*names, *table["actions"], *chain.from_iterable(phrases)])


@functools.cache
def known_clauses() -> frozenset[str]:
    """All phrases for people's motions without a subject, in the third person, as gerunds and plain: what sentences of
    training are made of.
    """
    return frozenset(conjugate(phrase, form) for phrase in known_phrases() for form in ("third", "gerund", "plain"))


def is_known_clause(clause: str) -> bool:
    """Whether `known_clauses` has a clause, without making them all."""
    spaces, begin = clause.count(" "), clause[:2]
    for group in _table("captions.json")["groups"]:
        for phrase in group["phrases"]:
            if phrase.count(" ") != spaces or phrase[phrase[0] == "{" :][:2] != begin:
                continue
            if any(conjugate(phrase, form) == clause for form in ("third", "gerund", "plain")):
                return True
    return False


def mirror_words(sentence: str) -> str:
    """The sentence of the mirrored motion: left and right, clockwise and counterclockwise change places, as whole
    words.
    """

    def swap(match: re.Match[str]) -> str:
        word = match.group(0)
        other = _MIRRORED[word.lower()]
        return other.upper() if word.isupper() else other.capitalize() if word[0].isupper() else other

    return _SIDE.sub(swap, sentence)


def _distinct(sentences: list[str], mirrored: bool) -> tuple[str, ...]:
    return tuple(dict.fromkeys(map(mirror_words, sentences) if mirrored else sentences))


@functools.lru_cache(maxsize=4096)
def caption_variants(label: str, mirrored: bool = False) -> tuple[str, ...]:
    """All sentences for a label, always in the same order, never empty.

    Args:
        label: A caption as the archive has it.
        mirrored: For the mirror image of the clip.
    """
    group = caption_group(label)
    if group.phrases:
        found = [sentence for phrase in group.phrases for sentence in sentence_forms(phrase)]
    else:
        found = [group.name] if _HUMAN.match(group.name) else [group.name, f"a person: {group.name}"]
    return _distinct(found, mirrored)


@functools.lru_cache(maxsize=8192)
def caption_clauses(label: str, mirrored: bool = False, form: str = "third") -> tuple[str, ...]:
    """What a label says without its subject, to be joined with others; nothing for a label that the file does not know.

    Args:
        label: A caption as the archive has it.
        mirrored: For the mirror image of the clip.
        form: "plain", "third" or "gerund", as `grammar.conjugate` has them, or "braces" for the phrase itself.
    """
    return _clauses(caption_group(label).phrases, mirrored, form)


def _clauses(phrases: tuple[str, ...], mirrored: bool, form: str) -> tuple[str, ...]:
    return _distinct([phrase if form == "braces" else conjugate(phrase, form) for phrase in phrases], mirrored)


def caption(label: str, seed: int, mirrored: bool = False) -> str:
    """One sentence for a label, the same for the same seed."""
    return random.Random(seed).choice(caption_variants(label, mirrored))


def _creature_phrases(species: str, action: str) -> tuple[str, ...]:
    """Phrases of the species' own kind first, then those of any creature."""
    table = _table("creature_captions.json")
    action = table["aliases"].get(action, action)
    own = [kind["phrases"].get(action, []) for kind in table["kinds"] if species in kind["species"]]
    only = any(action in kind.get("only", []) for kind in table["kinds"] if species in kind["species"])
    general = [] if only else table["actions"].get(action, [])
    found = [*(phrase for phrases in own for phrase in phrases), *general]
    first, _, rest = action.partition(" ")
    return tuple(found) or (f"{{{first}}} {rest}".strip() if first.isalpha() else f"{{do}} {action}",)


def person_phrases(species: str, action: str) -> tuple[str, ...]:
    """What a person would be doing whose part a creature takes by this: a fish that swims walks. With verbs in braces,
    often none.
    """
    table, species, action = _table("creature_captions.json"), normalise_label(species), normalise_label(action)
    action = table["aliases"].get(action, action)
    return tuple(
        phrase
        for kind in table["kinds"]
        if species in kind["species"]
        for phrase in kind.get("person", {}).get(action, [])
    )


@functools.lru_cache(maxsize=8192)
def creature_clauses(species: str, action: str, mirrored: bool = False, form: str = "third") -> tuple[str, ...]:
    """What a creature does without its name, to be joined with others; arguments as for `creature_variants` and
    `caption_clauses`.
    """
    return _clauses(_creature_phrases(normalise_label(species), normalise_label(action)), mirrored, form)


@functools.lru_cache(maxsize=4096)
def creature_names(species: str) -> tuple[str, ...]:
    """What a creature may be called, its species first: "husky", "dog"."""
    species = normalise_label(species)
    table = _table("creature_captions.json")
    kinds = [kind["name"] for kind in table["kinds"] if species in kind["species"] and "name" in kind]
    return tuple(dict.fromkeys([species, *table["called"].get(species, kinds)]))


def _article(name: str) -> str:
    return ("an " if name[0] in "aeiou" else "a ") + name


@functools.lru_cache(maxsize=4096)
def creature_variants(species: str, action: str, mirrored: bool = False) -> tuple[str, ...]:
    """All sentences for what a creature does: by its name, as "it", and as for a person or character.

    Args:
        species: What it is: "horse", "shiba inu".
        action: What it does in one or two canonical words: "walk", "hit reaction". Words that the file does not know
            are taken for a verb.
        mirrored: For the mirror image of the clip.
    """
    species = normalise_label(species)
    phrases = _creature_phrases(species, normalise_label(action))
    names = creature_names(species)
    named = [f"the {names[0]} {{third}}", f"{_article(names[0])} is {{gerund}}", f"the {names[0]} is {{gerund}}"]
    named += [
        frame for name in names[1:] for frame in (f"{_article(name)} {{third}}", f"{_article(name)} is {{gerund}}")
    ]
    found = []
    for phrase in phrases:
        # two sentences name the species: all of them for every phrase and species would be tens of thousands to encode
        drawn = named[zlib.crc32(f"{species} {phrase}".encode()) % len(named)]
        frames = [
            f"{_article(names[0])} {{third}}",
            drawn,
            "it {third}",
            "it is {gerund}",
            "the creature {third}",
            "{plain}",
            "{third}",
            "{gerund}",
        ]
        found += [fill(frame, phrase) for frame in frames if not (is_stative(phrase) and "{gerund}" in frame)]
    human = [*phrases[:3], *person_phrases(species, action)]
    found += [
        fill(frame, phrase)
        for phrase in dict.fromkeys(human)
        for frame in ("a person {third}", "the character {third}")
    ]
    return _distinct(found, mirrored)
