"""Legs under the trunk: the stage `support` of fitting.

Motions of people mean nothing by what their arms do while they bow, sit or look about. On a body with four legs these
are forelegs: folded, they leave the chest over nothing. Where the two legs of one end of the trunk are off the ground
for longer than a leap or a blow lasts, while the other end stands, they are put down below it. Who rears up means to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.bending import move_feet
from bunraku.anatomy.legs import Leg, foot_points
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.geometry.filters import gaussian
from bunraku.geometry.rotations import axis_angle_from_matrix, heading, matrix_from_axis_angle, matrix_y
from bunraku.handles.limbs import FAMILIES, SIDES, limb_handles
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Support"]

_FRONT = [handle for side in SIDES for handle in limb_handles(side, FAMILIES[1])]


def _ends(handles: Handles, legs: list[Leg]) -> tuple[list[int], list[int]]:
    """The legs of the rear and of the front of a body on four legs, by their numbers; empty of others."""
    front = [number for number, leg in enumerate(legs) if int(handles.played[leg.upper]) in _FRONT]
    rear = [number for number in range(len(legs)) if number not in front]
    return (rear, front) if len(front) == len(rear) == 2 else ([], [])


@dataclass(frozen=True)
class Support(Stage):
    """Legs stay under the trunk of a body on four legs.

    Args:
        lifted: A leg whose foot is higher, over its length, carries nothing.
        long: Legs that are lifted for longer leave the trunk without support [s].
        reared: An end of the trunk that is so much higher than at rest is meant to be up [rad].
        soft: How softly legs are put down [s].
    """

    name: ClassVar[str] = "support"

    lifted: float = 0.1
    long: float = 0.6
    reared: float = float(np.radians(20))
    soft: float = 0.12

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return len(anatomy.legs) == 4

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return fitting.moved(self.kept(fitting.motion, anatomy))

    def unsupported(self, motion: HandleMotion, anatomy: Anatomy) -> np.ndarray:
        """In which frames the rear and the front of a trunk have nothing under them, though the other end stands, shape
        (N, 2), bool.

        Args:
            motion: Of the character.
            anatomy: Of the character.
        """
        character, handles, legs, floor = anatomy.mesh, anatomy.mesh_handles, anatomy.legs, anatomy.floor
        world = motion.transforms(handles.positions)
        ends = _ends(handles, legs)
        out = np.zeros((len(motion), 2), bool)
        if not ends[0]:
            return out
        high, tops, rest = [], [], []
        for end in ends:
            heights = [
                (foot_points(legs[number], character, handles, world)[..., 1].min(axis=1) - floor) / legs[number].length
                for number in end
            ]
            high.append(np.min(heights, axis=0) > self.lifted)
            tops.append(np.mean([_joint(world, legs[number].upper, legs[number].joints[0]) for number in end], axis=0))
            rest.append(np.mean([legs[number].joints[0] for number in end], axis=0))
        rise = _slope(tops[1] - tops[0]) - _slope((rest[1] - rest[0])[None])  # of the front over the rear
        for side, rises in ((0, -rise), (1, rise)):
            out[:, side] = self._lasting(high[side] & ~high[1 - side] & (rises < self.reared), motion.fps)
        return out

    def kept(self, motion: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """The motion with legs put down below the end of the trunk that has nothing under it; as it is, of who does not
        stand on four.

        Args:
            motion: Of the character, on the ground.
            anatomy: Of the character.
        """
        handles, legs = anatomy.handles, anatomy.legs
        wanting = self.unsupported(motion, anatomy)
        if not wanting.any():
            return motion
        world = motion.transforms(handles.positions).astype(np.float64)
        ahead = np.asarray(matrix_y(heading(motion.root_rotation, motion.fps)), np.float64)
        shifts = np.zeros((len(motion), len(legs), 3))
        slopes = np.tile(np.eye(3), (len(motion), len(legs), 1, 1))
        for end, numbers in enumerate(_ends(handles, legs)):
            amount = gaussian(wanting[:, end].astype(float), self.soft * motion.fps)[:, None]
            if not wanting[:, end].any():
                continue
            for number in numbers:
                leg = legs[number]
                top = _joint(world, leg.upper, leg.joints[0])
                ankle = _joint(world, leg.end, leg.joints[2])
                goal = top + np.einsum("nij,j->ni", ahead, leg.joints[2] - leg.joints[0])
                goal[:, 1] = leg.joints[2][1]  # as high over the ground as at rest
                shifts[:, number] = amount * (goal - ankle)
                level = axis_angle_from_matrix(ahead @ np.swapaxes(world[:, leg.end, :, :3], -1, -2))
                slopes[:, number] = matrix_from_axis_angle(amount * np.asarray(level))
        return move_feet(motion, handles, anatomy.joints, legs, shifts, slopes)

    def _lasting(self, held: np.ndarray, fps: float) -> np.ndarray:
        """Runs of frames that last longer than `long`, shape (N,), bool."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(int)))
        out = np.zeros(len(held), bool)
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            out[start:end] = end - start > self.long * fps
        return out


def _joint(world: np.ndarray, handle: int, position: np.ndarray) -> np.ndarray:
    return np.asarray(world[:, handle, :, :3] @ position + world[:, handle, :, 3], np.float64)


def _slope(direction: np.ndarray) -> np.ndarray:
    """How far directions (N, 3) lead up [rad], shape (N,)."""
    return np.asarray(np.arctan2(direction[:, 1], np.hypot(direction[:, 0], direction[:, 2])))
