"""What a viewer of a motion sees: rotations, waving, kicking with the requested leg, floating and trembling."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bunraku.core.body.layout import HANDLE_NAMES, JOINT_COUNT
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import heading
from bunraku.core.geometry.surface import part_extremes
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.generation.verifier import SIDES, Track
from bunraku_lab.description.phrases import runs
from bunraku_lab.evaluation.motion.metrics import posed_positions

# Chosen by eye with some of the measured sentences in view.
DOWN = 0.05  # m over the ground; what is higher stands on nothing
LONGEST_FLIGHT = 1.2  # s
THROWN = 0.25  # share of a free flight's height that a jump rises by, at least
GRAVITY = 9.81  # m/s^2
MOVES = 0.2  # m/s; a root that is slower goes nowhere
SWAY = 5.0  # Hz; no hand waves faster
SETTLE = 0.3  # s in which a hand that was just raised is still on its way
SHORTEST_WAVE = 0.5  # s
LEAST_KICK = 0.25  # m between the two ankles
LEAST_PUNCH = 1.5  # m/s
LEAST_STEP = 0.1  # m
LEVEL = 0.1  # m below the shoulder, where a hand counts as raised
SEATED = 0.2  # m below standing
TUCKED = 0.1  # m; a foot of a seated person may stand on its edge


def turned(motion: HandleMotion) -> float:
    """Change of heading from the first frame to the last [degrees], positive to the left; whole turns add up."""
    angle = heading(motion.root_rotation, motion.fps)
    return float(np.degrees(angle[-1] - angle[0]))


def heading_drift(motion: HandleMotion) -> float:
    """Largest change of heading from the first frame, to either side [degrees]."""
    angle = heading(motion.root_rotation, motion.fps)
    return float(np.degrees(np.abs(angle - angle[0]).max()))


class Wave(NamedTuple):
    """How a hand waves.

    Args:
        range: Way to and fro between the 5th and 95th percentile along the principal axis [cm].
        fast: Share of the energy of its velocity above 5 Hz.
    """

    range: float
    fast: float


def wave_of(motion: HandleMotion, side: str) -> Wave | None:
    """How a hand waves in the longest stretch in which it is raised, seen from the root; None where it never is.

    Args:
        motion: N frames.
        side: "left" or "right".
    """
    track = Track.of(motion)
    stretches = _raised(track, side)
    if not stretches:
        return None
    from scipy.signal import periodogram  # which loads half of scipy

    start, stop = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    position = track.relative(f"{side}_wrist")[start:stop]
    away = position - position.mean(axis=0)
    along = away @ np.linalg.svd(away, full_matrices=False)[2][0]
    low, high = np.percentile(along, [5, 95])
    frequency, power = periodogram(np.diff(position, axis=0), motion.fps, window="hann", detrend="constant", axis=0)
    energy = power.sum(axis=1)
    return Wave(100 * float(high - low), float(energy[frequency > SWAY].sum() / max(energy.sum(), 1e-30)))


def _raised(track: Track, side: str) -> list[tuple[int, int]]:
    """Stretches in which a hand is up, above its elbow and about its shoulder, without the ways there and back."""
    wrist, elbow, shoulder = (track.points[f"{side}_{part}"][:, 1] for part in ("wrist", "elbow", "shoulder"))
    up = (wrist > elbow) & (wrist > shoulder - LEVEL)
    settle, last = track.frames(SETTLE), len(track)
    found = []
    for start, stop in runs(up, bridge=track.frames(0.15)):
        start, stop = start + settle * (start > 0), stop - settle * (stop < last)
        if stop - start >= track.frames(SHORTEST_WAVE):
            found.append((start, stop))
    return found


def waving_side(motion: HandleMotion) -> str | None:
    """The hand that goes the longer way while it is raised; None where neither is."""
    track = Track.of(motion)
    ways = {}
    for side in SIDES:
        position = track.relative(f"{side}_wrist")
        ways[side] = sum(
            float(np.linalg.norm(np.diff(position[start:stop], axis=0), axis=1).sum())
            for start, stop in _raised(track, side)
        )
    return _larger(ways, 0.0)


def kicking_side(motion: HandleMotion) -> str | None:
    """The leg that goes highest over the other ankle and farthest from its own hip; None where neither is lifted."""
    track = Track.of(motion)
    found = {}
    for side, other in zip(SIDES, SIDES[::-1], strict=True):
        ankle, hip = track.points[f"{side}_ankle"], track.points[f"{side}_hip"]
        rise = ankle[:, 1] - track.points[f"{other}_ankle"][:, 1]
        reach = np.hypot(*(ankle - hip)[:, [0, 2]].T)
        found[side] = float(np.where(rise >= LEAST_KICK, rise + reach, 0.0).max())
    return _larger(found, 0.0)


def punching_side(motion: HandleMotion) -> str | None:
    """The hand that shoots forward fastest, seen from the root; None where neither is fast."""
    track = Track.of(motion)
    found = {
        side: float(np.diff(track.relative(f"{side}_wrist")[:, 2]).max(initial=0.0) * motion.fps) for side in SIDES
    }
    return _larger(found, LEAST_PUNCH)


def raised_side(motion: HandleMotion) -> str | None:
    """The hand that is up at its shoulder for 0.25 s while the other never is; None for both or neither."""
    track = Track.of(motion)
    up = {}
    for side in SIDES:
        height = (track.points[f"{side}_wrist"] - track.points[f"{side}_shoulder"])[:, 1]
        up[side] = bool(runs(height > -LEVEL, track.frames(0.25)))
    return None if up["left"] == up["right"] else next(side for side in SIDES if up[side])


def stepped_side(motion: HandleMotion) -> str | None:
    """The side of its first heading to which the root goes farthest; None where it stays."""
    angle = float(heading(motion.root_rotation, motion.fps)[0])
    course = motion.root_translation[:, [0, 2]].astype(float) - motion.root_translation[0, [0, 2]]
    aside = course @ [np.cos(angle), -np.sin(angle)]
    return _larger({"left": float(aside.max()), "right": float(-aside.min())}, LEAST_STEP)


def _larger(found: dict[str, float], least: float) -> str | None:
    side = max(found, key=lambda side: found[side])
    return side if found[side] > least else None


DOERS: dict[str, Callable[[HandleMotion], str | None]] = {
    "kick": kicking_side, "punch": punching_side, "raise": raised_side, "wave": waving_side, "step": stepped_side,
}  # fmt: skip
"""Which side does an action, by its name."""


def moving_speed(motion: HandleMotion) -> float:
    """Mean speed of the root over the ground in the frames in which it goes somewhere [m/s]; 0 where it never does."""
    speed = Track.of(motion).speed
    return float(speed[speed > MOVES].mean()) if (speed > MOVES).any() else 0.0


def tremor(motion: HandleMotion) -> float:
    """Mean norm of the third difference of the positions of a person's 22 parts from frame to frame [cm]."""
    third = np.diff(posed_positions(motion)[:, :JOINT_COUNT].astype(float), 3, axis=0)
    return 100 * float(np.linalg.norm(third, axis=-1).mean()) if len(third) else 0.0


@functools.cache
def _extremes_and_feet() -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Extreme vertices of the reference body, their weights, and which of them are of each foot."""
    body = reference_body()
    pick = part_extremes(body.vertices, body.handle_weights)
    vertices, weights = body.vertices[pick], body.handle_weights[pick]
    feet = {
        side: weights[:, [HANDLE_NAMES.index(f"{side}_{part}") for part in ("ankle", "foot")]].sum(axis=1) > 0.9
        for side in SIDES
    }
    return vertices, weights, feet


def lowest_points(motion: HandleMotion) -> dict[str, np.ndarray]:
    """Height of the lowest point of the "body", of the "left" and of the "right" foot in each frame [m], shape (N,)."""
    vertices, weights, feet = _extremes_and_feet()
    heights = skin(vertices, weights, motion.transforms(reference_body().handles.positions))[..., 1]
    return {"body": heights.min(axis=1)} | {side: heights[:, foot].min(axis=1) for side, foot in feet.items()}


def floating(motion: HandleMotion) -> np.ndarray:
    """Whether nothing carries the body, in each frame, shape (N,), bool: its lowest point is over 5 cm up in no jump.

    A jump is a stretch of at most 1.2 s in the air in which the root rises and falls, at least a quarter as high as
    what is thrown up for as long.
    """
    air = lowest_points(motion)["body"] > DOWN
    root = motion.root_translation[:, 1].astype(float)
    for start, stop in runs(air):
        if start == 0 or stop == len(air) or stop - start > LONGEST_FLIGHT * motion.fps:
            continue
        flight = (stop - start) / motion.fps
        if root[start:stop].max() - max(root[start - 1], root[stop]) >= THROWN * GRAVITY * flight**2 / 8:
            air[start:stop] = False
    return air


def sits(motion: HandleMotion) -> bool:
    """Whether in the last half second both feet are on the ground and the pelvis is 20 cm or more below standing."""
    part = motion.take(slice(-max(1, round(motion.fps / 2)), None))
    points = lowest_points(part)
    down = all(abs(float(np.median(points[side]))) <= TUCKED for side in SIDES)
    return down and float(np.median(part.root_translation[:, 1])) <= -SEATED
