"""Whether a motion does what its sentence plainly says: the side, how far round, the direction, the posture.

A ranker that compares meanings takes a punch with the wrong hand for nearly as good. What is counted here is plain to
see in the numbers, and nothing is said of the rest. All rules treat left and right alike.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.language.description.track import SIDES, Track
from bunraku.language.limbs.posing import Posing
from bunraku.language.sentence import Clause

__all__ = ["agreement"]

_LEVEL = 0.15  # m below the shoulder, from where on a hand is up
_RISES = 0.15  # m; a hand or foot that is so much higher than the other is the one that is meant
_FAST = 1.0  # m/s
_STEP = 0.3  # m
_WALK = 0.6  # m
_PACE = 0.3  # m/s, slower than any walk: who is not half as fast stays where he is
_ON_FOOT = ("walk", "run")
_STANDS = 0.3  # share of the time for which who goes may stand
_ARCS, _EVEN = 3, 0.6  # thirds of a circle, and the share of an even turn that each has at the least
_SLACK = np.radians(30)
_SEAT = 0.2  # m
_CLEAR = 0.1  # m


def agreement(clause: Clause, motion: HandleMotion) -> float | None:
    """How far what a clause plainly says is true of a motion of the reference body.

    Args:
        clause: Of one thing that is done.
        motion: That should do it.

    Returns:
        That of the claim that holds least, from -1, the contrary, to 1; None where nothing is claimed that could be
        seen.
    """
    if clause.limbs_meanwhile is not None:
        clause = clause.body
    if len(motion) < 8 or not (clause.told is None or isinstance(clause.told, Posing)):
        return None  # "to the left" is where a thing is put
    if "then" in clause.cues and len(clause.actions) != 1:
        return None  # of several things that follow each other, no one holds throughout
    track = Track.of(motion)
    found = [score for claim in _CLAIMS if (score := claim(clause, track)) is not None]
    return float(np.clip(min(found), -1, 1)) if found else None


def _side(clause: Clause, part: str) -> int:
    """1 where the left of this place is spoken of, -1 where the right is, 0 for neither or both."""
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


def _over(track: Track, one: str, other: str) -> np.ndarray:
    return track.points[one][:, 1] - track.points[other][:, 1]


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
    """The way round and how far; without a side, how far; and that who goes forward does not turn."""
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
    """Forward, backwards or to a side, seen from the heading at each time; where none is said, anywhere at all."""
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
    """Whether who goes does so for most of the time: twice the speed that he has in all but a part of it, over that of
    slow walks, less 1.
    """
    speed = np.linalg.norm(track.velocity, axis=1)
    return float(min(2 * speed.mean(), 2.5 * np.quantile(speed, _STANDS)) / _PACE - 1)


def _posture(clause: Clause, track: Track) -> float | None:
    """Who sits down stands before and is low after; who gets up is low before and stands after."""
    edge = track.frames(0.3)
    first, last = float(np.median(track.height[:edge])), float(np.median(track.height[-edge:]))
    if "gets up" in clause.traits:
        return (last - first) / _SEAT
    if "sits" not in clause.traits:
        return None
    low = min((-last - _SEAT) / _CLEAR, 1.0)
    return min(low, (first + _SEAT) / _CLEAR) if "sits down" in clause.traits else low


_CLAIMS: tuple[Callable[[Clause, Track], float | None], ...] = (_arm, _leg, _turn, _way, _posture)
