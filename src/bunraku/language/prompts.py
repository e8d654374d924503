"""What a prompt may be."""

from __future__ import annotations

import unicodedata

from bunraku.errors import OptionError

__all__ = ["check_prompt", "narrow"]

PROMPT_LIMIT = 1000


def narrow(text: str) -> str:
    """Full-width letters, digits and signs as plain ones, each in its place (NFKC of those that stay one letter)."""
    if text.isascii():
        return text
    return "".join(plain if len(plain := unicodedata.normalize("NFKC", letter)) == 1 else letter for letter in text)


def check_prompt(prompt: str) -> str:
    """The prompt with plain single spaces and no full stop, as the training captions are.

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
    plain = plain.rstrip(" .") or plain
    if not any(letter.isalnum() for letter in plain):
        raise OptionError(
            "the prompt has no words; say what the character should do, for example 'a person walks forward'"
        )
    return plain
