"""Which captured examples show what a sentence says.

An example must do the very actions that are asked for, on the side and in the direction that is asked for; of those,
the nearest are taken by the ranker's vectors of sentences and motions.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from bunraku.diffusion.examples.pack import ExamplePack
from bunraku.language.captions.phrases import mirror_words
from bunraku.language.lexicon.cues import said_cues
from bunraku.language.lexicon.reading import goes_ahead, main_actions, said_traits
from bunraku.language.sentence import Clause

__all__ = ["Found", "retrieve"]

MOST = 16
"""Examples that are offered for a sentence."""
NEAR = 0.12
"""Mean cosine by which an example may be farther than the nearest one."""
NEAR_MADE = 0.05
"""The same for a captured one where the nearest is made by code, since what is captured shows that less plainly."""
LEAST = 0.6
"""Mean cosine from which an example is one at all."""
WALKING = 0.8
"""The same for plain walks and runs, which the network does well by itself."""
SAME = 0.9
"""Cosine of two sentences that mean the same, whatever words the lexicon finds in them. A gesture made by code
is what its words say: the ranker has never seen it, and takes sit-ups for sitting down.
"""
_PACE = {"slow", "fast"}
"""What an example must not say that was not asked for."""
_NOTHING = frozenset(main_actions([]))
_TURNS = {"turn", "turn around", "spin", "circle"}
_SIDED = frozenset(f"{side} {place}" for side in ("left", "right") for place in ("arm", "leg", "turn", "go")) | {
    "forward",
    "backwards",
    "sideways",
    "half",
    "full",
    "gets up",
    "lies",
    "sits",
    "in place",
    "twice",
    "thrice",
    "often",
}


class Found(NamedTuple):
    """An example that fits a sentence.

    Args:
        place: Which one of the pack.
        mirrored: Its mirror image is meant.
        score: Mean of the cosine of the sentence with its nearest sentence, and of that with its motion.
    """

    place: int
    mirrored: bool
    score: float


def retrieve(pack: ExamplePack, clause: Clause, vector: np.ndarray) -> list[Found]:
    """Examples that show what a clause says, the nearest first; none where there is none.

    Args:
        pack: To choose from.
        clause: Of one thing that is done.
        vector: The ranker's unit vector of it, shape (V,).
    """
    asked = _Asked(frozenset(clause.actions) or _NOTHING, clause.cues, clause.traits)
    sided = any(cue.startswith(("left", "right")) for cue in asked.cues)
    least = WALKING if asked.actions <= {"walk", "run"} else LEAST
    found = []
    for mirrored in (False, True):
        cosines = pack.texts[int(mirrored)].astype(float) @ vector
        best = np.full(len(pack.examples), -1.0)
        np.maximum.at(best, pack.owners, cosines)
        score = 0.5 * (best + pack.motions[int(mirrored)].astype(float) @ vector)
        for index in np.flatnonzero(score >= least).tolist():
            one = pack.examples[index]
            if one.made and mirrored and not sided:  # made by code with the hand that most people take
                continue
            near = 0.0 if one.made and asked.actions != _NOTHING else float(best[index])
            if _fits(one.texts, mirrored, asked, near):
                found.append(Found(index, mirrored, float(score[index])))
    found.sort(key=lambda one: -one.score)
    made = bool(found) and pack.examples[found[0].place].made
    made = made and asked.actions != {"stand up"}  # that depends on how somebody sits, kneels or lies
    away = [NEAR if pack.examples[one.place].made or not made else NEAR_MADE for one in found]
    return [one for one, most in zip(found, away, strict=True) if one.score >= found[0].score - most][:MOST]


class _Asked(NamedTuple):
    """What a clause asks for: its actions, cues and traits."""

    actions: frozenset[str]
    cues: frozenset[str]
    traits: frozenset[str]

    @property
    def shown(self) -> frozenset[str]:
        """Cues that an example must say too: "forward" of who goes, "around" of who turns."""
        idle = frozenset[str]() if goes_ahead(self.actions) else {"forward"}
        return (self.cues & _SIDED) - idle - (frozenset[str]() if self.actions & _TURNS else {"half", "full"})


def _fits(texts: tuple[str, ...], mirrored: bool, asked: _Asked, near: float) -> bool:
    if near < SAME and frozenset(main_actions(texts)) != asked.actions:
        return False
    shown = _told(texts)
    for here, there in (("chair", "floor"), ("floor", "chair")):
        if here in asked.traits and there in shown:
            return False
    if asked.actions == {"hop"} and "one foot" in asked.traits and "one foot" not in shown:
        return False
    if asked.actions == {"run"} and "sets off" in shown and "sets off" not in asked.traits:
        return False
    if "stairs" in asked.traits and "stairs" not in shown:
        return False
    if "climb" in asked.actions and "down" in shown and "down" not in asked.traits:
        return False
    if asked.actions == {"raise arm"} and ("both" in shown) != ("both" in asked.traits):
        return False
    if asked.actions <= {"walk", "run"} and "halts" in shown and "halts" not in asked.traits:
        return False
    told = frozenset[str]().union(*(said_cues(mirror_words(text) if mirrored else text) for text in texts))
    return asked.shown <= told and told & _PACE <= asked.cues


@functools.lru_cache(maxsize=1024)
def _told(texts: tuple[str, ...]) -> frozenset[str]:
    """The traits that sentences of an example tell."""
    return frozenset[str]().union(*map(said_traits, texts))
