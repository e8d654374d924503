"""Ears, horns, a trunk and a tail that nobody moves follow what they grow from with a damped lag: the stage `lag` of
fitting.

Each is a point on a spring. Where the point would be if the part were stiff is x_p(t); the point itself goes by

    x'' = w^2 (x_p - x) + 2 z w (x_p' - x'),

a second-order low-pass with w its natural frequency and z its damping, so what moves steadily has no lag. Between
frames x_p is taken as a straight line, for which the solution is known in closed form, so the result hardly depends on
the frames a second. It is causal: nothing moves before what moves it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.bending import carry, local_motion
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, rotation_between
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Lag"]

_TAIL = [HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")]
_GRAVITY, _PERSON = 9.81, 1.7


@dataclass(frozen=True)
class Lag(Stage):
    """Ears, horns, a trunk and a tail that nothing moves follow what they grow from with a damped lag.

    Args:
        stiff: Natural frequency, over that of a pendulum as long as the part on a body as tall as a person.
        damping: Share of critical damping, less than 1.
        most: No part is turned farther from where it would be if it were stiff [rad].
        drawn: A tail that turns against the pelvis by more on average was drawn, and has its motion already [rad].
        middle: How far along a part its point is: two thirds, as of a rod about its end.
    """

    name: ClassVar[str] = "lag"
    needs: ClassVar[tuple[str, ...]] = ("attach",)

    stiff: float = 2.5
    damping: float = 0.4
    most: float = float(np.radians(25))
    drawn: float = float(np.radians(6))
    middle: float = 2 / 3

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return len(fitting.source) > 1 and not anatomy.handles.rigid and bool(self.parts(fitting.source, anatomy))

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return fitting.moved(self.lagging(fitting.motion, anatomy, self.parts(fitting.source, anatomy)))

    def parts(self, source: HandleMotion, anatomy: Anatomy) -> list[list[int]]:
        """The handles of each part that nothing moves, from its root outwards.

        Args:
            source: Of the reference body.
            anatomy: Of the character.
        """
        out = [[handle] for handle in anatomy.appendages if anatomy.joints.present[handle]]
        tail = [handle for handle in _TAIL if anatomy.own[handle]]
        pelvis = source.rotations[:, :1].astype(np.float64).transpose(0, 1, 3, 2)
        turned = axis_angle_from_matrix(pelvis @ source.rotations[:, _TAIL].astype(np.float64))
        if anatomy.plan.tail and tail and float(np.linalg.norm(turned, axis=-1).mean()) < self.drawn:
            out.append(tail)
        return out

    def lagging(self, motion: HandleMotion, anatomy: Anatomy, parts: list[list[int]]) -> HandleMotion:
        """The motion with some parts lagging behind, each turned about its joint.

        Args:
            motion: Of the character.
            anatomy: Of the character.
            parts: Handles of each, from the root outwards; those further out go along with the first, and lag on.
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
        return local_motion(world, motion, handles)

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
        """Where a point on a spring is while its goal moves, shape (N, 3) each [m].

        Args:
            goal: Where it would rest.
            frequency: Its natural frequency, w [rad/s].
            fps: Frames a second [1/s].
        """
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
        return np.asarray(
            matrix_from_axis_angle(angles * self.most * np.tanh(size / self.most) / np.maximum(size, 1e-9))
        )
