"""Where clips come from, by how their names begin: weight, credit and licence, from `sources.json`.

How often a source is drawn, whom its clips show and what its takes begin with are facts of the data, so they stand in
the data. The credits of model cards are made from the same table.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources

__all__ = ["Source", "credit_lines", "source_of", "subject_of"]

_CUT = "turn_"
"""How the names of clips begin that were cut out of others (`turns`)."""


@dataclass(frozen=True)
class Source:
    """One source of clips.

    Args:
        prefixes: How the names of its clips begin.
        credit: Whom to name.
        licence: On which terms.
        weight: How often its clips are drawn, 1 for most; less where a toy's or a robot's proportions make feet slide,
            or where there is much of the same.
        subject_parts: Parts of a name, between underscores, that tell the captured subject; None for two parts without
            the number at their end.
        holds_ends: Its takes begin and end in a pose that is held, which is no part of what their captions say.
    """

    prefixes: tuple[str, ...]
    credit: str
    licence: str
    weight: float = 1.0
    subject_parts: int | None = None
    holds_ends: bool = False

    @property
    def credit_line(self) -> str:
        """A line of a model card's credits."""
        return f"{self.credit}. Licence: {self.licence}."


@functools.cache
def _table() -> tuple[Source, ...]:
    text = resources.files("bunraku_lab.datasets.motions").joinpath("sources.json").read_text(encoding="utf-8")
    return tuple(Source(**{**entry, "prefixes": tuple(entry["prefixes"])}) for entry in json.loads(text)["sources"])


def source_of(name: str) -> Source | None:
    """The source of a clip, that of the longest prefix; None where the table does not know it."""
    found = [
        (len(prefix), source)
        for source in _table()
        for prefix in source.prefixes
        if name.removeprefix(_CUT).startswith(prefix)
    ]
    return max(found, key=lambda pair: pair[0])[1] if found else None


def subject_of(name: str) -> str:
    """The captured subject of a clip, as its name tells: `cmu_16_11` -> `cmu_16`, `accad_m1_Walk2` -> `accad_m1`,
    `snu_WalkSad05` -> `snu_WalkSad`.
    """
    source = source_of(name)
    if source is not None and source.subject_parts is not None:
        return "_".join(name.split("_")[: source.subject_parts])
    return "_".join(name.split("_")[:2]).rstrip("0123456789")


def credit_lines(names: Iterable[str]) -> list[str]:
    """Whom to name for these clips, each source once, in the order of the table."""
    used = {source for source in map(source_of, names) if source is not None}
    return list(dict.fromkeys(source.credit_line for source in _table() if source in used))
