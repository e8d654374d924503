"""The table of words: movement verbs, parts, sides, directions, manners and numbers of five languages, in English.

`words.json` has a row for each meaning and in it the forms of each language, parted by commas:

* "geh~" is a stem that takes the endings of its language, "gerannt" a form as it is, "nach vorne" words in a row;
* "kopf&schüttel~" needs both words somewhere in the clause, "sich&" and "se&" a reflexive pronoun;
* "auf+steh~" is a separable verb: "steht auf", "aufstehen", "aufzustehen";
* Japanese verbs are in their dictionary form, with "・" after the stem where る alone is the ending ("投げ・る"), and
  with "+" where する follows ("ジャンプ+").

The English of a verb has its head in braces, and in angle brackets what it is done to unless the sentence says so:
"{raise} <the arms>".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bunraku.language.captions import caption_table

LANGUAGES = {"de": "German", "fr": "French", "es": "Spanish", "ja": "Japanese", "zh": "Chinese"}


@dataclass(frozen=True)
class Concept:
    """One word of the table in a sentence."""

    # "verb", "part", "side", "direction", "manner", "number", "unit", "time", "being", "noun", a connector ("then",
    # "and", "while", "before", "after", "first", "like"), "comma", "stop", "ignored" or "unknown"
    kind: str
    value: str  # in English, as the table has it; of "unknown" the word itself
    start: int  # of its first letter in the sentence
    stop: int  # after its last letter
    mark: str = ""  # how it is inflected, where that matters: "plural", "gerund", "infinitive", "te" or "plain"


def table() -> dict[str, list[dict[str, str]]]:
    """The rows of each section."""
    return caption_table("words.json")


def forms(language: str, fold: Callable[[str], str] = str) -> list[tuple[str, str, str, int]]:
    """Each form of a language with its kind, its English and its place among the forms of its row.

    Args:
        language: One of `LANGUAGES`.
        fold: What is done to the forms of a row.
    """
    return [
        (form, section.removesuffix("s"), row["en"], index)
        for section, rows in table().items()
        for row in rows
        for index, form in enumerate(fold(row.get(language, "")).split(", "))
        if form
    ]
