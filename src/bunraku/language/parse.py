"""A prompt as a parsed `Sentence`: each clause in fields, and what it means for bodies other than a person's."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from bunraku.errors import OptionError
from bunraku.language import clauses as split
from bunraku.language.clauses import subject_of, with_subject
from bunraku.language.interactions import interaction_of, says_more, with_names
from bunraku.language.lexicon import (
    LIMB_CUES,
    Otherwise,
    actions_of,
    cues_of,
    lexicon,
    locomotion_of,
    said_cues,
    said_otherwise,
    said_traits,
)
from bunraku.language.phrasing import added_words, count_of
from bunraku.language.posing import Posing, Stance
from bunraku.language.prompts import check_prompt, narrow, parse_sequence, timed_sequence
from bunraku.language.sentence import Clause, Sentence, Turn
from bunraku.language.understood import check_understood

if TYPE_CHECKING:
    from bunraku.language.reader import Frame


def parse(prompt: str, seconds: float | None = None, force: bool = False) -> Sentence:
    """A prompt as a sentence: what is done one after the other, each with its time.

    Args:
        prompt: In English or a language of `word_table.LANGUAGES`; several sentences in a row with their seconds
            ("walks:4; jumps:2; waves:3").
        seconds: What parts without seconds of their own share [s], at least 0.5; None gives them what fits what is done
            (`clauses.fitting`).
        force: Take it even where no movement in it is understood.

    Raises:
        OptionError: It is empty, too long or not understood, or a length is out of range.
    """
    if not isinstance(prompt, str):
        raise OptionError("the prompt must be a sentence")
    timed = [
        (check_understood(part, force), length)
        for part, length in timed_sequence(parse_sequence(narrow(prompt)), seconds)
    ]
    parts = [part for part, _ in timed]
    clauses = [
        clause
        for part, length in timed
        for clause in split.handed_on(split.timed_clauses(split.as_parsed(part.english), length))
    ]
    named = with_names([text for text, _ in clauses])
    texts = _homeward(named)
    frames = [
        clause_of(split.as_caption(split.as_present(text)), length)
        for text, (_, length) in zip(texts, clauses, strict=True)
    ]
    loop = any("loop" in said_traits(part.prompt) for part in parts)
    notes = [note for part in parts for note in part.notes]
    unknown = tuple(word for part in parts for word in part.unknown)
    notes += dict.fromkeys(
        _notes(frames, [part.english for part in parts], unknown, {"backward"} if texts != named else set())
    )
    return Sentence(
        prompt,
        "; ".join(part.english for part in parts),
        parts[0].language,
        tuple(replace(clause, fits=len(frames) == 1 and timed[0][1] is None) for clause in _with_stances(frames)),
        unknown,
        tuple(pair for part in parts for pair in part.corrected),
        (*notes, "it asks for a loop: add --loop (loop=True in Python)") if loop else tuple(notes),
        loop=loop,
    )


def _notes(clauses: Sequence[Clause], texts: Sequence[str], unknown: Sequence[object], done: set[str]) -> Iterator[str]:
    """What of some texts is not done in their clauses, beside some actions. Unknown words are told elsewhere."""
    from bunraku.language.reader import LIKELIEST, frames_of

    for clause in clauses:
        frames = [frame for told in clause.parts or (clause, *clause.voices) for frame in told.frames]
        done |= {frame.action for frame in frames} | set(clause.actions)
        for frame in frames:
            if frame.probability < LIKELIEST:
                yield f"nothing known is named in '{clause.text}'; '{frame.action}' is a guess"
        if not (frames or unknown or clause.detail or clause.locomotion):
            yield f"nothing known is named in '{clause.text}'; its motion is a guess"
    read = {frame.action: None for text in texts if len(clauses) > 1 for frame in frames_of(text)}
    if left := [f"'{action}'" for action in read if action not in done]:
        yield f"left out: {', '.join(left)}"


def _homeward(texts: Sequence[str]) -> list[str]:
    """Clauses in a row: a body that has turned around and goes "back" goes forward."""
    from bunraku.language.reader import frames_of

    clauses: list[str] = []
    for text in texts:
        before, back, after = text.partition(" back")
        if clauses and back and not after[:1].isalpha():
            earlier, now = ([frame.action for frame in frames_of(clause)] for clause in (clauses[-1], text))
            if "backward" in now and earlier[-1:] == ["turn around"]:
                text = f"{before} forward{after}"
        clauses.append(text)
    return clauses


def _with_stances(clauses: Iterable[Clause]) -> Iterator[Clause]:
    """Clauses in a row with the stance that the body has by then: after "sits down" it claps sitting."""
    stance: Stance | None = None
    stances = lexicon().reading["stances"]
    for clause in clauses:
        detail = clause.detail
        if isinstance(detail, Posing):
            if detail.stance is None and stance is not None:
                clause = replace(clause, detail=replace(detail, stance=stance))
            stance = (detail.stance or stance or Stance())._replace(goes=False)
        elif clause.actions:
            acts = [lexicon().actions[action] for action in clause.actions]
            like = [name for action, row in zip(clause.actions, acts, strict=True) for name in (action, row.like)]
            down = next((stances[name] for name in reversed(like) if name in stances), "")
            of_legs = any(row.part in ("", "legs") for row in acts)
            if clause.stance is None:
                if stance is not None and not down and not of_legs:
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
    """The frame of one clause: what its text asks for, in fields. All that is read of a clause is read here.

    Args:
        text: In English.
        seconds: How long it lasts [s].
    """
    text = split.on_foot(text)
    posing, subject = split.limbs_described(text), subject_of(text)[0]
    if posing is not None:
        clause = _clause(text, seconds)
        body = _clause(with_subject(posing.rest, subject), seconds) if posing.rest else None
        if body is not None and not (says_more(clause.detail) and body.detail != clause.detail):
            limbs = _clause(with_subject(posing.text, subject), seconds)
            part = " and ".join(posing.parts)
            return replace(clause, voices=(body, replace(limbs, detail=replace(posing, rest=""), part=part)))
        # limbs may be how a thing is met: "stands at a cliff and looks down"
        things = body is not None or any(target.at in ("floor", "chair") for target in posing.targets)
        return clause if things and says_more(clause.detail) else replace(clause, detail=posing)
    voices = tuple(_clause(voice, seconds) for voice in split.split_voices(text))
    parts = [] if voices else _homeward(split.parts_of(text)) or split.passing(text)
    if not parts or seconds / len(parts) < split.SHORTEST_CLAUSE:
        return _clause(text, seconds, voices)
    return _clause(text, seconds, (), tuple(map(clause_of, parts, split.shared(parts, seconds))))


def _clause(text: str, seconds: float, voices: tuple[Clause, ...] = (), parts: tuple[Clause, ...] = ()) -> Clause:
    from bunraku.language.reader import frames_of, guess_of  # numpy

    person, (subject, predicate) = split.of_person(text), subject_of(text)
    frames, phrased, interaction = frames_of(person), actions_of(person), interaction_of(person)
    if not (frames or interaction or locomotion_of(predicate) or split.limbs_described(text)):
        frames = (guess,) if (guess := guess_of(person)) else ()
    cues, traits = _with_fields(said_cues(person), frames), said_traits(person)
    actions = tuple(frame.action for frame in frames)
    counts = [int(frame.fields["count"]) for frame in frames if "count" in frame.fields]
    sided = {"left turn", "right turn", "left go", "right go"} & cues
    straight = ("forward" in cues or "goes on" in traits) and not sided and "winding" not in traits
    return Clause(
        text, seconds, subject, person, actions, split.moved_part(text), locomotion_of(predicate), cues, traits,
        _turn(frames), straight, count_of(person) or next(iter(counts), None),
        added_words(predicate, actions) if set(actions) <= set(phrased) else (), interaction,
        stance=next((Stance(stance) for frame in frames if (stance := _meanwhile(frame))), None), voices=voices,
        parts=parts, frames=frames,
    )  # fmt: skip


_CHOICES = tuple(map(cues_of, ("direction", "turn side", "degrees", "speed", "count")))
"""Cues of one kind: what the network reads counts, and where it reads none, the words."""


def _with_fields(cues: frozenset[str], frames: Sequence[Frame]) -> frozenset[str]:
    ways = _CHOICES[0]  # where arms point is not where the body goes, nor is the side of a kick
    cues -= frozenset(f"{frame.fields['side']} go" for frame in frames if _limb(frame))
    read = frozenset[str]().union(*(frame.cues - ways if _stays(frame) else frame.cues for frame in frames))
    taken = [read & choice or cues & choice for choice in _CHOICES]
    limbs = cues & LIMB_CUES or frozenset(filter(None, map(_limb, frames)))
    return cues.difference(*_CHOICES).union(*taken, limbs)


def _limb(frame: Frame) -> str:
    """The limb that does it, where a side is said: "left arm"; "" for none or both."""
    row, side = lexicon().actions[frame.action], frame.fields.get("side", "both")
    limb = row.limb or ("arm" if row.part.startswith("arms") else "leg" if row.part == "legs" else "")
    return f"{side} {limb}" if limb and side != "both" else ""


def _meanwhile(frame: Frame) -> str:
    """The stance in which something is done that is not the posture itself; "" where nothing is said of it."""
    posture = frame.fields.get("posture", "") or lexicon().actions[frame.action].posture
    return str(lexicon().reading["stances"].get(posture, "")) * _stays(frame)


def _stays(frame: Frame) -> bool:
    """Whether arms do it, wherever the body is."""
    return "arms" in lexicon().actions[frame.action].part


TURN, OVER, SLACK = 90.0, 250.0, (40.0, 0.2)
"""How far a turn goes of which nothing more is said, and a spin at the least; and by how much a turn may miss what is
said of it, at the least and as a share of it, but not by more than half of it. All were chosen by eye [degrees].
"""


def _turn(frames: Sequence[Frame]) -> Turn | None:
    """How far the body turns; None where nothing of the kind is said, or both sides are."""
    rows, plain = lexicon().actions, ("turn", "turn around", "spin", "circle")
    named = [frame for frame in frames if frame.action in plain or not rows[frame.action].turns]
    turns = [frame for frame in named if "turn side" in frame.fields or frame.action in plain]
    sides = {frame.fields.get("turn side", "?") for frame in turns}
    if not turns or {"left", "right"} <= sides:
        return None
    said, action = turns[0].fields.get("degrees", "?"), turns[0].action
    least, most = OVER, math.inf
    if action not in ("spin", "circle") or said not in ("?", "360"):
        degrees = float(said) if said != "?" else 2 * TURN if action == "turn around" else TURN
        slack = max(SLACK[0], SLACK[1] * degrees)
        least, most = max(degrees - slack, degrees / 2), degrees + slack
    return Turn(int("left" in sides) - int("right" in sides), math.radians(least), math.radians(most))


def instead_of_walking(kind: str) -> str:
    """What a body without legs does where a sentence says walk; "" for one that has legs."""
    row = _row("walk", kind)
    return row.verb if row else "hops" * (kind == "no legs")


def for_body(sentence: Sentence, kind: str, parts: Collection[str] = (), as_people: bool = True) -> Sentence:
    """A sentence in words for what a body does in its place, how it then moves, and what it cannot do.

    What is said of a person is said of "it" where the body does not move as people do: conditioned on a person's words,
    the network lets a dog walk on two legs.

    Args:
        sentence: From `parse`.
        kind: What the body stands and moves with: arms and two legs ("person"), legs alone ("two legs", "four legs",
            "many legs"), none ("no legs"), a long tail on the ground ("snake"), one in water ("fish"), wings alone
            ("bird in flight").
        parts: What the body has of "arms", "forelegs" (arms that it stands on) and "wings".
        as_people: Whether it moves as people do.
    """
    clauses = tuple(_for_body(clause, kind, "wings" in parts, as_people) for clause in sentence.clauses)
    cannot = dict.fromkeys(note for clause in sentence.clauses if (note := _in_vain(clause, kind, parts)))
    return replace(sentence, clauses=clauses, cannot=tuple(cannot))


def _row(locomotion: str, kind: str) -> Otherwise | None:
    return next((row for row in lexicon().otherwise if locomotion in row.locomotion and kind in row.bodies), None)


def _for_body(clause: Clause, kind: str, wings: bool, as_people: bool) -> Clause:
    """What a body does in place of a clause."""
    row = _row(clause.locomotion, kind)
    moves = row.moves if row else "fly" if clause.locomotion == "fly" and wings else ""
    adapted = clause
    if row and row.verb:
        predicate = subject_of(clause.text)[1]
        head = clause.text[: len(clause.text) - len(predicate)]
        adapted = clause_of(head + said_otherwise(predicate, row.verb), clause.seconds)
    ground = _on_ground(adapted)
    text = adapted.text
    if moves.startswith("fly"):  # the one flight that the network knows is a bird's
        subject, rest = subject_of(text)
        text = f"a bird {rest}" if subject else with_subject(text, "a bird")
    elif not as_people:
        text = _of_creature(adapted)
    if text != adapted.text:
        adapted = clause_of(text, clause.seconds)
    return replace(adapted, moves=moves or ("lie" if ground and kind == "snake" else ground))


def _on_ground(clause: Clause) -> str:
    """How a clause is done on the ground: "step" with a foot always on it, as in a walk, "run" with short flights,
    "stay" with those of a jump, and "" where it leaves the ground for longer: in the air or in water, on a ladder, on
    the hands, on a seat.
    """
    if clause.locomotion in ("fly", "swim") or "off the ground" in clause.traits:
        return ""
    return "stay" if "leaps" in clause.traits else lexicon().ground.get(clause.locomotion, "stay")


def _of_creature(clause: Clause) -> str:
    """A clause about a creature, and one of walking or running about "it", whichever creature is named: the network has
    seen few kinds walk, and a rat or a frog that is named hardly stirs. A bare verb gets "forward": conditioned on "it
    trots" alone, a wolf, a cow and a horse fell down.
    """
    if clause.locomotion not in ("walk", "run"):
        return split.of_creature(clause.text)
    subject, rest = subject_of(clause.text)
    caption = f"{rest} forward" if all(word.endswith("ly") for word in rest.split()[1:]) else rest
    return f"it {caption}" if subject else split.of_creature(caption)


def _in_vain(clause: Clause, kind: str, parts: Collection[str]) -> str:
    """What a clause requests that a body cannot do; "" for nothing."""
    row, note = _row(clause.locomotion, kind), ""
    instead = instead_of_walking(kind)
    if instead and (clause.part == "legs" or clause.locomotion in ("walk", "run")):
        note = f"'{{clause}}' moves legs, and none are found on this body; it {instead} instead"
    elif clause.part == "arms" and "forelegs" in parts:
        note = "'{clause}' moves arms, and this body stands on them; it lifts a foreleg shortly, if at all"
    elif clause.part == "arms" and not {"arms", "wings"} & set(parts):
        note = "'{clause}' moves arms, and none are found on this body; its trunk and head move instead"
    elif clause.locomotion == "fly" and "wings" not in parts:
        note = "'{clause}' needs wings, and none are found on this body; it stays on the ground or jumps"
    elif row:
        note = row.note
    return note.format(clause=clause.text)
