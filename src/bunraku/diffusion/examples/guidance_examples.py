"""Which candidate starts from which example: other seeds and other candidates take others of those that fit.

Of sentences in a row, each takes one of the examples that begin most as the one before it ends: who stands up after
sitting on a chair gets up from one.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence

import numpy as np

from bunraku.diffusion.examples.guide import CROUCH, GuidanceExample, fills, fits_into, pose_distance
from bunraku.diffusion.examples.pack import ExamplePack
from bunraku.diffusion.examples.retrieve import Found, retrieve
from bunraku.diffusion.features import mirror
from bunraku.gestures.manner import Manner
from bunraku.language.details import tells_all, unseen_word
from bunraku.language.lexicon.reading import goes_ahead, is_cyclic
from bunraku.language.sentence import Clause

__all__ = ["GuidanceExamples"]

NEAREST = 3
ALIKE = 1.0
"""Distance of poses by which others of these may begin less so than the nearest."""
TRIED = 3
"""Examples that are looked at for one."""
LEFT = 0.35
"""Share of gestures that are done with the left hand where nobody says with which."""
SIDES = ("left", "right")
PACES = {"slow": 0.72, "fast": 1.35}
"""Tempo of a gesture by what is said of it."""
ODD = 4.9
"""Distance of a pose from those of people who stand with which nobody begins; that of a kick at its height is 4.8."""


class GuidanceExamples:
    """Examples for the clauses of a call, looked up once each.

    Args:
        pack: To choose from.
        clauses: Each clause by its text, with the ranker's unit vector of it as said of a person.
    """

    def __init__(self, pack: ExamplePack, clauses: Mapping[str, tuple[Clause, np.ndarray]]):
        self.pack = pack
        retrieved = {text: retrieve(pack, *one) for text, one in clauses.items()}
        self._found = {text: one.found for text, one in retrieved.items()}
        self._lacking = {text: one.lacking for text, one in retrieved.items()}

    def shows(self, clause: Clause) -> bool:
        """Whether there is an example for a clause."""
        return bool(self._found.get(clause.text))

    def parted(self, clause: Clause) -> tuple[Clause, ...]:
        """A clause in the parts that are done one after the other, where no example shows it whole and one shows a
        part; else the clause.
        """
        if clause.parts and not self.shows(clause) and any(map(self.shows, clause.parts)):
            return clause.parts
        return (clause,)

    def lacking(self, clause: Clause) -> tuple[str, ...]:
        """What a clause says beyond an action whose gestures leave that out, so that none of them is used."""
        return self._lacking.get(clause.text, ())

    def unseen(self, clause: Clause) -> tuple[str, str]:
        """A word that says a clause's only action while no caption and no example has it, and that action; "" and ""
        for none.
        """
        found = self._found.get(clause.text, [])
        if len(clause.actions) != 1 or any(self.pack.examples[one.number].made for one in found):
            return "", ""
        word = unseen_word(clause.person, clause.actions[0])
        if not word or any(tells_all((word,), example.texts) for example in self.pack.examples):
            return "", ""
        return word, clause.actions[0]

    def unranked(self, script: Sequence[tuple[Clause, int]]) -> bool:
        """Whether a clause requests what the ranker has never seen, a gesture that is made by code or a clip of one's
        own: the network may not have learned it either.
        """
        return any(
            self.pack.examples[found.number].unranked
            for clause, _ in script
            for found in self._found.get(clause.text, [])[:1]
        )

    def of(self, script: Sequence[tuple[Clause, int]], noise: tuple[int, int], number: int) -> GuidanceExample | None:
        """What a candidate starts from; None where no clause has an example.

        Args:
            script: Clauses with the frames that each lasts.
            noise: Seed and row of the motion's own noise: it orders the examples.
            number: Of the candidate among those that start from examples.
        """
        seed = (noise[0] % 2**63, noise[1] % 2**63)
        random = np.random.default_rng(seed)
        chosen: list[Found | None] = []
        for clause, frames in script:
            offered = self._found.get(clause.text, [])
            fitting = [one for one in offered if fits_into(self.pack, one, frames)] or offered
            fitting = [one for one in fitting if fills(self.pack, one, frames)] or fitting
            if chosen and chosen[-1] is not None:
                fitting = self._following(chosen[-1], fitting)
            order = random.permutation(len(fitting)).tolist()
            first = number % max(len(order), 1)
            turn = [fitting[index] for index in order[first:] + order[:first]][:TRIED]
            chosen.append(next((one for one in turn if not self._begins_oddly(one)), turn[0]) if turn else None)
        if not any(chosen):
            return None
        hands = np.random.default_rng((*seed, number, 1))
        sided = [self._sided(clause, one, hands) for (clause, _), one in zip(script, chosen, strict=True)]
        return GuidanceExample(self.pack, tuple(sided), (*seed, number), tuple(_manner(clause) for clause, _ in script))

    def _sided(self, clause: Clause, found: Found | None, random: np.random.Generator) -> Found | None:
        """A gesture with either hand, where the clause names no side and people use either."""
        gesture = None if found is None else self.pack.gesture(found.number)
        if found is None or gesture is None or gesture.handed or any(cue.startswith(SIDES) for cue in clause.cues):
            return found
        return found._replace(mirrored=bool(random.random() < LEFT))

    def _following(self, last: Found, fitting: list[Found]) -> list[Found]:
        """The few that begin most as another ends: who sits on a chair does not get up from the floor."""
        end = self._pose(last, -1)
        away = np.sqrt([float(pose_distance(self._pose(one, 0), end)) for one in fitting])
        order = np.argsort(away, kind="stable")[:NEAREST]
        return [fitting[index] for index in order[away[order] <= away.min(initial=np.inf) + ALIKE].tolist()]

    def _begins_oddly(self, found: Found) -> bool:
        """Whether who stands as an example begins does so bent, as between two exercises, or with a leg far up."""
        first = self.pack.features(found.number)[0]
        if first[3] < -CROUCH or not self.pack.standing:
            return False
        return bool(np.sqrt(pose_distance(self._standing, first[3:])).min() > ODD)

    @functools.cached_property
    def _standing(self) -> np.ndarray:
        """Mean poses of the stretches of standing, shape (S, 268)."""
        return np.stack(list(self.pack.standing_poses.values()))

    def _pose(self, found: Found, frame: int) -> np.ndarray:
        features = self.pack.features(found.number)[[frame]]
        return (mirror(features) if found.mirrored else features)[0, 3:]


def _manner(clause: Clause) -> Manner:
    """How a clause says that something is done."""
    said = [pace for cue, pace in PACES.items() if cue in clause.cues]
    goes = "goes" in clause.traits or goes_ahead(clause.actions)
    lasts = goes and all(map(is_cyclic, clause.actions)) and clause.count is None and "halts" not in clause.traits
    return Manner(clause.count, said[0] if len(said) == 1 else 1.0, lasts=lasts, stance=clause.stance)
