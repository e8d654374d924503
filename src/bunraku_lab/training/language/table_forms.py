"""The forms of the table of words as sentences, so that the tagger knows what their relatives mean: 突き上げる has
上げる in it, "herumspringt" has "springt".
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator

from bunraku.language.foreign.sentence import english_sentence
from bunraku.language.foreign.table import LANGUAGES, Concept, forms
from bunraku.language.lexicon.reading import actions_of
from bunraku_lab.training.language.pairs import Pair

__all__ = ["table_pairs"]

_SAID_OF = {"de": "eine Person {}", "fr": "une personne {}", "es": "una persona {}", "ja": "人が{}", "zh": "一个人{}"}
_ENDINGS = {"de": ("t", "en", "te"), "fr": ("e", "ent", "er", "ant"), "es": ("a", "an", "ar", "ando")}
_SURU = "し", "する", "して"
_GODAN = {
    "く": ("いて", "き"), "ぐ": ("いで", "ぎ"), "す": ("して", "し"), "つ": ("って", "ち"), "ぬ": ("んで", "に"),
    "ぶ": ("んで", "び"), "む": ("んで", "み"), "る": ("って", "り"), "う": ("って", "い"),
}  # fmt: skip
"""Ends of a verb with て, and before ます."""


@functools.cache
def table_pairs() -> tuple[Pair, ...]:
    """A sentence for each form of each verb that says one action."""
    found = []
    for language in LANGUAGES:
        for form, kind, english, _ in forms(language):
            if kind != "verb":
                continue
            caption = english_sentence([Concept("verb", english, 0, 1)], language)
            actions = actions_of(caption)
            if len(actions) == 1:
                found += [
                    Pair(caption, _SAID_OF[language].format(said), language, actions)
                    for said in dict.fromkeys(_written(form, language))
                ]  # fmt: skip
    return tuple(found)


def _written(form: str, language: str) -> Iterator[str]:
    """A form of the table as sentences have it."""
    if language == "zh":
        yield form
    elif language == "ja":
        yield from _japanese(form)
    else:
        *others, head = form.split("&")
        *particles, head = head.split("+")
        beside = " ".join(word.rstrip("~") for word in others)
        for ending in _ENDINGS[language] if "~" in head else ("",):
            said = re.sub("~", ending, head)
            for whole in (f"{said} {particles[0]}", particles[0] + said) if particles else (said,):
                yield f"{beside} {whole}".strip()


def _japanese(form: str) -> Iterator[str]:
    if form.endswith("+"):
        yield from (form[:-1] + end for end in _SURU)
    elif "・" in form:
        yield from (form.replace("・る", end) for end in ("る", "て", ""))
    else:
        yield form
        yield from (form[:-1] + end for end in _GODAN.get(form[-1], ()))
