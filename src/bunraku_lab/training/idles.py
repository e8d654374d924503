"""Captured people who stand, for gestures to be made by: those who do nothing but shift their weight and breathe, and
those who use their hands, whose legs, trunk and head go with these.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bunraku.diffusion.features import decode
from bunraku.language.description.track import SIDES, Track, runs
from bunraku_lab.training.rows.clip_data import ClipEntry

__all__ = ["BUSY", "IDLE", "IdleBounds", "idling"]


@dataclass(frozen=True)
class IdleBounds:
    """Who stands and does nothing, or something with the hands.

    Args:
        busy: The hands do something.
        shortest: Of a stretch [s].
        longest: The same [s].
        level: How far ankles are from their height at rest at the most [m].
        apart: How far apart they are at the most [m].
        slides: How fast they are at the most [m/s].
        leans: How far the trunk leans at the most [degrees].
        sinks: How far the pelvis is lower than at rest at the most [m].
        shifts: How far it goes over the ground at the most [m].
        hangs: How far wrists of who does nothing are under the shoulders at the least [m].
        swings: How fast they are, seen from the pelvis, in the mean of a stretch at the most [m/s]; of who is busy the
            faster one at the least.
    """

    busy: bool = False
    shortest: float = 3.0
    longest: float = 9.0
    level: float = 0.03
    apart: float = 0.5
    slides: float = 0.12
    leans: float = 15.0
    sinks: float = 0.06
    shifts: float = 0.15
    hangs: float = 0.42
    swings: float = 0.12


IDLE = IdleBounds()
BUSY = IdleBounds(busy=True, sinks=0.1, shifts=0.3, swings=0.2)


def idling(clips: Mapping[str, ClipEntry], bounds: IdleBounds = IDLE) -> Iterator[tuple[str, np.ndarray]]:
    """The longest such stretch of each clip, as its name and its features, the longest first.

    Args:
        clips: Features of people by the names of their clips.
        bounds: Who they are.
    """
    found: list[tuple[str, np.ndarray]] = []
    for name, entry in clips.items():
        stretch = _longest(entry["features"], bounds)
        if stretch is not None:
            found.append((name, entry["features"][stretch]))
    yield from sorted(found, key=lambda one: -len(one[1]))


def _longest(features: np.ndarray, bounds: IdleBounds) -> slice | None:
    """The frames of the longest stretch in which somebody stands so; None where there is none."""
    motion = decode(features)
    if len(motion) < bounds.shortest * motion.fps:
        return None
    track = Track.of(motion)
    ankles = np.stack([track.points[f"{side}_ankle"] for side in SIDES], axis=1)
    speed = np.linalg.norm(np.diff(ankles, axis=0, prepend=ankles[:1]), axis=-1).max(axis=1) * motion.fps
    calm = (np.ptp(ankles[..., 1], axis=1) < bounds.level) & (ankles[..., 1].max(axis=1) < 0.081 + bounds.level)
    calm &= (np.linalg.norm(ankles[:, 0] - ankles[:, 1], axis=1) < bounds.apart) & (speed < bounds.slides)
    calm &= track.height > -bounds.sinks
    shoulders, hips = (
        np.mean([track.points[f"{side}_{part}"] for side in SIDES], axis=0) for part in ("shoulder", "hip")
    )
    trunk = shoulders - hips
    calm &= trunk[:, 1] > np.cos(np.radians(bounds.leans)) * np.linalg.norm(trunk, axis=1)
    for side in () if bounds.busy else SIDES:
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
        if (
            np.ptp(motion.root_translation[part], axis=0).max() < bounds.shifts
            and (swing > bounds.swings) == bounds.busy
        ):
            best = part
    return best
