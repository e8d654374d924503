"""What a clause says limbs do: how the body is (stands, sits, kneels, lies, squats), which limbs go where, what else
goes on meanwhile, and the manner in which a gesture is made.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from typing import NamedTuple

from bunraku.language.lexicon import Action, actions_of, lexicon, said_phrases, words_of
from bunraku.language.limb_phrases import LIMBS, OTHER, Phrase, Target, participle, phrases_of, segments_of, targets_of

__all__ = ["AS_USUAL", "Manner", "Posing", "Stance", "Step", "posing_of"]


_LEGS = frozenset(("leg", "knee", "heel"))
_LOW = frozenset(("knee", "leg", "heel", "floor", "buttocks"))
"""Places that hands reach with the help of all of the body."""
_POSTURES = frozenset(("lean", "bend", "tilt", "stretch", "spread", "cross", "clasp", "hang"))
"""Verbs of which "-ing" beside something else says how somebody is held."""
_PLAIN = frozenset(("walk", "run"))
"""Actions that a manner changes; others have their own."""
_PARTS = {"head": "head", "trunk": "upper body", "shoulders": "arms"}
_GOES_ON = frozenset(("and", "then", "comma"))


class Step(NamedTuple):
    """What limbs do at a time.

    Args:
        targets: Where they go.
        stays: They are held there.
        again: They go there and back again and again.
        alternately: First the one of the left, then that of the right side.
        besides: What limbs did before is kept meanwhile.
    """

    targets: tuple[Target, ...]
    stays: bool = False
    again: bool = False
    alternately: bool = False
    besides: bool = False


class Stance(NamedTuple):
    """How somebody is.

    Args:
        name: "stand", "chair", "seat" of who sits anywhere, "floor", "crossed" (who sits there with crossed legs),
            "kneel", "both knees", "squat", "back" or "belly" (who lies).
        side: That of the knee that is down; "" for either.
        goes: It is said that somebody goes down to it.
    """

    name: str = "stand"
    side: str = ""
    goes: bool = False


@dataclass(frozen=True)
class Posing:
    """What a clause says limbs do.

    Args:
        stance: How somebody is; None where nothing is said of it.
        held: Where limbs are all the time.
        steps: What they do, one after the other.
        rest: What goes on meanwhile, as the words stand there; "" for nothing.
        text: The words of the limbs.
    """

    stance: Stance | None
    held: tuple[Target, ...]
    steps: tuple[Step, ...]
    rest: str = ""
    text: str = ""

    @property
    def bare(self) -> Posing:
        """The same without its words, for comparison."""
        return replace(self, rest="", text="")

    @property
    def mirrored(self) -> Posing:
        """The same with left and right exchanged."""
        stance = self.stance and self.stance._replace(side=OTHER.get(self.stance.side, self.stance.side))
        steps = tuple([step._replace(targets=tuple([one.mirrored for one in step.targets])) for step in self.steps])
        return replace(self, stance=stance, held=tuple([one.mirrored for one in self.held]), steps=steps)

    @property
    def targets(self) -> tuple[Target, ...]:
        """All that limbs do."""
        return (*self.held, *(target for step in self.steps for target in step.targets))

    @property
    def parts(self) -> tuple[str, ...]:
        """Parts of the body that are told (`body.parts.PARTS`)."""
        found: dict[str, None] = {}
        for one in self.targets:
            arm = f"{one.side} arm" if one.side in OTHER else "arms"
            found[arm if one.limb in ("arm", "elbow") else _PARTS.get(one.limb, "lower body")] = None
        return tuple(found)


@functools.lru_cache(maxsize=1024)
def posing_of(predicate: str) -> Posing | None:
    """What a clause says limbs do; None where it says nothing of that, or something that needs the same limbs besides.

    Args:
        predicate: In English, without who does it.
    """
    words, spans = words_of(predicate)
    phrases = phrases_of(words)
    segments = segments_of(phrases)
    reader, left, told = _Reader(), list[tuple[str, list[Phrase]]](), list[list[Phrase]]()
    open_limbs: list[Phrase] = []
    unread: list[Phrase] | None = None
    for number, (join, own) in enumerate(segments):
        some, open_limbs = [*open_limbs, *own], []
        following, after = segments[number + 1] if number + 1 < len(segments) else ("", [])
        shared = following == "and" and (after[0].kind != "does" or participle(after[0]))
        if shared and {one.kind for one in own} <= {"part", "side"}:
            open_limbs = some  # "the arms and the legs spread"
        elif reader.read(join, some):
            told.append(some)
            unread = None
        elif join == "with" and unread is not None:
            unread.extend(some)  # "kicks with the right leg"
        else:
            left.append((join, some))
            unread = some
    reader.cross_legs()
    if reader.manners and _PLAIN.issuperset(actions_of(_text(predicate, spans, [some for _, some in left], {}))):
        reader.held += reader.manners
    if not (reader.held or reader.steps) or open_limbs:
        return None
    begins = {one.start: before.stop for before, one in itertools.pairwise(phrases)}
    rest, text = (_text(predicate, spans, some, begins) for some in ([some for _, some in left], told))
    found = Posing(reader.stance, tuple(reader.held), tuple(reader.steps), rest, text)
    at_once = len(left) == 1 and left[0][0] != "with" and all(join != "then" for join, _ in segments)
    return found if not rest or (at_once and _free(rest, found)) else None


class _Reader:
    """The things that a clause says of limbs, read one after the other."""

    def __init__(self) -> None:
        self.stance: Stance | None = None
        self.held: list[Target] = []
        self.steps: list[Step] = []
        self.verb, self.mode, self.other = "", "", "left"
        self.last: tuple[Target, ...] = ()
        self.manners: list[Target] = []

    def read(self, join: str, phrases: Sequence[Phrase]) -> bool:
        """Whether some phrases are of limbs, or of how somebody is; then they are read."""
        kinds = {one.kind for one in phrases}
        for one in phrases:
            if one.kind == "manner" and (meant := posing_of(one.value)) is not None:
                self.manners += meant.targets
        if "other" in kinds or kinds <= {"manner", "amount"}:
            return "other" not in kinds
        if "stance" in kinds:
            return "does" not in kinds and self._stance(join, phrases)
        if "only" in kinds or "still" in kinds:
            return self._legs_stay(phrases, kinds)
        return self._limbs(join, phrases, kinds)

    def cross_legs(self) -> None:
        """Who sits, on no chair, and crosses the legs sits on the floor, cross-legged."""
        targets = [*self.held, *(one for step in self.steps for one in step.targets)]
        crosses = any(one.limb == "leg" and "crossed" in one.ways for one in targets)
        if self.stance is None or self.stance.name not in ("seat", "floor") or not crosses:
            return
        self.stance = self.stance._replace(name="crossed")
        self.held = [one for one in self.held if one.limb != "leg"]
        left = [step._replace(targets=tuple([one for one in step.targets if one.limb != "leg"])) for step in self.steps]
        self.steps = [step for step in left if step.targets]

    def _stance(self, join: str, phrases: Sequence[Phrase]) -> bool:
        verb = next(one for one in phrases if one.kind == "stance").value
        parts = {one.value: one.words[-1] for one in phrases if one.kind == "part"}
        sides = [one.value for one in phrases if one.kind == "side"]
        ways = {one.value for one in phrases if one.kind == "way"}
        if "up" in ways or self.stance is not None:
            return False
        if self.steps and join != "while":
            return False
        side = next((one for one in sides if one in OTHER), "")
        if verb == "stand" and "leg" in parts and parts["leg"] in ("leg", "foot"):
            self.other = OTHER.get(side, "one")
            self.held.append(Target("leg", self.other, frozenset(["lifted"])))
        elif verb == "stand" and set(parts) - {"floor"}:
            return False
        if "apart" in ways:
            self.held.append(Target("leg", "both", frozenset(["apart"])))
        if "tiptoe" in ways:
            self.held.append(Target("heel", "both", frozenset(["tiptoe"])))
        name = {"sit": "seat", "lie": "back"}.get(verb, verb)
        if verb == "sit":
            name = next((one for one in ("floor", "chair") if one in parts), "crossed" if "crossed" in ways else name)
            name = "crossed" if "crossed" in ways and name != "chair" else name
        elif verb == "kneel" and (parts.get("knee") == "knees" or "both" in sides):
            name = "both knees"
        elif verb == "lie" and {"belly", "chest", "face"} & set(parts):
            name = "belly"
        self.stance = Stance(name, side if verb == "kneel" else "", "down" in ways)
        return True

    def _legs_stay(self, phrases: Sequence[Phrase], kinds: AbstractSet[str]) -> bool:
        """Whether phrases say that legs stay where they are, or that something else is all that moves."""
        parts = {LIMBS.get(one.value, "") for one in phrases if one.kind == "part"}
        legs = parts & {*_LEGS, ""}
        if not parts or (parts - _LEGS if "still" in kinds else legs):
            return False
        self.held.append(Target("leg", "both", frozenset(["still"])))
        return True

    def _limbs(self, join: str, phrases: Sequence[Phrase], kinds: AbstractSet[str]) -> bool:
        verbs = [one for one in phrases if one.kind == "does"]
        goes_on = join in _GOES_ON and not (join == "comma" and "part" in kinds)
        inherits = goes_on and (self.mode == "step" or not kinds & {"way", "level", "by"})
        verb = self.verb if inherits else ""
        if verbs:  # "lowers the raised arm", "keeps the arms stretched"
            told = [one.value for one in verbs if not participle(one) and one.value != "hold"]
            verb = told[0] if told else verbs[-1].value
        if join == "with" and kinds <= {"part", "side"}:
            return self._by_hand(phrases)
        if verb == "hold" and verbs and self.steps and "part" not in kinds:
            self.steps[-1] = self.steps[-1]._replace(stays=True)  # "and holds it up"
            return True
        targets = targets_of(phrases, verb, self.last, self.other)
        if not targets:
            return False
        again = bool(kinds & {"again", "alternately"}) or any(one.to for one in targets)
        acts = _acts(join, phrases, verbs) if verbs else goes_on and self.mode == "step"
        self.mode = "step" if acts or again else "held"
        if self.mode == "held":
            self.held += targets
        elif join == "while" and self.steps:
            before = self.steps[-1]
            self.steps[-1] = before._replace(targets=(*before.targets, *targets), again=before.again or again)
        else:
            besides = join in ("and", "comma") and bool(self.steps)
            self.steps.append(Step(targets, "stays" in kinds, again, "alternately" in kinds, besides))
        if self.mode == "step" or not self.steps:
            self.last = targets
        self.verb = verb
        self.other = next((OTHER.get(one.side, "left") for one in targets if one.side != "both"), self.other)
        return True

    def _by_hand(self, phrases: Sequence[Phrase]) -> bool:
        """Whether phrases say with which hands the last thing is done: "covers the head with both hands"."""
        side = next((one.value for one in phrases if one.kind == "side"), "")
        hands = all(LIMBS.get(one.value, "side") == "arm" for one in phrases if one.kind == "part")
        if not (hands and side and self.last) or any(one.limb in ("trunk", "hips", "shoulders") for one in self.last):
            return False
        told = tuple([one._replace(side=side) if one.limb == "arm" else one for one in self.last])
        if not any(one.limb == "arm" for one in told):
            told = _held_by(told[0], side)
        if self.steps and self.steps[-1].targets == self.last:
            self.steps[-1] = self.steps[-1]._replace(targets=told)
        else:
            self.held = [*self.held[: len(self.held) - len(self.last)], *told]
        self.last = told
        return True


def _held_by(target: Target, side: str) -> tuple[Target, ...]:
    """A limb with the hand that takes it where it goes: a foot that goes back comes up to it."""
    at = {"knee": "knee", "head": "head"}.get(target.limb, "leg")
    if at == "leg" and "back" in target.ways:
        target = target._replace(ways=frozenset(), at="buttocks", by="on")
    return target, Target("arm", side, at=at, by="on", at_side=target.side if target.side in OTHER else "")


def _acts(join: str, phrases: Sequence[Phrase], verbs: Sequence[Phrase]) -> bool:
    """Whether verbs say what somebody does, and not how he is: "leaning back" is a posture where it is joined to
    something else, and so is a form that says nothing ("spread") after its limb.
    """
    word, table = verbs[0].words[0], lexicon()
    if any(one.value == "hold" for one in verbs):
        return False
    if word in table.gerund and phrases[0].kind in ("part", "side"):
        return False  # "one arm pointing up"
    if word in table.gerund:
        return join in ("", "and", "then") or verbs[0].value not in _POSTURES
    return word in table.third or (word in table.verbs and join != "with" and phrases[0] is verbs[0])


def _text(
    predicate: str, spans: Sequence[tuple[int, int]], segments: Sequence[Sequence[Phrase]], begins: Mapping[int, int]
) -> str:
    """The words of some phrases as they stand there, with what stands between those of each, and before the first."""
    found = [(begins.get(some[0].start, 0), some[-1].stop - 1) for some in segments]
    return " and ".join(predicate[spans[first][0] : spans[last][1]] for first, last in found)


def _free(rest: str, posing: Posing) -> bool:
    """Whether who does something can pose limbs meanwhile: nobody does on legs what legs are told otherwise, and arms
    that swing or are bent go with the legs of who walks.
    """
    if posing.stance is not None and posing.stance.name != "stand":
        return False
    if any(one.limb in {*_LEGS, "hips"} and "still" not in one.ways for one in posing.targets):
        return False
    if any(one.at in _LOW or one.to & {"ahead", "back"} or _loose(one) for one in posing.targets):
        return False
    if any(one.limb == "trunk" for step in posing.steps for one in step.targets):
        return False
    rows = [lexicon().actions[action] for action in actions_of(rest)]
    arms = [part for part in posing.parts if part.endswith(("arm", "arms"))]  # they go along with a trunk
    spared = arms and all(part in ("left arm", "right arm") and _spares(rest, part) for part in arms)
    for row in rows:
        on_foot = _on_foot(row) or any(lexicon().actions[one].locomotion in ("walk", "run") for one in row.covers)
        busy = "arms" in row.part and not spared if arms else row.part == "head" and "head" in posing.parts
        turns = row.alone and not posing.steps
        if busy or not (on_foot or turns or row.part or posing.parts == ("head",)):
            return False
    return bool(rows)


def _spares(rest: str, arm: str) -> bool:
    """Whether something is said to be done with the other arm alone."""
    side, words = arm.partition(" ")[0], words_of(rest)[0]
    return OTHER[side] in words and side not in words and "both arms" not in said_phrases(rest)["cues"]


def _loose(target: Target) -> bool:
    """Whether an arm is only said to be bent or straight."""
    return target.limb in ("arm", "elbow") and target.ways <= {"bent", "straight"} and not (target.at or target.to)


def _on_foot(row: Action) -> bool:
    """Whether an action is one of the legs, whatever it does with the arms."""
    return bool(row.locomotion) or row.part == "legs" or row.turning or row.ahead


@dataclass(frozen=True)
class Manner:
    """What a sentence says of how a gesture is made.

    Args:
        count: How often; None where it says nothing of that.
        pace: Factor of its tempo.
        closed: It is a loop, whose last frame is followed by the first.
        lasts: Who does it goes somewhere, for all of its time, and does not stand before or after.
        stance: How somebody is who makes it; None for who stands, or goes where it says.
    """

    count: int | None = None
    pace: float = 1.0
    closed: bool = False
    lasts: bool = False
    stance: Stance | None = None


AS_USUAL = Manner()
"""How it is made where nothing is said of it."""
