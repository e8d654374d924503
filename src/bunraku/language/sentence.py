"""A sentence that has been read: what it says, clause by clause, in fields.

`parse.parse` makes it once, where a prompt comes in. What draws, chooses, fits and notes reads these fields; the text
is for the text encoder alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from bunraku.language.interactions import Interaction
from bunraku.language.posing import Posing, Stance

if TYPE_CHECKING:
    from bunraku.language.reader import Frame

SHORT = 0.5
"""A rest of a clause that is shorter than this stays with it [s]; chosen by eye."""


@dataclass(frozen=True)
class UnknownWord:
    """A word that is not understood."""

    word: str  # as it stands in the sentence
    start: int  # of its first letter
    stop: int  # after its last letter


@dataclass(frozen=True)
class Turn:
    """How far a clause says that the body turns."""

    side: int  # 1 to the left, -1 to the right, 0 for either
    least: float  # the least angle [rad]
    most: float  # the most [rad]


@dataclass(frozen=True)
class Clause:
    """One thing that is done."""

    text: str  # in English, what the text encoder reads
    seconds: float = 0.0  # how long it lasts [s]
    subject: str = ""  # "" where none is named
    person: str = ""  # the text as said of a person, in which captured examples and the ranker's vectors are looked up
    # what is done, in the lexicon's words, in the order in which it is said; none where nothing is known
    actions: tuple[str, ...] = ()
    part: str = ""  # what the verb moves: "legs", "arms", "head", "arms and head", or "" for neither or all
    locomotion: str = ""  # the locomotion: "fly", "swim", "slither", "crawl", "walk", "run"; "" for none of them
    cues: frozenset[str] = frozenset()  # sides, directions, turns, counts, speeds and postures (`encoders.CUES`)
    # what else it says, such as "sits down" or "chair" (the lexicon's table of that name)
    traits: frozenset[str] = frozenset()
    turn: Turn | None = None  # how far the body turns; None where it says nothing of that
    straight: bool = False  # whether it leads forward or on, with nothing of a turn, a curve or a side
    count: int | None = None  # how often it is done; None where it says nothing of that
    added: tuple[str, ...] = ()  # words for parts of the body and movements that it says beyond its actions
    # what is done with a thing, follows from where a person walks or looks, or is done by limbs, where that is all
    # that it says
    detail: Interaction | Posing | None = None
    stance: Stance | None = None  # of the body that does it, if that follows from what was said before
    # what the body of `for_body` then does: "fly" anywhere, "fly on" and "fly fast" ahead, "swim" and "slither", or how
    # it is on the ground: "step", "run", "stay", "lie"; "" for neither
    moves: str = ""
    # where a movement of the legs is joined with a gesture, the one and the other; none otherwise
    voices: tuple[Clause, ...] = field(default=())
    # what it says one after the other if it cannot be done all at once (`clauses.parts_of`); none where it says one
    # thing
    parts: tuple[Clause, ...] = field(default=())
    frames: tuple[Frame, ...] = ()  # what the reader says of it (`reader.frames_of`)
    fits: bool = False  # no length was asked for, so that examples may change it

    @property
    def body(self) -> Clause:
        """What is done beside the gesture."""
        return self.voices[0] if self.voices else self

    def lasting(self, seconds: float) -> Clause:
        """The same for so long [s]."""
        voices = tuple(replace(voice, seconds=seconds) for voice in self.voices)
        parts = tuple(voice.lasting(voice.seconds * seconds / self.seconds) for voice in self.parts if self.seconds)
        return replace(self, seconds=seconds, voices=voices, parts=parts)

    @property
    def limbs_meanwhile(self) -> Posing | None:
        """What limbs do while something else goes on; None for nothing."""
        detail = None if self.meanwhile is None else self.meanwhile.detail
        return detail if isinstance(detail, Posing) else None

    @property
    def meanwhile(self) -> Clause | None:
        """The gesture that is made at the same time; None for none."""
        return self.voices[1] if self.voices else None


@dataclass(frozen=True)
class Sentence:
    """A prompt that has been read."""

    prompt: str  # as it was given
    english: str  # what is read of it, in English
    language: str  # "en", "de", "fr", "es", "ja" or "zh"; "" for a script that is not read
    clauses: tuple[Clause, ...]  # what is done one after the other
    unknown: tuple[UnknownWord, ...] = ()  # words that are not understood
    corrected: tuple[tuple[str, str], ...] = ()  # words taken for typing errors, and what is read in their place
    notes: tuple[str, ...] = ()  # what the writer of the prompt should know, one line each
    loop: bool = False  # whether it asks for a loop: "walk cycle"
    cannot: tuple[str, ...] = ()  # what a body cannot do of it, one line each (`for_body`)

    @property
    def seconds(self) -> float:
        """How long all of it lasts [s]."""
        return sum(clause.seconds for clause in self.clauses)


def in_stretches(sentence: Sentence, longest: float) -> list[Sentence]:
    """A sentence in stretches of about the same length, each at most `longest` seconds, which may cut clauses."""
    count = max(math.ceil(sentence.seconds / longest - 1e-9), 1)
    share, stretches = sentence.seconds / count, []
    left = [(clause, clause.seconds) for clause in sentence.clauses]
    for number in range(count):
        room, clauses = share, []
        while left and room > 1e-6:
            clause, seconds = left.pop(0)
            taken = min(seconds, room)
            if seconds - taken > SHORT:
                left.insert(0, (clause, seconds - taken))
            else:
                taken = seconds
            clauses.append(clause.lasting(taken))
            room -= taken
        if clauses:
            stretches.append(replace(sentence, clauses=tuple(clauses), notes=() if number else sentence.notes))
    return stretches
