"""Tails that stream behind: not straight up on a body whose tail rests level, and not through the ground.

What horses do, whose tails hang down at rest and stream behind in a gallop, is a turn upwards by a right angle. A tail
that rests level would point to the sky by the same turn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.bending import carry, local_motion
from bunraku.anatomy.joints import Joints
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.geometry.filters import gaussian
from bunraku.geometry.rotations import heading, matrix_from_axis_angle, matrix_y
from bunraku.retarget.stages.ground import enough
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Tail", "TailClear"]

_TAIL, _TIP = HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")


@dataclass(frozen=True)
class Tail(Stage):
    """Tails that are held up higher than they rest are lowered.

    Args:
        highest: A tail that rests lower is held up so far at the most, but for its swings [rad].
        slow: What changes more slowly than this is how a tail is held, and no swing [s].
    """

    name: ClassVar[str] = "tail"

    highest: float = float(np.radians(25))
    slow: float = 0.5

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return fitting.source.own_kind

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        lowered = self.lowered(fitting.rotations, anatomy.handles, anatomy.joints, fitting.source.fps)
        return replace(fitting, rotations=lowered)

    def lowered(
        self,
        rotations: np.ndarray,
        handles: Handles,
        joints: Joints,
        fps: float,
        root_rotation: np.ndarray | None = None,
    ) -> np.ndarray:
        """Local rotations in which no tail is held up higher than it rests, or higher than `highest`, whatever is more.

        A trunk that tilts forward lifts the tail with it, and so much more is taken from the tail.

        Args:
            rotations: Of a character's handles from its rest pose, in the root's frame, shape (N, K, 3, 3).
            handles: Its handles.
            joints: Where they meet in its rest pose.
            fps: Frames a second [1/s].
            root_rotation: Of the root, shape (N, 3, 3); None for a root that does not turn.
        """
        out, tilt = rotations, np.eye(3)[None]
        there = joints.present & (handles.played == np.arange(len(handles.positions)))
        if root_rotation is not None:
            facing = np.asarray(matrix_y(heading(root_rotation, fps)), np.float64)
            tilt = facing.transpose(0, 2, 1) @ root_rotation
        for part in (_TAIL, _TIP):
            if not there[part]:
                continue
            along = handles.positions[part].astype(np.float64) - joints.positions[part]
            if part == _TAIL and there[_TIP]:
                along = joints.positions[_TIP] - joints.positions[part]
            if np.hypot(along[1], along[2]) < 0.5 * np.linalg.norm(along):  # it lies across the body
                continue
            rest = float(np.arctan2(along[1], -along[2]))
            posed = (tilt @ (rotations[:, part] @ along)[..., None])[..., 0]
            turned = np.arctan2(posed[:, 1], -posed[:, 2]) - rest
            held = gaussian(np.unwrap(turned), self.slow * fps)
            held -= 2 * np.pi * np.round(held.mean() / (2 * np.pi))
            above = np.maximum(rest + held - max(rest, self.highest), 0)
            if above.any():
                lower = matrix_from_axis_angle(-above[:, None] * np.array([1.0, 0, 0]))
                out = out.copy() if out is rotations else out
                out[:, part] = tilt.transpose(0, 2, 1) @ lower @ tilt @ rotations[:, part]
        return out


@dataclass(frozen=True)
class TailClear(Stage):
    """A tail that would sink into the ground is turned up.

    Args:
        step: Turns upwards are tried so far apart, up to a right angle [degrees].
        depth: What sinks less than this share of the height is left as it is.
        soft: How long before and after it is needed a tail is turned [s].
    """

    name: ClassVar[str] = "tail_clear"
    needs: ClassVar[tuple[str, ...]] = ("floor",)

    step: float = 3.0
    depth: float = 0.002
    soft: float = 0.15

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return bool(anatomy.legs)

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return fitting.moved(self.raised(fitting.motion, anatomy))

    def raised(self, motion: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """The motion with a tail turned up, about where it is joined, as far as it would sink into the ground.

        Args:
            motion: Of the character.
            anatomy: Of the character.
        """
        character, handles, joints, there = anatomy.mesh, anatomy.mesh_handles, anatomy.joints, anatomy.own
        held, floor = anatomy.tail, anatomy.floor
        base = _TAIL if there[_TAIL] else _TIP
        if not there[base] or not len(held):
            return motion
        world = motion.transforms(handles.positions).astype(np.float64)
        points = skin(character.vertices[held], handles.weights[held], world).astype(np.float64)
        low = floor - self.depth * character.height
        if points[..., 1].min() >= low:
            return motion
        pivot = np.einsum("nij,j->ni", world[:, base, :, :3], joints.positions[base]) + world[:, base, :, 3]
        facing = np.asarray(matrix_y(heading(motion.root_rotation, motion.fps)), np.float64)
        away = np.einsum("nji,nmj->nmi", facing, points - pivot[:, None])
        up, behind = away[..., 1], -away[..., 2]
        steps = np.radians(np.arange(0, 91, self.step))
        need = np.full(len(motion), steps[-1])
        for step in steps[::-1]:
            clear = (up * np.cos(step) + behind * np.sin(step)).min(axis=1) + pivot[:, 1] >= low
            need = np.where(clear, step, need)
        angle = enough(need, max(1, round(self.soft * motion.fps)))
        turn = facing @ matrix_from_axis_angle(angle[:, None] * np.array([1.0, 0, 0])) @ facing.transpose(0, 2, 1)
        for part in (_TAIL, _TIP) if base == _TAIL else (_TIP,):
            if there[part]:
                carry(world, part, joints, pivot, pivot, turn)
        return local_motion(world, motion, handles)
