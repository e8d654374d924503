"""Sentences on bodies that are no person's: what each does in place of what is said, and what it cannot do at all.

One table of the lexicon says it, `otherwise`: a row for locomotion and the kinds of body that do something else.
A snake that is to run slithers fast, a spider walks fast, and a dog that is to crawl walks slowly.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from bunraku.language.clauses import of_creature, subject_of, with_subject
from bunraku.language.lexicon.reading import said_otherwise
from bunraku.language.lexicon.tables import Otherwise, lexicon
from bunraku.language.parse import clause_of
from bunraku.language.sentence import Clause, Sentence

__all__ = ["INSTEAD", "KINDS", "for_body"]

KINDS = ("person", "two legs", "four legs", "many legs", "no legs", "snake", "fish")
"""What bodies stand and move with: arms and two legs, legs alone, none; a long tail on the ground, one in water."""


_NO_LEGS = "'{clause}' moves legs, and none are found on this body; it {instead} instead"
INSTEAD = {"snake": "slithers", "fish": "swims", "no legs": "glides, bends and bobs"}
"""What bodies without legs do where a sentence says walk."""


def for_body(sentence: Sentence, kind: str, parts: Collection[str] = (), as_people: bool = True) -> Sentence:
    """A sentence in words for what a body does in its place, how it then moves, and what it cannot do.

    What is said of a person is said of "it" where the body does not move as people do: conditioned on a person's words,
    the network lets a dog walk on two legs.

    Args:
        sentence: From `parse.parse`.
        kind: One of `KINDS`.
        parts: What the body has of "arms", "forelegs" (arms that it stands on) and "wings".
        as_people: Whether it moves as people do.
    """
    clauses = tuple(_done(clause, kind, "wings" in parts, as_people) for clause in sentence.clauses)
    cannot = dict.fromkeys(note for clause in sentence.clauses if (note := _in_vain(clause, kind, parts)))
    return replace(sentence, clauses=clauses, cannot=tuple(cannot))


def _row(locomotion: str, kind: str) -> Otherwise | None:
    return next((row for row in lexicon().otherwise if locomotion in row.locomotion and kind in row.bodies), None)


def _done(clause: Clause, kind: str, wings: bool, as_people: bool) -> Clause:
    """What a body does in place of a clause."""
    row = _row(clause.locomotion, kind)
    moves = row.moves if row else "fly" if clause.locomotion == "fly" and wings else ""
    said = clause
    if row and row.verb:
        predicate = subject_of(clause.text)[1]
        head = clause.text[: len(clause.text) - len(predicate)]
        said = clause_of(head + said_otherwise(predicate, row.verb), clause.seconds)
    ground = _on_ground(said)
    text = said.text
    if moves == "fly":
        text = _of_bird(text)
    elif not as_people:
        text = _of_kind(said)
    if text != said.text:
        said = clause_of(text, clause.seconds)
    return replace(said, moves=moves or ("lie" if ground and kind == "snake" else ground))


def _on_ground(clause: Clause) -> str:
    """How a clause says to be on the ground: "step" with a foot always on it, as in a walk, "run" for who leaves it
    shortly, "stay" for as long as a jump lasts, and "" where it says of leaving it for longer: in the air or in water,
    on a ladder, on the hands, on a seat.
    """
    if clause.locomotion in ("fly", "swim") or "off the ground" in clause.traits:
        return ""
    return "stay" if "leaps" in clause.traits else lexicon().ground.get(clause.locomotion, "stay")


def _of_kind(clause: Clause) -> str:
    """A clause said of a creature, and one of walking or running of "it", whichever is named: the network has seen few
    kinds walk, and a rat or a frog that is named hardly stirs. Who only goes goes forward: told "it trots" and no more,
    a wolf, a cow and a horse fell down.
    """
    if clause.locomotion not in ("walk", "run"):
        return of_creature(clause.text)
    subject, rest = subject_of(clause.text)
    said = f"{rest} forward" if all(word.endswith("ly") for word in rest.split()[1:]) else rest
    return f"it {said}" if subject else of_creature(said)


def _of_bird(text: str) -> str:
    """A clause of flight said of a bird: the one flight that the network knows, whoever has the wings."""
    subject, rest = subject_of(text)
    return f"a bird {rest}" if subject else with_subject(text, "a bird")


def _in_vain(clause: Clause, kind: str, parts: Collection[str]) -> str:
    """What a clause requests that a body cannot do; "" for nothing."""
    instead = INSTEAD.get(kind)
    if instead and (clause.part == "legs" or clause.locomotion in ("walk", "run")):
        return _NO_LEGS.format(clause=clause.text, instead=instead)
    row, note = _row(clause.locomotion, kind), ""
    if clause.part == "arms" and "forelegs" in parts:
        note = "'{clause}' moves arms, and this body stands on them; it lifts a foreleg shortly, if at all"
    elif clause.part == "arms" and not {"arms", "wings"} & set(parts):
        note = "'{clause}' moves arms, and none are found on this body; its trunk and head move instead"
    elif clause.locomotion == "fly" and "wings" not in parts:
        note = "'{clause}' needs wings, and none are found on this body; it stays on the ground or jumps"
    elif row:
        note = row.note
    return note.format(clause=clause.text)
