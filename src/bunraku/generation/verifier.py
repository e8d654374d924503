"""The measures of a motion (path, heading, heights, feet, hands), and whether it does only what its clause says."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.geometry.curves import gaussian, running_least
from bunraku.core.geometry.rotations import heading, matrix_y
from bunraku.core.motion import HandleMotion
from bunraku.language.interactions import Terrain
from bunraku.language.lexicon import done_once, goes_ahead, lexicon, stays_down
from bunraku.language.posing import Posing
from bunraku.language.sentence import Clause

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
    gaze: np.ndarray  # where the head faces, in the root's frame, shape (N, 3)

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
            fps, position, height, turn[:, 1, 1], angle, local_drift[:, [2, 0]], course, points, feet - ground[:, None],
            motion.rotations[:, HANDLE_NAMES.index("head"), :, 2],
        )  # fmt: skip

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


# Chosen by eye with sentences of `bunraku evaluate motion --only viewer` in view, where nothing else is said.
_LEVEL = 0.15  # m below the shoulder, from where on a hand is up
_RISES = 0.15  # m; a hand or foot that is so much higher than the other is the one that is meant
_MORE, _STILL = 2, 0.1  # the named arm is twice as fast as the other for a full score; m/s, the least that counts
_STEP = 0.3  # m
_WALK = 0.6  # m
_PACE = 0.3  # m/s, slower than any walk: a person who is not half as fast stays
_ON_FOOT = ("walk", "run")
_STANDS = 0.3  # share of the time for which a person who goes may stand
_ARCS, _EVEN = 3, 0.6  # thirds of a circle, and the share of an even turn that each has at the least
_SLACK = np.radians(30)
_SEAT = 0.2  # m
_CLEAR = 0.1  # m
_TURN, _SWAY = np.radians(45), np.radians(90)
"""How far a body may turn that is not told to, from the first frame to the last and to and fro. Chosen on 144 takes: no
take then turned by more than 60 degrees, and the ranker's mean cosine fell by .01.
"""
BEGUN = 0.7  # s until a motion has begun; of the same 144 takes, 1 % then began later than a second
_LATE = 0.8  # s later, nothing of the claim is left; the same
_LIVELY = 0.4  # m/s, mean speed of the body's points in a slow walk, from which on any motion has begun
_GAZE = np.radians(12)  # least angle by which the head turns, or nods; chosen by eye
_DONE = 0.3  # m/s, of the fastest point in what is done once, slowly; chosen by eye
REST = 1.2  # s that a motion may rest at its end; people who watched takes called 1.5 s idle
_CALM = 0.2  # share of the highest speed below which a body rests
_FLAT = 0.3  # m over the ground, below which the ankles of a body are that lies flat
_STAYS = 0.6  # m that a person who only uses the arms or the head may go


@dataclass(frozen=True)
class Claim:
    """Something that a clause says about the numbers of a motion, or that follows from what it does not say.

    Args:
        name: Of what a note says that it was missed.
        holds: How far it holds: 1 where it does, 0 at its limit, negative where the contrary does; None where the
            clause claims nothing of the kind.
        of_one: It is about one action; of several that follow each other, no such claim holds throughout.
    """

    name: str
    holds: Callable[[Clause, Track], float | None]
    of_one: bool = True


@dataclass(frozen=True)
class Verdict:
    """The claim about a motion that holds least."""

    agreement: float  # how far it holds, -1 to 1
    missed: str  # its name


def verify(clause: Clause, motion: HandleMotion, described: bool = True) -> Verdict | None:
    """The claim of a clause that holds least of a motion of the reference body; None where it claims nothing.

    Args:
        clause: What is asked for.
        motion: What is done.
        described: Whether to look at limbs that the clause describes: not where an example already puts them there.
    """
    if len(motion) < 8:
        return None
    if clause.meanwhile is not None and clause.meanwhile.detail is not None:
        clause = clause.body
    track = Track.of(motion)
    # "to the left" is where a thing is put; and of several things in a row, none holds throughout
    plain = isinstance(clause.detail, Terrain | None) or (described and isinstance(clause.detail, Posing))
    plain = plain and not ("then" in clause.cues and len(clause.actions) != 1)
    scores = [
        (float(np.clip(score, -1, 1)), claim.name)
        for claim in CLAIMS
        if (plain or not claim.of_one) and (score := claim.holds(clause, track)) is not None
    ]
    return Verdict(*min(scores, key=lambda pair: pair[0])) if scores else None


def times_asked(clause: Clause) -> int | None:
    """How often a clause asks for what it says, and once for a turn by an angle; None where it says nothing of that."""
    return clause.count or (1 if clause.turn is not None and np.isfinite(clause.turn.most) else None)


def asks_to_turn(clause: Clause) -> bool:
    """Whether a clause speaks of a turn, or of something that people turn for: a dance, a roll, going around."""
    spoken = clause.turn is not None or not clause.traits.isdisjoint(("winding", "turns"))
    return spoken or _turns(clause.actions)


def _turns(actions: Iterable[str]) -> bool:
    """Whether in any of some actions people turn, or are upside down."""
    rows = lexicon().actions
    return any(action in rows and rows[action].turns for action in actions)


def activity(track: Track) -> tuple[int, int]:
    """The first frame in which a motion has begun, and the one after its last: the points' mean speed reaches half of
    its highest, or that of a slow walk.
    """
    speed = _speed(track)
    moving = np.flatnonzero(speed >= min(speed.max() / 2, _LIVELY))
    return int(moving[0]), int(moving[-1]) + 1


def onset(track: Track) -> float:
    """When a motion has begun [s]."""
    return activity(track)[0] / track.fps


def _speed(track: Track) -> np.ndarray:
    """Mean speed of the body's points, smooth [m/s], shape (N,)."""
    points = np.stack(list(track.points.values()), axis=1)
    speed = np.linalg.norm(np.gradient(points, axis=0), axis=-1).mean(axis=1) * track.fps
    return smooth(speed, 0.05, track.fps)


def _side(clause: Clause, part: str) -> int:
    """1 where the left of this part is meant, -1 where the right is, 0 for neither or both."""
    return int(f"left {part}" in clause.cues) - int(f"right {part}" in clause.cues)


def _arm(clause: Clause, track: Track) -> float | None:
    side = _side(clause, "arm")
    there = clause.traits & {"arm up", "arm out"}
    if not side or "lowers" in clause.traits or (clause.detail is not None and not there):
        return None
    if not there:
        velocities = [np.diff(track.relative(f"{name}_wrist"), axis=0) * track.fps for name in SIDES[::side]]
        own, other = (float(np.linalg.norm(velocity, axis=1).max()) for velocity in velocities)
        return _MORE * (own - other) / max(own, other, _STILL)
    own, other = (np.quantile(_over(track, f"{name}_wrist", f"{name}_shoulder"), 0.9) for name in SIDES[::side])
    if "arm up" in clause.traits:
        return float(min(own + _LEVEL, -_LEVEL - other) / _RISES)  # one hand is up and the other is not
    return float(own - other) / _RISES


def _over(track: Track, upper: str, lower: str) -> np.ndarray:
    return track.points[upper][:, 1] - track.points[lower][:, 1]


def _leg(clause: Clause, track: Track) -> float | None:
    side = _side(clause, "leg")
    if not side:
        return None
    stands = "on a leg" in clause.traits
    raised = "leg up" in clause.traits or any(lexicon().actions[name].limb == "leg" for name in clause.actions)
    if not (stands or raised):
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


def _no_turn(clause: Clause, track: Track) -> float | None:
    if asks_to_turn(clause):
        return None
    net, sway = abs(float(track.angle[-1] - track.angle[0])), float(np.ptp(track.angle))
    return 1 - max(net - _TURN, 0) / _TURN - max(sway - _SWAY, 0) / _SWAY


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
    in_place = bool(clause.actions) and not goes_ahead(clause.actions) and not _turns(clause.actions)
    return _stays(track) if on_foot and not in_place else None


def _stays(track: Track) -> float:
    """Twice the speed that a person exceeds most of the time, over that of slow walks, less 1."""
    speed = np.linalg.norm(track.velocity, axis=1)
    return float(min(2 * speed.mean(), 2.5 * np.quantile(speed, _STANDS)) / _PACE - 1)


def _still_feet(clause: Clause, turns: bool = False) -> bool:
    """Whether a clause speaks of the arms and the head alone, or where that is asked for of a turn alone."""
    rows = lexicon().actions
    known = [rows[action] for action in clause.actions if action in rows]
    still = [row.part in ("arms", "head", "arms and head") or (turns and row.alone) for row in known]
    return bool(known) and all(still) and not (clause.locomotion or "goes" in clause.traits or clause.moves)


def _no_travel(clause: Clause, track: Track) -> float | None:
    """A person who does something in place, turns, or moves the arms or the head alone, stays there."""
    if "in place" not in clause.cues and (not _still_feet(clause, True) or "winding" in clause.traits):
        return None
    return 1 - max(float(np.linalg.norm(track.position[-1] - track.position[0])) - _STAYS, 0) / _STAYS


def _ends(track: Track) -> tuple[float, float]:
    """Median height of the root over its rest height at the beginning and at the end [m]."""
    edge = track.frames(0.3)
    return float(np.median(track.height[:edge])), float(np.median(track.height[-edge:]))


def _posture(clause: Clause, track: Track) -> float | None:
    """A person who sits down stands before and is low after; a person who gets up is low before and stands after."""
    first, last = _ends(track)
    if "gets up" in clause.traits:
        return (last - first) / _SEAT
    if clause.stance is not None and clause.stance.name in ("seat", "chair"):
        return (-max(first, last) - _SEAT) / _CLEAR
    if "sits" not in clause.traits:
        return None
    low = min((-last - _SEAT) / _CLEAR, 1.0)
    return min(low, (first + _SEAT) / _CLEAR) if "sits down" in clause.traits else low


def _stays_down(clause: Clause, track: Track) -> float | None:
    """A person who lies down, falls or dies is down at the end, and then no shin is in the air."""
    if not clause.actions or not stays_down(clause.actions[-1]) or "gets up" in clause.traits or clause.moves:
        return None
    first, height = _ends(track)
    down = (-height - _SEAT) / _CLEAR
    if "goes down" in clause.traits and "sits" not in clause.traits:
        down = min(down, (first + _SEAT) / _CLEAR)
    last = lexicon().actions[clause.actions[-1]]
    if not {clause.actions[-1], last.like} & {"lie", "fall"}:
        return down
    end = slice(-track.frames(0.3), None)
    raised = max(float(np.median(track.points[f"{side}_ankle"][end, 1])) for side in SIDES) - _FLAT
    return min(down, 1 - max(raised, 0) / _FLAT)


def _same_posture(clause: Clause, track: Track) -> float | None:
    """A person who uses the arms or the head alone, or walks, neither sits down for it nor gets up."""
    if not (_still_feet(clause) or clause.locomotion in _ON_FOOT) or clause.stance is not None:
        return None
    first, last = _ends(track)
    return 1 - max(abs(last - first) - _SEAT, 0) / _SEAT


def _begins(clause: Clause, track: Track) -> float | None:
    if clause.actions == ("idle",):
        return None
    return 1 - max(onset(track) - BEGUN, 0) / _LATE


def _looks(clause: Clause, track: Track) -> float | None:
    """A person who does something with the head alone turns it, or nods."""
    rows = lexicon().actions
    if not clause.actions or any(rows[action].part != "head" for action in clause.actions if action in rows):
        return None
    x, y, z = track.gaze.T
    return float(max(np.ptp(np.arctan2(x, z)), np.ptp(np.arctan2(y, z)))) / _GAZE - 1


def _done(clause: Clause, track: Track) -> float | None:
    """A body does what is done once, and does not only stand ready for it."""
    if asks_to_turn(clause) or not done_once(clause.actions):
        return None
    points = np.stack(list(track.points.values()), axis=1)
    speed = np.linalg.norm(np.gradient(points, axis=0), axis=-1).max(axis=1) * track.fps
    return 2 * float(smooth(speed, 0.05, track.fps).max()) / _DONE - 1


def _fills(clause: Clause, track: Track) -> float | None:
    """The body does not rest for long at the end of what goes on, but after a change of posture and on the ground."""
    still = any(action == "idle" or stays_down(action) for action in clause.actions)
    if still or times_asked(clause) or not clause.traits.isdisjoint(("halts", "on a leg")):
        return None
    first, last = _ends(track)
    if last < -_SEAT or last - first > _SEAT:
        return None
    speed = _speed(track)
    rest = (len(speed) - 1 - np.flatnonzero(speed >= _CALM * speed.max())[-1]) / track.fps
    return 1 - max(float(rest) - REST, 0) / REST


CLAIMS = (
    Claim("the named arm", _arm),
    Claim("the named leg", _leg),
    Claim("the turn", _turn),
    Claim("facing one way", _no_turn, of_one=False),
    Claim("the direction", _way),
    Claim("staying in place", _no_travel, of_one=False),
    Claim("sitting or standing", _posture),
    Claim("staying down", _stays_down, of_one=False),
    Claim("keeping the posture", _same_posture, of_one=False),
    Claim("turning the head", _looks),
    Claim("doing it", _done, of_one=False),
    Claim("beginning at once", _begins, of_one=False),
    Claim("filling the time", _fills, of_one=False),
)
"""Everything that is verified, each claim by itself."""
