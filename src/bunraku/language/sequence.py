"""Several prompts in a row: "walks:4; jumps:2; waves:3"."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bunraku.core.request.limits import SECONDS
from bunraku.errors import OptionError

__all__ = ["LONGEST", "SHORTEST", "parse_sequence", "timed_sequence"]

SHORTEST, LONGEST = SECONDS.low, SECONDS.high
"""Seconds that a clip, and each of its parts, may last."""


def parse_sequence(text: str) -> list[tuple[str, float | None]]:
    """The prompts of a sequence with the seconds that each lasts, None where the text gives none.

    Semicolons part the prompts; a number after a prompt's last colon is its seconds. A colon before anything else is
    part of the prompt.

    Args:
        text: For example "walks:4; jumps:2; waves".

    Raises:
        OptionError: A prompt is empty, or a part, or all parts together, last too long or too short.
    """
    pieces = text.split(";")
    if len(pieces) > 1 and not pieces[-1].strip():
        pieces.pop()
    found: list[tuple[str, float | None]] = []
    for number, piece in enumerate(pieces, 1):
        prompt, colon, tail = piece.rpartition(":")
        seconds = _number(tail) if colon else None
        if seconds is None:
            prompt = piece
        prompt = prompt.strip()
        if not prompt and (len(pieces) > 1 or seconds is not None):
            raise OptionError(
                f"part {number} of the sequence has no prompt; write for example 'walks:4; jumps:2; waves:3'"
            )
        if seconds is not None and not SHORTEST <= seconds <= LONGEST:
            raise OptionError(
                f"'{prompt[:60]}' cannot last {seconds:g} seconds; a part lasts {SHORTEST:g} to {LONGEST:g}"
            )
        found.append((prompt, seconds))
    _check_total([seconds for _, seconds in found if seconds is not None])
    return found


def _number(text: str) -> float | None:
    """The seconds that a text gives, "nan" and "inf" among them; None where it is no number."""
    try:
        return float(text.strip().rstrip("sS"))
    except ValueError:
        return None


def timed_sequence(parts: Sequence[tuple[str, float | None]], seconds: float) -> list[tuple[str, float]]:
    """The prompts with a duration each; those without one share `seconds` evenly.

    Args:
        parts: What `parse_sequence` found.
        seconds: Length [s] that the parts without one have together.

    Raises:
        OptionError: A part's share is less than half a second, or all parts last more than 120 seconds.
    """
    open_parts = sum(length is None for _, length in parts)
    if open_parts and not (math.isfinite(seconds) and SHORTEST <= seconds <= LONGEST):
        raise OptionError(
            f"a clip lasts {SHORTEST:g} to {LONGEST:g} seconds, not {seconds:g}; choose a length in between"
        )
    if open_parts and seconds / open_parts < SHORTEST:
        raise OptionError(
            f"{open_parts} prompts cannot share {seconds:g} seconds, as each lasts {SHORTEST:g} at the least; "
            "allow more seconds or say how long each lasts ('walks:4; jumps:2')"
        )
    timed = [(prompt, seconds / open_parts if length is None else length) for prompt, length in parts]
    _check_total([length for _, length in timed])
    return timed


def _check_total(lengths: Sequence[float]) -> None:
    total = sum(lengths)
    if total > LONGEST + 1e-9:
        raise OptionError(
            f"the parts of the sequence last {total:g} seconds in all but a clip lasts at most {LONGEST:g}; shorten "
            "some"
        )
