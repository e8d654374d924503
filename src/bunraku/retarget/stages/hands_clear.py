"""Hands stay out of the body: the stage `hands_clear` of fitting.

A generator of handle motion sees no surface, so hands that should rest on a thigh or at the chin sink into it. How deep
they are is told part by part in the rest pose: a point of a hand is carried back by the part that it is nearest to, and
compared with the surface there. What is inside is pushed out by bending the arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.bending import move_feet
from bunraku.anatomy.legs import Leg
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.geometry.filters import gaussian, running_most
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["BodySurface", "HandsClear"]

_ARM = ("collar", "shoulder", "elbow", "wrist", "fingers", "wing")
_BODY = np.array([not name.endswith(_ARM) for name in HANDLE_NAMES])
"""Whether hands are kept out of what a handle moves."""


@dataclass(frozen=True, eq=False)
class _Part:
    """The surface of one handle's part in the rest pose: its points, which way is out, and the box that it fills."""

    handle: int
    tree: cKDTree
    points: np.ndarray
    normals: np.ndarray
    low: np.ndarray
    high: np.ndarray


class BodySurface:
    """The surface of a body without its arms, part by part in the rest pose.

    Args:
        anatomy: Of the character.
        least: Points of a part under which it is none.
    """

    def __init__(self, anatomy: Anatomy, least: int = 12):
        mesh, handles = anatomy.mesh, anatomy.mesh_handles
        vertices = mesh.vertices.astype(np.float64)
        corners = vertices[mesh.faces]
        area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.zeros_like(vertices)
        for corner in range(3):
            np.add.at(normals, mesh.faces[:, corner], area)
        size = np.linalg.norm(normals, axis=1)
        owner = handles.weights.argmax(axis=1)
        body = handles.weights[:, _BODY[handles.played]].sum(axis=1) > 0.7
        usable = mesh.surface & body & (size > 1e-12)
        self._anatomy = anatomy
        self._positions = handles.positions
        self._parts = []
        for handle in np.unique(owner[usable]).tolist():
            own = np.flatnonzero(usable & (owner == handle))
            if len(own) >= least:
                points = vertices[own]
                out, low, high = normals[own] / size[own, None], points.min(axis=0), points.max(axis=0)
                self._parts.append(_Part(handle, cKDTree(points), points, out, low, high))

    def depths(self, motion: HandleMotion, hands: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray]:
        """How deep points are in the body, and which way is out.

        Args:
            motion: Of the character.
            hands: Points in each frame [m], shape (N, m, 3).
            near: Farther from a surface than this nothing is looked at [m].

        Returns:
            Depths [m], negative outside, shape (N, m), and unit vectors in the world, shape (N, m, 3).
        """
        world = motion.transforms(self._positions).astype(np.float64)
        count, points = hands.shape[:2]
        best = np.full((count, points), np.inf)
        depth = np.full((count, points), -np.inf)
        out = np.zeros((count, points, 3))
        for part in self._parts:
            turn, shift = world[:, part.handle, :, :3], world[:, part.handle, :, 3]
            local = (hands - shift[:, None]) @ turn
            beside = np.maximum(np.maximum(part.low - local, local - part.high), 0)
            close = np.sqrt((beside**2).sum(axis=-1)) <= np.minimum(best, near)  # of others the box is too far already
            frames, rows = np.nonzero(close)
            if not len(frames):
                continue
            local = local[frames, rows]
            away, index = part.tree.query(local, distance_upper_bound=near)
            found = away < best[frames, rows]  # none is at infinity
            frames, rows, index = frames[found], rows[found], index[found]
            best[frames, rows] = away[found]
            normals = part.normals[index]
            depth[frames, rows] = ((part.points[index] - local[found]) * normals).sum(axis=-1)
            out[frames, rows] = (turn[frames] @ normals[..., None])[..., 0]
        return depth, out


@dataclass(frozen=True)
class HandsClear(Stage):
    """Hands stay out of the body.

    Args:
        points: Points of a hand that are looked at.
        palm: What of a hand is this near to its wrist, over the arm's length, is no tool that it holds.
        near: Distance from a surface beyond which nothing is looked at, over the arm's length.
        least: Depth in the body up to which a hand only touches it [m of the reference body].
        above: How far over the surface it is then held [m of the reference body].
        most: How far a hand is moved at the most, over the arm's length.
        wide: For how long before and after it a correction is held [s].
        blend: Deviation of its smoothing in time [s].
        rounds: The correction is found in turns, since the nearest surface changes with it.
    """

    name: ClassVar[str] = "hands_clear"

    points: int = 96
    palm: float = 0.45
    near: float = 0.25
    least: float = 0.004
    above: float = 0.01
    most: float = 0.3
    wide: float = 0.1
    blend: float = 0.1
    rounds: int = 6

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return anatomy.upright and fitting.source.own_height and len(fitting.source) > 1 and bool(anatomy.arms)

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return fitting.moved(self.cleared(fitting.motion, anatomy))

    def cleared(self, motion: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """The motion with hands outside of the body.

        Args:
            motion: Of the character.
            anatomy: Of the character.
        """
        surface = BodySurface(anatomy)
        scale, first = anatomy.scale, motion
        for arm in anatomy.arms:
            shift = np.zeros((len(motion), 3))
            for _ in range(self.rounds):
                moved = move_feet(first, anatomy.handles, anatomy.joints, [arm], shift[:, None])
                depth, out = surface.depths(moved, self.hand(moved, arm, anatomy), self.near * arm.length)
                deepest = depth.argmax(axis=1)
                rows = np.arange(len(depth))
                inside = depth[rows, deepest]
                if not (inside > self.least * scale).any():
                    break
                want = np.where(inside > self.least * scale, inside + self.above * scale, 0)
                push = want[:, None] * out[rows, deepest]
                shift = shift + self._soft(push, motion.fps)
                far = np.linalg.norm(shift, axis=1, keepdims=True) / (self.most * arm.length)
                shift = shift * np.tanh(far) / np.maximum(far, 1e-9)
            if shift.any():
                first = move_feet(first, anatomy.handles, anatomy.joints, [arm], shift[:, None])
        return first

    def hand(self, motion: HandleMotion, arm: Leg, anatomy: Anatomy) -> np.ndarray:
        """Points of a hand in each frame [m], shape (N, m, 3)."""
        mesh, handles = anatomy.mesh, anatomy.mesh_handles
        away = np.linalg.norm(mesh.vertices[arm.foot_area] - arm.joints[2], axis=1)
        near = arm.foot_area[away < self.palm * arm.length]
        some = near if len(near) else arm.foot_area
        some = some[np.linspace(0, len(some) - 1, min(self.points, len(some))).astype(int)]
        world = motion.transforms(handles.positions).astype(np.float64)
        blended = (handles.weights[some].astype(np.float64) @ world.reshape(*world.shape[:2], 12)).reshape(
            len(world), len(some), 3, 4
        )
        rest = mesh.vertices[some].astype(np.float64)
        return np.asarray((blended[..., :3] @ rest[..., None])[..., 0] + blended[..., 3])

    def _soft(self, push: np.ndarray, fps: float) -> np.ndarray:
        """Pushes that set in before and fade after, as far as each asks for, shape (N, 3)."""
        size = np.linalg.norm(push, axis=1)
        if not size.any():
            return push
        wide = 2 * round(self.wide * fps) + 1
        held = gaussian(running_most(size, wide), self.blend * fps)
        way = gaussian(push, 2 * self.blend * fps)
        length = np.linalg.norm(way, axis=1, keepdims=True)
        return np.asarray(way / np.maximum(length, 1e-9) * held[:, None] * (length > 1e-9))
