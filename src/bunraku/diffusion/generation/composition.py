"""Two motions denoised side by side, for what happens at the same time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.body.parts import kept_handles
from bunraku.diffusion.features import feature_mask
from bunraku.language.limbs.posing import Posing
from bunraku.language.sentence import Clause

__all__ = ["PartTrack"]


@dataclass(frozen=True)
class PartTrack:
    """A second time line for a motion in which something happens at the same time: it is conditioned on the gestures,
    and moves as the first one else.

    The first does not see the second: a walk whose arms wave would soon stand still, as people do who wave.

    Args:
        motion: Which motion of the batch it belongs to.
        sentences: What it is conditioned on, a sentence for each of the motion's.
        handles: The handles that are its own, shape (K,), bool.
    """

    motion: int
    sentences: tuple[str, ...]
    handles: np.ndarray

    @classmethod
    def of(cls, motion: int, script: Sequence[Clause], limbs: bool = True) -> PartTrack | None:
        """The second time line of a motion with these clauses; None where nothing is done meanwhile in any.

        Args:
            motion: Its number.
            script: Its clauses.
            limbs: What limbs are told to do is on that line, too; else it is laid over the motion (`overlay`).
        """
        voices = [clause.meanwhile for clause in script]
        voices = [one if one is not None and (limbs or not isinstance(one.told, Posing)) else None for one in voices]
        own = [kept_handles(made.part.split(" and ")) for made in voices if made is not None]
        texts = tuple((made or clause.body).text for made, clause in zip(voices, script, strict=True))
        return cls(motion, texts, np.any(own, axis=0)) if own else None

    def follow(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """The second time line's features, shape (N, 271), with all that is not its own as in the first."""
        return np.where(feature_mask(self.handles), second, first)

    def adapt(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """The same of the adaptation, shape (N, K, 3)."""
        return np.where(self.handles[:, None], second, first)
