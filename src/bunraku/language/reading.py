"""What a clause says besides its actions, in named traits, and what follows from them: how far it turns, whether it
goes straight.
"""

from __future__ import annotations

import functools
import math
import re

from bunraku.language.actions import actions_of
from bunraku.language.cues import said_cues
from bunraku.language.sentence import Turn
from bunraku.language.ways import way_of as locomotion_of

__all__ = ["TRAITS", "actions_of", "goes_straight", "locomotion_of", "said_cues", "said_traits", "said_turn"]

TRAITS: dict[str, str] = {
    "hits": r"\b(punch\w*|jabs?|jabbing|hits?|hitting|throw\w*|toss\w*|push\w*|slap\w*|uppercuts?|hooks?)\b",
    "on a leg": r"\b(stand\w*|hop\w*|balanc\w*|jump\w*) (\w+ )?on\b",
    "leg up": r"\b(kick\w*|lift\w*|rais\w+|swing\w*|stretch\w*)\b",
    "arm up": r"\b(rais\w+|lift\w*|wav\w+|salut\w+|greet\w*)\b",
    "arm out": r"\b(point\w*|reach\w*|stretch\w*)\b",
    "lowers": r"lower",
    "aside": (
        r"\b(side ?-?step\w*|step\w*|shuffl\w*|slid\w+|strafe\w*|mov\w+|walk\w* sideways|hop\w*|jump\w*)"
        r"( \w+){0,3} (left|right)\b"
    ),
    "goes": r"\b(walk\w*|run\w*|jog\w*|march\w*|step\w*|mov\w+|sprint\w*|strid\w*|stroll\w*|shuffl\w*|sneak\w*)\b",
    "goes on": r"\b(walk|run|jog|march|strid|stroll|sneak|go)\w* (straight )?(on(?! the| a)|along|ahead)\b",
    "winding": (
        r"\b(turn\w*|spin\w*|circl\w*|curv\w*|around|round|danc\w*|zigzag\w*|corner|loop|eight|twirl\w*|arc|back)\b"
    ),
    "all round": r"\b(circles?|circling|spin\w*|twirl\w*|pirouett\w*|several|twice|two|double|times)\b",
    "turn": r"turn",
    "to and fro": r"forth",
    "gets up": r"\b(stand\w*|get\w*|rises?) up (from|again)|^(\w+ ){0,3}(stand|get)s? up$",
    "goes down": (
        r"\b(sits?|lies?|lays?|kneels?|gets?|crouch(es)?|squats?|sitting|lying|kneeling) down\b|\btak\w+ a seat\b"
        r"|\bsits? (on|in) (a|the) \w+$"
    ),
    "sits down": r"\bsits? down\b|\btak\w+ a seat\b",
    "sits": r"\bsits?\b|\bsitting (down|on)\b|\btak\w+ a seat\b",
    "backward": r"backward",
    "chair": r"\b(chair|stool|bench|seat|sofa|couch|armchair)\b",
    "floor": r"\b(floor|ground|knees|l(ies|ying))\b",
    "both": r"\b(both|two|arms|hands)\b",
    "one foot": r"\b(one|left|right) (foot|leg)\b",
    "halts": r"\b(halt\w*|stop\w*|pauses?|waits?|restart\w*)\b",
    "sets off": r"\b(walk\w*|stands?|starts?|(takes?|sets?) off|speed\w* up|accelerat\w*|slow\w*)\b",
    "down": r"\b(down|descend\w*|drop\w*|hang\w*|lets? go)\b",
    "stairs": r"\b(stairs?|staircase|stairway|upstairs|downstairs)\b",
    "off the ground": (
        r"\b(?:float|levitat|glid|climb|hang|swing|swung|dangl|ladder|stair|rope|pole|upstairs|uphill|downhill|pull-?up"
        r"|chin-?up|handstand|headstand|cartwheel|upside|sit|sat|ride|riding|surf|skat|dive|diving|onto|bench|chair"
        r"|ledge|(?:air|sky|skis?|skiing|box)\b)"
    ),
    "leaps": r"\b(?:jump|leap|hop|skip|vault|hurdl|flip|bounc|bound)",
}  # fmt: skip
"""What is told, and the words that tell it."""


@functools.cache
def _pattern(text: str) -> re.Pattern[str]:
    return re.compile(text)


def said_traits(text: str) -> frozenset[str]:
    """The names of the traits that a text tells."""
    plain = text.lower()
    return frozenset(trait for trait, words in TRAITS.items() if _pattern(words).search(plain))


def goes_straight(cues: frozenset[str], traits: frozenset[str]) -> bool:
    """Whether somebody goes forward or on, with nothing of a turn, a curve or a side."""
    sided = {"left turn", "right turn", "left go", "right go"} & cues
    return ("forward" in cues or "goes on" in traits) and not sided and "winding" not in traits


def said_turn(cues: frozenset[str], traits: frozenset[str]) -> Turn | None:
    """How far somebody turns; None where nothing of the kind is said, or both sides are."""
    side = int("left turn" in cues) - int("right turn" in cues)
    if {"left turn", "right turn"} <= cues:
        return None
    if not side and not ("turn" in traits and {"half", "full", "quarter"} & cues):
        return None
    least, most = 50.0, 130.0
    if "all round" in traits:
        least, most = 250.0, math.inf
    elif "full" in cues:
        least, most = 290.0, 430.0
    elif "half" in cues:
        least, most = 145.0, 215.0
    return Turn(side, math.radians(least), math.radians(most))
