"""The sentence of a training row: from its label, from the motion itself, or from both."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bunraku.language.captions.grammar import conjugate, fill, is_stative, sentence_forms
from bunraku.language.captions.phrases import (
    caption_clauses,
    caption_variants,
    creature_clauses,
    creature_names,
    creature_variants,
    mirror_words,
    person_phrases,
)
from bunraku_lab.description.describe import Phrase, joined

__all__ = ["all_variants", "borrowed_sentence", "can_do", "clauses", "computed_sentence", "creature_subjects", "verbs"]

_GOING = {
    "walk", "run", "jog", "move", "go", "stroll", "sprint", "step", "wander", "trot", "gallop", "swim", "fly",
    "crawl", "slither", "creep", "hop", "march", "sneak", "tiptoe", "stride", "limp", "stagger", "strut", "shuffle",
    "trudge", "stomp", "dash", "rush", "sidestep", "strafe", "shamble", "swagger", "hurry", "pace", "skip", "climb",
    "slouch", "stumble", "veer", "saunter", "amble", "plod", "navigate", "roam", "head", "follow", "bear", "drift",
    "circle", "hobble", "totter", "lurch", "return", "fetch", "bring", "carry", "pass", "advance", "retreat", "back",
}  # fmt: skip
# verbs of labels that say no more than the first verb of a computed phrase
_SAME = {
    "walk": {"walk"}, "run": {"run", "jog", "sprint"}, "move": {"walk", "run", "jog", "step", "sidestep", "move"},
    "jump": {"jump", "hop", "leap"},
    "turn": {"turn", "spin", "rotate", "pivot"}, "make": {"turn", "spin", "rotate", "pivot"}, "spin": {"turn", "spin",
    "twirl"}, "kick": {"kick"},
    "squat": {"squat", "bend"}, "bend": {"bend"}, "raise": {"raise", "lift"}, "wave": {"wave"}, "go": {"lie"},
    "get": {"get", "stand"}, "stand": {"stand", "idle"},
}  # fmt: skip
_PLAIN = re.compile(
    r"(forwards?|ahead|along|backwards?|left|right|sideways|straight|around|circles?|curve|arc|to|the|in|a|and|then|slowly|quickly|fast|up|down|high|"
    r"over|with|foot|leg|hands?|arms?|feet|both|on|spot|place|off|ground|floor|from|above|head|half|full|round|side|again|still|,|\s)*"
)
# words of a label that leave no room for a direction or speed of our own
_SAID = re.compile(
    r"\b(forward|forwards|ahead|along|backward|backwards|back|left|right|sideways|straight|around|circle|circles|curve|arc|bend|slowly|quickly|fast|"
    r"slow|quick|speed|pace|hurry|briskly|like|while|with|in|then|to|over|through|across|at|for|and)\b"
)
_VERB = re.compile(r"\{(\w+)\}")


def all_variants(text: str, species: str | None, action: str | None, mirrored: bool = False) -> tuple[str, ...]:
    """All sentences for a clip, the label itself among them where it is one.

    Args:
        text: Its label.
        species: Of a creature.
        action: What it does in a canonical word; of people, for labels that the caption file does not know.
        mirrored: For the mirror image.
    """
    if species and action:
        found = creature_variants(species, action)
    elif action and not caption_clauses(text):
        found = (text, *(sentence for phrase in clauses(text, None, action) for sentence in sentence_forms(phrase)))
    else:
        found = caption_variants(text)
    return tuple(dict.fromkeys(map(mirror_words, found) if mirrored else found))


def clauses(text: str, species: str | None, action: str | None) -> tuple[str, ...]:
    """What the clip shows as phrases with their verbs in braces; none where nothing is known of it. Arguments as
    above.
    """
    if species and action:
        return creature_clauses(species, action, form="braces")
    found = caption_clauses(text, form="braces")
    if action and not found:
        found = tuple(phrase.replace(" its ", " the ") for phrase in creature_clauses("person", action, form="braces"))
    return found


def verbs(phrases: Sequence[str]) -> set[str]:
    """The verbs in braces."""
    return {verb for phrase in phrases for verb in _VERB.findall(phrase)}


def can_do(species: str, action: str) -> set[str]:
    """Verbs that a creature's clip shows, those of a person whose part it takes among them."""
    return verbs([*creature_clauses(species, action, form="braces"), *person_phrases(species, action)])


def _one(choices: Sequence[str], random: np.random.Generator) -> str:
    return choices[int(random.integers(len(choices)))]


def creature_subjects(species: str) -> tuple[str, ...]:
    """What a sentence about a creature may begin with."""
    return (
        *(
            re.sub(r"^a (?=[aeiou])", "an ", f"{article} {name}")
            for name in creature_names(species)
            for article in ("a", "the")
        ),
        "it",
    )


def _creature_frames(species: str) -> list[str]:
    return [f"{subject} {form}" for subject in creature_subjects(species) for form in ("{third}", "is {gerund}")] + [
        "{third}",
        "{plain}",
    ]


def borrowed_sentence(
    phrases: Sequence[str], sentences: Sequence[str], species: str, random: np.random.Generator
) -> str:
    """What a person does, said of a creature or, as often, of a person: "a horse waves".

    Args:
        phrases: With verbs in braces.
        sentences: About a person.
        species: Of the creature.
        random: Chooses.
    """
    if not phrases or random.random() < 0.5:
        return _one(sentences, random)
    phrase = _one(phrases, random)
    frames = [frame for frame in _creature_frames(species) if not (is_stative(phrase) and "gerund" in frame)]
    return fill(_one(frames, random), phrase)


def computed_sentence(
    found: Sequence[Phrase],
    labels: Sequence[Sequence[str]],
    frames: int,
    random: np.random.Generator,
    species: str | None = None,
) -> str | None:
    """A sentence from the motion, alone or together with the label.

    It stands alone only where it tells what the label tells: "moves forward" would be true of a drinker who takes a
    step, but not what anybody would say.

    Args:
        found: What is true in the row, from `describe.inside`.
        labels: Phrases of the label, from `clauses`, of each clip that the row joins.
        frames: Length of the row.
        random: Chooses.
        species: Of a creature.

    Returns:
        None where the motion says nothing plain, or nothing that goes with the label.
    """
    if not found:
        return None
    variant = int(random.integers(12))
    if species is not None:
        return _of_creature(found, labels[0], random, species, variant) if len(labels) == 1 else None
    enough = all(not label or _covered(label, found) for label in labels)
    alone = enough and (len(labels) > 1 or random.random() < 0.5)
    text = None if alone or len(labels) > 1 or not labels[0] else _with_label(found, labels[0], frames, random, variant)
    if text is None and not enough:
        return None
    return _one(sentence_forms(text or joined(found, variant)), random)


def _covered(label: Sequence[str], found: Sequence[Phrase]) -> bool:
    """Whether one of the label's phrases says nothing but what was found: not how somebody walks, or what with."""
    known = set().union(*(_SAME.get(verb, {verb}) for phrase in found for verb in _VERB.findall(phrase.texts[0])[:1]))
    return any(verbs([phrase]) <= known and bool(_PLAIN.fullmatch(_VERB.sub("", phrase))) for phrase in label)


def _of_creature(
    found: Sequence[Phrase], label: Sequence[str], random: np.random.Generator, species: str, variant: int
) -> str | None:
    """ "gallops forward, then turns left" of a creature that goes, "attacks, turning left" of one that does something
    else.
    """
    if not label:
        return None
    short = [
        phrase for phrase in label if len(phrase.split()) <= 2 and not _SAID.search(phrase) and verbs([phrase]) & _GOING
    ]
    described = []
    for phrase in found:
        if phrase.kind == "go" and phrase.manner and short:
            phrase = replace(phrase, texts=(f"{_one(short, random)} {' '.join(phrase.manner[:2])}",))
        described.append(phrase)
    text = joined(described, variant)
    if not short or described[0].kind != "go":
        plain = [
            phrase for phrase in label if "," not in phrase and len(phrase.split()) <= 6 and not is_stative(phrase)
        ]
        if not plain:
            return None
        text = f"{_one(plain, random)}, {conjugate(joined(described, variant, most=2), 'gerund')}"
    return fill(_one(_creature_frames(species), random), text)


def _with_label(
    found: Sequence[Phrase], label: Sequence[str], frames: int, random: np.random.Generator, variant: int
) -> str | None:
    """ "{jog} in a circle to the left, slowly", or "{dance}, turning left twice"; None where the two do not go
    together.
    """
    clause = _one(label, random)
    own = verbs([clause])
    moving = [phrase for phrase in found if phrase.kind != "still"]
    goes = [phrase for phrase in moving if phrase.kind == "go"]
    if len(moving) == 1 and goes and goes[0].manner and goes[0].stop - goes[0].start > 0.6 * frames:
        free = [
            phrase
            for phrase in label
            if not _SAID.search(phrase) and "," not in phrase and verbs([phrase]) & _GOING and len(verbs([phrase])) == 1
        ]
        if free:
            way, *pace = goes[0].manner
            return f"{_one(free, random)} {way}" + (f", {pace[0]}" if pace else "")
    others = [phrase for phrase in moving if not any(verb in clause for verb in verbs(phrase.texts))]
    if not others or len(own) > 1 or own & _GOING or len(clause.split()) > 7:
        return None
    return f"{clause}, {conjugate(joined(others, variant, most=2), 'gerund')}"
