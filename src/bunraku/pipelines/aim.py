"""What a character that never stops looks at and reaches for: over whatever it does, its head turns to a point and a
hand goes to one. What is asked shows softly, frame by frame, so that points may move at any time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.legs import Leg
from bunraku.core.body.layout import HANDLE_INDEX
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages.stage import with_feet_moved

HEAD = tuple(HANDLE_INDEX[name] for name in ("neck", "head", "head_top", "face"))

# Angles [rad] and paces, chosen by eye on the sample person.
ASIDE, NOD = math.radians(75), math.radians(45)  # how far a head turns aside from where the body faces, and nods
BEHIND = math.radians(135)  # aside from which on a point is not looked at, nor reached for
EASE = 0.22  # share of what is missing that comes each frame
FASTEST = math.radians(10)  # turn of the head in a frame
FARTHEST = 0.97  # reach of a hand over the length of its arm

Point = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Aim:
    """How a body looks and reaches.

    Args:
        anatomy: Of the character.
    """

    anatomy: Anatomy

    @property
    def still(self) -> np.ndarray:
        """The state of a frame in which nothing is looked at or reached for, shape (2 + 4 L,) for L arms: how far the
        head is turned aside and down [rad], then for each arm the share that it reaches, 0 to 1, and where to [m].
        """
        return np.zeros(2 + 4 * len(self.anatomy.arms))

    def states(self, motion: HandleMotion, before: np.ndarray, look: Point | None, reach: Point | None) -> np.ndarray:
        """The states of the frames of a motion, shape (N, S), each from the one before it."""
        world = motion.transforms(self.anatomy.handles.positions).astype(np.float64)
        facing = motion.root_rotation.astype(np.float64)
        wanted = self._turns(world, facing, look)
        chosen = self._arms(world, facing, reach)
        out = np.empty((len(motion), len(before)))
        for frame in range(len(motion)):
            state = before.copy()
            state[:2] += np.clip(EASE * (wanted[frame] - state[:2]), -FASTEST, FASTEST)
            for arm, share in enumerate(state[2:].reshape(-1, 4)):
                asked = chosen[frame] == arm
                if asked:
                    share[1:] += (EASE if share[0] > EASE else 1.0) * (np.asarray(reach) - share[1:])
                share[0] += EASE * (float(asked) - share[0])
            out[frame] = before = np.where(np.abs(state) < 1e-4, 0.0, state)
        return out

    def applied(self, motion: HandleMotion, states: np.ndarray) -> HandleMotion:
        """The motion with its head and its arms as the states of its frames say."""
        if not states.any():
            return motion
        anatomy = self.anatomy
        if states[:, 2:].any():
            world = motion.transforms(anatomy.handles.positions).astype(np.float64)
            shares = states[:, 2:].reshape(len(states), -1, 4)
            shifts = np.stack([
                shares[:, number, :1] * (_within(world, arm, shares[:, number, 1:]) - _end(world, arm))
                for number, arm in enumerate(anatomy.arms)
            ], axis=1)  # fmt: skip
            motion = with_feet_moved(motion, anatomy, anatomy.arms, shifts)
        if states[:, :2].any() and self._pivots:
            world = motion.transforms(anatomy.handles.positions).astype(np.float64)
            turns = states[:, :2] / len(self._pivots)
            for pivot, members in self._pivots:  # the neck takes half of it, where there is one
                own = world[:, pivot, :, :3]
                turned = own @ _turn(turns) @ own.transpose(0, 2, 1)
                at = own @ anatomy.joints.positions[pivot] + world[:, pivot, :, 3]
                group = world[:, members]
                group[..., 3] = np.einsum("nij,nkj->nki", turned, group[..., 3] - at[:, None]) + at[:, None]
                group[..., :3] = turned[:, None] @ group[..., :3]
                world[:, members] = group
            motion = motion.with_transforms(world, anatomy.handles.positions)
        return motion

    @property
    def _pivots(self) -> list[tuple[int, list[int]]]:
        """The handles about whose joints the head turns, the lowest first, and those that go with each."""
        joints, played = self.anatomy.joints, self.anatomy.handles.played
        members = [int(each) for each in np.flatnonzero(np.isin(played, HEAD))]
        there = [each for each in members if joints.present[each] and int(played[each]) in HEAD[:2]]
        ordered = sorted(there, key=lambda each: HEAD.index(int(played[each])))
        return [
            (each, [one for one in members if HEAD.index(int(played[one])) >= HEAD.index(int(played[each]))])
            for each in ordered
        ]  # fmt: skip

    def _turns(self, world: np.ndarray, facing: np.ndarray, look: Point | None) -> np.ndarray:
        """How far the head of each frame would turn aside and down [rad], shape (N, 2)."""
        if look is None or not self._pivots:
            return np.zeros((len(world), 2))
        pivot = self._pivots[-1][0]
        own = world[:, pivot, :, :3]
        toward = np.asarray(look) - (own @ self.anatomy.joints.positions[pivot] + world[:, pivot, :, 3])
        x, y, z = np.einsum("nji,nj->ni", own, toward).T
        there = _aside(facing, own[:, :, 2])  # it may look aside by itself
        aside = np.clip(np.arctan2(x, z), -ASIDE - there, ASIDE - there)
        turns = np.stack([aside, np.clip(np.arctan2(-y, np.hypot(x, z)), -NOD, NOD)], axis=1)
        return np.where(np.abs(_aside(facing, toward))[:, None] < BEHIND, turns, 0)

    def _arms(self, world: np.ndarray, facing: np.ndarray, reach: Point | None) -> np.ndarray:
        """Which arm of each frame reaches, the nearest; -1 for none."""
        arms = self.anatomy.arms
        if reach is None or not arms:
            return np.full(len(world), -1)
        middle = (len(world) - 1) // 2  # one arm for all, so that no frame changes it
        away = [np.linalg.norm(np.asarray(reach) - _shoulder(world, arm)[middle]) for arm in arms]
        toward = np.asarray(reach) - np.mean([_shoulder(world, arm) for arm in arms], axis=0)
        return np.where(np.abs(_aside(facing, toward)) < BEHIND, int(np.argmin(away)), -1)


def _shoulder(world: np.ndarray, arm: Leg) -> np.ndarray:
    return np.asarray(world[:, arm.upper, :, :3] @ arm.joints[0] + world[:, arm.upper, :, 3])


def _end(world: np.ndarray, arm: Leg) -> np.ndarray:
    return np.asarray(world[:, arm.end, :, :3] @ arm.joints[2] + world[:, arm.end, :, 3])


def _within(world: np.ndarray, arm: Leg, goals: np.ndarray) -> np.ndarray:
    """Goals of a hand, drawn near to where its arm reaches [m], shape (N, 3)."""
    shoulder = _shoulder(world, arm)
    length = FARTHEST * np.linalg.norm(np.diff(arm.joints, axis=0), axis=1).sum()
    away = goals - shoulder
    far = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    return np.asarray(shoulder + away * np.minimum(1, length / far))


def _aside(facing: np.ndarray, toward: np.ndarray) -> np.ndarray:
    """How far directions are aside from where a body faces, over the ground [rad]."""
    x, _, z = np.einsum("nji,nj->ni", facing, toward).T
    return np.asarray(np.arctan2(x, z))


def _turn(turns: np.ndarray) -> np.ndarray:
    """Rotations of turns aside and down, shape (N, 3, 3)."""
    aside, down = np.zeros((len(turns), 3)), np.zeros((len(turns), 3))
    aside[:, 1], down[:, 0] = turns[:, 0], turns[:, 1]
    return np.asarray(matrix_from_axis_angle(aside) @ matrix_from_axis_angle(down))
