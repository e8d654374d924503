"""The reference body, a small human in a T-pose that defines the joints and handles, and SMPL's rest pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.character import Character, Handles, Rig
from bunraku.core.geometry.rotations import rotation_between
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.core.skinning import skin
from bunraku.errors import MotionError


@dataclass(frozen=True)
class ReferenceBody:
    """A human body with 22 joints in SMPL's order and the canonical weights of the 30 handles."""

    name: str  # name of the shape ("average", "child", ...)
    vertices: np.ndarray  # rest positions in the T-pose, feet on y = 0 [m], shape (V, 3)
    faces: np.ndarray  # triangles, shape (F, 3)
    joints: np.ndarray  # joint positions [m], shape (22, 3)
    # joint_weights, handle_weights: skin weights, shapes (V, 22) and (V, 30)
    joint_weights: np.ndarray
    handle_weights: np.ndarray
    mirror: np.ndarray  # vertex at the mirror image of each vertex, shape (V,)

    @cached_property
    def legs(self) -> float:
        """Mean length of the legs [m] (`leg_length`)."""
        return leg_length(self.joints)

    @cached_property
    def skeleton(self) -> Skeleton:
        """The 22 joints with their offsets."""
        parents = np.array(JOINT_PARENTS)
        offsets = self.joints - np.where(parents[:, None] >= 0, self.joints[parents], 0)
        return Skeleton(JOINT_NAMES, parents, offsets)

    @cached_property
    def handles(self) -> Handles:
        """The canonical handles; one without vertices on a person stands at its parent."""
        from bunraku.core.geometry.surface import vertex_areas

        areas = vertex_areas(self.vertices, self.faces)
        return Handles(handle_positions(self.vertices, self.handle_weights, areas), self.handle_weights)

    def character(self) -> Character:
        """The body as a rigged character."""
        indices = np.argsort(-self.joint_weights, axis=1)[:, :4]
        weights = np.take_along_axis(self.joint_weights, indices, axis=1)
        transforms = np.tile(np.eye(4), (len(self.joints), 1, 1))
        transforms[:, :3, 3] = self.joints
        weights = weights / weights.sum(axis=1, keepdims=True)
        rig = Rig(JOINT_NAMES, np.array(JOINT_PARENTS), transforms, indices, weights)
        return Character(f"reference-{self.name}", self.vertices, self.faces, rig)

    def pose(self, motion: SkeletalMotion) -> np.ndarray:
        """Vertices of the body in every frame of a motion of the 22 joints [m], shape (N, V, 3). The body keeps its own
        bones, and the root's path is scaled by the ratio of leg lengths. MotionError if the motion has other joints.
        """
        if motion.skeleton.names != JOINT_NAMES:
            raise MotionError("the reference body takes motions of SMPL's 22 joints only; map the skeleton first")
        scale = leg_length(self.joints) / leg_length(motion.skeleton.positions)
        scaled = SkeletalMotion(self.skeleton, motion.rotations, motion.root_translation * scale, motion.fps)
        rotations, positions = scaled.world()
        shifts = positions - np.einsum("njab,jb->nja", rotations, self.joints)
        transforms = np.concatenate([rotations, shifts[..., None]], axis=-1)
        return skin(self.vertices, self.joint_weights, transforms)


def leg_length(joints: np.ndarray) -> float:
    """Mean length of the two legs from hip to ankle [m], from joint positions (22, 3)."""
    legs = ((1, 4, 7), (2, 5, 8))
    lengths = [np.linalg.norm(joints[a] - joints[b]) + np.linalg.norm(joints[b] - joints[c]) for a, b, c in legs]
    return float(np.mean(lengths))


def handle_positions(vertices: np.ndarray, weights: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Mean of the vertices (V, 3) of each handle [m], shape (K, 3) (Eq. 4), by weights (V, K) and by the surface area
    of each vertex (V,), so that tessellation does not matter. A handle without weight stands where its parent stands.
    """
    from bunraku.core.body.layout import HANDLE_PARENTS

    mass = weights * (areas / max(areas.sum(), 1e-30))[:, None]
    total = mass.sum(axis=0)
    out = (mass.T @ vertices) / np.maximum(total, 1e-12)[:, None]
    centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    for handle, parent in enumerate(HANDLE_PARENTS[: weights.shape[1]]):
        if total[handle] < 1e-6:
            out[handle] = centre if parent < 0 else out[parent]
    return out.astype(np.float32)


@lru_cache(maxsize=1)
def _asset() -> dict[str, np.ndarray]:
    with np.load(Path(__file__).with_name("reference.npz"), allow_pickle=False) as archive:
        return {key: archive[key] for key in archive.files}


def reference_shapes() -> tuple[str, ...]:
    """Names of the shapes that ship, the average body first."""
    return tuple(str(name) for name in _asset()["shape_names"])


@lru_cache(maxsize=16)
def reference_body(shape: str = "average") -> ReferenceBody:
    """The reference body in one of `reference_shapes()`. KeyError if there is no such shape."""
    asset = _asset()
    names = reference_shapes()
    if shape not in names:
        raise KeyError(f"no body shape {shape!r}; there are {', '.join(names)}")
    index = names.index(shape)
    vertices = asset["vertices"] if index == 0 else asset["shape_vertices"][index].astype(np.float32)

    def weights(key: str) -> np.ndarray:
        dense = asset[key].astype(np.float32)
        return dense / dense.sum(axis=1, keepdims=True)

    return ReferenceBody(
        shape, vertices, asset["faces"].astype(np.int64), asset["shape_joints"][index], weights("joint_weights"),
        weights("handle_weights"), asset["mirror"].astype(np.int64),
    )  # fmt: skip


# Centimetres from the parent joint in SMPL's published mean body, both sides averaged: enough for directions.
_LEFT_AND_MIDDLE = {
    "left_hip": (6.5, -9, -1), "spine1": (0, 12, -3.5), "left_knee": (3.5, -37.5, -0.4), "spine2": (0, 13.6, 2.2),
    "left_ankle": (-1.4, -39.8, -4.4), "spine3": (0, 5.5, 0.3), "left_foot": (3.5, -6, 12.2), "neck": (0, 21.3, -3.4),
    "left_collar": (7.7, 11.4, -2.1), "head": (0, 8.9, 5), "left_shoulder": (11.5, 4.5, -1.9),
    "left_elbow": (25.5, -1.5, -2.3), "left_wrist": (26.5, 1.3, -0.7),
}  # fmt: skip

_ENDS = {"hip": "knee", "knee": "ankle", "shoulder": "elbow", "elbow": "wrist"}
LIMB_CHILD: dict[int, int] = {
    JOINT_NAMES.index(f"{side}_{part}"): JOINT_NAMES.index(f"{side}_{end}")
    for part, end in _ENDS.items()
    for side in ("left", "right")
}
"""The joint at the end of each limb, by the limb's joint: parts whose direction makes a pose."""


@lru_cache(maxsize=1)
def smpl_offsets() -> np.ndarray:
    """Offset of each joint of SMPL's mean body from its parent's, to about a centimetre [m], (22, 3); pelvis 0."""
    out = np.zeros((JOINT_COUNT, 3))
    for name, offset in _LEFT_AND_MIDDLE.items():
        out[JOINT_NAMES.index(name)] = np.array(offset) / 100
        if name.startswith("left"):
            out[JOINT_NAMES.index(name.replace("left", "right"))] = np.array(offset) / 100 * [-1, 1, 1]
    return out


@lru_cache(maxsize=1)
def smpl_rotations() -> np.ndarray:
    """World rotation of each part from the reference body's T-pose to SMPL's, shape (22, 3, 3). Limbs rotate, hands
    with their forearms; the trunk and the feet face the same way in both.
    """
    ours, want = reference_body().skeleton.offsets.astype(float), smpl_offsets()
    out = np.tile(np.eye(3), (JOINT_COUNT, 1, 1))
    for joint, child in LIMB_CHILD.items():
        above = out[JOINT_PARENTS[joint]]
        out[joint] = rotation_between(above @ ours[child], want[child]) @ above
    for side in ("left", "right"):
        out[JOINT_NAMES.index(f"{side}_wrist")] = out[JOINT_NAMES.index(f"{side}_elbow")]
    return out


LOOSE = 0.5
"""How far parts of soft bodies, and loose parts, may leave their joints [m of the reference body]."""
LOOSE_ON_PEOPLE = LOOSE / 10
"""The same for people, where more is an error of the generator [m of the reference body]."""


def capped(residual: np.ndarray, soft: bool) -> np.ndarray:
    """Local translations beyond stiff joints [m], shape (..., 3), cut to what `soft` bodies or people allow."""
    length = np.linalg.norm(residual, axis=-1, keepdims=True)
    return np.asarray(residual * np.minimum(1, (LOOSE if soft else LOOSE_ON_PEOPLE) / np.maximum(length, 1e-9)))
