"""The body under apparel: one set of joints for all, points of its surface, and the distance from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from bunraku.anatomy.handles.networks import farthest_points
from bunraku.anatomy.names.bone_names import NO_HANDLE
from bunraku.apparel.clothed import BESIDE, LAYER, ClothedCharacter
from bunraku.apparel.mask import moved_joints
from bunraku.core.animation import RigAnimation, bone_order
from bunraku.core.avatars import mmd_model
from bunraku.core.body.layout import HANDLE_PARENTS, JOINT_COUNT, JOINT_PARENTS
from bunraku.core.character import Character
from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges
from bunraku.core.geometry.surface import vertex_normals
from bunraku.errors import CharacterError
from bunraku.retarget.rig_parts import RigParts


@dataclass(frozen=True, eq=False)
class UnifiedBody:
    """A character's rig as SMPL's 22 joints."""

    parts: RigParts  # the rig's bones as parts of the reference body
    # positions in the rest pose [m], shape (22, 3); joints that the rig lacks lie between their neighbours
    joints: np.ndarray
    weights: np.ndarray  # skinning weights of the vertices for the joints, shape (V, 22), float32, rows sum to 1
    # the bone that each joint is, shape (22,); of a joint that the rig lacks, that of the joint above it
    bones: np.ndarray
    joint_of: np.ndarray  # the joint that each bone goes along with, shape (J,)
    moved: np.ndarray  # bones that physics move and those below them, shape (J,), bool

    @classmethod
    def of(cls, character: Character) -> UnifiedBody:
        """Read a character's rig. CharacterError if there is no rig, or it is not that of a person."""
        parts = RigParts.of(character)
        if not parts.humanoid or character.rig is None:
            raise CharacterError(
                f"{character.name}: its rig has no pelvis, arms and legs that are known; apparel data need a person's"
            )
        rig = character.rig
        by_physics = moved_joints(character)
        moved = np.zeros(len(rig.names), bool) if by_physics is None else by_physics
        joint_of = _joints_of_bones(parts, moved)
        weights = np.zeros((len(character.vertices), JOINT_COUNT), np.float32)
        np.add.at(weights, (np.arange(len(weights))[:, None], joint_of[rig.indices]), rig.weights)
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
        bones = _leads(parts, joint_of, moved)
        present = bones >= 0
        for joint in range(1, JOINT_COUNT):
            if not present[joint]:
                bones[joint] = bones[JOINT_PARENTS[joint]]
        return cls(parts, _positions(rig.positions[bones], present), weights, bones, joint_of, moved)

    def transforms(self, animation: RigAnimation) -> np.ndarray:
        """T of Eq. 1: rotation from the rest pose and position of each joint, `[R | t]`, shape (N, 22, 3, 4), float32.

        A vertex of one joint goes to `R (v - J) + t` (Eq. 4).
        """
        affine = animation.transforms()[:, self.bones].astype(np.float64)
        affine[..., 3] += np.einsum("njab,jb->nja", affine[..., :3], self.joints)
        return affine.astype(np.float32)


def _joints_of_bones(parts: RigParts, moved: np.ndarray) -> np.ndarray:
    assert parts.character.rig is not None
    parents, model = parts.parents, mmd_model(parts.character)
    out = np.full(len(parents), -1)
    for bone in bone_order(parents):
        handle, parent = int(parts.parts[bone]), int(parents[bone])
        if not moved[bone] and handle != NO_HANDLE:
            while handle >= JOINT_COUNT:
                handle = HANDLE_PARENTS[handle]
            out[bone] = handle
        elif parent >= 0:
            out[bone] = out[parent]
    if model is not None and len(model.bones) == len(out):
        for bone, entry in enumerate(model.bones):  # helpers of MMD that rotate fully with another bone
            append = entry.append
            if append is None or not append.rotation or abs(append.ratio - 1) >= 1e-6:
                continue
            if not moved[bone] and parts.parts[bone] == NO_HANDLE:
                out[bone] = out[append.bone]
    return np.maximum(out, 0)


def _leads(parts: RigParts, joint_of: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The bone that is each joint, -1 for none, shape (22,)."""
    out = parts.leads[:JOINT_COUNT].copy()
    for joint, bone in enumerate(out):
        if bone >= 0 and (moved[bone] or joint_of[bone] != joint):
            out[joint] = -1
    if out[0] < 0:
        raise CharacterError(
            f"{parts.character.name}: physics move the pelvis of its rig; apparel data need a body that follows the "
            "motion"
        )
    return out


def _positions(positions: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Joints with missing ones half way between the joints above and below that are there, or at the one above."""
    out = positions.copy()
    for joint in range(1, JOINT_COUNT):
        if not present[joint]:
            above = out[JOINT_PARENTS[joint]]
            below, line = joint, [other for other in range(joint + 1, JOINT_COUNT) if JOINT_PARENTS[other] == joint]
            while line and not present[below]:
                below = line[0]
                line = [other for other in range(below + 1, JOINT_COUNT) if JOINT_PARENTS[other] == below]
            out[joint] = (above + positions[below]) / 2 if present[below] else above
    return out


def eq4_transforms(transforms: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Affine transforms for `skin` from `[R | t]` of [MMDMC 4], both (N, J, 3, 4), and rest positions [m] (J, 3)."""
    out = np.array(transforms, np.float32)
    out[..., 3] -= np.einsum("njab,jb->nja", out[..., :3], np.asarray(joints, np.float32))
    return out


PLANES = 4  # nearest points of a surface whose planes say how far something is from it; chosen by eye

BAND = 0.09  # over the character's size [m]: what is farther from a limb is not near it; chosen by eye


@dataclass(frozen=True, eq=False)
class Planes:
    """What of a surface is nearest to each of K points: C points of it, and the ways out there."""

    positions: np.ndarray  # [m], shape (K, C, 3)
    normals: np.ndarray  # shape (K, C, 3)

    def of(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Signed distance of points (K, 3), the mean of those from the planes by nearness [m], shape (K,); the way out,
        shape (K, 3); and how far beside the nearest of them each point is [m], shape (K,).
        """
        away = points[:, None] - self.positions
        height = np.einsum("kca,kca->kc", away, self.normals)
        square = np.einsum("kca,kca->kc", away, away)
        share = 1 / np.square(square + 1e-6)
        share /= share.sum(axis=1, keepdims=True)
        way = np.einsum("kc,kca->ka", share, self.normals)
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-6)
        nearest = np.arange(len(points)), square.argmin(axis=1)
        beside = np.sqrt(np.maximum(square[nearest] - np.square(height[nearest]), 0))
        return np.einsum("kc,kc->k", share, height), way, beside

    def push(self, points: np.ndarray, gap: np.ndarray, most: float, size: float) -> tuple[np.ndarray, np.ndarray]:
        """What points (K, 3) lack until they are as far from the surface as `gap`.

        Args:
            points: [m], shape (K, 3).
            gap: [m], below 0 where a point may be inside, shape (K,).
            most: Points that lack more stay: they are on the wrong side of something thin [m].
            size: Of the character, over `clothed.SIZE`.

        Returns:
            What each lacks, shape (K,), 0 where it stays [m]; and the ways out, shape (K, 3).
        """
        distance, way, beside = self.of(points)
        lack = gap - distance
        moves = (lack > 0) & (lack < most) & (beside < BESIDE * size + np.abs(distance))
        return np.where(moves, lack, 0), way


@dataclass(frozen=True, eq=False)
class PosedBody:
    """Points of a body in a frame [m], and the ways out of it there, both (B, 3)."""

    positions: np.ndarray
    normals: np.ndarray

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.positions)

    def planes(self, points: np.ndarray, within: float = np.inf) -> tuple[np.ndarray, Planes]:
        """The rows of points (M, 3) that are as near as `within` [m], shape (K,), and what is nearest to each."""
        count = min(PLANES, len(self.positions))
        gap, near = (found.reshape(len(points), count) for found in self._tree.query(points, count))
        rows = np.flatnonzero(gap[:, 0] < within)
        return rows, Planes(self.positions[near[rows]], self.normals[near[rows]])

    def gap(self, points: np.ndarray, clear: float, size: float) -> np.ndarray:
        """How near points (M, 3) may come that are there at rest [m], shape (M,): no nearer than they are, or than
        `clear` [m], and `-inf` for those so deep in the body that they do not count.
        """
        distance, _, beside = self.planes(points)[1].of(points)
        near = np.where(distance > -LAYER * size, np.minimum(distance, clear), -np.inf)
        return np.where(beside < BESIDE * size + np.abs(distance), near, clear)


@dataclass(frozen=True, eq=False)
class BodyPoints:
    """Points spread over the body."""

    rest: np.ndarray  # positions in the rest pose [m], shape (B, 3)
    normals: np.ndarray  # outward, shape (B, 3)
    weights: np.ndarray  # skinning weights for the 22 joints, shape (B, 22)
    joint: np.ndarray  # the joint that holds each most, shape (B,)

    def posed(self, affine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and normals in a frame, (B, 3) each, by transforms of the joints as of `eq4_transforms`."""
        blends = (self.weights @ affine.reshape(len(affine), 12)).reshape(-1, 3, 4)
        positions = np.einsum("bac,bc->ba", blends[..., :3], self.rest) + blends[..., 3]
        return positions, np.einsum("bac,bc->ba", affine[self.joint, :, :3], self.normals)


def body_points(clothed: ClothedCharacter, most: int = 512) -> BodyPoints:
    """Points of a clothed character's body, evenly spread; none where all of it is apparel."""
    normals = vertex_normals(clothed.rest, clothed.faces)
    used = np.zeros(len(clothed.rest), bool)
    used[clothed.faces] = True
    rows = np.flatnonzero(used & (clothed.part < 0) & (np.linalg.norm(normals, axis=1) > 0.5))
    if len(rows):
        rows = rows[farthest_points(clothed.rest[rows].astype(np.float64), min(most, len(rows)))]
    weights = clothed.weights[rows].astype(np.float32)
    return BodyPoints(
        clothed.rest[rows].astype(np.float32), normals[rows].astype(np.float32), weights,
        weights.argmax(axis=1) if len(rows) else np.zeros(0, np.int64),
    )  # fmt: skip


def surface_points(clothed: ClothedCharacter, count: int) -> BodyPoints:
    """Points spread over the faces of a clothed character's body by area, however coarse it is; none where all of it is
    apparel. Normals look out of every connected piece, whichever way round its faces are.
    """
    faces = clothed.faces[~clothed.apparel[clothed.faces].any(axis=1)]
    corners = clothed.rest[faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    if not area.sum() > 0:
        none = np.zeros((0, 3), np.float32)
        return BodyPoints(none, none, np.zeros((0, JOINT_COUNT), np.float32), np.zeros(0, np.int64))
    clean = clean_mesh(clothed.rest, faces)
    piece = mesh_parts(unique_edges(clean.faces, len(clean.vertices)), len(clean.vertices))[clean.index[faces[:, 0]]]
    middle: np.ndarray = np.stack([np.bincount(piece, area * column) for column in corners.mean(axis=1).T], axis=1)
    middle = middle / np.maximum(np.bincount(piece, area), 1e-30)[:, None]
    volume = np.bincount(piece, np.einsum("fa,fa->f", normals, corners.mean(axis=1) - middle[piece]))
    normals *= np.where(volume < 0, -1.0, 1.0)[piece, None]
    chosen = np.minimum(np.searchsorted(np.cumsum(area), (np.arange(count) + 0.5) / count * area.sum()), len(faces) - 1)
    shares = np.random.default_rng(0).dirichlet(np.ones(3), count)
    weights = np.einsum("pc,pcj->pj", shares, clothed.weights[faces[chosen]]).astype(np.float32)
    rest = np.einsum("pc,pca->pa", shares, corners[chosen]).astype(np.float32)
    out = normals[chosen] / np.maximum(area[chosen], 1e-30)[:, None]
    return BodyPoints(rest, out.astype(np.float32), weights, weights.argmax(axis=1))


def nearest_point(points: np.ndarray, positions: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The plane of the nearest of the posed body's points (B, 3): signed distance of each point (M, 3) from it [m],
    shape (M,), and its normal (M, 3); far away where there is no body.
    """
    if not len(positions):
        return np.full(len(points), 10.0, np.float32), np.zeros_like(points)
    near = cKDTree(positions).query(points)[1]
    return ((points - positions[near]) * normals[near]).sum(axis=-1), normals[near]
