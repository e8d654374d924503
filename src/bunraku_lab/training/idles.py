"""Captured people who stand and do nothing, shifting their weight and breathing, for gestures to be made by."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bunraku.diffusion.features import decode
from bunraku.language.description.track import SIDES, Track, runs
from bunraku_lab.training.diffusion.clip_data import ClipEntry

__all__ = ["IdleBounds", "idling"]


@dataclass(frozen=True)
class IdleBounds:
    """Who stands and does nothing.

    Args:
        shortest: Of a stretch [s].
        longest: The same [s].
        level: How far ankles are from their height at rest at the most [m].
        apart: How far apart they are at the most [m].
        slides: How fast they are at the most [m/s].
        sinks: How far the pelvis is lower than at rest at the most [m].
        shifts: How far it goes over the ground at the most [m].
        hangs: How far wrists are under the shoulders at the least [m].
        swings: How fast they are, seen from the pelvis, in the mean of a stretch at the most [m/s].
    """

    shortest: float = 3.0
    longest: float = 9.0
    level: float = 0.03
    apart: float = 0.5
    slides: float = 0.12
    sinks: float = 0.06
    shifts: float = 0.15
    hangs: float = 0.42
    swings: float = 0.12


def idling(clips: Mapping[str, ClipEntry], bounds: IdleBounds = IdleBounds()) -> Iterator[tuple[str, np.ndarray]]:
    """The longest such stretch of each clip, as its name and its features, the longest first.

    Args:
        clips: Features of people by the names of their clips.
        bounds: Who stands and does nothing.
    """
    found: list[tuple[str, np.ndarray]] = []
    for name, entry in clips.items():
        stretch = _longest(entry["features"], bounds)
        if stretch is not None:
            found.append((name, entry["features"][stretch]))
    yield from sorted(found, key=lambda one: -len(one[1]))


def _longest(features: np.ndarray, bounds: IdleBounds) -> slice | None:
    """The frames of the longest stretch in which somebody idles; None where there is none."""
    motion = decode(features)
    if len(motion) < bounds.shortest * motion.fps:
        return None
    track = Track.of(motion)
    ankles = np.stack([track.points[f"{side}_ankle"] for side in SIDES], axis=1)
    speed = np.linalg.norm(np.diff(ankles, axis=0, prepend=ankles[:1]), axis=-1).max(axis=1) * motion.fps
    calm = (np.ptp(ankles[..., 1], axis=1) < bounds.level) & (ankles[..., 1].max(axis=1) < 0.081 + bounds.level)
    calm &= (np.linalg.norm(ankles[:, 0] - ankles[:, 1], axis=1) < bounds.apart) & (speed < bounds.slides)
    calm &= track.height > -bounds.sinks
    for side in SIDES:
        wrist, shoulder = (track.points[f"{side}_{part}"][:, 1] for part in ("wrist", "shoulder"))
        calm &= wrist < shoulder - bounds.hangs
    best: slice | None = None
    for start, stop in runs(calm):
        stop = min(stop, start + round(bounds.longest * motion.fps))
        part = slice(start, stop)
        if stop - start < max(bounds.shortest * motion.fps, best.stop - best.start if best else 0):
            continue
        swing = max(
            float(np.linalg.norm(np.diff(track.relative(f"{side}_wrist")[part], axis=0), axis=1).mean()) * motion.fps
            for side in SIDES
        )
        if np.ptp(motion.root_translation[part], axis=0).max() < bounds.shifts and swing < bounds.swings:
            best = part
    return best
