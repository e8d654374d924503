"""What a clause says limbs do: the stance of the body, which limbs go where, what else goes on meanwhile, and how a
gesture is made.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from typing import NamedTuple

from bunraku.language.lexicon import actions_of, lexicon, said_phrases, words_of
from bunraku.language.limb_phrases import LIMBS, OTHER, Phrase, Target, participle, phrases_of, segments_of, targets_of


class Step(NamedTuple):
    """What limbs do at a time."""

    targets: tuple[Target, ...]  # where they go
    stays: bool = False  # they are held there
    again: bool = False  # they go there and back again and again
    alternately: bool = False  # first the one of the left, then that of the right side
    besides: bool = False  # what limbs did before is kept meanwhile


class Stance(NamedTuple):
    """How the body stands, sits, kneels or lies."""

    # "stand", "chair", "seat" (sits anywhere), "floor", "crossed" (sits there with crossed legs), "kneel", "both
    # knees", "squat", "back" or "belly" (lies on it)
    name: str = "stand"
    side: str = ""  # that of the knee that is down; "" for either
    goes: bool = False  # the clause says that the body goes down to it


@dataclass(frozen=True)
class Posing:
    """What a clause says limbs do."""

    stance: Stance | None  # of the body; None where nothing is said of it
    held: tuple[Target, ...]  # where limbs are all the time
    steps: tuple[Step, ...]  # what they do, one after the other
    rest: str = ""  # what goes on meanwhile, as the words stand there; "" for nothing
    text: str = ""  # the words of the limbs

    @property
    def bare(self) -> Posing:
        """The same without its words, for comparison."""
        return replace(self, rest="", text="")

    @property
    def mirrored(self) -> Posing:
        """The same with left and right exchanged."""
        stance = self.stance and self.stance._replace(side=OTHER.get(self.stance.side, self.stance.side))
        steps = tuple(step._replace(targets=tuple(one.mirrored for one in step.targets)) for step in self.steps)
        return replace(self, stance=stance, held=tuple(one.mirrored for one in self.held), steps=steps)

    @property
    def targets(self) -> tuple[Target, ...]:
        """All that limbs do."""
        return (*self.held, *(target for step in self.steps for target in step.targets))

    @property
    def parts(self) -> tuple[str, ...]:
        """Parts of the body that are named (`body.layout.PARTS`)."""
        found: dict[str, None] = {}
        for target in self.targets:
            arm = f"{target.side} arm" if target.side in OTHER else "arms"
            named = {"arm": arm, "head": "head", "trunk": "upper body", "shoulders": "arms"}
            found[named.get(target.whole, "lower body")] = None
        return tuple(found)


@functools.lru_cache(maxsize=1024)
def posing_of(predicate: str) -> Posing | None:
    """What a clause says limbs do; None where it says nothing of that, or something that needs the same limbs besides.

    Args:
        predicate: In English, without its subject.
    """
    words, spans = words_of(predicate)
    phrases = phrases_of(words)
    segments = segments_of(phrases)
    reader = _Reader()
    unread, read = list[list[Phrase]](), list[list[Phrase]]()
    joins: list[str] = []  # of what is not read
    open_limbs: list[Phrase] = []
    goes_on = False
    for number, (join, segment) in enumerate(segments):
        whole, open_limbs = [*open_limbs, *segment], []
        following, after = segments[number + 1] if number + 1 < len(segments) else ("", [])
        shared = following == "and" and (after[0].kind != "does" or participle(after[0]))
        if shared and {phrase.kind for phrase in segment} <= {"part", "side"}:
            open_limbs = whole  # "the arms and the legs spread"
        elif reader.read(join, whole):
            read.append(whole)
            goes_on = False
        elif join == "with" and goes_on:
            unread[-1].extend(whole)  # "kicks with the right leg"
        else:
            unread.append(whole)
            joins.append(join)
            goes_on = True
    reader.cross_legs()
    if reader.manners and {"walk", "run"}.issuperset(actions_of(_text(predicate, spans, unread, {}))):
        reader.held += reader.manners  # other actions have a manner of their own
    if not (reader.held or reader.steps) or open_limbs:
        return None
    begins = {phrase.start: before.stop for before, phrase in itertools.pairwise(phrases)}
    rest, text = (_text(predicate, spans, parts, begins) for parts in (unread, read))
    found = Posing(reader.stance, tuple(reader.held), tuple(reader.steps), rest, text)
    at_once = len(unread) == 1 and joins != ["with"] and all(join != "then" for join, _ in segments)
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
        """Whether some phrases are of limbs, or of a stance; then they are read."""
        kinds = {phrase.kind for phrase in phrases}
        for phrase in phrases:
            if phrase.kind == "manner" and (meant := posing_of(phrase.value)) is not None:
                self.manners += meant.targets
        if "other" in kinds or kinds <= {"manner", "amount"}:
            return "other" not in kinds
        if "stance" in kinds:
            return "does" not in kinds and self._stance(join, phrases)
        if "only" in kinds or "still" in kinds:
            return self._legs_stay(phrases, kinds)
        return self._limbs(join, phrases, kinds)

    def cross_legs(self) -> None:
        """A body that sits, on no chair, with crossed legs sits on the floor, cross-legged."""
        targets = [*self.held, *(target for step in self.steps for target in step.targets)]
        crosses = any(target.limb == "leg" and "crossed" in target.ways for target in targets)
        if self.stance is None or self.stance.name not in ("seat", "floor") or not crosses:
            return
        self.stance = self.stance._replace(name="crossed")
        self.held = [target for target in self.held if target.limb != "leg"]
        left = [[target for target in step.targets if target.limb != "leg"] for step in self.steps]
        self.steps = [step._replace(targets=tuple(some)) for step, some in zip(self.steps, left, strict=True) if some]

    def _stance(self, join: str, phrases: Sequence[Phrase]) -> bool:
        verb = next(one for one in phrases if one.kind == "stance").value
        parts = {one.value: one.words[-1] for one in phrases if one.kind == "part"}
        sides = [one.value for one in phrases if one.kind == "side"]
        ways = {one.value for one in phrases if one.kind == "way"}
        if "up" in ways or self.stance is not None or (self.steps and join != "while"):
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
        parts = {Target(LIMBS.get(one.value, "")).whole for one in phrases if one.kind == "part"}
        if not parts or (parts - {"leg"} if "still" in kinds else parts & {"leg", ""}):
            return False
        self.held.append(Target("leg", "both", frozenset(["still"])))
        return True

    def _limbs(self, join: str, phrases: Sequence[Phrase], kinds: AbstractSet[str]) -> bool:
        verbs = [one for one in phrases if one.kind == "does"]
        goes_on = join in ("and", "then", "comma") and not (join == "comma" and "part" in kinds)
        inherits = goes_on and (self.mode == "step" or not kinds & {"way", "level", "by"})
        verb = self.verb if inherits else ""
        if verbs:  # "lowers the raised arm", "keeps the arms stretched"
            verb = next((one.value for one in verbs if not participle(one) and one.value != "hold"), verbs[-1].value)
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
        targets = tuple(one._replace(side=side) if one.limb == "arm" else one for one in self.last)
        if not any(one.limb == "arm" for one in targets):
            targets = _held_by(targets[0], side)
        if self.steps and self.steps[-1].targets == self.last:
            self.steps[-1] = self.steps[-1]._replace(targets=targets)
        else:
            self.held = [*self.held[: len(self.held) - len(self.last)], *targets]
        self.last = targets
        return True


def _held_by(target: Target, side: str) -> tuple[Target, ...]:
    """A limb with the hand that takes it where it goes: a foot that goes back comes up to it."""
    at = {"knee": "knee", "head": "head"}.get(target.limb, "leg")
    if at == "leg" and "back" in target.ways:
        target = target._replace(ways=frozenset(), at="buttocks", by="on")
    return target, Target("arm", side, at=at, by="on", at_side=target.side if target.side in OTHER else "")


def _acts(join: str, phrases: Sequence[Phrase], verbs: Sequence[Phrase]) -> bool:
    """Whether verbs say a movement, not a posture: "leaning back" is a posture if it is joined to something else. So is
    a form that says nothing ("spread") after its limb.
    """
    word, table = verbs[0].words[0], lexicon()
    pointing = word in table.gerund and phrases[0].kind in ("part", "side")  # "one arm pointing up"
    if pointing or any(one.value == "hold" for one in verbs):
        return False
    if word in table.gerund:
        return join in ("", "and", "then") or verbs[0].value not in table.grammar["held postures"]
    return word in table.third or (word in table.verbs and join != "with" and phrases[0] is verbs[0])


def _text(
    predicate: str, spans: Sequence[tuple[int, int]], segments: Sequence[Sequence[Phrase]], begins: Mapping[int, int]
) -> str:
    """The words of some phrases as they stand there, with what stands between those of each, and before the first."""
    found = [(begins.get(some[0].start, 0), some[-1].stop - 1) for some in segments]
    return " and ".join(predicate[spans[first][0] : spans[last][1]] for first, last in found)


def _free(rest: str, posing: Posing) -> bool:
    """Whether the limbs are free to be posed during something else: it does not need them, and arms that swing or are
    bent go with the legs of a walk.
    """
    if posing.stance is not None and posing.stance.name != "stand":
        return False
    for one in posing.targets:
        loose = one.limb in ("arm", "elbow") and one.ways <= {"bent", "straight"} and not (one.at or one.to)
        moves_legs = one.whole in ("leg", "hips") and "still" not in one.ways
        if loose or moves_legs or one.low is not None or one.to & {"ahead", "back"}:
            return False
    if any(one.limb == "trunk" for step in posing.steps for one in step.targets):
        return False
    rows = [lexicon().actions[action] for action in actions_of(rest)]
    arms = [part for part in posing.parts if part.endswith(("arm", "arms"))]  # they go along with a trunk
    spared = arms and all(part in ("left arm", "right arm") and _spares(rest, part) for part in arms)
    for row in rows:
        on_foot = bool(row.locomotion) or row.part == "legs" or row.turning or row.ahead
        on_foot = on_foot or any(lexicon().actions[one].locomotion in ("walk", "run") for one in row.covers)
        busy = "arms" in row.part and not spared if arms else row.part == "head" and "head" in posing.parts
        turns = row.alone and not posing.steps
        if busy or not (on_foot or turns or row.part or posing.parts == ("head",)):
            return False
    return bool(rows)


def _spares(rest: str, arm: str) -> bool:
    """Whether something is said to be done with the other arm alone."""
    side, words = arm.partition(" ")[0], words_of(rest)[0]
    return OTHER[side] in words and side not in words and "both arms" not in said_phrases(rest)["cues"]


@dataclass(frozen=True)
class Manner:
    """What a sentence says of how a gesture is made."""

    count: int | None = None  # how often; None where it says nothing of that
    pace: float = 1.0  # factor of its tempo
    closed: bool = False  # it is a loop, whose last frame is followed by the first
    lasts: bool = False  # the body goes somewhere all the time, and does not stand before or after
    stance: Stance | None = None  # of the body; None for one that stands, or goes where the gesture says


AS_USUAL = Manner()
"""How it is made where nothing is said of it."""
