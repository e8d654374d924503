"""Motions of a skeleton, of handles (Eq. 3 of TapMo) and of a mesh's vertices, and the same at another rate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from bunraku.core.geometry.rotations import Resampling
from bunraku.core.saving import Saved
from bunraku.errors import CharacterError, MotionError, OptionError

Array = Any  # numpy.ndarray, or a tensor


def _product(matrices: Array, points: Array) -> Array:
    if isinstance(matrices, np.ndarray):
        return np.einsum("...ij,...j->...i", matrices, points)
    return (matrices @ points[..., None])[..., 0]


def handle_offsets(positions: Array, translations: Array, rotations: Array) -> Array:
    """What a handle's local transform adds to a rotated vertex, `R (v - h) + h + t = R v + (h + t - R h)`, shape (...,
    K, 3), by rest positions h [m], local translations t [m] and rotations R (..., K, 3, 3); numpy arrays or tensors.
    """
    return positions + translations - _product(rotations, positions)


def posed_points(transforms: Array, points: Array) -> Array:
    """Where affine transforms [A | b], shape (..., K, 3, 4), take one point each [m], `A p + b`, shape (..., K, 3);
    numpy arrays or tensors.
    """
    return _product(transforms[..., :3], points) + transforms[..., 3]


def frozen_array(
    array: Any,
    shape: tuple[int | None, ...],
    what: str,
    dtype: Any = np.float32,
    error: type[MotionError] | None = None,
) -> np.ndarray:
    """The array as a read-only one of this type and shape; None in the shape stands for any length.

    Raises:
        CharacterError: It has another shape.
        error: The same, or a value is not finite, where an error of motions is given.
    """
    out = np.ascontiguousarray(array, dtype=dtype)
    wrong = out.ndim != len(shape)
    for have, want in zip(out.shape, shape, strict=False):
        wrong = wrong or (want is not None and have != want)
    if wrong:
        raise (error or CharacterError)(f"{what} must have shape {shape} with None for any length, not {out.shape}")
    if error is not None and not np.isfinite(out).all():
        raise error(f"{what} holds values that are not numbers")
    if out is array:
        out = out.view()
    out.flags.writeable = False
    return out


_array = partial(frozen_array, error=MotionError)


class FrozenArrays:
    """A frozen object with fields that are arrays."""

    def freeze_fields(self, what: str, fields: Mapping[str, tuple[tuple[int | None, ...], Any]]) -> None:
        """Put read-only arrays of these shapes and types (`frozen_array`) in place of fields, each called "`what`
        field" in errors.
        """
        for name, (shape, dtype) in fields.items():
            array = frozen_array(getattr(self, name), shape, f"{what} {name}".strip(), dtype)
            object.__setattr__(self, name, array)


def check_rate(fps: float) -> None:
    """Raise MotionError unless frames a second [1/s] are positive and finite."""
    if not 0 < fps < math.inf:
        raise MotionError("frames a second must be positive and finite")


@dataclass(frozen=True)
class Skeleton:
    """Joints, each after its parent.

    Args:
        names: Joint names, length J.
        parents: Parent of each joint, -1 for the root, which is joint 0, shape (J,).
        offsets: Rest position of each joint from its parent's [m], shape (J, 3).
    """

    names: tuple[str, ...]
    parents: np.ndarray
    offsets: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "parents", _array(self.parents, (len(self.names),), "skeleton parents", np.int64))
        object.__setattr__(self, "offsets", _array(self.offsets, (len(self.names), 3), "skeleton offsets"))
        below = self.parents[1:]
        ordered = (below >= 0).all() and (below < np.arange(1, len(self.names))).all()
        if not len(self.names) or self.parents[0] != -1 or not ordered:
            raise MotionError("a skeleton needs one root, first, and every parent before its children")

    def __repr__(self) -> str:
        return f"<Skeleton: {len(self.names)} joints>"

    @property
    def positions(self) -> np.ndarray:
        """Joint positions in the rest pose [m], shape (J, 3)."""
        out = self.offsets.copy()
        for joint in range(1, len(self.names)):
            out[joint] += out[self.parents[joint]]
        return out


def line_up(joint: int, parents: Sequence[int] | np.ndarray) -> list[int]:
    """A joint and all above it, the root last."""
    out = [joint]
    while parents[out[-1]] >= 0:
        out.append(int(parents[out[-1]]))
    return out


def lines_up(parents: Sequence[int]) -> list[list[int]]:
    """`line_up` of every joint."""
    return [line_up(joint, parents) for joint in range(len(parents))]


def local_rotations(world: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Rotations in the parents' frames from those in the world, (N, J, 3, 3), by a skeleton's parents (J,)."""
    out = world.copy()
    out[:, 1:] = np.swapaxes(world[:, parents[1:]], -1, -2) @ world[:, 1:]
    return out


@dataclass(frozen=True, repr=False)
class SkeletalMotion(Saved):
    """Local joint rotations and a root translation per frame.

    Args:
        skeleton: The J joints.
        rotations: Rotation of each joint in its parent's frame, shape (N, J, 3, 3).
        root_translation: Position of the root joint [m], shape (N, 3).
        fps: Frames a second [1/s].
    """

    skeleton: Skeleton
    rotations: np.ndarray
    root_translation: np.ndarray
    fps: float = 20.0

    def __post_init__(self) -> None:
        joints = len(self.skeleton.names)
        object.__setattr__(self, "rotations", _array(self.rotations, (None, joints, 3, 3), "joint rotations"))
        object.__setattr__(
            self, "root_translation", _array(self.root_translation, (len(self.rotations), 3), "root translation")
        )
        check_rate(self.fps)

    def __len__(self) -> int:
        return len(self.rotations)

    def world(self) -> tuple[np.ndarray, np.ndarray]:
        """Forward kinematics: world rotations (N, J, 3, 3) and joint positions [m] (N, J, 3)."""
        rotations = np.empty_like(self.rotations)
        positions = np.empty((*self.rotations.shape[:2], 3), np.float32)
        rotations[:, 0], positions[:, 0] = self.rotations[:, 0], self.root_translation
        for joint in range(1, self.rotations.shape[1]):
            parent = self.skeleton.parents[joint]
            rotations[:, joint] = rotations[:, parent] @ self.rotations[:, joint]
            positions[:, joint] = positions[:, parent] + rotations[:, parent] @ self.skeleton.offsets[joint]
        return rotations, positions


@dataclass(frozen=True, repr=False)
class HandleMotion(Saved):
    """Motion of K mesh handles: x0 = {tau_l, r_l, tau_g, r_g} of TapMo, section 3.1.

    What it does to a vertex is Eq. 3 (`core.skinning`): handle 0 has the identity as its local transform.

    Args:
        translations: Local translations t_k in the root's frame [m], shape (N, K, 3); handle 0 is zero.
        rotations: Local rotations R_k in the root's frame, shape (N, K, 3, 3); handle 0 is the identity.
        root_translation: Global translation t_g [m], shape (N, 3).
        root_rotation: Global rotation R_g, shape (N, 3, 3).
        fps: Frames a second [1/s].
        own_kind: Of a motion of the reference body: its rotations were made for a body of the kind that takes it. A
            lying body then keeps the pelvis' tilt, and its fins, tail and head are adapted.
        own_height: Likewise: its height over the floor is that of the body that takes it, which is only set down where
            it hovers.
        soft: Likewise: its parts may leave their joints farther than those of people.

    Raises:
        MotionError: Shapes disagree, a value is not finite, or handle 0 moves locally.
    """

    translations: np.ndarray
    rotations: np.ndarray
    root_translation: np.ndarray
    root_rotation: np.ndarray
    fps: float = 20.0
    own_kind: bool = False
    own_height: bool = False
    soft: bool = False

    arrays: ClassVar[tuple[str, ...]] = ("translations", "rotations", "root_translation", "root_rotation")
    """Names of the fields with a value for each frame."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "translations", _array(self.translations, (None, None, 3), "handle translations"))
        frames, handles = self.translations.shape[:2]
        object.__setattr__(self, "rotations", _array(self.rotations, (frames, handles, 3, 3), "handle rotations"))
        object.__setattr__(self, "root_translation", _array(self.root_translation, (frames, 3), "root translation"))
        object.__setattr__(self, "root_rotation", _array(self.root_rotation, (frames, 3, 3), "root rotation"))
        if frames == 0:
            raise MotionError("a motion needs at least one frame")
        check_rate(self.fps)
        if np.abs(self.translations[:, 0]).max() > 1e-5 or np.abs(self.rotations[:, 0] - np.eye(3)).max() > 1e-5:
            raise MotionError("handle 0 is the root: its local transform must be the identity")

    def __len__(self) -> int:
        return len(self.translations)

    @property
    def duration(self) -> float:
        """Length [s]."""
        return len(self) / self.fps

    def of_own_body(self, own: bool = True) -> HandleMotion:
        """The motion marked as made for the body that takes it, in kind, height and softness, or for none."""
        return replace(self, own_kind=own, own_height=own, soft=own)

    def with_arrays(self, arrays: Mapping[str, np.ndarray]) -> HandleMotion:
        """The motion with other values of some of `arrays`, by their names."""
        changed: dict[str, Any] = dict(arrays)
        return replace(self, **changed)

    def take(self, frames: slice | np.ndarray) -> HandleMotion:
        """The motion of some frames: a slice, or indices of shape (M,)."""
        return replace(self, **{name: getattr(self, name)[frames] for name in self.arrays})

    @classmethod
    def joined(cls, parts: Sequence[HandleMotion]) -> HandleMotion:
        """Motions of the same handles one after the other, at the rate of the first."""
        arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in cls.arrays}
        return replace(parts[0], **arrays)

    def transforms(self, positions: np.ndarray) -> np.ndarray:
        """World transform of each handle as Eq. 3 applies it to rest positions, for handles at h [m], shape (K, 3).

        Returns:
            Affine transforms [A | b], shape (N, K, 3, 4), float32: a vertex wholly of handle k goes to A v + b.
        """
        h = np.asarray(positions, np.float32)
        local = handle_offsets(h, self.translations, self.rotations)
        out = np.empty((*self.translations.shape[:2], 3, 4), np.float32)
        out[..., :3] = self.root_rotation[:, None] @ self.rotations
        turned = np.einsum("nij,nkj->nki", self.root_rotation, local - h[0])
        out[..., 3] = turned + h[0] + self.root_translation[:, None]
        return out

    def with_transforms(self, transforms: np.ndarray, positions: np.ndarray) -> HandleMotion:
        """The motion with the same root and other world transforms of its handles at h [m] (K, 3): as `transforms`
        gives them, shape (N, K, 3, 4), float64.
        """
        h = positions.astype(np.float64)
        root = self.root_rotation.astype(np.float64)
        rotations = root.transpose(0, 2, 1)[:, None] @ transforms[..., :3]
        away = posed_points(transforms, h) - h[0] - self.root_translation[:, None]
        translations = np.einsum("nji,nkj->nki", root, away) + h[0] - h
        rotations[:, 0], translations[:, 0] = np.eye(3), 0
        return replace(self, rotations=rotations, translations=translations)


@dataclass(frozen=True, eq=False)
class MeshMotion:
    """Vertices of a mesh in each frame. MotionError if shapes disagree, a value is not finite, or there is no frame."""

    vertices: np.ndarray  # positions, +Y up and facing +Z in the first frame [m], shape (N, V, 3)
    faces: np.ndarray  # triangles, shape (F, 3)
    fps: float = 20.0  # frames a second [1/s]
    name: str = "mesh"

    def __post_init__(self) -> None:
        vertices, faces = np.asarray(self.vertices, np.float32), np.asarray(self.faces, np.int64)
        if vertices.ndim != 3 or vertices.shape[2] != 3 or not vertices.size:
            raise MotionError(f"a moving mesh needs vertices of shape (frames, vertices, 3), not {vertices.shape}")
        shaped = faces.ndim == 2 and faces.shape[1:] == (3,) and len(faces) > 0
        if not shaped or faces.min() < 0 or faces.max() >= vertices.shape[1]:
            raise MotionError("a moving mesh needs triangles of shape (F, 3) that name its vertices")
        if not np.isfinite(vertices).all():
            raise MotionError("a moving mesh has coordinates that are not numbers")
        check_rate(self.fps)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    def __len__(self) -> int:
        return len(self.vertices)


def resample_motion(motion: SkeletalMotion, fps: float) -> SkeletalMotion:
    """A skeletal motion of at least one frame at another rate [1/s], as far as it lasts: rotations take the short way
    between frames, the root moves in straight lines. MotionError if the rate is not positive.
    """
    check_rate(fps)
    if abs(motion.fps - fps) < 1e-6 * fps:
        return motion
    between = Resampling.of(len(motion), motion.fps, fps)
    return SkeletalMotion(
        motion.skeleton, between.rotations(motion.rotations), between.linear(motion.root_translation.astype(float)), fps
    )


def checked_fps(fps: float | None, default: float) -> float:
    """Frames a second of an output [1/s]. OptionError if they are not a number from 1 to 1000."""
    if fps is None:
        return float(default)
    try:
        value = float(fps)
    except (TypeError, ValueError):
        raise OptionError(f"fps must be a number from 1 to 1000, not {fps!r}") from None
    if not 1 <= value <= 1000:
        raise OptionError(f"fps must be a number from 1 to 1000, not {fps!r}")
    return value


def resample(motion: HandleMotion, fps: float) -> HandleMotion:
    """A handle motion at another rate [1/s]: translations linear, rotations along the shortest arc. Frame m of the
    result is at m / fps seconds, as far as the motion lasts.
    """
    if abs(fps - motion.fps) < 1e-6 or len(motion) == 1:
        return motion if len(motion) > 1 else replace(motion, fps=fps)
    between = Resampling.of(len(motion), motion.fps, fps)
    moves, path = (between.linear(values.astype(float)) for values in (motion.translations, motion.root_translation))
    return replace(
        motion, translations=moves, rotations=between.rotations(motion.rotations), root_translation=path,
        root_rotation=between.rotations(motion.root_rotation), fps=fps,
    )  # fmt: skip
