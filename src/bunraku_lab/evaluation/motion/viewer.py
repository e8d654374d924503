"""What a viewer of a motion sees: turning, waving, kicking with the requested leg, floating, trembling, the swing of
the legs, hands inside the body, and contacts that slide.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_COUNT
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import heading
from bunraku.core.geometry.surface import part_extremes
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.generation.agreement import SIDES, Track, runs
from bunraku.retarget.stages.animals import pairs_of
from bunraku_lab.evaluation.motion.metrics import posed_positions

__all__ = [
    "DOERS", "Pair", "Slides", "Wave", "floating", "gait_of", "hands_in_body", "heading_drift", "kicking_side",
    "lowest_points", "moving_speed", "punching_side", "raised_side", "sits", "sliding_contacts", "stepped_side",
    "tremor", "turned", "wave_of", "waving_side",
]  # fmt: skip


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
TUCKED = 0.1  # m; a foot of who sits may stand on its edge


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


LOW_PERCENTILE, HIGH_PERCENTILE = 5, 95
"""Percentiles between which a leg swings."""
NEAR = 24
"""Vertices around a joint that tell where it is."""


@dataclass(frozen=True)
class Pair:
    """A left and a right leg.

    Args:
        left: Through which angle the left one swings [degrees].
        right: The same of the right one.
        phase: How far the right one is behind the left one, in cycles, 0 to 1.
    """

    left: float
    right: float
    phase: float

    @property
    def ratio(self) -> float:
        """The left one's swing over the right one's."""
        return self.left / max(self.right, 1e-9)


def gait_of(animation: Animation | RigAnimation, anatomy: Anatomy) -> list[Pair]:
    """The pairs of legs of a body, the foremost first."""
    character = animation.character
    whole = Anatomy(character, anatomy.handles, character, anatomy.handles)
    vertices = animation.vertices().astype(np.float64)
    middle = vertices.mean(axis=1)
    way = (middle[-1] - middle[0]) * [1, 0, 1]
    ahead = way / max(float(np.linalg.norm(way)), 1e-9) if np.linalg.norm(way) > 0.1 * character.height else [0, 0, 1.0]
    pairs = []
    for pair in pairs_of(whole.legs):
        angles = []
        for leg in pair:
            near = np.argsort(np.linalg.norm(character.vertices - leg.joints[0], axis=1))[:NEAR]
            down = vertices[:, leg.sole].mean(axis=1) - vertices[:, near].mean(axis=1)
            angles.append(np.degrees(np.arctan2(down @ ahead, -down[:, 1])))
        swings = [float(np.ptp(np.percentile(angle, [LOW_PERCENTILE, HIGH_PERCENTILE]))) for angle in angles]
        pairs.append(Pair(swings[0], swings[1], _behind(*angles)))
    return pairs


def _behind(left: np.ndarray, right: np.ndarray) -> float:
    """How far one signal is behind another in cycles of the strongest frequency they share."""
    window = np.hanning(len(left))
    spectra = [np.fft.rfft((one - one.mean()) * window, 4 * len(one)) for one in (left, right)]
    shared = np.abs(spectra[0]) * np.abs(spectra[1])
    peak = int(shared[4:].argmax()) + 4
    return float((np.angle(spectra[0][peak]) - np.angle(spectra[1][peak])) / (2 * np.pi) % 1.0)


DEEP = 0.01
"""How deep a point of a hand in the body is seen [m]."""
SOLE_HEIGHT = 0.03
"""Height of a sole's lowest point with which it is on the ground [m]."""
FAST = 1.0
"""Speed along the ground with which a foot is swung [m/s]."""
SLID = 0.03
"""Way that is seen [m]."""
MOMENT = 0.1
"""Time in which it is [s]."""
SOLE = 0.02
"""How much higher than the lowest a point of a sole may be to be where the foot stands [m]."""


@functools.cache
def _trunk_and_hands() -> tuple[np.ndarray, np.ndarray]:
    """Faces of the reference body without its arms, and some vertices of both hands."""
    body = reference_body()

    def moved_by(*ends: str) -> np.ndarray:
        chosen = [name.endswith(ends) for name in HANDLE_NAMES]
        return np.asarray(body.handle_weights[:, chosen].sum(axis=1))

    arms = moved_by("collar", "shoulder", "elbow", "wrist", "fingers")
    faces = body.character().faces
    return faces[(arms[faces] < 0.5).all(axis=1)], np.flatnonzero(moved_by("wrist", "fingers") > 0.8)[::20]


def hands_in_body(motion: HandleMotion, every: int = 2) -> np.ndarray:
    """Whether a hand is more than 1 cm deep in the body without its arms, in every second frame, shape (N / 2,), bool:
    by the generalised winding number of the posed surface (Jacobson et al. 2013).
    """
    import igl

    body = reference_body()
    faces, hands = _trunk_and_hands()
    transforms = motion.transforms(body.handles.positions)
    found = []
    for frame in range(0, len(motion), every):
        posed = skin(body.vertices, body.handle_weights, transforms[frame : frame + 1])[0].astype(np.float64)
        points = posed[hands]
        inside = igl.fast_winding_number(posed, faces.astype(np.int64), points) > 0.5
        deep = 0.0
        if inside.any():
            deep = float(igl.point_mesh_squared_distance(points[inside], posed, faces.astype(np.int64))[0].max()) ** 0.5
        found.append(deep > DEEP)
    return np.array(found)


class Slides(NamedTuple):
    """Contacts, counted for each foot and each frame in which it stays on the ground to the next.

    Args:
        fast: How many slide more than 3 cm in a tenth of a second.
        far: How many are more than 3 cm from where their contact began.
        contacts: All of them.
    """

    fast: int
    far: int
    contacts: int


def sliding_contacts(motion: HandleMotion) -> Slides:
    """How feet on the ground slide; a foot is where its lowest part is, so rolling is no slide."""
    body = reference_body()
    transforms = motion.transforms(body.handles.positions)
    fast = far = count = 0
    for side in ("left", "right"):
        columns = [HANDLE_NAMES.index(f"{side}_{part}") for part in ("ankle", "foot")]
        foot = body.handle_weights[:, columns].sum(axis=1) > 0.9
        posed = skin(body.vertices[foot], body.handle_weights[foot], transforms)
        height = posed[..., 1]
        sole = height - height.min(axis=1, keepdims=True) < SOLE
        both = sole[1:] & sole[:-1]
        ways = (np.diff(posed[..., [0, 2]], axis=0) * both[..., None]).sum(axis=1)
        ways /= np.maximum(both.sum(axis=1), 1)[:, None]
        speed = np.linalg.norm(ways, axis=1) * motion.fps
        low = height.min(axis=1) < SOLE_HEIGHT
        down = low[1:] & low[:-1] & (speed < FAST)
        from_start = np.zeros(2)
        for frame in range(len(down)):
            from_start = from_start + ways[frame] if down[frame] else np.zeros(2)
            count += bool(down[frame])
            fast += bool(down[frame] and speed[frame] * MOMENT > SLID)
            far += bool(down[frame] and np.linalg.norm(from_start) > SLID)
    return Slides(fast, far, count)
