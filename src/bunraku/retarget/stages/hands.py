"""Stages for hands: those that touch the body stay near it, and all stay out of it."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from scipy.spatial import cKDTree

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.legs import Leg
from bunraku.core.body.layout import HANDLE_NAMES, WRISTS
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.curves import gaussian, running_most, smooth_step, softly_bounded
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages.stage import Fitting, Stage, near_wrist, with_feet_moved

_PARTS = {"head": ("head", "head_top", "face"), "spine3": ("spine2", "spine3", "left_wing", "right_wing"),
"pelvis": ("pelvis", "spine1"),
          "left_hip": ("left_hip",), "right_hip": ("right_hip",)}  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Box:
    """A part of a body that hands touch: its handle, and its surface's box in the stance [m]."""

    handle: int
    middle: np.ndarray
    half: np.ndarray
    points: np.ndarray


@dataclass(frozen=True)
class Hands(Stage, name="hands"):
    """Hands that touch the body stay near it."""

    # Distance from a palm's middle to the body at which it begins to count [m of the reference body].
    near: float = 0.12
    touches: float = 0.05  # distance at which it counts wholly [m of the reference body]
    rests: float = 0.3  # speed of a palm along a part below which it may touch it [m/s of the reference body]
    passes: float = 0.8  # speed over which it only passes by [m/s of the reference body]
    close: float = 0.04  # a hand that is off its position by less than this stays where it is [m of the reference body]
    blend: float = 0.08  # deviation of the smoothing in time [s]
    most: float = 0.5  # how far a hand is moved at the most, over the arm's length
    palm: float = 0.45  # what of a hand is this near to its wrist, over the arm's length, is no tool that it holds
    box: float = 0.02  # share of a part's surface that may stick out of its box on each side

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return anatomy.upright and len(fitting.source) > 1

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        """The motion with hands where the reference body's hands touch it."""
        motion, fitted = fitting.source, fitting.motion
        character, handles, scale = anatomy.mesh, anatomy.mesh_handles, anatomy.scale
        arms = [arm for arm in anatomy.arms if int(handles.played[arm.foot[0]]) in WRISTS]
        if not arms:
            return fitting
        body = reference_body()
        reference_parts = self._parts(body.vertices, body.handle_weights, np.arange(len(HANDLE_NAMES)))
        stance = anatomy.stance_transforms.astype(np.float64)
        world = fitted.transforms(handles.positions).astype(np.float64)
        theirs = motion.transforms(body.handles.positions).astype(np.float64)
        posed = np.einsum("vk,kij->vij", handles.weights, stance)
        vertices = np.einsum("vij,vj->vi", posed[..., :3], character.vertices) + posed[..., 3]
        character_parts = self._parts(vertices[character.surface], handles.weights[character.surface], handles.played)
        held = {wrist: body.handle_weights[:, [wrist, wrist + 2]].sum(axis=1) > 0.5 for wrist in WRISTS}
        palms = {wrist: np.asarray(body.vertices[rows].mean(axis=0), np.float64) for wrist, rows in held.items()}
        shifts = np.zeros((len(fitted), len(arms), 3))
        positions = []  # of each arm: the reference's palm and the character's in each frame
        for number, arm in enumerate(arms):
            wrist = int(handles.played[arm.foot[0]])
            source = _applied(theirs[:, wrist], palms[wrist])
            near = near_wrist(arm, anatomy, self.palm)
            palm = character.vertices[near if len(near) else arm.foot_area].mean(axis=0).astype(np.float64)
            present = _applied(world[:, arm.foot[0]], palm)
            positions.append((wrist, source, present))
            total, want = np.zeros(len(fitted)), np.zeros((len(fitted), 3))
            closest = np.zeros(len(fitted))
            for name, part in reference_parts.items():
                if name not in character_parts:
                    continue
                frame = theirs[:, part.handle]
                local = np.einsum("nji,nj->ni", frame[..., :3], source - frame[..., 3])
                speed = (
                    gaussian(np.linalg.norm(np.gradient(local, axis=0), axis=1), self.blend * motion.fps) * motion.fps
                )
                near = smooth_step(cKDTree(part.points).query(local)[0], self.near, self.touches)
                share = near * smooth_step(speed, self.passes, self.rests)
                there = character_parts[name]
                goal = _placed(local, part, there, scale)
                frame = world[:, there.handle] @ _square(np.linalg.inv(_square(stance[there.handle])))
                want += (share**4)[:, None] * (_applied(frame, goal) - present)
                total += share**4
                closest = np.maximum(closest, share)
            shifts[:, number] = want / np.maximum(total, 1e-9)[:, None] * closest[:, None]
        if len(positions) == 2 and {position[0] for position in positions} == set(WRISTS):
            self._joined(positions, shifts, motion, fitted, scale)
        for number, arm in enumerate(arms):
            off = np.linalg.norm(shifts[:, number], axis=1, keepdims=True)
            shifts[:, number] *= np.maximum(1 - self.close * scale / np.maximum(off, 1e-9), 0)
            smooth = gaussian(shifts[:, number], self.blend * fitted.fps)
            shifts[:, number] = softly_bounded(smooth, self.most * arm.length)
        return fitting.moved(with_feet_moved(fitted, anatomy, arms, shifts))

    def _joined(
        self, positions: list[tuple[int, np.ndarray, np.ndarray]], shifts: np.ndarray, motion: HandleMotion,
        fitted: HandleMotion, scale: float,
    ) -> None:  # fmt: skip
        """Bring hands together that touch each other, in place: each goes half of the way."""
        between = positions[0][1] - positions[1][1]
        apart = np.linalg.norm(between, axis=1) - self.near / 2  # palms' middles are apart by two hands
        share = smooth_step(apart, self.near, self.touches)
        turn = fitted.root_rotation.astype(np.float64) @ np.swapaxes(motion.root_rotation, -1, -2)
        want = np.einsum("nij,nj->ni", turn, between) * scale
        have = positions[0][2] + shifts[:, 0] - positions[1][2] - shifts[:, 1]
        half = 0.5 * share[:, None] * (want - have)
        shifts[:, 0] += half
        shifts[:, 1] -= half

    def _parts(self, vertices: np.ndarray, weights: np.ndarray, played: np.ndarray) -> dict[str, _Box]:
        out = {}
        for name, members in _PARTS.items():
            columns = np.isin(played, [HANDLE_NAMES.index(member) for member in members])
            points = vertices[weights[:, columns].sum(axis=1) > 0.5].astype(np.float64)
            handle = np.flatnonzero(played == HANDLE_NAMES.index(name))
            if len(points) < 4 or not len(handle) or not (weights[:, handle[0]] > 0.1).any():
                continue
            low, high = np.quantile(points, [self.box, 1 - self.box], axis=0)
            out[name] = _Box(int(handle[0]), (low + high) / 2, (high - low) / 2, points[:: max(1, len(points) // 400)])
        return out


def _placed(local: np.ndarray, part: _Box, there: _Box, scale: float) -> np.ndarray:
    """Points (N, 3) of one part's stance as those of another's."""
    away = local - part.middle
    inside = np.clip(away, -part.half, part.half)
    return np.asarray(there.middle + inside * (there.half / np.maximum(part.half, 1e-6)) + (away - inside) * scale)


def _square(affine: np.ndarray) -> np.ndarray:
    return np.concatenate([affine, [[0.0, 0, 0, 1]]]) if affine.shape == (3, 4) else affine


def _applied(transforms: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (3,) or (N, 3) under affine transforms (N, 3, 4)."""
    return np.asarray(
        np.einsum("nij,nj->ni", transforms[..., :3], np.broadcast_to(points, (len(transforms), 3))) + transforms[..., 3]
    )


_ARM = ("collar", "shoulder", "elbow", "wrist", "fingers", "wing")
_BODY = np.array([not name.endswith(_ARM) for name in HANDLE_NAMES])
"""Whether hands are kept out of what a handle moves."""


@dataclass(frozen=True, eq=False)
class _BodyPart:
    """The surface of one handle's part in the rest pose: its points, which way is out, and the box that it fills."""

    handle: int
    tree: cKDTree
    points: np.ndarray
    normals: np.ndarray
    low: np.ndarray
    high: np.ndarray


EDGE = 0.1
"""How far over what is near a point may be outside of the boxes of all parts and still be looked at; chosen by eye."""


class BodySurface:
    """The surface of a body without its arms, part by part in the rest pose; a part has `least` points or more."""

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
        self._positions = handles.positions
        self._parts = []
        for handle in np.unique(owner[usable]).tolist():
            members = np.flatnonzero(usable & (owner == handle))
            if len(members) >= least:
                points = vertices[members]
                out, low, high = normals[members] / size[members, None], points.min(axis=0), points.max(axis=0)
                self._parts.append(_BodyPart(handle, cKDTree(points), points, out, low, high))

    def depths(self, motion: HandleMotion, hands: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray]:
        """How deep points (N, m, 3) are in the body [m], negative outside and minus infinity farther from it than
        `near`, shape (N, m), and which way is out, unit vectors in the world, shape (N, m, 3).
        """
        world = motion.transforms(self._positions).astype(np.float64)
        beside = np.empty((len(self._parts), *hands.shape[:2]))
        for number, part in enumerate(self._parts):
            local = (hands - world[:, None, part.handle, :, 3]) @ world[:, part.handle, :, :3]
            beside[number] = np.linalg.norm(np.maximum(np.maximum(part.low - local, local - part.high), 0), axis=-1)
        best = np.full(hands.shape[:2], np.inf)
        depth = np.full(hands.shape[:2], -np.inf)
        out = np.zeros(hands.shape)
        within = beside.min(axis=0, initial=np.inf) <= EDGE * near  # the others are outside of the body
        for number, part in enumerate(self._parts):
            frames, rows = np.nonzero(within & (beside[number] <= np.minimum(best, near)))
            if not len(frames):
                continue
            turn = world[frames, part.handle, :, :3]
            local = ((hands[frames, rows] - world[frames, part.handle, :, 3])[:, None] @ turn)[:, 0]
            away, index = part.tree.query(local, distance_upper_bound=near)
            deeper = away < best[frames, rows]  # none is at infinity
            frames, rows, index = frames[deeper], rows[deeper], index[deeper]
            best[frames, rows] = away[deeper]
            normals = part.normals[index]
            depth[frames, rows] = ((part.points[index] - local[deeper]) * normals).sum(axis=-1)
            out[frames, rows] = (turn[deeper] @ normals[..., None])[..., 0]
        return depth, out


_SURFACES: WeakKeyDictionary[Anatomy, BodySurface] = WeakKeyDictionary()
"""Of bodies that were looked at before; the next sentence of a body need not find its surface again."""


@dataclass(frozen=True)
class HandsClear(Stage, name="hands_clear"):
    """Hands and forearms stay out of the body."""

    points: int = 96  # points of a hand that are looked at
    palm: float = 0.45  # what of a hand is this near to its wrist, over the arm's length, is no tool that it holds
    near: float = 0.25  # distance from a surface beyond which nothing is looked at, over the arm's length
    least: float = 0.004  # depth in the body up to which a hand only touches it [m of the reference body]
    above: float = 0.01  # how far over the surface it is then held [m of the reference body]
    most: float = 0.3  # how far a hand is moved at the most, over the arm's length
    wide: float = 0.1  # for how long before and after it a correction is held [s]
    blend: float = 0.1  # deviation of its smoothing in time [s]
    rounds: int = 6  # the correction is found in turns, since the nearest surface changes with it

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return anatomy.upright and fitting.source.own_height and len(fitting.source) > 1 and bool(anatomy.arms)

    def changed(self, motion: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """The motion with hands outside of the body."""
        surface = _SURFACES.get(anatomy) or _SURFACES.setdefault(anatomy, BodySurface(anatomy))
        scale, first = anatomy.scale, motion
        for arm in anatomy.arms:
            shift = np.zeros((len(motion), 3))
            for _ in range(self.rounds):
                moved = with_feet_moved(first, anatomy, [arm], shift[:, None])
                depth, out = surface.depths(moved, self.hand(moved, arm, anatomy, forearm=True), self.near * arm.length)
                deepest = depth.argmax(axis=1)
                rows = np.arange(len(depth))
                inside = depth[rows, deepest]
                if not (inside > self.least * scale).any():
                    break
                want = np.where(inside > self.least * scale, inside + self.above * scale, 0)
                push = want[:, None] * out[rows, deepest]
                shift = softly_bounded(shift + self._soft(push, motion.fps), self.most * arm.length)
            if shift.any():
                first = with_feet_moved(first, anatomy, [arm], shift[:, None])
        return first

    def hand(self, motion: HandleMotion, arm: Leg, anatomy: Anatomy, forearm: bool = False) -> np.ndarray:
        """Points of a hand in each frame, and of the lower half of its forearm perhaps [m], shape (N, m, 3)."""
        mesh, handles = anatomy.mesh, anatomy.mesh_handles
        near = near_wrist(arm, anatomy, self.palm)
        vertices = near if len(near) else arm.foot_area
        vertices = vertices[np.linspace(0, len(vertices) - 1, min(self.points, len(vertices))).astype(int)]
        if forearm:
            bone = arm.joints[2] - arm.joints[1]
            outer = (mesh.vertices - arm.joints[1]) @ bone > 0.5 * (bone @ bone)  # what a wrist can take along
            held = np.flatnonzero(mesh.surface & outer & (handles.weights[:, arm.lower] > 0.5))
            vertices = np.append(vertices, held[:: max(1, 2 * len(held) // self.points)])
        world = motion.transforms(handles.positions).astype(np.float64)
        blended = handles.weights[vertices].astype(np.float64) @ world.reshape(*world.shape[:2], 12)
        blended = blended.reshape(len(world), len(vertices), 3, 4)
        rest = mesh.vertices[vertices].astype(np.float64)
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
