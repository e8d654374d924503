"""Which captured examples show what a sentence says.

An example must do the very actions that are requested, on the requested side and in the requested direction; of those,
the nearest are taken by the ranker's vectors of sentences and motions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bunraku.generation.pack import ExamplePack, Said, said_by
from bunraku.gestures.catalogue import part_in
from bunraku.language.clauses import limbs_described
from bunraku.language.interactions import Interaction, says_more
from bunraku.language.lexicon import goes_ahead, lexicon, stays_down
from bunraku.language.phrasing import tells_all
from bunraku.language.posing import Posing
from bunraku.language.sentence import Clause

__all__ = ["Found", "Retrieved", "retrieve"]

MOST = 16
"""Examples that are offered for a sentence."""
NEAR = 0.12
"""Mean cosine by which an example may be farther than the nearest one."""
SOME = 4
"""Examples to choose from that are enough to do without those that show more beside what is meant."""
NEAR_MADE = 0.05
"""The same where the nearest is made by code, since what is captured shows that less plainly."""
LEAST = 0.6
"""Mean cosine from which an example is one at all."""
LEAST_MADE = 0.4
"""The same for a gesture, which does the very action and leaves nothing out: a number in the sentence, and the ranker
is far from words that it has hardly seen.
"""
WALKING = 0.8
"""The same for plain walks and runs, which the network does well by itself."""
SAME = 0.9
"""Cosine of two sentences that mean the same, whatever words the lexicon finds in them. A gesture made by code
is what its words say: the ranker has never seen it, and takes sit-ups for sitting down.
"""
_PACE = {"slow", "fast"}
"""What an example must not say that was not requested."""
_NOTHING = said_by([]).actions
_TURNS = {"turn", "turn around", "spin", "circle"}
_SIDED = frozenset(f"{side} {limb}" for side in ("left", "right") for limb in ("arm", "leg", "turn", "go")) | {
    "forward",
    "backwards",
    "sideways",
    "half",
    "full",
    "gets up",
    "lies",
    "sits",
    "in place",
}
_COUNTS = frozenset(("twice", "thrice", "often"))
"""What captured examples must say too; a gesture is done as often as requested."""
_WAYS = frozenset(("left go", "right go"))
MOST_TIMES = 4
"""How often a captured example is done in a row at the most."""
_ADDED_WAYS = frozenset(("backwards", "forward", "sideways", "left go", "right go"))
_ADDED = frozenset(("high", "low")) | _ADDED_WAYS
_ADDED_TRAITS = frozenset(("on a leg", "backward", "stairs"))
"""Cues and traits of a clause that a gesture does not do where its own words do not say them."""
_SAYS = {"left go": "to the left", "right go": "to the right"}
"""Cues in the words of who says them."""


class Found(NamedTuple):
    """An example that fits a sentence.

    Args:
        number: Which one of the pack.
        mirrored: Its mirror image is meant.
        score: Mean of the cosine of the sentence with its nearest sentence, and of that with its motion.
        part: The part of the body at which a gesture is done in place of its own (`gestures.parts`); "" for its own.
        times: How often a captured one is done that shows one time of what is counted.
        detail: What is done with a thing, follows from one, or is done by limbs, as a gesture of its own
            (`gestures.interactions`).
    """

    number: int
    mirrored: bool
    score: float
    part: str = ""
    times: int = 1
    detail: Interaction | Posing | None = None


class Retrieved(NamedTuple):
    """What fits a sentence.

    Args:
        found: Examples, the nearest first; none where there is none.
        lacking: What the sentence adds to its action that no gesture of that action has, where one would fit but for
            that.
    """

    found: list[Found]
    lacking: tuple[str, ...] = ()


def retrieve(pack: ExamplePack, clause: Clause, vector: np.ndarray) -> Retrieved:
    """Examples that show what a clause says. What limbs do is a gesture of these, and what is done with a thing one
    through the places that it names, or as captured where it names none. Where none shows all of it, those count that
    show it once, to be done as often as is said, and those with the limb that is meant, whichever way its movement
    goes.

    Args:
        pack: To choose from.
        clause: Of one thing that is done.
        vector: The ranker's unit vector of it, shape (V,).
    """
    told = [] if clause.detail is None else [Found(one, False, 1.0, "", 1, clause.detail) for one in pack.handled]
    if told and isinstance(clause.detail, Posing):
        return Retrieved(_telling(pack, clause, clause.detail) or told)
    if clause.limbs_meanwhile is not None:
        return Retrieved([])  # what else is done is shown apart
    if told and not isinstance(clause.detail, Posing) and says_more(clause.detail):
        return Retrieved(told)
    found = _retrieved(pack, clause, vector, frozenset())
    if told and not found.found:
        return Retrieved(told)
    limbed = any(f"{side} {limb}" in clause.cues for side in ("left", "right") for limb in ("arm", "leg"))
    let_go = _WAYS if limbed and "goes" not in clause.traits else frozenset[str]()
    let_go |= _COUNTS if clause.count and 1 < clause.count <= MOST_TIMES else frozenset[str]()
    if found.found or found.lacking or not let_go & clause.cues:
        return found
    return _retrieved(pack, clause, vector, let_go)


def _telling(pack: ExamplePack, clause: Clause, posing: Posing) -> list[Found]:
    """The gestures with a sentence that says the very same of limbs as a clause does."""
    found = []
    for index in np.flatnonzero(pack.made).tolist():
        if pack.said(index).actions != frozenset(clause.actions):
            continue
        own = [limbs_described(text) for text in pack.examples[index].texts]
        same = [one.bare for one in own if one is not None and not one.rest]
        for mirrored, wanted in ((False, posing.bare), (True, posing.mirrored.bare)):
            if wanted in same:
                found.append(Found(index, mirrored, 1.0))
                break
    return found


def _retrieved(pack: ExamplePack, clause: Clause, vector: np.ndarray, let_go: frozenset[str]) -> Retrieved:
    """Examples that show what a clause says but for some cues."""
    query = Said(frozenset(clause.actions) or _NOTHING, clause.cues, clause.traits)
    wanted = _shown(query) - let_go
    counts = query.cues & _COUNTS - let_go
    times = clause.count or 1 if query.cues & _COUNTS & let_go else 1
    lacking: dict[str, None] = {}
    sided = any(cue.startswith(("left", "right")) for cue in query.cues)
    least = WALKING if query.actions <= {"walk", "run"} else LEAST
    found = []
    for mirrored in (False, True):
        cosines = pack.texts[int(mirrored)].astype(float) @ vector
        best = np.full(len(pack.examples), -1.0)
        np.maximum.at(best, pack.owners, cosines)
        score = 0.5 * (best + pack.motions[int(mirrored)].astype(float) @ vector)
        for index in np.flatnonzero((score >= min(least, LEAST_MADE)) | pack.made).tolist():
            made = bool(pack.made[index])
            if not made and score[index] < least:
                continue
            if made and mirrored and not sided:  # made by code with the hand that most people take
                continue
            near = 0.0 if made and query.actions != _NOTHING else float(best[index])
            shown = wanted - _ADDED if made else wanted | counts
            if not _fits(pack.said(index), mirrored, query, shown, near):
                continue
            if times > 1 and (made or pack.said(index).cues & _COUNTS or pack.examples[index].loop is not None):
                continue
            lacks, part = _lacks(pack, index, mirrored, clause) if made else ((), "")
            if not part and score[index] < LEAST_MADE:  # at another part its own sentences say little of it
                continue
            if lacks:
                lacking.update(dict.fromkeys(lacks))
            else:
                found.append(Found(index, mirrored, float(score[index]), part, times))
    found.sort(key=lambda one: -one.score)
    best_made = bool(found) and bool(pack.made[found[0].number])
    best_made = best_made and query.actions != {"stand up"}  # that depends on how somebody sits, kneels or lies
    away = NEAR_MADE if best_made else NEAR
    kept = [one for one in found if one.score >= found[0].score - away]
    besides = [_besides(pack, one, query) for one in kept]
    most = sorted(besides)[:SOME][-1] if besides else 0
    kept = [one for one, more in zip(kept, besides, strict=True) if more <= most]
    whole = [one for one in kept if one.part or tells_all(clause.added, pack.examples[one.number].texts)]
    return Retrieved((whole or kept)[:MOST], () if whole else tuple(lacking))


def _besides(pack: ExamplePack, found: Found, query: Said) -> int:
    """How much an example shows that nobody asked for: other actions, and, of a gesture, another way. Who points does
    not point to the left, and who falls does not get up and fall again.
    """
    said = pack.said(found.number)
    ways = (said.mirrored_cues if found.mirrored else said.cues) & _ADDED_WAYS - query.cues
    rows = lexicon().actions
    others = [one for one in said.besides - query.actions if one not in rows or not rows[one].passing]
    return len(others) + (len(ways) if pack.made[found.number] else 0)


def _lacks(pack: ExamplePack, index: int, mirrored: bool, clause: Clause) -> tuple[tuple[str, ...], str]:
    """What a clause adds to its action that a gesture does not do, and the part of the body at which it is done instead
    of at its own.
    """
    texts, said = pack.examples[index].texts, pack.said(index)
    words = [word for word in clause.added if not tells_all((word,), texts)]
    cues = said.mirrored_cues if mirrored else said.cues
    words += [_SAYS.get(cue, cue) for cue in sorted((clause.cues & _ADDED) - cues) if not tells_all((cue,), texts)]
    words += sorted((clause.traits & _ADDED_TRAITS) - said.traits)
    if not words and not clause.count:
        return (), ""
    gesture, part = pack.gesture(index), part_in(clause.person)  # only then is the gesture read
    if gesture is None or not gesture.at:
        part = None
    if part is not None:
        words = [word for word in words if word not in part.words]
    if clause.count and gesture is not None and not gesture.counted:
        words.append(f"{clause.count} times")
    return tuple(words), "" if part is None else part.name


def _shown(query: Said) -> frozenset[str]:
    """Cues that an example must say too: "forward" of who goes, "around" of who turns."""
    idle = frozenset[str]() if goes_ahead(query.actions) else {"forward"}
    return (query.cues & _SIDED) - idle - (frozenset[str]() if query.actions & _TURNS else {"half", "full"})


def _fits(said: Said, mirrored: bool, query: Said, wanted: frozenset[str], near: float) -> bool:
    if near < SAME and said.actions != query.actions:
        return False
    shown, cues = said.traits, said.mirrored_cues if mirrored else said.cues
    for pair in lexicon().contrary:
        asked, told = (pair & (names.cues | names.traits) for names in (query, said._replace(cues=cues)))
        if asked and told and not asked & told:
            return False
    if query.actions == {"hop"} and "one foot" in query.traits and "one foot" not in shown:
        return False
    if query.actions == {"run"} and "sets off" in shown and "sets off" not in query.traits:
        return False
    if "gets up" in said.cues and "gets up" not in query.cues and any(map(stays_down, query.actions)):
        return False
    if "stairs" in query.traits and "stairs" not in shown:
        return False
    if "climb" in query.actions and "down" in shown and "down" not in query.traits:
        return False
    if query.actions == {"raise arm"} and ("both" in shown) != ("both" in query.traits):
        return False
    if query.actions <= {"walk", "run"} and "halts" in shown and "halts" not in query.traits:
        return False
    return wanted <= cues and cues & _PACE <= query.cues
