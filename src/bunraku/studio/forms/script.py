"""The script of a take: sentences in a row, and clips of the library among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bunraku.clips import clip as find_clip
from bunraku.core.request.limits import SECONDS
from bunraku.errors import OptionError

__all__ = ["MOST_PARTS", "MOST_WORDS", "Part", "read_script", "script_json", "sequence_of"]

MOST_PARTS = 20
MOST_WORDS = 1000


@dataclass(frozen=True)
class Part:
    """A sentence of a script, or a clip of the library.

    Args:
        text: What the character does.
        seconds: For how long.
        clip: The name of a clip, which is played as it is; "" where the sentence is generated.
    """

    text: str
    seconds: float = 4.0
    clip: str = ""

    def __post_init__(self) -> None:
        if len(self.text) > MOST_WORDS:
            raise OptionError(f"text has more than {MOST_WORDS} characters, {len(self.text):,}; say it in fewer")
        SECONDS.check(self.seconds)
        if self.clip:
            find_clip(self.clip)


def read_script(script: Sequence[Part]) -> tuple[Part, ...]:
    """The sentences of a script one by one: what was typed in a row, such as "walks:4; jumps:2", is several.

    Raises:
        OptionError: A sentence is empty, or all are too long.
    """
    from bunraku.language.prompts import parse_sequence, timed_sequence

    if not script or not all(part.clip or part.text.strip(" ;\n\t") for part in script):
        raise OptionError("type what the character does, such as: walks forward, then waves")
    if len(script) > MOST_PARTS:
        raise OptionError(f"script has more than {MOST_PARTS} entries")
    timed: list[Part] = []
    for part in script:
        if part.clip:
            timed.append(part)
            continue
        typed = parse_sequence(part.text.replace("\n", " ").strip())
        timed += [Part(text, seconds) for text, seconds in timed_sequence(typed, part.seconds)]
    if len(timed) > MOST_PARTS:
        raise OptionError(f"script has more than {MOST_PARTS} entries")
    if sum(part.seconds for part in timed) > SECONDS.high:
        raise OptionError(f"all sentences together last at most {SECONDS.high:g} seconds; shorten some")
    return tuple(timed)


def sequence_of(script: Sequence[Part]) -> str:
    """The sentences in a row, as a prompt says them."""
    return "; ".join(f"{part.text}:{part.seconds:g}" for part in script)


def script_json(script: Sequence[Part]) -> list[dict[str, object]]:
    """What a record keeps of a script."""
    return [
        {"text": part.text, "seconds": part.seconds, **({"clip": part.clip} if part.clip else {})} for part in script
    ]
