"""What a prompt may be: a sentence, or several in a row with their seconds."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Sequence

from bunraku.core.request import WHOLE
from bunraku.errors import OptionError

PROMPT_LIMIT = 1000
_NAMED = re.compile(r"\s*(?P<name>[^=;:]{1,60}?)\s*=\s*(?P<prompt>.+)", re.DOTALL)
_BEFORE = " \t\"'“”„«»‘’`:;,.-*"
_AFTER = ' "“”„«»`:;,.'
"""Signs around a sentence that is quoted or copied out of a list; an apostrophe at its end is a word's own."""


def split_name(prompt: str) -> tuple[str, str]:
    """The name that stands before a prompt, "" where none does, and the prompt: "Walk = walks forward"."""
    match = _NAMED.fullmatch(prompt)
    return (match["name"], match["prompt"]) if match else ("", prompt)


def narrow(text: str) -> str:
    """Full-width letters, digits and signs as plain ones, each in its place (NFKC of those that stay one letter)."""
    if text.isascii():
        return text
    return "".join(plain if len(plain := unicodedata.normalize("NFKC", letter)) == 1 else letter for letter in text)


def plain_words(text: str) -> str:
    """A sentence or the name of a clip with a space between all words: "Walk_BackL45" is "Walk Back L 45"."""
    out: list[str] = []
    for at, letter in enumerate(text):
        before, after = text[at - 1 : at], text[at + 1 : at + 2]
        joined = (
            (letter.isupper() and (before.islower() or (before.isupper() and after.islower())))
            or (letter.isdigit() and before.isalpha())
            or (letter.isalpha() and before.isdigit())
        )  # fmt: skip
        out.append(" " + letter if joined else " " if letter in "_-|/\\@()[]" else letter)
    return " ".join("".join(out).split())


def check_prompt(prompt: str) -> str:
    """The prompt with plain single spaces and no quotes, stops or commas around it, as the training captions are.

    Raises:
        OptionError: It is empty, has no letters or digits, or is longer than 1,000 characters.
    """
    if not isinstance(prompt, str):
        raise OptionError("the prompt must be a sentence")
    if len(prompt) > PROMPT_LIMIT:
        raise OptionError(f"the prompt has {len(prompt):,} characters; say it in at most {PROMPT_LIMIT:,}")
    if not prompt.isprintable():
        prompt = "".join(" " if unicodedata.category(letter)[0] in "CZ" else letter for letter in prompt)
    plain = " ".join(prompt.split())
    if not plain:
        raise OptionError("the prompt is empty; say what the character should do, for example 'a person walks forward'")
    plain = plain.lstrip(_BEFORE).rstrip(_AFTER) or plain
    if not any(letter.isalnum() for letter in plain):
        raise OptionError(
            "the prompt has no words; say what the character should do, for example 'a person walks forward'"
        )
    return plain


SHORTEST, LONGEST = WHOLE.low, WHOLE.high
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
    parts: list[tuple[str, float | None]] = []
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
        parts.append((prompt, seconds))
    _check_total([seconds for _, seconds in parts if seconds is not None])
    return parts


def _number(text: str) -> float | None:
    """The seconds that a text gives, "nan" and "inf" among them; None if it is not a number."""
    try:
        return float(text.strip().rstrip("sS"))
    except ValueError:
        return None


def timed_sequence(
    parts: Sequence[tuple[str, float | None]], seconds: float | None
) -> list[tuple[str, float | None]]:  # fmt: skip
    """The prompts with a duration each; those without one share `seconds` evenly, or stay without where it is None.

    Args:
        parts: What `parse_sequence` found.
        seconds: Length [s] that the parts without one have together.

    Raises:
        OptionError: A part's share is less than half a second, or all parts last longer than a clip may.
    """
    if seconds is None:
        return list(parts)
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
    lengths = [seconds / open_parts if length is None else length for _, length in parts]
    _check_total(lengths)
    return [(prompt, length) for (prompt, _), length in zip(parts, lengths, strict=True)]


def _check_total(lengths: Sequence[float]) -> None:
    total = sum(lengths)
    if total > LONGEST + 1e-9:
        raise OptionError(
            f"the parts of the sequence last {total:g} seconds in all but a clip lasts at most {LONGEST:g}; shorten "
            "some"
        )
