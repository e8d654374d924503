"""Nothing sinks into the ground and nothing that stands floats over it: the stage `floor` of fitting.

The root is lifted where the body, without its feet, would sink. Feet are then put on the ground where they stand and
lifted out of it where they do not, by bending their legs. What still sinks lifts the root once more. All lifts are
smooth in time and never less than what is needed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.linalg import solveh_banded
from scipy.ndimage import convolve1d, maximum_filter1d

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.bending import move_feet
from bunraku.anatomy.ground import lowest
from bunraku.anatomy.legs import Leg, foot_points
from bunraku.core.character import Character
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages.feet import add_bending
from bunraku.retarget.stages.stage import Contacts, Fitting, Stage

__all__ = ["Floor", "enough"]


def enough(need: np.ndarray, reach: int) -> np.ndarray:
    """A smooth curve that is nowhere below another one and nowhere larger than that is within twice `reach` frames,
    shape (N,).
    """
    if not need.any():
        return np.zeros(len(need))
    window = np.hanning(2 * reach + 3)[1:-1]
    return np.asarray(
        convolve1d(maximum_filter1d(need, 2 * reach + 1, mode="nearest"), window / window.sum(), mode="nearest")
    )


def _lifted(motion: HandleMotion, lift: np.ndarray) -> HandleMotion:
    if not lift.any():
        return motion
    path = motion.root_translation.astype(np.float64)
    path[:, 1] += lift
    return replace(motion, root_translation=path)


@dataclass(frozen=True)
class Floor(Stage):
    """Nothing sinks into the ground, and feet that stand are on it.


    Args:
        hand: How far from the wrist a hand reaches, over the arm's length; farther out is what it holds.
        depth: What sinks less than this share of the height is left as it is.
        spread: How long before and after it is needed a lift begins and ends [s].
        lowered: How far a standing foot that floats is put down at the most, over the leg's length.
        hold: Weight of the heights of standing feet, over the acceleration of their correction.
        pull: Weight of the heights of other feet.
    """

    name: ClassVar[str] = "floor"

    hand: float = 0.45
    depth: float = 0.002
    spread: float = 0.15
    lowered: float = 0.08
    hold: float = 10.0
    pull: float = 0.05

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return fitting.moved(self.settled(fitting.motion, anatomy, fitting.contacts))

    def _foot_lifts(self, heights: np.ndarray, trust: np.ndarray, most: float, depth: float, reach: int) -> np.ndarray:
        """How far a foot is moved up in each frame [m], shape (N,): to the ground where it stands, out of it where it
        does not.

        Args:
            heights: Of its lowest point over the ground [m], shape (N,).
            trust: How much it stands, shape (N,).
            most: How far it is put down at the most [m].
            depth: What may sink [m].
            reach: How many frames before and after it is needed a lift begins and ends.
        """
        goal = np.maximum(-heights, -most)
        band = np.zeros((3, len(heights)))
        band[2] = self.hold * trust + self.pull * (1 - trust) + 1e-4
        add_bending(band)
        lifts = solveh_banded(band, self.hold * trust * goal)
        return np.asarray(lifts + enough(np.maximum(-(heights + lifts) - depth, 0), reach))

    def _solid(self, anatomy: Anatomy) -> np.ndarray:
        """Vertices that must not sink, shape (V,), bool: what the character stands on, its arms and its hands, but not
        what they hold.
        """
        character, handles, out = anatomy.mesh, anatomy.mesh_handles, anatomy.stands.copy()
        for arm in anatomy.arms:
            out |= character.surface & (handles.weights[:, [arm.upper, arm.lower]].sum(axis=1) > 0.5)
            out[self._held(character, arm, True)] = True
        return out

    def _held(self, character: Character, arm: Leg, near: bool) -> np.ndarray:
        """Vertices of a hand that are near its wrist, or those that are not and so what it holds, shape (n,)."""
        away = np.linalg.norm(character.vertices[arm.foot_area] - arm.joints[2], axis=1)
        return np.asarray(arm.foot_area[(away < self.hand * arm.length) == near])

    def settled(
        self,
        motion: HandleMotion,
        anatomy: Anatomy,
        contacts: Contacts | None,
    ) -> HandleMotion:
        """The motion with nothing below the ground, and standing feet on it.

        Args:
            motion: Of the character.
            anatomy: Of the character. What may stand on the ground, arms and hands must not sink, but what hands hold
                may.
            contacts: Of its feet; None where they are not known.
        """
        character, handles, legs, arms = anatomy.mesh, anatomy.mesh_handles, anatomy.legs, anatomy.arms
        floor = anatomy.floor
        depth, reach = self.depth * character.height, max(1, round(self.spread * motion.fps))
        solid = self._solid(anatomy)
        limbs = [
            *legs,
            *(replace(arm, sole=np.intersect1d(arm.sole, self._held(character, arm, True))) for arm in arms),
        ]
        limbs = [limb for limb in limbs if len(limb.sole)]

        def need(some: np.ndarray) -> np.ndarray:
            if not some.any():
                return np.zeros(len(motion))
            return np.maximum(
                floor - depth - lowest(character.vertices[some], handles.weights[some], motion, handles.positions), 0
            )

        ends = np.zeros(len(character.vertices), bool)
        for limb in limbs:
            ends[limb.foot_area] = True
        motion = _lifted(motion, enough(need(solid & ~ends), reach))
        if limbs and len(motion) > 2:
            shifts, transforms = np.zeros((len(motion), len(limbs), 3)), motion.transforms(handles.positions)
            for number, limb in enumerate(limbs):
                heights = foot_points(limb, character, handles, transforms)[..., 1].min(axis=1) - floor
                trust = np.zeros(len(motion))
                if contacts is not None and number < len(legs):
                    held = contacts.stands[:, number]
                    trust[0], trust[-1], trust[1:-1] = held[0], held[-1], np.maximum(held[1:], held[:-1])
                shifts[:, number, 1] = self._foot_lifts(heights, trust, self.lowered * limb.length, depth, reach)
            motion = move_feet(motion, handles, anatomy.joints, limbs, shifts)
        return _lifted(motion, enough(need(solid), reach))
