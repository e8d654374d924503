"""Animations: a character moved by its handles, by the bones of its own rig, or with vertices that also move on their
own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np

from bunraku.core.character import Character, Handles, Rig
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.rotations import Resampling, axis_angle_from_matrix, matrix_from_axis_angle, matrix_y
from bunraku.core.motion import HandleMotion, check_rate, frozen_array, resample
from bunraku.core.saving import Shown
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError, MotionError


@dataclass(frozen=True, repr=False)
class Animation(Shown):
    """A character driven by a handle motion.

    Args:
        character: The character.
        handles: Its K handles.
        motion: Their motion.
        reference: The reference body's motion that `motion` was fitted from, where it is known; `bunraku.edit` edits
            it.

    Raises:
        CharacterError: The handles weigh another number of vertices than the character has.
        MotionError: The motion has another number of handles.
    """

    character: Character
    handles: Handles
    motion: HandleMotion
    reference: HandleMotion | None = None

    def __post_init__(self) -> None:
        self.handles.check_vertices(len(self.character.vertices), self.character.name)
        moved, have = self.motion.translations.shape[1], len(self.handles.positions)
        if moved != have:
            raise MotionError(f"the motion has {moved} handles but the character has {have}")

    @property
    def fps(self) -> float:
        """Frames a second [1/s]."""
        return self.motion.fps

    def vertices(
        self, frames: slice | list[int] | np.ndarray | None = None, *, chosen: np.ndarray | None = None
    ) -> np.ndarray:
        """Posed vertices [m], shape (N, V, 3), float32, of some frames and the `chosen` vertices, or of all (Eq. 3)."""
        transforms = self.motion.transforms(self.handles.positions)
        rest, weights, beside = self.character.vertices, self.handles.weights, self.character.beside
        if chosen is not None:
            rest, weights = rest[chosen], weights[chosen]
        out = skin(rest, weights, transforms if frames is None else transforms[frames])
        if beside is not None:
            still = beside if chosen is None else beside[chosen]
            out[:, still] = rest[still]
        return out

    def at(self, fps: float) -> Animation:
        """The same at another rate [1/s], without `reference`, which stays at its own rate."""
        return self if fps == self.motion.fps else Animation(self.character, self.handles, resample(self.motion, fps))

    def take(self, frames: slice) -> Animation:
        """Some of the frames, and of `reference` where it has as many."""
        reference = self.reference
        reference = reference.take(frames) if reference is not None and len(reference) == len(self.motion) else None
        return Animation(self.character, self.handles, self.motion.take(frames), reference)


@dataclass(frozen=True, eq=False, repr=False)
class RigAnimation(Shown):
    """A character driven by the J bones of its own rig.

    A bone's rotation counts from the rest pose, in axes that are the world's there, as in `SkeletalMotion`: identities
    and zeros give the rest pose.

    Args:
        character: The character, with its rig.
        rotations: Rotation of each bone in its parent's frame, shape (N, J, 3, 3).
        translations: How far each bone's head leaves its rest position, in its parent's frame [m] (the world for a bone
            without a parent), shape (N, J, 3); zero where bones keep their lengths.
        fps: Frames a second [1/s].
        reference: As in `Animation`.
        parts: Which part of a body each bone is (`retarget.rig_parts.RigParts`), where that is known.

    Raises:
        CharacterError: The character has no rig.
        MotionError: Shapes disagree, a value is not finite, or there is no frame.
    """

    character: Character
    rotations: np.ndarray
    translations: np.ndarray
    fps: float = 20.0
    reference: HandleMotion | None = None
    parts: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.character.rig is None:
            raise CharacterError(f"{self.character.name}: there is no rig in this file to animate")
        joints = len(self.character.rig.names)
        for name, tail in (("rotations", (joints, 3, 3)), ("translations", (joints, 3))):
            shape = len(self.rotations), *tail
            array = frozen_array(getattr(self, name), shape, f"bone {name}", error=MotionError)
            object.__setattr__(self, name, array)
        if not len(self.rotations):
            raise MotionError("a motion needs at least one frame")
        check_rate(self.fps)

    @classmethod
    def of_world(
        cls,
        character: Character,
        world_rotations: np.ndarray,
        positions: np.ndarray,
        fps: float = 20.0,
        reference: HandleMotion | None = None,
    ) -> RigAnimation:
        """The animation whose `world` gives these rotations (N, J, 3, 3) and positions of heads [m] (N, J, 3)."""
        if character.rig is None:
            raise CharacterError(f"{character.name}: there is no rig in this file to animate")
        rig, rest = character.rig, character.rig.positions
        rotations, translations = np.array(world_rotations, np.float64), positions - rest
        for bone, parent in enumerate(rig.parents):
            if parent >= 0:
                back = np.swapaxes(world_rotations[:, parent], -1, -2)
                rotations[:, bone] = back @ world_rotations[:, bone]
                away = np.einsum("nij,nj->ni", back, positions[:, bone] - positions[:, parent])
                translations[:, bone] = away - (rest[bone] - rest[parent])
        return cls(character, rotations, translations, fps, reference)

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def rig(self) -> Rig:
        """The character's rig."""
        assert self.character.rig is not None
        return self.character.rig

    @property
    def duration(self) -> float:
        """Length [s]."""
        return len(self) / self.fps

    def world(self) -> tuple[np.ndarray, np.ndarray]:
        """Forward kinematics: world rotation of each bone from its rest pose (N, J, 3, 3), and the position of its head
        [m] (N, J, 3), float64.
        """
        rig, rest = self.rig, self.rig.positions
        rotations, positions = self.rotations.astype(np.float64), rest + self.translations.astype(np.float64)
        for bone in bone_order(rig.parents):
            parent = int(rig.parents[bone])
            if parent >= 0:
                rotations[:, bone] = rotations[:, parent] @ self.rotations[:, bone]
                away = rest[bone] - rest[parent] + self.translations[:, bone]
                positions[:, bone] = positions[:, parent] + np.einsum("nij,nj->ni", rotations[:, parent], away)
        return rotations, positions

    @cached_property
    def _affine(self) -> np.ndarray:
        rotations, positions = self.world()
        shift = positions - np.einsum("njab,jb->nja", rotations, self.rig.positions)
        return np.concatenate([rotations, shift[..., None]], axis=-1).astype(np.float32)

    def transforms(self) -> np.ndarray:
        """Affine transform of each bone from the rest pose [m], shape (N, J, 3, 4), float32."""
        return self._affine

    @cached_property
    def handles(self) -> Handles:
        """The bones as handles: a first one that stands still and holds nothing, then each bone that holds vertices."""
        dense = self.rig.dense_weights()
        weights = np.concatenate([np.zeros((len(dense), 1), np.float32), dense[:, self._used]], axis=1)
        weights[:, 0] = np.maximum(1 - weights[:, 1:].sum(axis=1), 0)
        positions = np.concatenate([np.zeros((1, 3)), self.rig.positions[self._used]])
        return Handles(positions, weights / weights.sum(axis=1, keepdims=True))

    @cached_property
    def _used(self) -> np.ndarray:
        return np.unique(self.rig.indices[self.rig.weights > 0])

    @cached_property
    def motion(self) -> HandleMotion:
        """The motion of `handles`, so that whatever plays or writes an `Animation` can use this."""
        affine = self._affine[:, self._used].astype(np.float64)
        return behind_still(affine, self.handles.positions[1:].astype(np.float64), self.fps)

    def animation(self) -> Animation:
        """The same as an animation of `handles`."""
        return Animation(self.character, self.handles, self.motion)

    def vertices(self, frames: slice | list[int] | np.ndarray | None = None) -> np.ndarray:
        """Posed vertices [m], shape (N, V, 3), float32, of all or some frames."""
        return self.animation().vertices(frames)

    def at(self, fps: float) -> RigAnimation:
        """The same at another rate [1/s], without `reference`, which stays at its own rate."""
        if abs(fps - self.fps) < 1e-6:
            return self
        between = Resampling.of(len(self.rotations), self.fps, fps)
        moved = between.linear(self.translations.astype(float))
        return RigAnimation(self.character, between.rotations(self.rotations), moved, fps, parts=self.parts)

    def take(self, frames: slice) -> RigAnimation:
        """Some of the frames, and of `reference` where it has as many."""
        known = self.reference
        known = known.take(frames) if known is not None and len(known) == len(self) else None
        return replace(self, rotations=self.rotations[frames], translations=self.translations[frames], reference=known)


def behind_still(affine: np.ndarray, positions: np.ndarray, fps: float) -> HandleMotion:
    """The motion of handles at rest [m] (J, 3) by affine transforms from there (N, J, 3, 4), float64, behind a first
    handle that stands still.
    """
    frames, joints = affine.shape[:2]
    rotations, translations = np.tile(np.eye(3), (frames, joints + 1, 1, 1)), np.zeros((frames, joints + 1, 3))
    rotations[:, 1:] = affine[..., :3]
    translations[:, 1:] = affine[..., 3] - positions + np.einsum("njab,jb->nja", affine[..., :3], positions)
    still = np.broadcast_to(np.eye(3), (frames, 3, 3))
    return HandleMotion(translations, rotations, np.zeros((frames, 3)), still, fps)


def bone_order(parents: np.ndarray) -> list[int]:
    """All bones, each after its parent; those of a cycle last."""
    out: list[int] = []
    below: list[list[int]] = [[] for _ in parents]
    for bone, parent in enumerate(parents):
        (below[int(parent)] if parent >= 0 else out).append(bone)
    for bone in out:
        out.extend(below[bone])
    reached = set(out)
    return out + [bone for bone in range(len(parents)) if bone not in reached]


@dataclass(frozen=True, eq=False, repr=False)
class PointAnimation(Shown):
    """A skinned animation, and the distance of each vertex from where the skin takes it. MotionError if the offsets
    have another shape, or a value is not finite.
    """

    animation: Animation  # the skinned part, N frames
    offsets: np.ndarray  # displacement of each vertex from its skinned position, in the world [m], shape (N, V, 3)

    def __post_init__(self) -> None:
        shape = (len(self.animation.motion), len(self.animation.character.vertices), 3)
        object.__setattr__(self, "offsets", frozen_array(self.offsets, shape, "offsets", error=MotionError))

    @classmethod
    def of_vertices(cls, animation: Animation, vertices: np.ndarray) -> PointAnimation:
        """The animation whose vertices are in these positions [m], shape (N, V, 3)."""
        if np.shape(vertices) != (len(animation.motion), len(animation.character.vertices), 3):
            frames, shape = len(animation.motion), np.shape(vertices)
            raise MotionError(f"vertices must be those of {frames} frames of the animation, not of shape {shape}")
        return cls(animation, np.asarray(vertices, np.float32) - animation.vertices())

    @property
    def character(self) -> Character:
        """The character."""
        return self.animation.character

    @property
    def motion(self) -> HandleMotion:
        """The motion of the skinned part."""
        return self.animation.motion

    @property
    def handles(self) -> Handles:
        """What moves the skinned part."""
        return self.animation.handles

    @property
    def reference(self) -> HandleMotion | None:
        """As in `Animation`, of the skinned part."""
        return self.animation.reference

    @property
    def fps(self) -> float:
        """Frames a second [1/s]."""
        return self.motion.fps

    def vertices(self, frames: slice | list[int] | np.ndarray | None = None) -> np.ndarray:
        """Posed vertices [m], shape (N, V, 3), float32, of all or some frames."""
        return np.asarray(self.animation.vertices(frames) + (self.offsets if frames is None else self.offsets[frames]))

    def at(self, fps: float) -> PointAnimation:
        """The same at another rate [1/s]; offsets move in straight lines between frames."""
        moved = self.animation.at(fps)
        if moved.motion is self.motion:
            return self
        return PointAnimation(moved, Resampling.of(len(self.offsets), self.motion.fps, fps).linear(self.offsets))

    def take(self, frames: slice) -> PointAnimation:
        """Some of the frames."""
        return PointAnimation(self.animation.take(frames), self.offsets[frames])


FADE = 0.3
"""How long the difference between the two poses at a join takes to fade out [s]."""


def end_to_start(animations: Sequence[RigAnimation]) -> RigAnimation:
    """Join animations of the same rig into one, at the rate of the first.

    Each is moved over the ground and rotated about +Y so that its first pose lies as close as possible to the last pose
    of the one before, by least squares over the heads of all bones. The remaining difference fades out. MotionError if
    they are of several characters.
    """
    first = animations[0]
    rotations, translations = [first.rotations], [first.translations]
    last = first.world()[1][-1]
    for following in animations[1:]:
        if following.character is not first.character:
            raise MotionError("animations of several characters cannot be joined; put them on one with `transfer`")
        clip = _aligned(following.at(first.fps), last)
        share = smooth_step(1 - np.arange(len(clip)) / max(round(FADE * first.fps), 1))[:, None, None]
        off = axis_angle_from_matrix(rotations[-1][-1].astype(float) @ np.swapaxes(clip.rotations[0], -1, -2))
        rotations.append(matrix_from_axis_angle(share * off) @ clip.rotations.astype(float))
        translations.append(clip.translations + share * (translations[-1][-1] - clip.translations[0]))
        rotations[-1], translations[-1] = rotations[-1][1:], translations[-1][1:]  # its first pose is there already
        if len(rotations[-1]):
            last = RigAnimation(first.character, rotations[-1][-1:], translations[-1][-1:]).world()[1][0]
    return RigAnimation(first.character, np.concatenate(rotations), np.concatenate(translations), first.fps)


def _aligned(animation: RigAnimation, goal: np.ndarray) -> RigAnimation:
    """The animation moved so that its bones' heads in the first frame come closest to a goal [m], shape (J, 3)."""
    rotations, heads = animation.world()
    start, middle = heads[0].mean(axis=0), goal.mean(axis=0)
    before, after = (heads[0] - start)[:, [0, 2]], (goal - middle)[:, [0, 2]]
    cross = float((before[:, 1] * after[:, 0] - before[:, 0] * after[:, 1]).sum())
    about_y = matrix_y(np.array([math.atan2(cross, float((before * after).sum()))]))[0]
    heads = (heads - start) @ about_y.T + start + (middle - start) * [1, 0, 1]
    return RigAnimation.of_world(animation.character, about_y @ rotations, heads, animation.fps)


@runtime_checkable
class AnimatedCharacter(Protocol):
    """A character that moves: an `Animation`, a `RigAnimation` or a `PointAnimation`, which document these members."""

    @property
    def character(self) -> Character: ...
    @property
    def handles(self) -> Handles: ...
    @property
    def motion(self) -> HandleMotion: ...
    @property
    def reference(self) -> HandleMotion | None: ...
    @property
    def fps(self) -> float: ...
    def vertices(self, frames: slice | list[int] | np.ndarray | None = None) -> np.ndarray: ...
    def at(self, fps: float) -> Self: ...
    def take(self, frames: slice) -> Self: ...
    def save(self, path: str | Path, **options: object) -> Path: ...
