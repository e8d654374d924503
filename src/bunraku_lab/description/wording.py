"""Sentences of motions, computed from the motion itself, from a label, or from both."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.generation.verifier import Track
from bunraku.language.captions import conjugate, mirror_words
from bunraku_lab.description.captions import (
    caption_clauses,
    caption_variants,
    creature_clauses,
    creature_names,
    creature_variants,
    fill,
    is_stative,
    person_phrases,
    sentence_forms,
)
from bunraku_lab.description.events import (
    find_arms,
    find_bends,
    find_gaits,
    find_jumps,
    find_kicks,
    find_stillness,
    find_turns,
)
from bunraku_lab.description.phrases import Phrase

_LEAST = 16  # frames of a state that are worth a word
_TIMES = {2: "twice", 3: "three times", 4: "four times", 5: "five times"}
_COUNTED = {"turn", "jump", "kick", "bend"}


def describe(motion: HandleMotion, human: bool = True) -> list[Phrase]:
    """What a motion of the reference body plainly does, in order of time.

    Args:
        motion: Of 30 handles.
        human: False for creatures, of which only directions and turns are described.
    """
    track = Track.of(motion)
    if len(track) < 8:
        return []
    turns = find_turns(track)
    ways = find_gaits(track, turns, human)
    circles = [way for way in ways if any("circle" in word for word in way.manner)]
    found = ways + [turn for turn in turns if _overlap(turn, circles) < 0.5]
    if human:
        jumps = find_jumps(track)
        found = [phrase for phrase in found if phrase.kind != "go" or _overlap(phrase, jumps) < 0.2]
        bends = [phrase for phrase in find_bends(track) if _overlap(phrase, jumps) < 0.2]
        found += jumps + find_kicks(track) + find_arms(track) + bends + find_stillness(track)
    occurrences = Counter((phrase.start, phrase.stop, phrase.kind) for phrase in found)
    # two of a kind in the very same frames have no order that a mirror would keep
    found = [phrase for phrase in found if occurrences[phrase.start, phrase.stop, phrase.kind] == 1]
    return sorted(found, key=lambda phrase: (phrase.start, phrase.stop, phrase.kind))


def _overlap(phrase: Phrase, others: Sequence[Phrase]) -> float:
    shared = sum(max(min(phrase.stop, other.stop) - max(phrase.start, other.start), 0) for other in others)
    return shared / max(phrase.stop - phrase.start, 1)


def inside(phrases: Sequence[Phrase], start: int, stop: int) -> list[Phrase]:
    """The phrases that are true in frames `start` to `stop` - 1; repeats are counted in words."""
    kept, broken = [], []
    for phrase in phrases:
        a, b = max(phrase.start, start), min(phrase.stop, stop)
        if phrase.start >= start and phrase.stop <= stop:
            kept.append(replace(phrase, start=a - start, stop=b - start))
        elif phrase.part and b - a >= _LEAST:
            manner = phrase.manner if phrase.part == phrase.texts else ()
            kept.append(replace(phrase, texts=phrase.part, start=a - start, stop=b - start, manner=manner))
        elif b > a:
            broken.append((phrase.kind, set(phrase.texts)))
    return _counted(kept, broken)


def _counted(phrases: list[Phrase], broken: list[tuple[str, set[str]]]) -> list[Phrase]:
    """Neighbours that say the same become one, with how often; no number where the crop cuts one of them."""
    out: list[tuple[Phrase, int]] = []
    for phrase in phrases:
        if out and out[-1][0].kind == phrase.kind and out[-1][0].texts == phrase.texts:
            last, times = out[-1]
            out[-1] = (replace(last, stop=max(last.stop, phrase.stop)), times + 1)
        else:
            out.append((phrase, 1))
    found = []
    for phrase, times in out:
        if times > 1 and phrase.kind in _COUNTED:
            sure = all(kind != phrase.kind for kind, _ in broken)
            often = _TIMES.get(times, "several times") if sure else "more than once"
            phrase = replace(phrase, texts=tuple(f"{text} {often}" for text in phrase.texts if " and " not in text))
        found.append(phrase)
    return found


def _texts(phrases: Sequence[Phrase], variant: int) -> list[str]:
    return [phrase.texts[variant * (index + 1) % len(phrase.texts)] for index, phrase in enumerate(phrases)]


def joined(phrases: Sequence[Phrase], variant: int = 0, most: int = 4) -> str:
    """Phrases in order as one, verbs in braces: "{turn} left twice, then {run} forward"; empty without phrases.

    Args:
        phrases: From `inside`.
        variant: Chooses rewordings and links.
        most: Phrases to name; standing still is left out first.
    """
    described = list(phrases)
    if len(described) > 1:
        moving = [phrase for phrase in described if phrase.kind != "still"]
        described = moving if len(described) > most and moving else described
    described = described[:most]
    groups: list[str] = []
    for index, (phrase, text) in enumerate(zip(described, _texts(described, variant), strict=True)):
        before = described[index - 1]
        together = min(before.stop, phrase.stop) - max(before.start, phrase.start)
        if index and together > 0.5 * min(before.stop - before.start, phrase.stop - phrase.start):
            groups[-1] += f" and {text}" if " and " not in groups[-1] + text else f", {text}"
        else:
            groups.append(text)
    return chain(groups, variant)


def chain(parts: Sequence[str], variant: int = 0) -> str:
    """Clauses in order of time with the word "then", in one of three ways."""
    if len(parts) < 2:
        return "".join(parts)
    if variant % 3 == 0:
        return ", then ".join(parts)
    return ", ".join(parts[:-1]) + (" and then " if variant % 3 == 1 else ", and then ") + parts[-1]


def sentences(phrases: Sequence[Phrase], start: int, stop: int) -> list[str]:
    """What happens in frames `start` to `stop` - 1, in order, in several wordings without a subject.

    Args:
        phrases: From `describe`.
        start: First frame of the crop.
        stop: Frame after its last.
    """
    found = inside(phrases, start, stop)
    if not found:
        return []
    return list(dict.fromkeys(conjugate(joined(found, variant), "third") for variant in range(6)))


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
    """What the clip shows as phrases with their verbs in braces; none where nothing is known of it."""
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
    """What a person does, said of a creature or, as often, of a person: "a horse waves"."""
    if not phrases or random.random() < 0.5:
        return _one(sentences, random)
    phrase = _one(phrases, random)
    frames = [frame for frame in _creature_frames(species) if not (is_stative(phrase) and "gerund" in frame)]
    return fill(_one(frames, random), phrase)


def computed_sentence(
    found: Sequence[Phrase], labels: Sequence[Sequence[str]], frames: int, random: np.random.Generator,
    species: str | None = None,
) -> str | None:  # fmt: skip
    """A sentence from the motion, alone or together with the label.

    It stands alone only where it tells what the label tells: "moves forward" would be true of a person who
    drinks and takes a step, but it would not describe the motion.

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
    """Whether one of the label's phrases says nothing but what was found: not how a person walks, or what with."""
    known = set().union(*(_SAME.get(verb, {verb}) for phrase in found for verb in _VERB.findall(phrase.texts[0])[:1]))
    return any(verbs([phrase]) <= known and bool(_PLAIN.fullmatch(_VERB.sub("", phrase))) for phrase in label)


def _of_creature(
    found: Sequence[Phrase], label: Sequence[str], random: np.random.Generator, species: str, variant: int
) -> str | None:
    """ "gallops forward, then turns left" of a creature that goes, else "attacks, turning left"."""
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
    """ "{jog} in a circle to the left" or "{dance}, turning left twice"; None where the two do not go together."""
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
