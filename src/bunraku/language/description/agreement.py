"""Whether a motion does what its sentence plainly says: the side, how far round, the direction, the posture.

A ranker that compares meanings takes a punch with the wrong hand for nearly as good. What is counted here is plain to
see in the numbers, and nothing is said of the rest. All rules treat left and right alike.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.language.cues import said_cues
from bunraku.language.description.track import SIDES, Track

__all__ = ["agreement", "asked_turn", "goes_straight", "starts_standing"]

_HITS = r"\b(punch\w*|jabs?|jabbing|hits?|hitting|throw\w*|toss\w*|push\w*|slap\w*|uppercuts?|hooks?)\b"
_ON_LEG = r"\b(stand\w*|hop\w*|balanc\w*|jump\w*) (\w+ )?on\b"
_LEG_UP = r"\b(kick\w*|lift\w*|rais\w+|swing\w*|stretch\w*)\b"
_ARM_UP = r"\b(rais\w+|lift\w*|wav\w+|salut\w+|greet\w*)\b"
_ARM_OUT = r"\b(point\w*|reach\w*|stretch\w*)\b"
_ASIDE = (
    r"\b(side ?-?step\w*|step\w*|shuffl\w*|slid\w+|strafe\w*|mov\w+|walk\w* sideways|hop\w*|jump\w*)"
    r"( \w+){0,3} (left|right)\b"
)
_GOES = r"\b(walk\w*|run\w*|jog\w*|march\w*|step\w*|mov\w+|sprint\w*|strid\w*|stroll\w*|shuffl\w*|sneak\w*)\b"
_GOES_ON = r"\b(walk|run|jog|march|strid|stroll|sneak|go)\w* (straight )?(on(?! the| a)|along|ahead)\b"
_WINDING = r"\b(turn\w*|spin\w*|circl\w*|curv\w*|around|round|danc\w*|zigzag\w*|corner|loop|eight|twirl\w*|arc|back)\b"
_CIRCLE = r"\b(circles?|circling|spin\w*|twirl\w*|pirouett\w*|several|twice|two|double|times)\b"
_LEVEL = 0.15  # m below the shoulder, from where on a hand is up
_RISES = 0.15  # m; a hand or foot that is so much higher than the other is the one that is meant
_FAST = 1.0  # m/s
_STEP = 0.3  # m
_WALK = 0.6  # m
_SLACK = np.radians(30)
_GETS_UP = r"\b(stand\w*|get\w*|rises?) up (from|again)|^(\w+ ){0,3}(stand|get)s? up$"
_GOES_DOWN = (
    r"\b(sits?|lies?|lays?|kneels?|gets?|crouch(es)?|squats?|sitting|lying|kneeling) down\b|\btak\w+ a seat\b"
    r"|\bsits? (on|in) (a|the) \w+$"
)
_SITS_DOWN = r"\bsits? down\b|\btak\w+ a seat\b"
_SITS = r"\bsits?\b|\bsitting (down|on)\b|\btak\w+ a seat\b"
_SEAT = 0.2  # m
_CLEAR = 0.1  # m


@functools.cache
def _pattern(text: str) -> re.Pattern[str]:
    return re.compile(text)


def agreement(sentence: str, motion: HandleMotion) -> float | None:
    """How far what a sentence plainly says is true of a motion of the reference body.

    Args:
        sentence: In English, of one thing that is done.
        motion: That should do it.

    Returns:
        That of the claim that holds least, from -1, the contrary, to 1; None where nothing is claimed that could be
        seen.
    """
    if len(motion) < 8:
        return None
    text = sentence.lower()
    said = said_cues(sentence)
    if "then" in said:
        return None  # of several things that follow each other, no one holds throughout
    track = Track.of(motion)
    found = [score for claim in _CLAIMS if (score := claim(text, said, track)) is not None]
    return float(np.clip(min(found), -1, 1)) if found else None


def goes_straight(sentence: str) -> bool:
    """Whether somebody is said to go forward or on, and nothing of a turn, a curve or a side."""
    said = said_cues(sentence)
    sided = {"left turn", "right turn", "left go", "right go"} & said
    text = sentence.lower()
    ahead = "forward" in said or _pattern(_GOES_ON).search(text) is not None
    return ahead and not sided and not _pattern(_WINDING).search(text)


def starts_standing(sentence: str) -> bool:
    """Whether somebody goes down who must have stood before: sits, lies or kneels down, takes a seat."""
    return bool(_pattern(_GOES_DOWN).search(sentence.lower()))


def _side(said: frozenset[str], place: str) -> int:
    """1 where the left of this place is spoken of, -1 where the right is, 0 for neither or both."""
    return int(f"left {place}" in said) - int(f"right {place}" in said)


def _arm(text: str, said: frozenset[str], track: Track) -> float | None:
    side = _side(said, "arm")
    if not side or "lower" in text:
        return None
    if _pattern(_HITS).search(text):
        own, other = (float(np.diff(track.relative(f"{name}_wrist")[:, 2]).max()) * track.fps for name in SIDES[::side])
        return min((own - other) / _FAST, (own - _FAST) / _FAST)
    own, other = (np.quantile(_over(track, f"{name}_wrist", f"{name}_shoulder"), 0.9) for name in SIDES[::side])
    if _pattern(_ARM_UP).search(text):
        return float(min(own + _LEVEL, -_LEVEL - other) / _RISES)  # one hand is up and the other is not
    return float(own - other) / _RISES if _pattern(_ARM_OUT).search(text) else None


def _over(track: Track, one: str, other: str) -> np.ndarray:
    return track.points[one][:, 1] - track.points[other][:, 1]


def _leg(text: str, said: frozenset[str], track: Track) -> float | None:
    side = _side(said, "leg")
    if not side:
        return None
    stands = bool(_pattern(_ON_LEG).search(text))
    if not stands and not _pattern(_LEG_UP).search(text):
        return None
    rises = _over(track, "left_ankle", "right_ankle")
    higher = float(rises.max() + rises.min())
    return (-side if stands else side) * higher / _RISES


def asked_turn(sentence: str) -> tuple[int, float, float] | None:
    """How far a sentence says that somebody turns: 1 to the left, -1 to the right or 0 for either, the least and the
    most [rad]; None where it says nothing of the kind, or both sides.
    """
    text = sentence.lower()
    said = said_cues(sentence)
    side = _side(said, "turn")
    if "left turn" in said and "right turn" in said:
        return None
    if not side and not ("turn" in text and {"half", "full", "quarter"} & said):
        return None
    least, most = np.radians([50.0, 130.0])
    if _pattern(_CIRCLE).search(text):
        least, most = np.radians(250.0), np.inf
    elif "full" in said:
        least, most = np.radians([290.0, 430.0])
    elif "half" in said:
        least, most = np.radians([145.0, 215.0])
    return side, float(least), float(most)


def _turn(text: str, said: frozenset[str], track: Track) -> float | None:
    """The way round and how far; without a side, how far; and that who goes forward does not turn."""
    angle = float(track.angle[-1] - track.angle[0])
    asked = asked_turn(text)
    if asked is None:
        return 1 - max(abs(angle) - _SLACK, 0) / _SLACK if goes_straight(text) else None
    side, least, most = asked
    turned = side * angle if side else abs(angle)
    return 1 - max(least - turned, turned - most, 0) / np.radians(45)


def _way(text: str, said: frozenset[str], track: Track) -> float | None:
    """Forward, backwards or to a side, seen from the heading at each time."""
    if not _pattern(_GOES).search(text) or "in place" in said or "forth" in text:
        return None
    ahead, aside = (track.velocity.mean(axis=0) * len(track) / track.fps).tolist()
    side = _side(said, "go")
    if "backwards" in said:
        return None if "forward" in said else -ahead / _WALK
    if side:
        return side * aside / _STEP if _pattern(_ASIDE).search(text) and not _pattern(_WINDING).search(text) else None
    return ahead / _WALK if "forward" in said else None


def _posture(text: str, said: frozenset[str], track: Track) -> float | None:
    """Who sits down stands before and is low after; who gets up is low before and stands after."""
    edge = track.frames(0.3)
    first, last = float(np.median(track.height[:edge])), float(np.median(track.height[-edge:]))
    if _pattern(_GETS_UP).search(text):
        return (last - first) / _SEAT
    if not _pattern(_SITS).search(text):
        return None
    low = min((-last - _SEAT) / _CLEAR, 1.0)
    return min(low, (first + _SEAT) / _CLEAR) if _pattern(_SITS_DOWN).search(text) else low


_CLAIMS: tuple[Callable[[str, frozenset[str], Track], float | None], ...] = (_arm, _leg, _turn, _way, _posture)
