"""What `animate` and `transfer` give, whatever moves the character: 30 handles or the bones of its own rig."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, Self, runtime_checkable

import numpy as np

from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion

__all__ = ["AnimatedCharacter"]


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
