"""Stages for what trails: ears, horns, trunks and tails follow with a damped lag, and tails stay out of the ground."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import Joints
from bunraku.anatomy.legs import carry
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Handles
from bunraku.core.geometry.curves import gaussian
from bunraku.core.geometry.rotations import (
    axis_angle_from_matrix,
    facing_and_tilt,
    matrix_from_axis_angle,
    rotation_between,
)
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.retarget.stages.ground import enough
from bunraku.retarget.stages.stage import Fitting, Stage

_TAIL, _TIP = _TAIL_HANDLES = [HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")]
# Standard gravity [m/s^2], and the height of a person by whose pendulums the lag was chosen by eye [m].
_GRAVITY, _PERSON = 9.81, 1.7


@dataclass(frozen=True)
class Lag(Stage, name="lag", needs=("attach",)):
    """Ears, horns, a trunk and a tail that nothing moves follow what they grow from with a damped lag."""

    stiff: float = 2.5  # natural frequency, over that of a pendulum as long as the part on a body as tall as a person
    damping: float = 0.4  # share of critical damping, less than 1
    most: float = float(np.radians(25))  # no part is turned farther from where it would be if it were stiff [rad]
    # A tail that turns against the pelvis by more on average was drawn, and has its motion already [rad].
    drawn: float = float(np.radians(6))
    middle: float = 2 / 3  # how far along a part its point is: two thirds, as of a rod about its end

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return len(fitting.source) > 1 and not anatomy.handles.rigid and bool(self.parts(fitting.source, anatomy))

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return fitting.moved(self.lagging(fitting.motion, anatomy, self.parts(fitting.source, anatomy)))

    def parts(self, source: HandleMotion, anatomy: Anatomy) -> list[list[int]]:
        """The handles of each part that nothing moves, from its root outwards."""
        out = [[handle] for handle in anatomy.appendages if anatomy.joints.present[handle]]
        tail = [handle for handle in _TAIL_HANDLES if anatomy.own[handle]]
        pelvis = source.rotations[:, :1].astype(np.float64).transpose(0, 1, 3, 2)
        turned = axis_angle_from_matrix(pelvis @ source.rotations[:, _TAIL_HANDLES].astype(np.float64))
        if anatomy.plan.tail and tail and float(np.linalg.norm(turned, axis=-1).mean()) < self.drawn:
            out.append(tail)
        return out

    def lagging(self, motion: HandleMotion, anatomy: Anatomy, parts: list[list[int]]) -> HandleMotion:
        """The motion with some parts lagging behind, each turned about its joint. Of the handles of a part, from the
        root outwards, those further out go along with the first, and lag on.
        """
        joints, handles = anatomy.joints, anatomy.handles
        world = motion.transforms(handles.positions).astype(np.float64)
        for part in parts:
            for number, handle in enumerate(part):
                joint = joints.positions[handle]
                out = self._reach(anatomy, handle) * (np.asarray(handles.positions[handle], np.float64) - joint)
                length = float(np.linalg.norm(out))
                if length < 1e-6 * anatomy.mesh.height:
                    continue
                pivot = np.einsum("nij,j->ni", world[:, handle, :, :3], joint) + world[:, handle, :, 3]
                stiff = np.einsum("nij,j->ni", world[:, handle, :, :3], out) * self.middle
                frequency = self.stiff * np.sqrt(_GRAVITY * anatomy.mesh.height / (_PERSON * length))
                turn = self._turns(stiff, self.followed(pivot + stiff, frequency, motion.fps) - pivot)
                for each in part[number:]:
                    carry(world, each, joints, pivot, pivot, turn)
        return motion.with_transforms(world, handles.positions)

    def _reach(self, anatomy: Anatomy, handle: int) -> float:
        """How far a part goes on from its joint, over the way to its middle."""
        joint, middle = anatomy.joints.positions[handle], np.asarray(anatomy.handles.positions[handle], np.float64)
        held = anatomy.mesh.surface & (anatomy.mesh_handles.weights[:, handle] > 0.5)
        way = float(np.linalg.norm(middle - joint))
        if not held.any() or way < 1e-9:
            return 1.0
        along = (anatomy.mesh.vertices[held] - joint) @ (middle - joint) / way
        return max(float(along.max()) / way, 1.0)

    def followed(self, goal: np.ndarray, frequency: float, fps: float) -> np.ndarray:
        """Where a point on a spring of natural frequency w [rad/s] is while its goal moves, shape (N, 3) each [m]."""
        rate, swing = self.damping * frequency, frequency * np.sqrt(1 - self.damping**2)
        # Of e = x - x_p between frames: e'' = -w^2 e - 2 z w e', a swing that dies away.
        sine, cosine = np.sin(swing / fps) / swing, np.cos(swing / fps)
        step = np.exp(-rate / fps) * np.array(
            [[cosine + rate * sine, sine], [-(frequency**2) * sine, cosine - rate * sine]]
        )
        speed = np.diff(goal, axis=0) * fps
        out, lag, pace = np.empty_like(goal), np.zeros(3), np.zeros(3)
        out[0] = goal[0]
        for frame in range(1, len(goal)):
            if frame > 1:
                pace = pace - (speed[frame - 1] - speed[frame - 2])
            lag, pace = step[0, 0] * lag + step[0, 1] * pace, step[1, 0] * lag + step[1, 1] * pace
            out[frame] = goal[frame] + lag
        return out

    def _turns(self, stiff: np.ndarray, lags: np.ndarray) -> np.ndarray:
        """Rotations from where a part would point to where it does, softly bounded, shape (N, 3, 3)."""
        angles = axis_angle_from_matrix(rotation_between(stiff, lags))
        size = np.linalg.norm(angles, axis=1, keepdims=True)
        bounded = angles * self.most * np.tanh(size / self.most) / np.maximum(size, 1e-9)
        return np.asarray(matrix_from_axis_angle(bounded))


@dataclass(frozen=True)
class Tail(Stage, name="tail"):
    """Tails that are held up higher than they rest are lowered."""

    # A tail that rests lower is held up so far at the most, but for its swings [rad].
    highest: float = float(np.radians(25))
    slow: float = 0.5  # what changes more slowly than this is how a tail is held, and no swing [s]

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return fitting.source.own_kind

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        fps, root = fitting.source.fps, fitting.source.root_rotation
        return replace(fitting, rotations=self.lowered(fitting.rotations, anatomy.handles, anatomy.joints, fps, root))

    def lowered(self, turns: np.ndarray, handles: Handles, joints: Joints, fps: float, root: np.ndarray) -> np.ndarray:
        """Local rotations in which no tail is held up higher than it rests, or higher than `highest`, whatever is more.

        A trunk that tilts forward lifts the tail with it, and so much more is taken from the tail.

        Args:
            turns: Those of a character's handles from its rest pose, in the root's frame, shape (N, K, 3, 3).
            joints: Where the handles meet in the rest pose.
            root: Rotations of the root, shape (N, 3, 3).
        """
        out, (_, tilt) = turns, facing_and_tilt(root, fps)
        there = joints.present & (handles.played == np.arange(len(handles.positions)))
        for part in (_TAIL, _TIP):
            if not there[part]:
                continue
            along = handles.positions[part].astype(np.float64) - joints.positions[part]
            if part == _TAIL and there[_TIP]:
                along = joints.positions[_TIP] - joints.positions[part]
            if np.hypot(along[1], along[2]) < 0.5 * np.linalg.norm(along):  # it lies across the body
                continue
            rest = float(np.arctan2(along[1], -along[2]))
            posed = (tilt @ (turns[:, part] @ along)[..., None])[..., 0]
            turned = np.arctan2(posed[:, 1], -posed[:, 2]) - rest
            held = gaussian(np.unwrap(turned), self.slow * fps)
            held -= 2 * np.pi * np.round(held.mean() / (2 * np.pi))
            above = np.maximum(rest + held - max(rest, self.highest), 0)
            if above.any():
                lower = matrix_from_axis_angle(-above[:, None] * np.array([1.0, 0, 0]))
                out = out.copy() if out is turns else out
                out[:, part] = tilt.transpose(0, 2, 1) @ lower @ tilt @ turns[:, part]
        return out


@dataclass(frozen=True)
class TailClear(Stage, name="tail_clear", needs=("floor",)):
    """A tail that would sink into the ground is turned up."""

    step: float = 3.0  # turns upwards are tried so far apart, up to a right angle [degrees]
    depth: float = 0.002  # what sinks less than this share of the height is left as it is
    soft: float = 0.15  # how long before and after it is needed a tail is turned [s]

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return bool(anatomy.legs)

    def changed(self, motion: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """The motion with a tail turned up, about where it is joined, as far as it would sink into the ground."""
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
        facing, _ = facing_and_tilt(motion.root_rotation, motion.fps)
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
        return motion.with_transforms(world, handles.positions)
