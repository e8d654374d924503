"""One training clip in network units: what it says, where it loops, and how it is made longer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bunraku.diffusion.captions import caption_group
from bunraku.diffusion.features import FeatureStatistics, feature_weights
from bunraku.diffusion.joining import join_point, splice

__all__ = ["TrainingClip"]

FARTHEST = 8.0  # standard deviations; beyond are faults of capture that would outweigh all else in a squared error


@dataclass(frozen=True)
class TrainingClip:
    """One clip in network units.

    Args:
        name: Its name in the index.
        values: Normalised features, shape (N, D), float32.
        texts: Its captions as the archive has them.
        weight: The index's own weight.
        loop: Frames (i, j) such that playing on from j after i is smooth; None where there are none.
        rests: The clip ends at rest, so its last pose can be held.
        species: What creature it is of; None for people.
        action: What is done, in a canonical word, where the index says so.
        character: The creature's name in the mesh bank; None for any humanoid.
    """

    name: str
    values: np.ndarray
    texts: tuple[str, ...]
    weight: float = 1.0
    loop: tuple[int, int] | None = None
    rests: bool = False
    species: str | None = None
    action: str | None = None
    character: str | None = None

    @property
    def label(self) -> str:
        """What groups it with clips of the same meaning."""
        group = caption_group(self.texts[0])
        return f"{self.species or 'person'}: {self.action}" if self.action and not (self.species is None and group.phrases) else group.name

    @classmethod
    def prepare(cls, name: str, entry: dict[str, Any], statistics: FeatureStatistics, frames: int) -> TrainingClip:
        """Bring a clip to network units and see whether it loops or ends at rest.

        Args:
            name: Its name in the index.
            entry: Its index entry with its "features", shape (N, D).
            statistics: Units of the network.
            frames: Only clips shorter than this are ever lengthened.
        """
        values = np.clip(statistics.normalise(entry["features"]).astype(np.float32), -FARTHEST, FARTHEST)
        loop, rests = None, False
        if len(values) < frames:
            i, j, distance = join_point(values, values, feature_weights())
            if distance < (0.8 if len(values) < 60 else 0.3) and i - j >= 6:
                loop = (i, j)
            speed = np.abs(entry["features"][-4:, :3]).max()
            change = float((np.diff(values[-4:], axis=0)[:, 4:] ** 2).mean())
            rests = bool(speed < 0.5 and change < 0.02)
        species, action = entry.get("species"), entry.get("action")
        creature = (species, action, entry.get("character")) if species and action else (None, action, None)
        texts = tuple(entry.get("texts") or [f"a {species}: {action}"])
        return cls(name, values, texts, float(entry.get("weight", 1.0)), loop, rests, *creature)

    def lengthened(self, target: int, still: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """The clip played again from its loop point, or with its last pose held, until it has `target` frames or can have no more.

        Args:
            target: Frames wanted.
            still: The root's velocities at rest in network units, shape (3,).
            random: Draws how long the last pose is held.

        Returns:
            The very array of the clip where nothing can be added, else a longer one, shape (N, D).
        """
        values = self.values
        if self.loop is not None:
            i, j = self.loop
            while len(values) < target:
                values = splice(values, self.values, len(values) - len(self.values) + i, j)
        elif self.rests and len(values) < target:
            hold = np.repeat(values[-1:], min(target - len(values), int(random.integers(5, 40))), axis=0)
            fade = 0.5 ** np.arange(1, len(hold) + 1, dtype=np.float32)[:, None]
            hold[:, :3] = still + (hold[:, :3] - still) * fade
            values = np.concatenate([values, hold])
        return values
