"""Left and right legs swing alike: the stage `swings` of fitting.

What a generator makes of four legs limps: one leg of a pair swings up to twice as far as the other, about another
middle. Where a pair goes to and fro again and again, both legs are turned to swing as far as they do in the mean.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.legs import Leg
from bunraku.geometry.rotations import (
    axis_angle_from_matrix,
    heading,
    matrix_from_axis_angle,
    matrix_y,
    nearest_rotation,
)
from bunraku.handles.limbs import further_legged
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Swings", "pairs_of"]


def pairs_of(legs: list[Leg]) -> list[tuple[Leg, Leg]]:
    """Legs of the left and of the right side that meet the body side by side, the foremost first.

    Args:
        legs: Of a body that faces +z.
    """
    left, found = sorted((leg for leg in legs if leg.joints[0][0] > 0), key=lambda leg: -leg.joints[0][2]), []
    right = [leg for leg in legs if leg.joints[0][0] <= 0]
    for one in left:
        if right:
            other = min(right, key=lambda leg: abs(leg.joints[0][2] - one.joints[0][2]))
            right = [leg for leg in right if leg is not other]
            found.append((one, other))
    return found


@dataclass(frozen=True)
class Swings(Stage):
    """Left and right legs of a body on four legs swing alike.

    Args:
        shortest: Shortest cycle of steps [s].
        longest: Longest one [s].
        alike: Correlation of a leg's angle with itself a cycle later, from which on it goes to and fro.
        turns: Correlation of both legs, negative, from which on they take turns, whatever their pace.
        crossings: How often one then passes the other at the least: once is a step, and no walk.
        least: Angle through which both legs swing at the least [rad].
        unlike: Factor between both beyond which they do different things, as who strikes with a paw.
        percent: Share of the frames beyond the swing's ends, on each side.
        most: Factor by which a swing is made larger or smaller at the most.
        rounds: The factors are found in turns, since a leg's angle is no linear function of its parts'.
    """

    name: ClassVar[str] = "swings"

    shortest: float = 0.25
    longest: float = 2.5
    alike: float = 0.4
    turns: float = 0.5
    crossings: int = 4
    least: float = 0.1
    unlike: float = 3.0
    percent: float = 5.0
    most: float = 1.8
    rounds: int = 4

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return fitting.source.own_kind and bool(anatomy.plan.front) and not further_legged(anatomy.handles)

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        rotations, fps = fitting.rotations.copy(), fitting.source.fps
        # a trunk that rocks with the steps adds to the swing of one leg what it takes from the other's
        rocks = matrix_y(-heading(fitting.root_rotation, fps)) @ fitting.root_rotation
        for pair in pairs_of(anatomy.legs):
            self._paired(rotations, pair, anatomy, rocks, fps)
        return replace(fitting, rotations=rotations)

    def _paired(
        self, rotations: np.ndarray, pair: tuple[Leg, Leg], anatomy: Anatomy, rocks: np.ndarray, fps: float
    ) -> None:
        """Make both legs of a pair swing alike, in place."""
        angles = [self.angle(rotations, leg, anatomy, rocks) for leg in pair]
        swings = [self.swing(angle) for angle in angles]
        ratio = max(swings) / max(min(swings), 1e-9)
        if min(swings) < self.least or ratio > self.unlike or not self._goes_on(angles, fps):
            return
        swing, middle = float(np.sqrt(swings[0] * swings[1])), float(np.mean([one.mean() for one in angles]))
        for leg, own in zip(pair, swings, strict=True):
            factor, turned = 1.0, rotations
            for _ in range(self.rounds):
                factor = float(np.clip(factor * swing / max(own, 1e-9), 1 / self.most, self.most))
                turned = self._scaled(rotations, leg, factor)
                own = self.swing(self.angle(turned, leg, anatomy, rocks))
            shift = middle - float(self.angle(turned, leg, anatomy, rocks).mean())
            about = matrix_from_axis_angle(np.array([-shift, 0.0, 0.0]))
            for handle in _handles(leg):
                rotations[:, handle] = about @ turned[:, handle]

    def angle(self, rotations: np.ndarray, leg: Leg, anatomy: Anatomy, rocks: np.ndarray) -> np.ndarray:
        """How far forward a leg points along the heading [rad], shape (N,), of a root with these rotations from its
        heading, shape (N, 3, 3).
        """
        hip, knee, ankle = leg.joints.astype(np.float64)
        sole = anatomy.mesh.vertices[leg.sole].mean(axis=0) - ankle
        way = rotations[:, leg.upper] @ (knee - hip) + rotations[:, leg.lower] @ (ankle - knee)
        way = (rocks @ (way + rotations[:, leg.end] @ sole)[..., None])[..., 0]
        return np.unwrap(np.arctan2(way[:, 2], -way[:, 1]))

    def swing(self, angle: np.ndarray) -> float:
        """Through how much of an angle a leg swings [rad]."""
        return float(np.ptp(np.percentile(angle, [self.percent, 100 - self.percent])))

    def _scaled(self, rotations: np.ndarray, leg: Leg, factor: float) -> np.ndarray:
        """Rotations with a larger or smaller swing of a leg about the axis from side to side, each of its parts about
        its own mean.
        """
        out = rotations.copy()
        for handle in _handles(leg):
            own = rotations[:, handle]
            mean = nearest_rotation(own.mean(axis=0))
            turn = np.asarray(axis_angle_from_matrix(own @ mean.T))
            turn[:, 0] *= factor
            out[:, handle] = matrix_from_axis_angle(turn) @ mean
        return out

    def _goes_on(self, angles: list[np.ndarray], fps: float) -> bool:
        """Whether both legs go to and fro: with one cycle, or at any pace, one ahead while the other is behind."""
        away = [angle - angle.mean() for angle in angles]
        apart, size = away[0] - away[1], float(np.sqrt((away[0] @ away[0]) * (away[1] @ away[1])))
        if away[0] @ away[1] < -self.turns * size and np.count_nonzero(np.diff(np.sign(apart))) >= self.crossings:
            return True
        count = len(angles[0])
        first, last = round(self.shortest * fps), min(round(self.longest * fps), (2 * count) // 3)
        if last <= first + 1:
            return False
        alike = np.full((2, last + 1), -1.0)
        for row, own in enumerate(away):
            for lag in range(first, last + 1):
                one, other = own[:-lag], own[lag:]
                alike[row, lag] = (one @ other) / max(float(np.sqrt((one @ one) * (other @ other))), 1e-12)
        return bool(alike.min(axis=0).max() > self.alike)


def _handles(leg: Leg) -> list[int]:
    """The handles of a leg's parts, each once."""
    return list(dict.fromkeys((leg.upper, leg.lower, *leg.foot)))
