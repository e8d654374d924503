"""Phrases of limbs: which limb, of which side, goes where, how far, once or to and fro.

The words are those of the lexicon's table `posing`, each row a kind ("part", "side", "way", "does", ...) and a value.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from bunraku.language.lexicon import lexicon, longest_phrase, words_of
from bunraku.language.vocabulary import FUNCTION_WORDS

__all__ = ["LIMBS", "OTHER", "Phrase", "Target", "names_limb", "participle", "phrases_of", "segments_of", "targets_of"]

LIMBS = {
    "arm": "arm", "elbow": "elbow", "leg": "leg", "knee": "knee", "heel": "heel", "head": "head", "face": "head",
    "chin": "head", "neck": "head", "trunk": "trunk", "chest": "trunk", "back": "trunk", "hip": "hips",
    "weight": "hips", "shoulder": "shoulders",
}  # fmt: skip
"""The limb of each part of the body that can go somewhere."""
OTHER = {"left": "right", "right": "left"}
_PAIRED = frozenset(("arm", "elbow", "leg", "knee", "heel"))
_WAYS = frozenset((
    "up", "down", "ahead", "back", "side", "left", "right", "apart", "together", "crossed", "bent", "tiptoe",
    "straight",
))  # fmt: skip
_GOES = {
    "raise": {
        "arm": "up", "elbow": "side", "leg": "up", "knee": "up", "heel": "tiptoe", "shoulders": "up", "head": "up",
    },
    "spread": {"arm": "side", "leg": "apart"}, "cross": {"arm": "crossed", "leg": "crossed"},
    "bend": {"arm": "bent", "elbow": "bent", "leg": "bent", "knee": "bent", "trunk": "ahead"},
    "bow": {"trunk": "ahead", "head": "down"}, "tuck": {"head": "down", "knee": "up", "elbow": "down"},
    "clasp": {"arm": "together"}, "stretch": {"arm": "straight", "leg": "straight"}, "tilt": {"head": "right"},
    "hang": {"arm": "down", "leg": "down", "head": "down"},
}  # fmt: skip
"""Where a limb goes by a verb that says no more of it."""
_SHAPES = frozenset(("cross", "bend", "clasp"))
"""Verbs that say so beside another way, too: "crossed behind the back"."""
_OF_TRUNK = frozenset(("lean", "bend", "bow", "twist"))
"""Verbs that move the trunk where no limb is named."""
_AT_PARTS = frozenset(("hold", "cover"))
"""Verbs of hands that are at the part of the body that is named."""
_TURNED = frozenset(("turn", "twist", "look"))
_LOOKS = frozenset(("up", "down", "left", "right", "back"))
_ENDS = {"ahead": "back", "back": "ahead", "left": "right", "right": "left"}
"""The other end of what swings."""
_AMOUNTS = {"small": 0.5, "half": 0.6, "large": 1.45}
_JOINS = frozenset(("and", "but", "then", "while", "with", ","))
"""Words before which a comparison ends: "spread like wings"."""
_BEFORE_NOUNS = frozenset(
    ("a", "an", "the", "two", "three", "four", "five", "several", "some", "deep", "low", "into", "from")
)


class Target(NamedTuple):
    """Where a limb goes.

    Args:
        limb: "arm", "elbow", "leg", "knee", "heel", "head", "trunk", "hips" or "shoulders".
        side: "left", "right", "both", or "one" for either.
        ways: "up", "down", "ahead", "back", "side", "left", "right", "apart", "together", "crossed", "bent",
            "straight", "tiptoe", "lifted", "still"; "turned" of what turns about its own axis, "bowed" of a trunk.
        at: The part of the body or the height where it goes; "" for none.
        by: How it is there: "on", "front", "behind", "above", "under", or "level" for a height.
        at_side: The side of that part; "" where nothing is said of it.
        amount: How far, of what is usual.
        to: Ways of the other end of what goes to and fro, "round" of what circles; none of what goes there once.
    """

    limb: str
    side: str = "both"
    ways: frozenset[str] = frozenset()
    at: str = ""
    by: str = ""
    at_side: str = ""
    amount: float = 1.0
    to: frozenset[str] = frozenset()

    @property
    def mirrored(self) -> Target:
        """The same with left and right exchanged."""
        ways, to = (frozenset(OTHER.get(way, way) for way in some) for some in (self.ways, self.to))
        side, at_side = (OTHER.get(one, one) for one in (self.side, self.at_side))
        return self._replace(side=side, ways=ways, at_side=at_side, to=to)


class Phrase(NamedTuple):
    """Words that say one thing.

    Args:
        kind: Of its row in the table; "other" of what is in none.
        value: The same.
        words: As they stand there.
        start: The number of the first word.
        stop: The number of the word after.
    """

    kind: str
    value: str
    words: tuple[str, ...]
    start: int
    stop: int


def phrases_of(words: Sequence[str]) -> list[Phrase]:
    """The phrases of some words; those that say nothing are left out, and those that are not known are "other"."""
    found: list[Phrase] = []
    at, table = 0, lexicon().posing
    while at < len(words):
        best = longest_phrase(table.get(words[at], ()), words, at)
        stop = at + 1 if best is None else best[1]
        if words[at] == "like":
            stop = next((number for number in range(at + 1, len(words)) if words[number] in _JOINS), len(words))
            found.append(Phrase("like", "", tuple(words[at:stop]), at, stop))
        elif best is not None:
            kind, _, value = best[0].name.partition(" ")
            if kind in ("does", "stance") and _noun(words, at, found):
                kind = "other"
            found.append(Phrase(kind, value, tuple(words[at:stop]), at, stop))
        elif words[at] not in FUNCTION_WORDS and not words[at].endswith("ly") and words[at].isalnum():
            found.append(Phrase("other", "", (words[at],), at, stop))
        at = stop
    return [one for number in range(len(found)) for one in _sided(found, number)]


def _of_past(word: str) -> bool:
    """Whether a word is no verb but for one of the past, or a gerund: "raised" may stand before a noun."""
    return word not in lexicon().verbs and word not in lexicon().third


def _noun(words: Sequence[str], at: int, before: Sequence[Phrase]) -> bool:
    """Whether what looks like a verb is a noun: "two squats", "knee lifts"."""
    if at and words[at - 1] in _BEFORE_NOUNS and (words[at - 1] == "from" or not _of_past(words[at])):
        return True
    part = before[-1] if before and before[-1].stop == at and before[-1].kind == "part" else None
    if part is None or words[at] not in lexicon().third or words[at - 1].endswith("s"):
        return False
    return part.start == 0 or words[part.start - 1] not in FUNCTION_WORDS | set(OTHER)


def _sided(phrases: Sequence[Phrase], number: int) -> list[Phrase]:
    """A "left" or "right" as the side of the limb after it, or else as a way; what says nothing is left out."""
    one = phrases[number]
    after = phrases[number + 1].kind if number + 1 < len(phrases) else ""
    if one.kind == "aside":
        return []
    if one.kind == "round" and len(one.words) == 1 and after in ("part", "side"):
        return [one._replace(kind="by", value="on")]  # "the arms around the knees"
    if one.value not in OTHER:
        return [one]
    named = next((other for other in phrases[number + 1 : number + 3] if other.kind not in ("does", "amount")), None)
    if named is None or named.kind != "part":
        return [one._replace(kind="way")]
    side = one._replace(kind="side")
    return [side] if len(one.words) == 1 else [one._replace(kind="by", value="on"), side]


def names_limb(text: str) -> bool:
    """Whether a text is the name of a limb: "the left leg"."""
    found = phrases_of(words_of(text)[0])
    limbs = [one.value in LIMBS for one in found if one.kind == "part"]
    return bool(limbs) and all(limbs) and {one.kind for one in found} <= {"part", "side"}


def participle(phrase: Phrase) -> bool:
    """Whether a verb is in a form that is no verb of a sentence: "raised"."""
    word, table = phrase.words[0], lexicon()
    return word not in table.third and word not in table.gerund and word not in table.verbs


def segments_of(phrases: Sequence[Phrase]) -> list[tuple[str, list[Phrase]]]:
    """The phrases of each thing that is said, and what joins it: "", "and", "comma", "then", "with" or "while"."""
    found: list[tuple[str, list[Phrase]]] = []
    join, own = "", list[Phrase]()
    for one in phrases:
        kinds = {before.kind for before in own}
        verb = one.kind in ("does", "stance")
        begins = verb and bool("stance" in kinds or (kinds & {"does", "other"} and not participle(one)))
        if one.kind != "joins" and not begins:
            own.append(one)
            continue
        if own:
            found.append((join, own))
            join = ""
        if one.kind == "joins":
            join, own = one.value if one.value != "and" or not join else join, []
        else:
            join, own = join or ("while" if one.words[0] in lexicon().gerund else "with"), [one]
    return [*found, (join, own)] if own else found


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
    if not limbs and any(one.kind == "it" for one in phrases):
        limbs = [(one.limb, one.side) for one in last]
    if not limbs and (verb in _OF_TRUNK or verb == "look"):
        limbs = [("head" if verb == "look" else "trunk", "both")]
    if not limbs:
        goes_on = (ways or plain.at) and not any(one.kind == "does" for one in phrases)
        return tuple([_of_limb(one.limb, one.side, ways, plain, "") for one in last]) if goes_on else ()
    if limbs[0][0] == "trunk" and plain.at == "hip":  # "bends at the hips"
        plain = plain._replace(at="", by="")
    if limbs[0][0] == "head" and plain.at == "chest":
        ways, plain = ways | {"down"}, plain._replace(at="", by="")
    leans_on = plain.at and (limbs[0][0] == "head" or (limbs[0][0] == "trunk" and (plain.at != "arm" or not ways)))
    if plain.by == "off" or leans_on or (verb == "look" and not ways & _LOOKS):
        return ()
    if verb == "circle" and not plain.to:
        plain = plain._replace(to=frozenset(["round"]))
    if verb == "swing" and not plain.to:
        start = next(iter(sorted(ways & set(_ENDS))), "ahead" if limbs[0][0] in _PAIRED else "left")
        ways = ways if ways & _WAYS else ways | {start}
        plain = plain._replace(to=frozenset([_ENDS[start]]))
    found = tuple([_of_limb(limb, side, ways, plain, verb) for limb, side in limbs])
    if verb == "hold" and plain.at == "leg" and limbs[0][0] == "arm":  # the foot comes to the hand
        found += (Target("leg", plain.at_side or "one", at="buttocks", by="on"),)
    return found if all(one.ways & _WAYS or one.at or one.to for one in found) else ()


def _of_limb(limb: str, side: str, ways: frozenset[str], plain: Target, verb: str) -> Target:
    """A target with what a verb says beside its words."""
    usual = _GOES.get(verb, {}).get(limb)
    if verb == "lower" and limb not in ("trunk", "hips") and not plain.at:
        ways = frozenset(["down"])
    elif usual and (not (ways & _WAYS or plain.at or plain.to) or (verb in _SHAPES and limb != "trunk")):
        ways |= {usual}
    if limb == "heel" and "up" in ways:
        ways = ways - {"up"} | {"tiptoe"}
    if limb == "trunk" and verb in ("bend", "bow"):
        ways |= {"bowed" if verb == "bow" else "bent"}
    if limb in ("head", "trunk") and verb in _TURNED:
        ways |= {"turned"}
    return plain._replace(limb=limb, side=side, ways=ways)


def _said(
    phrases: Sequence[Phrase], verb: str, other: str
) -> tuple[list[tuple[str, str]], frozenset[str], Target] | None:
    """Limbs with their sides, ways, and a target with all else that some phrases say; None where they make no sense."""
    limbs: list[tuple[str, str]] = []
    ways, plain = set[str](), Target("")
    side = pending = ""
    for number, one in enumerate(phrases):
        kind, value = one.kind, one.value
        if side == "other" and not limbs and kind not in ("part", "does", "amount"):
            limbs.append(("", other))  # "one hand on the head and the other on the hip"
            side = ""
        if kind == "part":
            limb = LIMBS.get(value, "")
            touches = verb in _AT_PARTS and not (pending or limbs) and limb not in ("arm", "elbow", "")
            if touches and (verb == "cover" or not _posed(phrases[number + 1 :])):
                limbs.append(("arm", "both" if verb == "cover" else "one"))
                plain = plain._replace(at=value, by="on", at_side=side)
            elif pending or not limb or plain.at:
                if not limbs and not (verb in _OF_TRUNK and pending):
                    return None
                at_side = plain.at_side or side
                plain = plain._replace(at=plain.at or value, by=plain.by or pending or "on", at_side=at_side)
            else:
                many = one.words[-1].endswith("s") or one.words[-1] == "feet"
                own = other if side == "other" else side
                limbs.append((limb, own or ("both" if many else "one") if limb in _PAIRED else "both"))
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
            plain = plain._replace(amount=_AMOUNTS[value])
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


def _posed(phrases: Sequence[Phrase]) -> bool:
    """Whether phrases after a limb say how it is held, so that no hand is at it."""
    return any(one.kind in ("way", "level", "by", "does", "to") for one in phrases)
