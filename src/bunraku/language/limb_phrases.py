"""Phrases of limbs: which limb, of which side, goes where, how far, once or to and fro.

The words are those of the lexicon's table `posing`, each row a kind ("part", "side", "way", "does", ...) and a value.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from bunraku.language.lexicon import lexicon, longest_pattern, words_of
from bunraku.language.vocabulary import FUNCTION_WORDS

LIMBS: dict[str, str] = lexicon().limbs["parts"]
"""The limb of each part of the body that can go somewhere."""
OTHER = {"left": "right", "right": "left"}
_WAYS, _OF_TRUNK = lexicon().grammar["ways"], lexicon().grammar["of the trunk"]


class Target(NamedTuple):
    """Where a limb goes."""

    limb: str  # "arm", "elbow", "leg", "knee", "heel", "head", "trunk", "hips" or "shoulders"
    side: str = "both"  # "left", "right", "both", or "one" for either
    # "up", "down", "ahead", "back", "side", "left", "right", "apart", "together", "crossed", "bent", "straight",
    # "tiptoe", "lifted", "still"; "turned" of what turns about its own axis, "bowed" of a trunk
    ways: frozenset[str] = frozenset()
    at: str = ""  # the part of the body or the height where it goes; "" for none
    by: str = ""  # how it is there: "on", "front", "behind", "above", "under", or "level" for a height
    at_side: str = ""  # the side of that part; "" where nothing is said of it
    amount: float = 1.0  # how far, of what is usual
    # ways of the other end of what goes to and fro, "round" of what circles; none of what goes there once
    to: frozenset[str] = frozenset()

    @property
    def whole(self) -> str:
        """The arm or leg that the limb is a part of; others as they are."""
        return {"elbow": "arm", "knee": "leg", "heel": "leg"}.get(self.limb, self.limb)

    @property
    def low(self) -> str | None:
        """The joint at a place that hands reach by bending, "" for the floor; None of all other places."""
        joint: str | None = lexicon().limbs["low"].get(self.at)
        return joint

    @property
    def mirrored(self) -> Target:
        """The same with left and right exchanged."""
        ways, to = (frozenset(OTHER.get(way, way) for way in some) for some in (self.ways, self.to))
        side, at_side = (OTHER.get(name, name) for name in (self.side, self.at_side))
        return self._replace(side=side, ways=ways, at_side=at_side, to=to)


class Phrase(NamedTuple):
    """Words that say one thing."""

    kind: str  # of its row in the table; "other" of what is in none
    value: str  # the same
    words: tuple[str, ...]  # as they stand there
    start: int  # the number of the first word
    stop: int  # the number of the word after


def phrases_of(words: Sequence[str]) -> list[Phrase]:
    """The phrases of some words; those that say nothing are left out, and those that are not known are "other"."""
    found: list[Phrase] = []
    at, table, ends = 0, lexicon().posing, lexicon().grammar["after comparisons"]
    while at < len(words):
        best = longest_pattern(table.starting(words[at]), words, at)
        stop = at + 1 if best is None else best[1]
        kind = value = ""
        if words[at] == "like":
            stop = next((number for number in range(at + 1, len(words)) if words[number] in ends), len(words))
            kind = "like"
        elif best is not None:
            kind, _, value = best[0].name.partition(" ")
            if kind in ("does", "stance") and _is_noun(words, at, found):
                kind = "other"
        elif words[at] not in FUNCTION_WORDS and not words[at].endswith("ly") and words[at].isalnum():
            kind = "other"
        if kind:
            found.append(Phrase(kind, value, tuple(words[at:stop]), at, stop))
        at = stop
    return [phrase for number in range(len(found)) for phrase in _sided(found, number)]


def _is_noun(words: Sequence[str], at: int, before: Sequence[Phrase]) -> bool:
    """Whether what looks like a verb is a noun: "two squats", "knee lifts". "The raised arm" is none."""
    table = lexicon()
    verb = words[at] in table.verbs or words[at] in table.third
    if at and words[at - 1] in lexicon().grammar["before nouns"] and (words[at - 1] == "from" or verb):
        return True
    part = before[-1] if before and before[-1].stop == at and before[-1].kind == "part" else None
    if part is None or words[at] not in table.third or words[at - 1].endswith("s"):
        return False
    return part.start == 0 or words[part.start - 1] not in FUNCTION_WORDS | set(OTHER)


def _sided(phrases: Sequence[Phrase], number: int) -> list[Phrase]:
    """A "left" or "right" as the side of the limb after it, or else as a way; what says nothing is left out."""
    phrase = phrases[number]
    after = phrases[number + 1].kind if number + 1 < len(phrases) else ""
    if phrase.kind == "aside":
        return []
    if phrase.kind == "round" and len(phrase.words) == 1 and after in ("part", "side"):
        return [phrase._replace(kind="by", value="on")]  # "the arms around the knees"
    if phrase.value not in OTHER:
        return [phrase]
    named = next((other for other in phrases[number + 1 : number + 3] if other.kind not in ("does", "amount")), None)
    if named is None or named.kind != "part":
        return [phrase._replace(kind="way")]
    side = phrase._replace(kind="side")
    return [side] if len(phrase.words) == 1 else [phrase._replace(kind="by", value="on"), side]


def names_limb(text: str) -> bool:
    """Whether a text is the name of a limb: "the left leg"."""
    found = phrases_of(words_of(text)[0])
    limbs = [phrase.value in LIMBS for phrase in found if phrase.kind == "part"]
    return bool(limbs) and all(limbs) and {phrase.kind for phrase in found} <= {"part", "side"}


def participle(phrase: Phrase) -> bool:
    """Whether a verb is in a form that is no verb of a sentence: "raised"."""
    word, table = phrase.words[0], lexicon()
    return word not in table.third and word not in table.gerund and word not in table.verbs


def segments_of(phrases: Sequence[Phrase]) -> list[tuple[str, list[Phrase]]]:
    """The phrases of each thing that is said, and what joins it: "", "and", "comma", "then", "with" or "while"."""
    found: list[tuple[str, list[Phrase]]] = []
    join, segment = "", list[Phrase]()
    for phrase in phrases:
        kinds = {before.kind for before in segment}
        verb = phrase.kind in ("does", "stance")
        begins = verb and bool("stance" in kinds or (kinds & {"does", "other"} and not participle(phrase)))
        if phrase.kind != "joins" and not begins:
            segment.append(phrase)
            continue
        if segment:
            found.append((join, segment))
            join = ""
        if phrase.kind == "joins":
            join, segment = phrase.value if phrase.value != "and" or not join else join, []
        else:
            join = join or ("while" if phrase.words[0] in lexicon().gerund else "with")
            segment = [phrase]
    return [*found, (join, segment)] if segment else found


def targets_of(phrases: Sequence[Phrase], verb: str, last: Sequence[Target], other: str) -> tuple[Target, ...]:
    """Where the limbs of some phrases go; none where that is not said.

    Args:
        phrases: Of one thing that is said, none of them "other".
        verb: What is done; "" where nothing says it.
        last: What was said before, of which "it" and "then to the right" are.
        other: The side of "the other" limb.
    """
    said = _said(phrases, verb, other)
    if said is None:
        return ()
    limbs, ways, plain = said
    limbs = [(limb or last[0].limb, side) for limb, side in limbs if limb or last]
    if not limbs and any(phrase.kind == "it" for phrase in phrases):
        limbs = [(target.limb, target.side) for target in last]
    if not limbs and (verb in _OF_TRUNK or verb == "look"):
        limbs = [("head" if verb == "look" else "trunk", "both")]
    if not limbs:
        goes_on = (ways or plain.at) and not any(phrase.kind == "does" for phrase in phrases)
        return tuple([_of_limb(target.limb, target.side, ways, plain, "") for target in last]) if goes_on else ()
    first = limbs[0][0]
    if first == "trunk" and plain.at == "hip":  # "bends at the hips"
        plain = plain._replace(at="", by="")
    if first == "head" and plain.at == "chest":
        ways, plain = ways | {"down"}, plain._replace(at="", by="")
    leans_on = plain.at and (first == "head" or (first == "trunk" and (plain.at != "arm" or not ways)))
    if plain.by == "off" or leans_on or (verb == "look" and not ways & {"up", "down", "left", "right", "back"}):
        return ()
    if verb == "circle" and not plain.to:
        plain = plain._replace(to=frozenset(["round"]))
    if verb == "swing" and not plain.to:
        ends = {"ahead": "back", "back": "ahead", **OTHER}
        start = next(iter(sorted(ways & set(ends))), "ahead" if Target(first).whole in ("arm", "leg") else "left")
        ways = ways if ways & _WAYS else ways | {start}
        plain = plain._replace(to=frozenset([ends[start]]))
    found = tuple([_of_limb(limb, side, ways, plain, verb) for limb, side in limbs])
    if verb == "hold" and plain.at == "leg" and first == "arm":  # the foot comes to the hand
        found += (Target("leg", plain.at_side or "one", at="buttocks", by="on"),)
    return found if all(target.ways & _WAYS or target.at or target.to for target in found) else ()


def _of_limb(limb: str, side: str, ways: frozenset[str], plain: Target, verb: str) -> Target:
    """A target with what a verb says beside its words."""
    usual = lexicon().limbs["goes"].get(verb, {}).get(limb)
    besides = verb in ("cross", "bend", "clasp") and limb != "trunk"  # "crossed behind the back"
    if verb == "lower" and limb not in ("trunk", "hips") and not plain.at:
        ways = frozenset(["down"])
    elif usual and (besides or not (ways & _WAYS or plain.at or plain.to)):
        ways |= {usual}
    if limb == "heel" and "up" in ways:
        ways = ways - {"up"} | {"tiptoe"}
    if limb == "trunk" and verb in ("bend", "bow"):
        ways |= {"bowed" if verb == "bow" else "bent"}
    if limb in ("head", "trunk") and verb in ("turn", "twist", "look"):
        ways |= {"turned"}
    return plain._replace(limb=limb, side=side, ways=ways)


def _said(
    phrases: Sequence[Phrase], verb: str, other: str
) -> tuple[list[tuple[str, str]], frozenset[str], Target] | None:
    """Limbs with their sides, ways, and a target with all else that some phrases say; None where they make no sense."""
    limbs: list[tuple[str, str]] = []
    ways, plain = set[str](), Target("")
    side = pending = ""
    for number, phrase in enumerate(phrases):
        kind, value = phrase.kind, phrase.value
        if side == "other" and not limbs and kind not in ("part", "does", "amount"):
            limbs.append(("", other))  # "one hand on the head and the other on the hip"
            side = ""
        if kind == "part":
            limb = LIMBS.get(value, "")
            # verbs of hands at the part of the body that is named
            touches = verb in ("hold", "cover") and not (pending or limbs) and limb not in ("arm", "elbow", "")
            posed = any(after.kind in ("way", "level", "by", "does", "to") for after in phrases[number + 1 :])
            if touches and (verb == "cover" or not posed):
                limbs.append(("arm", "both" if verb == "cover" else "one"))
                plain = plain._replace(at=value, by="on", at_side=side)
            elif pending or not limb or plain.at:
                if not limbs and not (verb in _OF_TRUNK and pending):
                    return None
                at_side = plain.at_side or side
                plain = plain._replace(at=plain.at or value, by=plain.by or pending or "on", at_side=at_side)
            else:
                many = phrase.words[-1].endswith("s") or phrase.words[-1] == "feet"
                own = other if side == "other" else side
                limbs.append(
                    (limb, own or ("both" if many else "one") if Target(limb).whole in ("arm", "leg") else "both")
                )
            side = ""
        elif kind == "side":
            side = value
        elif kind == "way":
            ways.add(value)
        elif kind == "level":
            plain = plain._replace(at=value, by="level")
        elif kind == "by":
            pending = value
        elif kind == "amount":
            plain = plain._replace(amount=float(value))
        elif kind == "to":
            first, second = value.split("-")
            ways.add(first)
            plain = plain._replace(to=frozenset([second]))
        elif kind == "round":
            plain = plain._replace(to=frozenset(["round"]))
        elif kind == "stance":
            return None
    if side == "other" and not limbs:
        limbs.append(("", other))  # "raises one knee, then the other"
    if "beside" in ways:  # what goes up and down there is out to the side
        ways = ways - {"beside"} | {"side" if plain.to else "down"}
    return limbs, frozenset(ways), plain._replace(by=plain.by or (pending if pending == "off" else ""))
