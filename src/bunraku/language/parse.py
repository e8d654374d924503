"""A prompt read once: several sentences in a row, each in English, part by part in the order of time, each part in
fields.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

from bunraku.errors import OptionError
from bunraku.language.clauses import (
    SHORTEST_CLAUSE,
    as_caption,
    as_present,
    as_told,
    handed_on,
    limbs_told,
    of_person,
    parts_of,
    shared,
    subject_of,
    timed_clauses,
    with_subject,
)
from bunraku.language.concurrent import moved_part, split_voices
from bunraku.language.details import added_words, count_of
from bunraku.language.lexicon.cues import said_cues
from bunraku.language.lexicon.reading import actions_of, locomotion_of, said_traits
from bunraku.language.lexicon.tables import lexicon
from bunraku.language.limbs.posing import Posing, Stance
from bunraku.language.prompts import check_prompt, narrow, parse_sequence, timed_sequence
from bunraku.language.sentence import Clause, Sentence, Turn
from bunraku.language.told import says_more, told_of, with_names
from bunraku.language.understood import check_understood

__all__ = ["clause_of", "clauses_of", "parse"]


_STANCES = {"sit": "seat", "kneel": "kneel", "both knees": "both knees", "lie": "back", "squat": "squat"}
"""How somebody is after an action (`Stance`)."""
_ROUND = frozenset(("spin", "circle"))
"""Actions of who turns all the way round."""


def parse(prompt: str, seconds: float = 6.0, force: bool = False) -> Sentence:
    """A prompt as a sentence: what is done one after the other, each with its time.

    Args:
        prompt: In English or a language of `language.words`; several sentences in a row with their seconds
            ("walks:4; jumps:2; waves:3").
        seconds: What parts without seconds of their own share [s], at least 0.5.
        force: Take it even where no movement in it is understood.

    Raises:
        OptionError: It is empty, too long or not understood, or a length is out of range.
    """
    if not isinstance(prompt, str):
        raise OptionError("the prompt must be a sentence")
    timed = timed_sequence(parse_sequence(narrow(prompt)), seconds)
    parts = [(check_understood(part, force), length) for part, length in timed]
    clauses = [clause for found, length in parts for clause in handed_on(timed_clauses(as_told(found.english), length))]
    clauses = list(zip(with_names([text for text, _ in clauses]), [length for _, length in clauses], strict=True))
    found = [part for part, _ in parts]
    read = [clause_of(as_caption(as_present(text)), length) for text, length in clauses]
    loop = any("loop" in said_traits(part.prompt) for part in found)
    notes = [note for part in found for note in part.notes]
    return Sentence(
        prompt,
        "; ".join(part.english for part in found),
        found[0].language,
        tuple(_with_stances(read)),
        tuple(word for part in found for word in part.unknown),
        tuple(pair for part in found for pair in part.corrected),
        (*notes, "it asks for a loop: add --loop (loop=True in Python)") if loop else tuple(notes),
        loop=loop,
    )


def _with_stances(clauses: Iterable[Clause]) -> Iterator[Clause]:
    """Clauses in a row in which arms and head are moved as somebody is by then: who has sat down claps sitting."""
    stance: Stance | None = None
    for clause in clauses:
        told = clause.told
        if isinstance(told, Posing):
            if told.stance is None and stance is not None:
                clause = replace(clause, told=replace(told, stance=stance))
            stance = (told.stance or stance or Stance())._replace(goes=False)
        elif clause.actions:
            down = next((_STANCES[action] for action in reversed(clause.actions) if action in _STANCES), "")
            stays = stance is not None and all(
                lexicon().actions[one].part not in ("", "legs") for one in clause.actions
            )
            if stays and not down:
                clause = replace(clause, stance=stance)
            else:
                stance = Stance(down) if down and "gets up" not in clause.traits else None
        yield clause


def clauses_of(script: Iterable[tuple[str, float]]) -> tuple[Clause, ...]:
    """Sentences that are taken as they stand, each one clause, with the seconds that each lasts.

    Raises:
        OptionError: One is empty, has no letters or digits, or is too long.
    """
    return tuple(clause_of(check_prompt(text), seconds) for text, seconds in script)


def clause_of(text: str, seconds: float = 0.0) -> Clause:
    """One clause in its fields.

    Args:
        text: In English.
        seconds: How long it lasts [s].
    """
    posing, subject = limbs_told(text), subject_of(text)[0]
    if posing is not None:
        whole = _clause(text, seconds)
        body = _clause(with_subject(posing.rest, subject), seconds) if posing.rest else None
        if body is not None and not (says_more(whole.told) and body.told != whole.told):
            return replace(whole, voices=(body, _limbs(posing, subject, seconds)))
        # limbs may be how a thing is met: "stands at a cliff and looks down"
        things = body is not None or any(one.at in ("floor", "chair") for one in posing.targets)
        return whole if things and says_more(whole.told) else replace(whole, told=posing)
    voices = tuple(_clause(voice, seconds) for voice in split_voices(text))
    parts = [] if voices else parts_of(text)
    if not parts or seconds / len(parts) < SHORTEST_CLAUSE:
        return _clause(text, seconds, voices)
    return _clause(text, seconds, (), tuple(map(clause_of, parts, shared(parts, seconds))))


def _clause(text: str, seconds: float, voices: tuple[Clause, ...] = (), parts: tuple[Clause, ...] = ()) -> Clause:
    person, (subject, predicate) = of_person(text), subject_of(text)
    cues, traits, actions = said_cues(person), said_traits(person), actions_of(person)
    return Clause(
        text, seconds, subject, person, actions, moved_part(text), locomotion_of(predicate), cues, traits,
        _turn(cues, traits, actions), _goes_straight(cues, traits), count_of(person), added_words(predicate, actions),
        told_of(person), voices=voices, parts=parts,
    )  # fmt: skip


def _limbs(posing: Posing, subject: str, seconds: float) -> Clause:
    """What limbs do meanwhile as a clause of its own."""
    said = _clause(with_subject(posing.text, subject), seconds)
    return replace(said, told=replace(posing, rest=""), part=" and ".join(posing.parts))


def _goes_straight(cues: frozenset[str], traits: frozenset[str]) -> bool:
    """Whether somebody goes forward or on, with nothing of a turn, a curve or a side."""
    sided = {"left turn", "right turn", "left go", "right go"} & cues
    return ("forward" in cues or "goes on" in traits) and not sided and "winding" not in traits


def _turn(cues: frozenset[str], traits: frozenset[str], actions: tuple[str, ...]) -> Turn | None:
    """How far somebody turns; None where nothing of the kind is said, or both sides are, or only the head does."""
    side = int("left turn" in cues) - int("right turn" in cues)
    if {"left turn", "right turn"} <= cues:
        return None
    turns = "turns" in traits and {"half", "full", "quarter"} & cues
    if not side and not turns and not ("full" in cues and _ROUND.intersection(actions)):
        return None
    least, most = 50.0, 130.0
    if "all round" in traits:
        least, most = 250.0, math.inf
    elif "full" in cues:
        least, most = 290.0, 430.0
    elif "half" in cues:
        least, most = 145.0, 215.0
    return Turn(side, math.radians(least), math.radians(most))
