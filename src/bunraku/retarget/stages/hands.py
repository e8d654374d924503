"""Hands that touch the body stay near it: the stage `hands` of fitting.

Proportions differ, so a hand that lay on the hip ends beside it, or inside it. Where a hand of the reference body is
near its head, chest, hips, a thigh or the other hand, the character's hand is brought to the same place of the same
part, by bending the arm. A place is told in the box of a part: within it in shares of the box, outside of it as a gap
in the character's scale.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.bending import move_feet
from bunraku.anatomy.joints import Joints, attach_joints
from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.geometry.easing import smooth_step
from bunraku.geometry.filters import gaussian
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Hands"]

_PARTS = {"head": ("head", "head_top", "face"), "spine3": ("spine2", "spine3", "left_wing", "right_wing"),
"pelvis": ("pelvis", "spine1"),
          "left_hip": ("left_hip",), "right_hip": ("right_hip",)}  # fmt: skip
_WRISTS = (HANDLE_NAMES.index("left_wrist"), HANDLE_NAMES.index("right_wrist"))


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of a body that hands touch: its handle, and its surface's box in the stance [m]."""

    handle: int
    middle: np.ndarray
    half: np.ndarray
    points: np.ndarray


@dataclass(frozen=True)
class Hands(Stage):
    """Hands that touch the body stay near it.

    Args:
        near: Distance from a palm's middle to the body at which it begins to count [m of the reference body].
        touches: Distance at which it counts wholly [m of the reference body].
        rests: Speed of a palm along a part below which it may touch it [m/s of the reference body].
        passes: Speed over which it only passes by [m/s of the reference body].
        close: A hand that is off its position by less than this stays where it is [m of the reference body].
        blend: Deviation of the smoothing in time [s].
        most: How far a hand is moved at the most, over the arm's length.
        palm: What of a hand is this near to its wrist, over the arm's length, is no tool that it holds.
        box: Share of a part's surface that may stick out of its box on each side.
    """

    name: ClassVar[str] = "hands"
    on_request: ClassVar[bool] = True

    near: float = 0.12
    touches: float = 0.05
    rests: float = 0.3
    passes: float = 0.8
    close: float = 0.04
    blend: float = 0.08
    most: float = 0.5
    palm: float = 0.45
    box: float = 0.02

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return anatomy.upright and len(fitting.source) > 1

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return fitting.moved(self.kept(fitting.source, fitting.motion, anatomy))

    def kept(
        self,
        motion: HandleMotion,
        fitted: HandleMotion,
        anatomy: Anatomy,
    ) -> HandleMotion:
        """The fitted motion with hands where the reference body's hands touch it.

        Args:
            motion: Of the reference body.
            fitted: Of the character.
            anatomy: Of the character.
        """
        character, handles, joints, scale = anatomy.mesh, anatomy.mesh_handles, anatomy.joints, anatomy.scale
        arms = [arm for arm in anatomy.arms if int(handles.played[arm.foot[0]]) in _WRISTS]
        if not arms:
            return fitted
        body = reference_body()
        known = self._parts(body.vertices, body.handle_weights, np.arange(len(HANDLE_NAMES)))
        stance = _stance(handles, joints, anatomy.rotations)
        world, theirs = (
            fitted.transforms(handles.positions).astype(np.float64),
            motion.transforms(body.handles.positions).astype(np.float64),
        )
        posed = np.einsum("vk,kij->vij", handles.weights, stance)
        vertices = np.einsum("vij,vj->vi", posed[..., :3], character.vertices) + posed[..., 3]
        own = self._parts(vertices[character.surface], handles.weights[character.surface], handles.played)
        palms = {
            wrist: _palm(body.vertices, body.handle_weights[:, [wrist, wrist + 2]].sum(axis=1)) for wrist in _WRISTS
        }
        shifts = np.zeros((len(fitted), len(arms), 3))
        positions = []  # of each arm: the reference's palm and the character's in each frame
        for number, arm in enumerate(arms):
            wrist = int(handles.played[arm.foot[0]])
            source = _applied(theirs[:, wrist], palms[wrist])
            away = np.linalg.norm(character.vertices[arm.foot_area] - arm.joints[2], axis=1)
            near = arm.foot_area[away < self.palm * arm.length]
            palm = character.vertices[near if len(near) else arm.foot_area].mean(axis=0).astype(np.float64)
            present = _applied(world[:, arm.foot[0]], palm)
            positions.append((wrist, source, present))
            total, want = np.zeros(len(fitted)), np.zeros((len(fitted), 3))
            closest = np.zeros(len(fitted))
            for name, part in known.items():
                if name not in own:
                    continue
                local = _unapplied(theirs[:, part.handle], source)
                share = smooth_step(cKDTree(part.points).query(local)[0], self.near, self.touches) * self._rest(
                    local, motion.fps
                )
                there = own[name]
                goal = _placed(local, part, there, scale)
                frame = world[:, there.handle] @ _square(np.linalg.inv(_square(stance[there.handle])))
                want += (share**4)[:, None] * (_applied(frame, goal) - present)
                total += share**4
                closest = np.maximum(closest, share)
            shifts[:, number] = want / np.maximum(total, 1e-9)[:, None] * closest[:, None]
        if len(positions) == 2 and {position[0] for position in positions} == set(_WRISTS):
            self._joined(positions, shifts, motion, fitted, scale)
        for number, arm in enumerate(arms):
            off = np.linalg.norm(shifts[:, number], axis=1, keepdims=True)
            shifts[:, number] *= np.maximum(1 - self.close * scale / np.maximum(off, 1e-9), 0)
            smooth = gaussian(shifts[:, number], self.blend * fitted.fps)
            far = np.linalg.norm(smooth, axis=1, keepdims=True) / (self.most * arm.length)
            shifts[:, number] = smooth * np.tanh(far) / np.maximum(far, 1e-9)
        return move_feet(fitted, handles, joints, arms, shifts)

    def _joined(
        self,
        positions: list[tuple[int, np.ndarray, np.ndarray]],
        shifts: np.ndarray,
        motion: HandleMotion,
        fitted: HandleMotion,
        scale: float,
    ) -> None:
        """Bring hands together that touch each other, in place: each goes half of the way."""
        between = positions[0][1] - positions[1][1]
        share = smooth_step(
            np.linalg.norm(between, axis=1) - self.near / 2, self.near, self.touches
        )  # palms' middles are apart by two hands
        turn = fitted.root_rotation.astype(np.float64) @ np.swapaxes(motion.root_rotation, -1, -2)
        want = np.einsum("nij,nj->ni", turn, between) * scale
        have = positions[0][2] + shifts[:, 0] - positions[1][2] - shifts[:, 1]
        half = 0.5 * share[:, None] * (want - have)
        shifts[:, 0] += half
        shifts[:, 1] -= half

    def _rest(self, local: np.ndarray, fps: float) -> np.ndarray:
        """How much a palm rests on a part, 0 to 1, by its positions in the part's frame (N, 3)."""
        speed = np.linalg.norm(np.gradient(local, axis=0), axis=1) * fps
        return smooth_step(gaussian(speed, self.blend * fps), self.passes, self.rests)

    def _parts(self, vertices: np.ndarray, weights: np.ndarray, played: np.ndarray) -> dict[str, _Part]:
        out = {}
        for name, members in _PARTS.items():
            columns = np.isin(played, [HANDLE_NAMES.index(member) for member in members])
            points = vertices[weights[:, columns].sum(axis=1) > 0.5].astype(np.float64)
            handle = np.flatnonzero(played == HANDLE_NAMES.index(name))
            if len(points) < 4 or not len(handle) or not (weights[:, handle[0]] > 0.1).any():
                continue
            low, high = np.quantile(points, [self.box, 1 - self.box], axis=0)
            out[name] = _Part(int(handle[0]), (low + high) / 2, (high - low) / 2, points[:: max(1, len(points) // 400)])
        return out


def _placed(local: np.ndarray, part: _Part, there: _Part, scale: float) -> np.ndarray:
    """Points (N, 3) of one part's stance as those of another's."""
    away = local - part.middle
    inside = np.clip(away, -part.half, part.half)
    return np.asarray(there.middle + inside * (there.half / np.maximum(part.half, 1e-6)) + (away - inside) * scale)


def _stance(handles: Handles, joints: Joints, to_reference: np.ndarray) -> np.ndarray:
    """Transforms of the handles from the rest pose into the stance, shape (K, 3, 4)."""
    rotations, translations = attach_joints(to_reference[None].astype(np.float64), handles, joints)
    still = HandleMotion(translations, rotations, np.zeros((1, 3)), np.eye(3)[None])
    return still.transforms(handles.positions)[0].astype(np.float64)


def _palm(vertices: np.ndarray, weights: np.ndarray) -> np.ndarray:
    own = weights > 0.5
    return np.asarray(vertices[own].mean(axis=0), np.float64)


def _square(affine: np.ndarray) -> np.ndarray:
    return np.concatenate([affine, [[0.0, 0, 0, 1]]]) if affine.shape == (3, 4) else affine


def _applied(transforms: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (3,) or (N, 3) under affine transforms (N, 3, 4)."""
    return np.asarray(
        np.einsum("nij,nj->ni", transforms[..., :3], np.broadcast_to(points, (len(transforms), 3))) + transforms[..., 3]
    )


def _unapplied(transforms: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("nji,nj->ni", transforms[..., :3], points - transforms[..., 3]))
