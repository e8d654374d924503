"""Whether a motion does what its sentence plainly says, and the measures of a motion: path, heading, heights, feet,
hands.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.geometry.curves import gaussian, running_least
from bunraku.core.geometry.rotations import heading, matrix_y
from bunraku.core.motion import HandleMotion
from bunraku.language.posing import Posing
from bunraku.language.sentence import Clause

__all__ = ["Phrase", "SIDES", "Track", "agreement", "runs", "smooth"]

SIDES = ("left", "right")
_PARTS = ("ankle", "foot", "wrist", "elbow", "shoulder", "hip")
_NAMES = [f"{side}_{part}" for side in SIDES for part in _PARTS] + ["head_top", "head"]


@functools.cache
def _rest() -> tuple[np.ndarray, np.ndarray]:
    from bunraku.core.body.reference import reference_body

    positions = reference_body().handles.positions.astype(float)
    rows = np.array([HANDLE_NAMES.index(name) for name in _NAMES])
    return rows, np.concatenate([positions[:1], positions[rows]])


def smooth(values: np.ndarray, seconds: float, fps: float) -> np.ndarray:
    """Gaussian mean over time with this deviation."""
    return gaussian(values, seconds * fps)


def runs(mask: np.ndarray, least: float = 1, bridge: float = 0) -> list[tuple[int, int]]:
    """Runs (start, stop) in which the mask holds for `least` frames or more, gaps of up to `bridge` frames included."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    merged: list[tuple[int, int]] = []
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if merged and start - merged[-1][1] <= bridge:
            merged[-1] = (merged[-1][0], stop)
        else:
            merged.append((start, stop))
    return [(start, stop) for start, stop in merged if stop - start >= least]


@dataclass(frozen=True)
class Phrase:
    """Something that a motion does in some of its frames."""

    kind: str  # "go", "turn", "jump", "kick", "arm", "bend" or "still"
    texts: tuple[str, ...]  # rewordings of the same, with verbs in braces
    # start, stop: first frame, and the one after the last
    start: int
    stop: int
    # words that are still true where only a part of the frames is there; empty where a part is nothing
    part: tuple[str, ...] = ()
    manner: tuple[str, ...] = ()  # for "go": direction and speed, to follow another verb, such as "backwards", "slowly"


@dataclass(frozen=True)
class Track:
    """Measures of a motion of the reference body; +left is the body's own left."""

    fps: float  # frames a second [1/s]
    position: np.ndarray  # path of the root on the ground (x, z) [m], shape (N, 2)
    height: np.ndarray  # root over its rest height, over the ground near it in time [m], shape (N,)
    up: np.ndarray  # cosine of the root's tilt, 1 upright, shape (N,)
    angle: np.ndarray  # heading [rad], positive to the left, smooth, shape (N,)
    velocity: np.ndarray  # forward and to the left, smooth [m/s], shape (N, 2)
    course: np.ndarray  # direction of the path itself [rad], unwrapped, shape (N,)
    points: dict[str, np.ndarray]  # world position of each named handle [m], shape (N, 3) each
    feet: np.ndarray  # lowest handle of each foot over the ground [m], shape (N, 2), left first

    @classmethod
    def of(cls, motion: HandleMotion) -> Track:
        """Measure a motion."""
        fps = motion.fps
        rows, rest = _rest()
        turn = motion.root_rotation.astype(float)
        local = rest[1:] - rest[0] + motion.translations[:, rows]
        world = np.einsum("nij,nkj->nki", turn, local) + rest[0] + motion.root_translation[:, None]
        points = {name: world[:, index] for index, name in enumerate(_NAMES)}
        feet = np.stack(
            [np.minimum(points[f"{side}_ankle"][:, 1] - 0.046, points[f"{side}_foot"][:, 1] - 0.016) for side in SIDES],
            1,
        )
        ground = running_least(feet.min(1), 2 * int(1.2 * fps) + 1)
        position = motion.root_translation[:, [0, 2]].astype(float)
        angle = smooth(heading(motion.root_rotation, fps), 0.2, fps)
        step = np.gradient(position, axis=0) * fps if len(position) > 1 else np.zeros_like(position)
        drift = smooth(step, 0.25, fps)
        back = matrix_y(-angle)
        local_drift = np.einsum("nij,nj->ni", back, np.stack([drift[:, 0], 0 * drift[:, 0], drift[:, 1]], 1))
        course = np.unwrap(np.arctan2(drift[:, 0], drift[:, 1]))
        height = motion.root_translation[:, 1].astype(float) - ground
        return cls(
            fps, position, height, turn[:, 1, 1], angle, local_drift[:, [2, 0]], course, points, feet - ground[:, None]
        )

    def __len__(self) -> int:
        return len(self.position)

    def frames(self, seconds: float) -> int:
        """Number of frames of a time, at least one."""
        return max(1, round(seconds * self.fps))

    @property
    def speed(self) -> np.ndarray:
        """Of the root over the ground, smooth [m/s], shape (N,)."""
        return np.hypot(self.velocity[:, 0], self.velocity[:, 1])

    def relative(self, name: str) -> np.ndarray:
        """A handle seen from the root in its heading: to the left, height in the world, forward [m], shape (N, 3)."""
        offset = self.points[name].copy()
        offset[:, [0, 2]] -= self.position
        return np.einsum("nij,nj->ni", matrix_y(-self.angle), offset)


# Chosen by eye with sentences of `bunraku evaluate motion --only viewer` in view.
_LEVEL = 0.15  # m below the shoulder, from where on a hand is up
_RISES = 0.15  # m; a hand or foot that is so much higher than the other is the one that is meant
_FAST = 1.0  # m/s
_STEP = 0.3  # m
_WALK = 0.6  # m
_PACE = 0.3  # m/s, slower than any walk: a person who is not half as fast stays
_ON_FOOT = ("walk", "run")
_STANDS = 0.3  # share of the time for which a person who goes may stand
_ARCS, _EVEN = 3, 0.6  # thirds of a circle, and the share of an even turn that each has at the least
_SLACK = np.radians(30)
_SEAT = 0.2  # m
_CLEAR = 0.1  # m


def agreement(clause: Clause, motion: HandleMotion) -> float | None:
    """How far what a clause of one action plainly says is true of a motion of the reference body: that of the claim
    that holds least, from -1, the contrary, to 1; None where it claims nothing visible.
    """
    if clause.limbs_meanwhile is not None:
        clause = clause.body
    if len(motion) < 8 or not (clause.detail is None or isinstance(clause.detail, Posing)):
        return None  # "to the left" is where a thing is put
    if "then" in clause.cues and len(clause.actions) != 1:
        return None  # of several things that follow each other, no one holds throughout
    track = Track.of(motion)
    scores = [score for claim in _CLAIMS if (score := claim(clause, track)) is not None]
    return float(np.clip(min(scores), -1, 1)) if scores else None


def _side(clause: Clause, part: str) -> int:
    """1 where the left of this part is meant, -1 where the right is, 0 for neither or both."""
    return int(f"left {part}" in clause.cues) - int(f"right {part}" in clause.cues)


def _arm(clause: Clause, track: Track) -> float | None:
    side = _side(clause, "arm")
    if not side or "lowers" in clause.traits:
        return None
    if "hits" in clause.traits:
        own, other = (float(np.diff(track.relative(f"{name}_wrist")[:, 2]).max()) * track.fps for name in SIDES[::side])
        return min((own - other) / _FAST, (own - _FAST) / _FAST)
    own, other = (np.quantile(_over(track, f"{name}_wrist", f"{name}_shoulder"), 0.9) for name in SIDES[::side])
    if "arm up" in clause.traits:
        return float(min(own + _LEVEL, -_LEVEL - other) / _RISES)  # one hand is up and the other is not
    return float(own - other) / _RISES if "arm out" in clause.traits else None


def _over(track: Track, upper: str, lower: str) -> np.ndarray:
    return track.points[upper][:, 1] - track.points[lower][:, 1]


def _leg(clause: Clause, track: Track) -> float | None:
    side = _side(clause, "leg")
    if not side:
        return None
    stands = "on a leg" in clause.traits
    if not stands and "leg up" not in clause.traits:
        return None
    rises = _over(track, "left_ankle", "right_ankle")
    higher = float(rises.max() + rises.min())
    return (-side if stands else side) * higher / _RISES


def _turn(clause: Clause, track: Track) -> float | None:
    """The direction and angle of a turn, or its angle alone; a clause that goes forward does not turn."""
    angle = float(track.angle[-1] - track.angle[0])
    requested = clause.turn
    if requested is None:
        return 1 - max(abs(angle) - _SLACK, 0) / _SLACK if clause.straight else None
    turned = requested.side * angle if requested.side else abs(angle)
    score = 1 - max(requested.least - turned, turned - requested.most, 0) / np.radians(45)
    if "circle" not in clause.actions:
        return score
    edges = track.angle[np.linspace(0, len(track.angle) - 1, _ARCS + 1).astype(int)]
    return min(score, _ARCS / _EVEN * float((np.diff(edges) / (angle or 1.0)).min()))


def _way(clause: Clause, track: Track) -> float | None:
    """Forward, backwards or to a side, seen from the heading at each time; anywhere where no direction is said."""
    if "goes" not in clause.traits or "in place" in clause.cues or "to and fro" in clause.traits:
        return None
    ahead, aside = (track.velocity.mean(axis=0) * len(track) / track.fps).tolist()
    side = _side(clause, "go")
    if "backwards" in clause.cues:
        return None if "forward" in clause.cues else -ahead / _WALK
    if side:
        return side * aside / _STEP if "aside" in clause.traits and "winding" not in clause.traits else None
    if "forward" in clause.cues:
        return min(ahead / _WALK, _stays(track) if clause.locomotion in _ON_FOOT and clause.count is None else 1)
    on_foot = clause.locomotion in _ON_FOOT and "halts" not in clause.traits
    return _stays(track) if on_foot else None


def _stays(track: Track) -> float:
    """Twice the speed that a person exceeds most of the time, over that of slow walks, less 1."""
    speed = np.linalg.norm(track.velocity, axis=1)
    return float(min(2 * speed.mean(), 2.5 * np.quantile(speed, _STANDS)) / _PACE - 1)


def _posture(clause: Clause, track: Track) -> float | None:
    """A person who sits down stands before and is low after; a person who gets up is low before and stands after."""
    edge = track.frames(0.3)
    first, last = float(np.median(track.height[:edge])), float(np.median(track.height[-edge:]))
    if "gets up" in clause.traits:
        return (last - first) / _SEAT
    if "sits" not in clause.traits:
        return None
    low = min((-last - _SEAT) / _CLEAR, 1.0)
    return min(low, (first + _SEAT) / _CLEAR) if "sits down" in clause.traits else low


_CLAIMS: tuple[Callable[[Clause, Track], float | None], ...] = (_arm, _leg, _turn, _way, _posture)
