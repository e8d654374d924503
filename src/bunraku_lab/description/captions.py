"""Sentences of training for the labels of clips: a label's phrases in the forms in which people type them.

The phrases stand in `captions.json` and `creature_captions.json` of `bunraku.language`.
"""

from __future__ import annotations

import functools
import random
import re
import zlib
from dataclasses import dataclass

from bunraku.language.captions import caption_table, conjugate, mirror_words

_VERB = re.compile(r"\{(\w+)\}")
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


_DRAWN = 4
"""Of the second list for each phrase: all of them for all would be tens of thousands of sentences to encode."""


def is_stative(phrase: str) -> bool:
    """Whether a phrase has no progressive: no person "is being angry"."""
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
def _groups() -> dict[str, CaptionGroup]:
    found: dict[str, CaptionGroup] = {}
    for entry in caption_table("captions.json")["groups"]:
        group = CaptionGroup(entry["labels"][0], tuple(entry["phrases"]), float(entry["weight"]))
        found.update(dict.fromkeys(entry["labels"], group))
    return found


def caption_group(label: str) -> CaptionGroup:
    """The group of a label; a label that the file does not know is a group of its own."""
    label = normalise_label(label)
    return _groups().get(label) or CaptionGroup(label, ())


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
        form: "plain", "third" or "gerund", as `conjugate` has them, or "braces" for the phrase itself.
    """
    return _clauses(caption_group(label).phrases, mirrored, form)


def _clauses(phrases: tuple[str, ...], mirrored: bool, form: str) -> tuple[str, ...]:
    return _distinct([phrase if form == "braces" else conjugate(phrase, form) for phrase in phrases], mirrored)


def caption(label: str, seed: int, mirrored: bool = False) -> str:
    """One sentence for a label, the same for the same seed."""
    return random.Random(seed).choice(caption_variants(label, mirrored))


def _creature_phrases(species: str, action: str) -> tuple[str, ...]:
    """Phrases of the species' own kind first, then those of any creature."""
    table = caption_table("creature_captions.json")
    action = table["aliases"].get(action, action)
    own = [kind["phrases"].get(action, []) for kind in table["kinds"] if species in kind["species"]]
    only = any(action in kind.get("only", []) for kind in table["kinds"] if species in kind["species"])
    general = [] if only else table["actions"].get(action, [])
    found = [*(phrase for phrases in own for phrase in phrases), *general]
    first, _, rest = action.partition(" ")
    return tuple(found) or (f"{{{first}}} {rest}".strip() if first.isalpha() else f"{{do}} {action}",)


def person_phrases(species: str, action: str) -> tuple[str, ...]:
    """What a person does in place of a creature, with verbs in braces: walk, where a fish swims. Often none."""
    table, species, action = caption_table("creature_captions.json"), normalise_label(species), normalise_label(action)
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
    table = caption_table("creature_captions.json")
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
