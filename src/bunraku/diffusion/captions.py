"""Captions: short motion-capture labels as sentences that people type.

`captions.json` groups the labels of the motion archive that mean the same and gives each group phrases with their verbs in
braces, such as "{walk} forward and {turn}". Rules put a phrase into the third person, the progressive, the imperative or
the gerund, with several subjects.
"""

from __future__ import annotations

import functools
import json
import random
import re
from dataclasses import dataclass
from importlib import resources

__all__ = ["CaptionGroup", "caption", "caption_group", "caption_variants", "mirror_words", "normalise_label"]

_VERB = re.compile(r"\{(\w+)\}")
_SUBJECTS = ("a person", "someone", "the character", "a human")
_DOUBLED = {
    "run", "jog", "hop", "swim", "spin", "sit", "stop", "step", "put", "get", "slip", "mop", "grab", "squat", "flip", "nod",
    "hit", "stab", "skip", "trip", "strut",
}  # fmt: skip
_GERUNDS = {"lie": "lying", "die": "dying", "be": "being", "tiptoe": "tiptoeing", "dribble": "dribbling"}
_THIRD = {"be": "is", "do": "does", "go": "goes"}
_MIRRORED = {
    "left": "right",
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
def _groups() -> dict[str, CaptionGroup]:
    data = json.loads(resources.files("bunraku.diffusion").joinpath("captions.json").read_text(encoding="utf-8"))
    found: dict[str, CaptionGroup] = {}
    for entry in data["groups"]:
        group = CaptionGroup(entry["labels"][0], tuple(entry["phrases"]), float(entry["weight"]))
        found.update(dict.fromkeys(entry["labels"], group))
    return found


def caption_group(label: str) -> CaptionGroup:
    """The group of a label; a label that the file does not know is a group of its own."""
    label = normalise_label(label)
    return _groups().get(label) or CaptionGroup(label, ())


def mirror_words(sentence: str) -> str:
    """The sentence of the mirrored motion: left and right, clockwise and counterclockwise change places, as whole words."""

    def swap(match: re.Match[str]) -> str:
        word = match.group(0)
        other = _MIRRORED[word.lower()]
        return other.upper() if word.isupper() else other.capitalize() if word[0].isupper() else other

    return _SIDE.sub(swap, sentence)


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


def _forms(phrase: str) -> list[str]:
    plain = _VERB.sub(lambda match: match.group(1), phrase)
    third = _VERB.sub(lambda match: _third(match.group(1)), phrase)
    gerund = _VERB.sub(lambda match: _gerund(match.group(1)), phrase)
    return [
        *(f"{subject} {third}" for subject in _SUBJECTS),
        *(f"{subject} is {gerund}" for subject in _SUBJECTS[:3]),
        plain,
        third,
        gerund,
    ]


@functools.lru_cache(maxsize=4096)
def caption_variants(label: str, mirrored: bool = False) -> tuple[str, ...]:
    """All sentences for a label, always in the same order, never empty.

    Args:
        label: A caption as the archive has it.
        mirrored: For the mirror image of the clip.
    """
    group = caption_group(label)
    if group.phrases:
        found = [sentence for phrase in group.phrases for sentence in _forms(phrase)]
    else:
        found = [group.name] if _HUMAN.match(group.name) else [group.name, f"a person: {group.name}"]
    if mirrored:
        found = [mirror_words(sentence) for sentence in found]
    return tuple(dict.fromkeys(found))


def caption(label: str, seed: int, mirrored: bool = False) -> str:
    """One sentence for a label, the same for the same seed."""
    return random.Random(seed).choice(caption_variants(label, mirrored))
