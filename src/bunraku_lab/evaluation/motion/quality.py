"""How clean a motion is: do standing feet slide, does anything sink, does it jitter; and what each stage of fitting
does about it.

All lengths are at human size: those of the character times 1.7 m over its height. Nothing here uses what the stages
detect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import posed_points, skin
from bunraku.retarget.fit import Stages, fit_motion

__all__ = [
    "Gauge",
    "MotionQuality",
    "gauge",
    "measure",
    "pooled",
    "stage_effects",
]

HUMAN = 1.7  # m
DOWN = 0.05  # a foot is down where its lowest vertex is so near to the ground, over the leg's length
# m/s at human size: a foot that moves faster along the ground than this and than the body does is swung, not slid
SWING = 1.0
POINTS = 300  # vertices of each foot that are looked at
SINK = 20000  # vertices of the body that are looked at
CLEANING = ("smooth", "feet", "floor")
"""The stages that clean a motion, as against those that fit it to a body."""


@dataclass(frozen=True, eq=False)
class Gauge:
    """What is measured on a character.

    Args:
        character: In its rest pose.
        handles: Its handles.
        feet: Vertices of each foot, arrays of indices; none of who has no legs.
        legs: Length of each leg [m].
        stands: Vertices that must not sink, shape (n,): all of the surface but, of who stands on legs, what may hang
            lower than the feet such as a weapon in a hand (`standing`).
        present: Handles that the character has, shape (K,), bool.
        floor: Height of the ground [m].
    """

    character: Character
    handles: Handles
    feet: tuple[np.ndarray, ...]
    legs: tuple[float, ...]
    stands: np.ndarray
    present: np.ndarray
    floor: float

    @property
    def scale(self) -> float:
        """Centimetres at human size for each metre of the character's."""
        return 100 * HUMAN / self.character.height


@dataclass(frozen=True)
class MotionQuality:
    """What is measured of motions; lengths at human size.

    Args:
        sliding: Mean way of a foot along the ground from frame to frame while it is down and not swung [cm].
        sliding_all: The same with feet that are swung low over the ground [cm].
        down: How many times a foot was down from one frame to the next: the weight of the two above.
        contact_share: Share of feet that are down, and not swung, 0 to 1.
        sunk: Mean depth of the lowest vertex below the ground, 0 where it is not below [% of the height].
        deepest: Depth of the lowest vertex of all frames [% of the height].
        jitter: Mean third difference of the handles' positions [cm].
        frames: How many.
    """

    sliding: float
    sliding_all: float
    down: int
    contact_share: float
    sunk: float
    deepest: float
    jitter: float
    frames: int


def gauge(character: Character, handles: Handles) -> Gauge:
    """What to measure on a character; the same for all its motions."""
    anatomy = Anatomy(character, handles, character, handles)  # on all vertices
    joints, legs, stands = anatomy.joints, anatomy.legs, np.flatnonzero(anatomy.stands)
    floor = float(character.vertices[stands, 1].min())
    feet = tuple(leg.foot_area[:: max(1, len(leg.foot_area) // POINTS)] for leg in legs)
    return Gauge(
        character,
        handles,
        feet,
        tuple(leg.length for leg in legs),
        stands[:: max(1, len(stands) // SINK)],
        joints.present,
        floor,
    )


def _slides(what: Gauge, transforms: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Ways of feet that are down from a frame to the next [cm], whether each is no swing, and how many pairs of frames
    and feet there are.
    """
    ways, slid, count = [], [], 0
    h = what.handles.positions
    root = transforms[:, 0, :, :3] @ h[0] + transforms[:, 0, :, 3]
    body = np.linalg.norm(np.diff(root[:, [0, 2]], axis=0), axis=1) * what.scale
    for foot, leg in zip(what.feet, what.legs, strict=True):
        posed = skin(what.character.vertices[foot], what.handles.weights[foot], transforms)
        low = posed[..., 1] < what.floor + DOWN * leg
        low = low[1:] & low[:-1]
        course = np.linalg.norm(np.diff(posed[..., [0, 2]], axis=0), axis=-1)
        down = low.any(axis=1)
        mean = (course * low).sum(axis=1)[down] / low.sum(axis=1)[down] * what.scale
        ways.append(mean)
        slid.append(mean <= np.maximum(1.01 * body[down], 100 * SWING / fps))
        count += len(low)
    if not ways:
        return np.zeros(0), np.zeros(0, bool), 0
    return np.concatenate(ways), np.concatenate(slid), count


def _depths(what: Gauge, transforms: np.ndarray) -> np.ndarray:
    """How deep the lowest vertex is below the ground in each frame [% of the height], shape (N,)."""
    vertices, weights = what.character.vertices[what.stands], what.handles.weights[what.stands]
    lowest = np.concatenate(
        [skin(vertices, weights, transforms[n : n + 50])[..., 1].min(axis=1) for n in range(0, len(transforms), 50)]
    )
    return np.maximum(what.floor - lowest, 0) / what.character.height * 100


def _jitter(what: Gauge, transforms: np.ndarray) -> float:
    positions = posed_points(transforms, what.handles.positions)
    if len(positions) < 4:
        return 0.0
    return float(
        np.linalg.norm(np.diff(positions[:, what.present].astype(np.float64), 3, axis=0), axis=-1).mean() * what.scale
    )


def measure(what: Gauge, motion: HandleMotion) -> MotionQuality:
    """All measures of one motion of a character.

    Args:
        what: The character's gauge.
        motion: Motion of its handles.
    """
    transforms = motion.transforms(what.handles.positions)
    ways, slid, count = _slides(what, transforms, motion.fps)
    depths = _depths(what, transforms)
    return MotionQuality(
        sliding=float(ways[slid].mean()) if slid.any() else 0.0,
        sliding_all=float(ways.mean()) if len(ways) else 0.0,
        down=int(slid.sum()),
        contact_share=float(slid.sum() / count) if count else 0.0,
        sunk=float(depths.mean()),
        deepest=float(depths.max()),
        jitter=_jitter(what, transforms),
        frames=len(motion),
    )


def pooled(found: Sequence[MotionQuality]) -> MotionQuality:
    """Measures of many motions as of one: means over all frames and feet, and the deepest of all."""
    frames, down = np.array([each.frames for each in found], float), np.array([each.down for each in found], float)

    def mean(name: str, weight: np.ndarray) -> float:
        return float(np.average([getattr(each, name) for each in found], weights=weight)) if weight.sum() else 0.0

    return MotionQuality(
        sliding=mean("sliding", down), sliding_all=mean("sliding_all", down), down=int(down.sum()),
        contact_share=mean("contact_share", frames),
        sunk=mean("sunk", frames), deepest=max((each.deepest for each in found), default=0.0),
        jitter=mean("jitter", frames), frames=int(frames.sum()),
    )  # fmt: skip


def stage_effects(
    motions: Sequence[HandleMotion], characters: Mapping[str, tuple[Character, Handles]]
) -> list[dict[str, float | str]]:
    """What each cleaning stage does: every motion on every character with all stages, with each left out once, and with
    none of them.

    Args:
        motions: Of the reference body.
        characters: Character and handles by name.

    Returns:
        A row for each character and case: `character` (of all together: "all"), `without` (a stage, "nothing" or
        "smooth, feet, floor") and the fields of `MotionQuality`; `moved` is the mean distance of the handles' positions
        in the root's frame from those without any of the stages [cm].
    """
    everything = Stages(shape=True)
    cases = {"nothing": everything, **{name: replace(everything, **{name: False}) for name in CLEANING}}
    none = ", ".join(CLEANING)
    cases[none] = replace(everything, **dict.fromkeys(CLEANING, False))
    results: dict[str, list[tuple[str, MotionQuality, float]]] = {case: [] for case in cases}
    for name, (character, handles) in characters.items():
        what, anatomy = gauge(character, handles), Anatomy.of(character, handles)
        for motion in motions:
            plain = fit_motion(motion, anatomy, cases[none])
            for case, stages in cases.items():
                fitted = plain if case == none else fit_motion(motion, anatomy, stages)
                results[case].append((name, measure(what, fitted), _moved(what, plain, fitted)))
    rows: list[dict[str, float | str]] = []
    for name in [*characters, "all"]:
        for case, found in results.items():
            own = [(quality, moved) for owner, quality, moved in found if name in ("all", owner)]
            if own:
                quality = pooled([each for each, _ in own])
                values = {field.name: getattr(quality, field.name) for field in fields(quality)}
                rows.append(
                    {"character": name, "without": case, **values, "moved": float(np.mean([moved for _, moved in own]))}
                )
    return rows


def _moved(what: Gauge, before: HandleMotion, after: HandleMotion) -> float:
    """Mean distance between the handles' positions of two motions of a character in the root's frame [cm]."""
    away = np.linalg.norm(after.translations - before.translations, axis=-1)[:, what.present]
    return float(away.mean() * what.scale)
