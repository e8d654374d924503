"""How often a clause says that something is done, and what its words add to its actions."""

from __future__ import annotations

import functools
from collections.abc import Collection, Sequence

from bunraku.language.captions import caption_table
from bunraku.language.lexicon import lexicon, said_phrases, words_of
from bunraku.language.vocabulary import FUNCTION_WORDS, action_stems, caption_stems, stem, stems

MOST = 99
"""How often something is done at the most."""
_OBJECT = 3
"""Words after a verb that says where a part of the body is among which the part is."""


def count_of(text: str) -> int | None:
    """How often a text says that something is done: "twice", "three times", "two jumping jacks"; None where it says
    nothing of that.
    """
    words, numbers = words_of(text)[0], lexicon().numbers
    starts = set(said_phrases(text)["actions"].values())
    for at, word in enumerate(words):
        times = at + 1 < len(words) and words[at + 1] in ("time", "times")
        # figures without "times" are angles, hands and takes in names of clips; the network reads those that count
        count = numbers.get(word) or (int(word) if times and word.isdecimal() and len(word) <= 2 else 0)
        counts = times or word in lexicon().grammar["adverbs"] or (at and {at + 1, at + 2} & starts)
        if counts and 0 < count <= MOST:
            return count
    return None


@functools.cache
def body_stems() -> frozenset[str]:
    """Stems of words for parts of the body, but for those that are verbs: a spin is no spine."""
    named = [word for row in caption_table("words.json")["parts"] for word in row["en"].split("/")]
    words, verbs = [*named, *lexicon().grammar["body"]], lexicon().lemmas
    roots = zip(words, stems(words), strict=True)
    return frozenset([root for word, root in roots if root == word or root not in verbs])


@functools.lru_cache(maxsize=1024)
def _stems_of(texts: tuple[str, ...]) -> frozenset[str]:
    """Stems of all words of some sentences."""
    return frozenset(stems(word for text in texts for word in words_of(text)[0]))


@functools.lru_cache(maxsize=64)
def _own(action: str) -> frozenset[str]:
    """Stems of the words that say an action."""
    words: set[str] = set()
    for pattern in lexicon().phrases.of("actions", action):
        words.update(*filter(None, pattern.words))
    return frozenset(stems(words))


@functools.lru_cache(maxsize=64)
def _limbs(action: str) -> frozenset[str]:
    """Stems of the words for the limbs that a gesture moves, and for arms that do anything; how other actions hold them
    is a pose of its own.
    """
    row = lexicon().actions[action]
    moved = [part for part in ("arm", "leg", "head") if part in row.part and (row.gesture or part == "arm")]
    patterns = [pattern for part in moved for pattern in lexicon().posing.of("posing", f"part {part}")]
    return frozenset(stems(word for pattern in patterns for words in filter(None, pattern.words) for word in words))


def added_words(text: str, actions: Sequence[str]) -> tuple[str, ...]:
    """Words of a text that say a part of the body or a movement beyond its actions, as they stand there. "Arms" add
    nothing to a gesture of the arms.

    Args:
        text: In English.
        actions: What it says, in the lexicon's words.
    """
    own, limbs = (frozenset[str]().union(*map(find, actions)) for find in (_own, _limbs))
    if any(lexicon().actions[action].gesture for action in actions):
        own |= _own("idle")  # a gesture is made standing, said or not
    verbs = action_stems()
    found = []
    words = words_of(text)[0]
    for at, word in enumerate(words):
        root = stem(word)
        if word in lexicon().holding and body_stems().intersection(stems(words[at + 1 : at + 1 + _OBJECT])):
            continue
        if word in FUNCTION_WORDS or word.endswith("ly") or not word.isalpha():
            continue
        if (root in body_stems() and root not in limbs) or (root in verbs and root not in own):
            found.append(word)
    return tuple(dict.fromkeys(found))


def saying(text: str, actions: Sequence[str]) -> list[str]:
    """The words of a text that say its actions, in the lexicon's words."""
    own = frozenset[str]().union(*map(_own, actions))
    words = [word for word in words_of(text)[0] if word.isalpha() and word not in FUNCTION_WORDS]
    return [word for word in words if stem(word) in own]


def unseen_word(text: str, action: str) -> str:
    """The word that says an action in a text, where no watched caption has any that does; "" where one has.

    Args:
        text: In English.
        action: In the lexicon's words.
    """
    said = saying(text, (action,))
    named = _stems_of((action,))
    seen = any(stem(word) in named or stem(word) in caption_stems() for word in said)
    return "" if seen else next(iter(said), "")


def tells_all(added: Collection[str], texts: tuple[str, ...]) -> bool:
    """Whether all of the words that a clause adds are among those of some sentences."""
    return all(stem(word) in _stems_of(texts) for word in added)


def told(words: Collection[str], texts: tuple[str, ...]) -> int:
    """How many of some words one of some sentences has at the most."""
    return max([sum(stem(word) in _stems_of((text,)) for word in words) for text in texts], default=0)
