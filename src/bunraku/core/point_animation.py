"""An animation whose vertices also move on their own: what skinning leaves to cloth, hair and other apparel."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.saving import Shown, save
from bunraku.errors import MotionError
from bunraku.geometry.resampling import Resampling

__all__ = ["PointAnimation"]


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
