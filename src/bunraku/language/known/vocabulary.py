"""Words of the training sentences: what the network can have learned the meaning of.

They are those of the captions and their tables, and of `vocabulary.json`: the words that two or more of the watched
captions share, which `tools/build_vocabulary.py` writes; and words of clips of one's own (`own_words`), each of which
says a movement. Words are compared by their stems, so "waved" is known where "waves" is.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterable
from importlib import resources
from typing import Any, NamedTuple

from bunraku.language.captions.phrases import creature_words, known_phrases
from bunraku.language.foreign.table import table
from bunraku.language.known.own_words import own_words
from bunraku.language.lexicon.reading import actions_of
from bunraku.language.lexicon.tables import lexicon

__all__ = [
    "FUNCTION_WORDS",
    "Word",
    "action_stems",
    "caption_stems",
    "is_known",
    "known_words",
    "says_action",
    "stem",
    "stems",
    "words_of",
]

_WORD = re.compile(r"[^\W_]+(?:['’-][^\W_]+)*")
_IRREGULAR = {
    "ran": "run", "sat": "sit", "stood": "stand", "fell": "fall", "fallen": "fall", "went": "go", "gone": "go",
    "threw": "throw", "thrown": "throw", "caught": "catch", "swam": "swim", "flew": "fly", "flown": "fly",
    "shook": "shake", "shaken": "shake", "bent": "bend", "swung": "swing", "held": "hold", "hung": "hang",
    "knelt": "kneel", "crept": "creep", "leapt": "leap", "spun": "spin", "slid": "slide", "strode": "stride",
    "rose": "rise", "risen": "rise", "ate": "eat", "eaten": "eat", "drank": "drink", "drunk": "drink", "sang": "sing",
    "fought": "fight", "hid": "hide", "hidden": "hide", "lain": "lie", "lying": "lie", "dying": "die", "took": "take",
    "taken": "take", "came": "come", "got": "get", "gave": "give", "made": "make", "did": "do", "done": "do",
    "struck": "strike", "stuck": "stick", "swept": "sweep", "slept": "sleep", "drove": "drive", "rode": "ride",
    "bit": "bite", "dug": "dig", "shot": "shoot", "stole": "steal", "drew": "draw", "blew": "blow", "woke": "wake",
    "feet": "foot", "men": "man", "women": "woman", "children": "child", "knives": "knife", "teeth": "tooth",
    "mice": "mouse", "wolves": "wolf", "has": "have", "does": "do", "goes": "go", "is": "be", "are": "be", "was": "be",
    "were": "be", "been": "be", "being": "be", "am": "be",
}  # fmt: skip
_FUNCTION = (
    "a an the this that these those one ones some any each every all both other another own his her its their my your "
    "our he she it they him them i you we me us himself herself itself themselves myself someone somebody who which "
    "something anything nothing everything thing things and or but nor so then than as if while when whilst until "
    "before after because since though of to in on at by for from with without into onto off out over under up down "
    "around round about across along through between behind beside near toward towards against again also too very "
    "really quite rather just only even still almost nearly more most less least much many few several little lot lots "
    "be do have can could will would shall should may might must not no yes don't doesn't let lets please there here "
    "now once twice first second third last next finally afterwards later soon same such like how what where why "
    "person people man woman guy girl boy lady character figure human child kid creature animal "
    "two three four five six seven eight nine ten half"
)
FUNCTION_WORDS = frozenset(_FUNCTION.split())
"""Words that say nothing of a movement; they are in every language model, and no reason for a warning."""
_THINGS = (
    "goodbye searching everybody cups plate apple camera orchestra book page pot wrapped waking noise biceps club meal "
    "soldier boxer jabs cross hook overarm stone fastball baseball racket serve pitcher press fours puddle obstacle "
    "log abs freestyle newspaper soup spoon undead hair combs"
)
"""Other words of sentences that tell gestures."""
_LIGHT = (
    "be do have make let start begin continue keep try act take give get use perform show want need seem become cause "
    "help say tell know feel set can will would may must please remain mean call change find add list own note light "
    "present end finish handle repeat strain"
)
"""Verbs that say no movement by themselves: "does a blorp"."""


class Word(NamedTuple):
    """A word of a sentence: as it stands there, from where to where, and whether training had it."""

    text: str
    start: int
    stop: int
    known: bool


@functools.lru_cache(maxsize=16384)
def stem(word: str) -> str:
    """What an English word has in common with its inflections: "waving", "waves" and "waved" are "wav"."""
    return stems((word,))[0]


def stems(words: Iterable[str]) -> list[str]:
    """The stem of each of some words."""
    found = []
    for word in words:
        word = word.lower().replace("’", "'").removesuffix("'s").rstrip("'")
        word = _IRREGULAR.get(word, word)
        if word.endswith("ly") and len(word) > 4:
            word = word[:-2]
        for ending, least in (("ies", 2), ("ied", 2), ("es", 3), ("s", 3), ("ing", 3), ("ed", 3)):
            if word.endswith(ending) and len(word) - len(ending) >= least and not word.endswith("ss"):
                word = word[: -len(ending)] + ("y" if ending in ("ies", "ied") else "")
                break
        if len(word) > 2 and word[-1] == "e":
            word = word[:-1]
        if len(word) > 2 and word[-1] == word[-2] and word[-1] not in "aeiou":
            word = word[:-1]
        found.append(word[:-1] + "i" if len(word) > 2 and word[-1] == "y" else word)
    return found


@functools.cache
def _written() -> dict[str, Any]:
    text = resources.files("bunraku.language").joinpath("vocabulary.json").read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


@functools.cache
def known_words() -> dict[str, int]:
    """The words as they are written, with how many sentences have each; 1 for those of the tables. Names of characters
    and of parts of the body are among them, whatever the captions say of them.
    """
    written: dict[str, int] = _written()["words"]
    named = [row["en"].replace("/", " ") for section in ("beings", "parts") for row in table()[section]]
    lexical = (*lexicon().words, *lexicon().verbs, _THINGS)
    listed = " ".join((*known_phrases(), *creature_words(), *named, *lexical))
    return (
        dict.fromkeys(own_words(), 1)
        | dict.fromkeys(re.findall(r"[a-z]+", listed.lower()), 1)
        | dict.fromkeys(FUNCTION_WORDS, 1)
        | written
    )


@functools.cache
def _stems() -> frozenset[str]:
    return frozenset(stems(known_words()))


@functools.cache
def caption_stems() -> frozenset[str]:
    """Stems of the words that watched captions share."""
    return frozenset(stems(_written()["words"]))


@functools.cache
def action_stems() -> frozenset[str]:
    """Stems of the verbs that training shows, without those that say no movement by themselves, and without those that
    are a part of the body, too.
    """
    verbs = {*lexicon().verbs, *_written()["verbs"], *own_words()}
    parts = [name for row in table()["parts"] for name in row["en"].split("/")]
    return (frozenset(stems(verbs)) & _stems()) - frozenset(stems([*parts, *_LIGHT.split()]))


def is_known(word: str) -> bool:
    """Whether training had a word, in any inflection; of one with hyphens whether it had all parts."""
    if (plain := word.lower()) in FUNCTION_WORDS or plain in lexicon().lemmas or plain in lexicon().words:
        return True
    if plain in _written()["words"]:
        return True
    known = _stems()
    if stem(word) in known or word.isdigit() or word.lower() in FUNCTION_WORDS:
        return True
    parts = re.split(r"[-'’]", word)
    return len(parts) > 1 and all(not part or part.isdigit() or stem(part) in known or len(part) < 2 for part in parts)


def words_of(sentence: str) -> list[Word]:
    """The words of a sentence with their places."""
    return [Word(found.group(), *found.span(), is_known(found.group())) for found in _WORD.finditer(sentence)]


def says_action(sentence: str) -> bool:
    """Whether any word of a sentence is a movement that training shows."""
    if actions_of(sentence):
        return True
    acting = action_stems()
    return any(
        stem(part) in acting
        for word in _WORD.findall(sentence)
        for part in (word, *re.split(r"[-'’]", word))
        if part.lower() not in FUNCTION_WORDS
    )
