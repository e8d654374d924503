"""Animations: a character moved by its handles, by the bones of its own rig, or with vertices that move on their
own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol, Self, runtime_checkable

import numpy as np

from bunraku.core.character import Character, Handles
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.rotations import Resampling, axis_angle_from_matrix, matrix_from_axis_angle, matrix_y
from bunraku.core.motion import HandleMotion, resample
from bunraku.core.saving import Shown, save
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError, MotionError

__all__ = ["AnimatedCharacter", "Animation", "PointAnimation", "RigAnimation", "bone_order", "end_to_start"]


@dataclass(frozen=True)
class Animation(Shown):
    """A character driven by a handle motion.

    Args:
        character: The character.
        handles: Its K handles.
        motion: Their motion.
        reference: The motion of the reference body that `motion` was fitted from, where it is known; it is what
            `bunraku.edit` edits.

    Raises:
        CharacterError: The handles weigh another number of vertices than the character has.
        MotionError: The motion has another number of handles.
    """

    character: Character
    handles: Handles
    motion: HandleMotion
    reference: HandleMotion | None = None

    def __post_init__(self) -> None:
        if len(self.handles.weights) != len(self.character.vertices):
            raise CharacterError(
                f"the handles weigh {len(self.handles.weights)} vertices but the character has "
                f"{len(self.character.vertices)}"
            )
        if self.motion.translations.shape[1] != len(self.handles.positions):
            raise MotionError(
                f"the motion has {self.motion.translations.shape[1]} handles but the character has "
                f"{len(self.handles.positions)}"
            )

    @property
    def fps(self) -> float:
        """Frames a second [1/s]."""
        return self.motion.fps

    def vertices(
        self, frames: slice | list[int] | np.ndarray | None = None, *, chosen: np.ndarray | None = None
    ) -> np.ndarray:
        """Posed vertices [m], shape (N, V, 3), float32, of all frames or of those named (Eq. 3); of all vertices or of
        those chosen.
        """
        transforms = self.motion.transforms(self.handles.positions)
        rest, weights = self.character.vertices, self.handles.weights
        if chosen is not None:
            rest, weights = rest[chosen], weights[chosen]
        return skin(rest, weights, transforms if frames is None else transforms[frames])

    def at(self, fps: float) -> Animation:
        """The same at another rate [1/s]; the motion that it was fitted from is left out, as it stays at its own."""
        return self if fps == self.motion.fps else Animation(self.character, self.handles, resample(self.motion, fps))

    def take(self, frames: slice) -> Animation:
        """Some of its frames, and of the motion that it was fitted from where that has as many."""
        known = self.reference
        known = known.take(frames) if known is not None and len(known) == len(self.motion) else None
        return Animation(self.character, self.handles, self.motion.take(frames), known)

    def save(self, path: str | Path, **options: object) -> Path:
        """Write the animation in the format that the file's suffix names and return the path.

        Raises:
            FormatError: The suffix is unknown, or the file cannot be written.
        """
        return save(self, path, **options)


@dataclass(frozen=True, eq=False)
class RigAnimation(Shown):
    """A character driven by the J bones of its own rig.

    A bone's rotation is counted from the rest pose, in axes that are the world's there, as in `SkeletalMotion`:
    identities and zeros put the character into its rest pose.

    Args:
        character: The character, with its rig.
        rotations: Rotation of each bone in its parent's frame, shape (N, J, 3, 3).
        translations: How far each bone's head leaves its rest position, in its parent's frame [m], shape (N, J, 3);
            zero where bones keep their lengths. For a bone without a parent it is in the world.
        fps: Frames a second [1/s].
        reference: The motion of the reference body that this was fitted from, where it is known.

    Raises:
        CharacterError: The character has no rig.
        MotionError: Shapes disagree, a value is not finite, or there is no frame.
    """

    character: Character
    rotations: np.ndarray
    translations: np.ndarray
    fps: float = 20.0
    reference: HandleMotion | None = None

    def __post_init__(self) -> None:
        if self.character.rig is None:
            raise CharacterError(f"{self.character.name}: there is no rig in this file to animate")
        joints = len(self.character.rig.names)
        for name, tail in (("rotations", (joints, 3, 3)), ("translations", (joints, 3))):
            array = np.ascontiguousarray(getattr(self, name), np.float32)
            if array.shape[1:] != tail or len(array) != len(self.rotations):
                raise MotionError(f"bone {name} must have shape (N, {', '.join(map(str, tail))}), not {array.shape}")
            if not np.isfinite(array).all():
                raise MotionError(f"bone {name} hold values that are not numbers")
            array = array.view()
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if not len(self.rotations):
            raise MotionError("a motion needs at least one frame")
        if not 0 < self.fps < np.inf:
            raise MotionError("frames a second must be positive and finite")

    @classmethod
    def of_world(
        cls,
        character: Character,
        world_rotations: np.ndarray,
        positions: np.ndarray,
        fps: float = 20.0,
        reference: HandleMotion | None = None,
    ) -> RigAnimation:
        """From what `world` gives.

        Args:
            character: With a rig.
            world_rotations: World rotation of each bone from its rest pose, shape (N, J, 3, 3).
            positions: Where its head is [m], shape (N, J, 3).
            fps: Frames a second [1/s].
            reference: As above.
        """
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
    def duration(self) -> float:
        """Length [s]."""
        return len(self) / self.fps

    def world(self) -> tuple[np.ndarray, np.ndarray]:
        """Forward kinematics: world rotation of each bone from its rest pose (N, J, 3, 3), and where its head is [m]
        (N, J, 3), float64.
        """
        rig = self.character.rig
        assert rig is not None
        rest = rig.positions
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
        assert self.character.rig is not None
        shift = positions - np.einsum("njab,jb->nja", rotations, self.character.rig.positions)
        return np.concatenate([rotations, shift[..., None]], axis=-1).astype(np.float32)

    def transforms(self) -> np.ndarray:
        """Affine transform of each bone from the rest pose [m], shape (N, J, 3, 4), float32."""
        return self._affine

    @cached_property
    def handles(self) -> Handles:
        """Bones as handles: a first one that stands still and holds nothing, then one for each bone that holds
        something.
        """
        rig = self.character.rig
        assert rig is not None
        dense = rig.dense_weights()
        weights = np.concatenate([np.zeros((len(dense), 1), np.float32), dense[:, self._used]], axis=1)
        weights[:, 0] = np.maximum(1 - weights[:, 1:].sum(axis=1), 0)
        return Handles(
            np.concatenate([np.zeros((1, 3)), rig.positions[self._used]]), weights / weights.sum(axis=1, keepdims=True)
        )

    @cached_property
    def _used(self) -> np.ndarray:
        rig = self.character.rig
        assert rig is not None
        return np.unique(rig.indices[rig.weights > 0])

    @cached_property
    def motion(self) -> HandleMotion:
        """The motion of `handles`, so that all that plays or writes an `Animation` plays and writes this."""
        affine, positions = (
            self._affine[:, self._used].astype(np.float64),
            self.handles.positions[1:].astype(np.float64),
        )
        frames = len(affine)
        rotations = np.tile(np.eye(3), (frames, len(positions) + 1, 1, 1))
        rotations[:, 1:] = affine[..., :3]
        translations = np.zeros((frames, len(positions) + 1, 3))
        translations[:, 1:] = affine[..., 3] - positions + np.einsum("njab,jb->nja", affine[..., :3], positions)
        return HandleMotion(
            translations, rotations, np.zeros((frames, 3)), np.broadcast_to(np.eye(3), (frames, 3, 3)), self.fps
        )

    def animation(self) -> Animation:
        """The same as an animation of `handles`."""
        return Animation(self.character, self.handles, self.motion)

    def vertices(self, frames: slice | list[int] | np.ndarray | None = None) -> np.ndarray:
        """Posed vertices [m], shape (N, V, 3), float32, of all frames or of those named."""
        transforms = self.motion.transforms(self.handles.positions)
        return skin(self.character.vertices, self.handles.weights, transforms if frames is None else transforms[frames])

    def at(self, fps: float) -> RigAnimation:
        """The same at another rate [1/s]; the motion that it was fitted from is left out, as it stays at its own."""
        if abs(fps - self.fps) < 1e-6:
            return self
        between = Resampling.of(len(self.rotations), self.fps, fps)
        moved = between.linear(self.translations.astype(float))
        return RigAnimation(self.character, between.rotations(self.rotations), moved, fps)

    def take(self, frames: slice) -> RigAnimation:
        """Some of its frames, and of the motion that it was fitted from where that has as many."""
        known = self.reference
        known = known.take(frames) if known is not None and len(known) == len(self) else None
        return RigAnimation(self.character, self.rotations[frames], self.translations[frames], self.fps, known)

    def save(self, path: str | Path, **options: object) -> Path:
        """Write the animation: a .glb keeps the file's own nodes, skins and materials, a .vmd the bones of an MMD
        model.

        Other formats are those of `Animation.save`.

        Raises:
            FormatError: The suffix is unknown, or the file cannot be written.
        """
        return save(self, path, **options)


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


@dataclass(frozen=True, eq=False)
class PointAnimation(Shown):
    """A skinned animation, and how far each vertex is from where its skin takes it.

    Args:
        animation: The skinned part, N frames.
        offsets: Displacement of each vertex from its skinned position, in the world [m], shape (N, V, 3).

    Raises:
        MotionError: The offsets have another shape, or a value is not finite.
    """

    animation: Animation
    offsets: np.ndarray

    def __post_init__(self) -> None:
        offsets = np.ascontiguousarray(self.offsets, np.float32)
        shape = (len(self.animation.motion), len(self.animation.character.vertices), 3)
        if offsets.shape != shape:
            raise MotionError(f"offsets must have shape {shape}, not {offsets.shape}")
        if not np.isfinite(offsets).all():
            raise MotionError("offsets hold values that are not numbers")
        offsets = offsets.view()
        offsets.flags.writeable = False
        object.__setattr__(self, "offsets", offsets)

    @classmethod
    def of_vertices(cls, animation: Animation, vertices: np.ndarray) -> PointAnimation:
        """From where all vertices are in each frame [m], shape (N, V, 3)."""
        if np.shape(vertices) != (len(animation.motion), len(animation.character.vertices), 3):
            raise MotionError(
                f"vertices must be those of {len(animation.motion)} frames of the animation, not of shape "
                f"{np.shape(vertices)}"
            )
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
        """The motion of the reference body that the skinned part was fitted from, where it is known."""
        return self.animation.reference

    @property
    def fps(self) -> float:
        """Frames a second [1/s]."""
        return self.motion.fps

    def vertices(self, frames: slice | list[int] | np.ndarray | None = None) -> np.ndarray:
        """Posed vertices [m], shape (N, V, 3), float32, of all frames or of those named."""
        return np.asarray(self.animation.vertices(frames) + (self.offsets if frames is None else self.offsets[frames]))

    def at(self, fps: float) -> PointAnimation:
        """The same at another rate [1/s]: offsets move in straight lines between frames."""
        moved = self.animation.at(fps)
        if moved.motion is self.motion:
            return self
        return PointAnimation(moved, Resampling.of(len(self.offsets), self.motion.fps, fps).linear(self.offsets))

    def take(self, frames: slice) -> PointAnimation:
        """Some of its frames."""
        return PointAnimation(self.animation.take(frames), self.offsets[frames])

    def save(self, path: str | Path, **options: object) -> Path:
        """Write the animation in the format that the file's suffix names and return the path.

        A .glb has the skin, and morph targets for what moves on its own; .usd, .usdc, .usda and .usdz have the points
        of every frame; .obj and .ply are a sequence of meshes.

        Raises:
            FormatError: The suffix is unknown, or the file cannot be written.
        """
        return save(self, path, **options)


FADE = 0.3
"""How long the difference of two poses at a join takes to fade out [s]."""


def end_to_start(animations: Sequence[RigAnimation]) -> RigAnimation:
    """One animation of all in a row.

    Each is moved over the ground and turned about +Y until its first pose lies on the last of the one before as closely
    as can be, by least squares over the heads of all bones. What is left of the difference fades out.

    Args:
        animations: Of the same rig, at least one; the rate is that of the first.

    Raises:
        MotionError: They are of several rigs.
    """
    first = animations[0]
    rest = first.character.rig
    assert rest is not None
    rotations, translations = [first.rotations], [first.translations]
    _, places = first.world()
    last = places[-1]
    for some in animations[1:]:
        if some.character is not first.character:
            raise MotionError("animations of several characters cannot be joined; put them on one with `transfer`")
        one = _placed(some.at(first.fps), last)
        share = smooth_step(1 - np.arange(len(one)) / max(round(FADE * first.fps), 1))[:, None, None]
        off = axis_angle_from_matrix(rotations[-1][-1].astype(float) @ np.swapaxes(one.rotations[0], -1, -2))
        rotations.append(matrix_from_axis_angle(share * off) @ one.rotations.astype(float))
        translations.append(one.translations + share * (translations[-1][-1] - one.translations[0]))
        rotations[-1], translations[-1] = rotations[-1][1:], translations[-1][1:]  # its first pose is there already
        if len(rotations[-1]):
            last = RigAnimation(first.character, rotations[-1][-1:], translations[-1][-1:]).world()[1][0]
    return RigAnimation(first.character, np.concatenate(rotations), np.concatenate(translations), first.fps)


def _placed(animation: RigAnimation, goal: np.ndarray) -> RigAnimation:
    """The animation moved over the ground so that its first pose lies on another.

    Args:
        animation: N frames of J bones.
        goal: Where the heads of the bones are [m], shape (J, 3).
    """
    turns, places = animation.world()
    start, middle = places[0].mean(axis=0), goal.mean(axis=0)
    own, theirs = (places[0] - start)[:, [0, 2]], (goal - middle)[:, [0, 2]]
    cross = float((own[:, 1] * theirs[:, 0] - own[:, 0] * theirs[:, 1]).sum())
    angle = math.atan2(cross, float((own * theirs).sum()))
    turn = matrix_y(np.array([angle]))[0]
    places = (places - start) @ turn.T + start + (middle - start) * [1, 0, 1]
    return RigAnimation.of_world(animation.character, turn @ turns, places, animation.fps)


@runtime_checkable
class AnimatedCharacter(Protocol):
    """A character that moves: an `Animation` of handles or a `RigAnimation` of bones."""

    @property
    def character(self) -> Character:
        """The character in its rest pose."""

    @property
    def handles(self) -> Handles:
        """What moves it: its handles, or its bones as handles."""

    @property
    def motion(self) -> HandleMotion:
        """How these move."""

    @property
    def reference(self) -> HandleMotion | None:
        """The motion of the reference body that this was fitted from, where it is known."""

    @property
    def fps(self) -> float:
        """Frames a second [1/s]."""

    def vertices(self, frames: slice | list[int] | np.ndarray | None = None) -> np.ndarray:
        """Posed vertices [m], shape (N, V, 3), float32, of all frames or of those named."""

    def at(self, fps: float) -> Self:
        """The same at another rate [1/s]."""

    def take(self, frames: slice) -> Self:
        """Some of its frames."""

    def save(self, path: str | Path, **options: object) -> Path:
        """Write the animation in the format that the file's suffix names and return the path."""
