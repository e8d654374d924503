"""Several clips of one character: their names, and which of them are loops."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from bunraku.pipelines.requests.constraints import Constraints, Loop
from bunraku.pipelines.requests.request import Request

if TYPE_CHECKING:
    from bunraku.language.sentence import Sentence

__all__ = ["clip_names", "is_cycle", "with_loops"]

LONGEST = 60
"""Letters of a clip's name."""


def clip_names(prompts: Iterable[str]) -> dict[str, str]:
    """Prompts by the names of their clips: those that stand before them, or their words, "walks forward" as
    walks-forward; one that is there already gets a number.
    """
    from bunraku.formats.gltf.carry_clips import free_name
    from bunraku.language.prompts import split_name

    out: dict[str, str] = {}
    for prompt in prompts:
        name, said = split_name(prompt)
        words = "-".join(re.findall(r"\w+", said.split(";")[0].lower()))[:LONGEST].strip("-")
        out[free_name(name or words or "clip", out)] = said
    return out


def is_cycle(sentence: Sentence) -> bool:
    """Whether a sentence tells of one thing that goes on as it is, as walking does and jumping does not."""
    from bunraku.language.lexicon.reading import is_cyclic

    if sentence.loop:
        return True
    if len(sentence.clauses) != 1:
        return False
    (clause,) = sentence.clauses
    if clause.turn is not None and (clause.turn.side or math.isfinite(clause.turn.most)):
        return False
    return all(map(is_cyclic, clause.actions)) if clause.actions else bool(clause.locomotion)


def with_loops(requests: Mapping[str, Request]) -> dict[str, Request]:
    """Requests of which those are loops whose sentences are parsed, tell of a cycle, and meet nothing that a loop does
    not go with.
    """
    from bunraku.language.sentence import Sentence

    loops: dict[int, Constraints] = {}
    out = {}
    for name, request in requests.items():
        own = request.constraints
        free = not request.apparel.moves and all(one.kind == "in_place" for one in own)
        if free and isinstance(request.sentence, Sentence) and is_cycle(request.sentence):
            closed = loops.setdefault(id(own), Constraints((Loop(), *own)))
            request = replace(request, constraints=closed)
        out[name] = request
    return out
