"""Heads that stay above the ground on bodies that lie along their spine.

A bull lowers its head by a turn of the trunk that would drive the snout of a crocodile into the ground; lifted out of
it as a whole, the body would stand on its head.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.ground import lowest
from bunraku.anatomy.joints import attach_joints
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.geometry.filters import gaussian, running_least
from bunraku.geometry.rotations import axis_angle_from_matrix, heading, matrix_from_axis_angle, matrix_y
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Front"]

_TRUNK = [HANDLE_NAMES.index(name) for name in ("spine1", "spine2", "spine3", "neck", "head", "head_top", "face")]


@dataclass(frozen=True)
class Front(Stage):
    """Heads of bodies that lie along their spine are kept above the ground.

    Args:
        sink: A head may be so far under the ground, over the height.
        steps: Shares of the bending that are tried, before none.
        soft: How softly bending is taken out [s].
    """

    name: ClassVar[str] = "front"
    needs: ClassVar[tuple[str, ...]] = ("ground",)

    sink: float = 0.01
    steps: tuple[float, ...] = (0.75, 0.5, 0.25)
    soft: float = 0.15

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return fitting.source.own_kind and bool(anatomy.legs) and not anatomy.upright

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        source, rotations = self.raised(fitting.source, fitting.rotations, anatomy)
        return replace(
            fitting, source=source, rotations=rotations, root_rotation=source.root_rotation,
            root_translation=anatomy.path(source),
        )  # fmt: skip

    def raised(self, motion: HandleMotion, rotations: np.ndarray, anatomy: Anatomy) -> tuple[HandleMotion, np.ndarray]:
        """A motion with less tilt of the root, and local rotations with less bending of the trunk, in frames in which
        the head of a body that stands as high as at rest would sink into the ground.

        Args:
            motion: Whose root's rotation counts.
            rotations: Of the character's handles, in the root's frame, shape (N, K, 3, 3).
            anatomy: Of the character.
        """
        held = anatomy.front
        if not len(held):
            return motion, rotations
        character, handles, joints = anatomy.mesh, anatomy.mesh_handles, anatomy.joints
        floor = float(character.vertices[character.surface, 1].min()) - self.sink * character.height
        tilt, facing = _tilt(motion)
        bends = np.asarray(axis_angle_from_matrix(rotations[:, _TRUNK].astype(np.float64)))

        def bent(share: np.ndarray) -> tuple[HandleMotion, np.ndarray]:
            some = rotations.copy()
            some[:, _TRUNK] = matrix_from_axis_angle(share[:, None, None] * bends)
            return replace(motion, root_rotation=facing @ matrix_from_axis_angle(share[:, None] * tilt)), some

        def sinks(moved: HandleMotion, some: np.ndarray) -> np.ndarray:
            turned, translations = attach_joints(some.astype(np.float64), handles, joints)
            still = np.zeros_like(motion.root_translation)
            posed = replace(moved, rotations=turned, translations=translations, root_translation=still)
            return lowest(character.vertices[held], handles.weights[held], posed, handles.positions) < floor

        low = sinks(motion, rotations)
        if not low.any():
            return motion, rotations
        share = np.where(low, 0.0, 1.0)
        for step in self.steps:
            clear = ~sinks(*bent(np.full(len(motion), step)))
            share = np.where(low & clear, np.maximum(share, step), share)
        reach = max(round(2 * self.soft * motion.fps), 1)
        share = running_least(share, 2 * reach + 1)
        return bent(gaussian(share, self.soft * motion.fps))


def _tilt(motion: HandleMotion) -> tuple[np.ndarray, np.ndarray]:
    """The tilt of the root as axis times angle (N, 3), and its turn about +Y (N, 3, 3)."""
    facing = np.asarray(matrix_y(heading(motion.root_rotation, motion.fps)), np.float64)
    return np.asarray(axis_angle_from_matrix(facing.transpose(0, 2, 1) @ motion.root_rotation)), facing
