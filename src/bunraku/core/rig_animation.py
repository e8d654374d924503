"""An animation on a character's own rig: bones turn, skinning does the rest."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.saving import Shown, save
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError, MotionError
from bunraku.geometry.resampling import Resampling

__all__ = ["RigAnimation", "bone_order"]


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
