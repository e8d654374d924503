"""What training rows of people are joined to: how people stand and walk in the training clips."""

from __future__ import annotations

from collections.abc import Sequence

from bunraku.diffusion.examples.joins import FEWEST, Joins, standing_stretches
from bunraku.diffusion.features import FeatureStatistics
from bunraku_lab.training.rows.training_clip import TrainingClip

__all__ = ["goes", "joins_of"]


def goes(clip: TrainingClip) -> bool:
    """Whether somebody walks or runs in it, and may walk on."""
    return bool({"walk", "run"} & set(clip.actions))


def joins_of(clips: Sequence[TrainingClip], statistics: FeatureStatistics) -> Joins:
    """Banks of all stretches of standing, and of all walks and runs that can be played again."""
    people = [clip for clip in clips if clip.species is None]
    standing = [part for clip in people for part in standing_stretches(clip.values, statistics)]
    walking = [
        (clip.values, clip.loop)
        for clip in people
        if clip.loop is not None and clip.actions in (("walk",), ("run",)) and len(clip.values) >= FEWEST
    ]
    return Joins(standing, walking)
