"""An animation: a character, its handles and their motion, ready to be played or saved."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.resample import resample
from bunraku.core.saving import Shown, save
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError, MotionError

__all__ = ["Animation"]


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
