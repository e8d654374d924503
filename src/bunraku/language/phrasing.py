"""What the readers of a clause share: where its verbs stand, which hand or part of the body it names, how often it is
done, and what its words add.
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Mapping, Sequence

from bunraku.language.captions import caption_table
from bunraku.language.lexicon import actions_of, lexicon, said_phrases, words_of
from bunraku.language.vocabulary import FUNCTION_WORDS, action_stems, caption_stems, stem, stems


def verbs_in(words: Sequence[str], verbs: Mapping[str, str]) -> list[tuple[int, str]]:
    """The numbers of the words that are verbs of a table, and what each says. No verb stands after "the" and "from"; a
    noun of the lexicon is a verb if an object follows: "hands a letter".
    """
    table = lexicon()
    before = table.grammar["before names"] | table.grammar["determiners"]
    objects = table.grammar["determiners"] | table.grammar["pronouns"] | table.grammar["somebody"]
    found = []
    for at, word in enumerate(words):
        if word not in verbs or (at and words[at - 1] in before):
            continue
        after = [one for one in words[at + 1 : at + 3] if one not in table.grammar["particles"]]
        if word in table.lemmas or objects.intersection(after[:1]):
            found.append((at, verbs[word]))
    return found


def zone_of(words: Sequence[str], verb: int) -> range:
    """The words after a verb that belong to it: up to what is said of something else."""
    stop = verb + 1
    while stop < len(words) and words[stop] not in lexicon().grammar["joints"]:
        stop += 1
    return range(verb + 1, stop)


def object_of(words: Sequence[str], zone: range) -> range:
    """What a verb has first: "a dog" of "a dog on the head", "down the blind" of "down the blind with a hand"."""
    ends, start = lexicon().grammar["ends"], zone.start
    while start < zone.stop and (words[start] in lexicon().grammar["before objects"] or words[start].endswith("ly")):
        start += 1
    stop = start
    while stop < zone.stop and words[stop] not in ends:
        stop += 1
    return range(start, stop)


def names_a_thing(words: Sequence[str], some: range) -> bool:
    """Whether some words are a noun that is no part of the body: "the contraption"."""
    table, own = lexicon(), words[some.start : some.stop]
    body = table.grammar["limbs"] | table.grammar["parts"] | table.grammar["body"]
    return len(own) > 1 and own[0] in table.grammar["determiners"] and not body.intersection(own)


def does_else(text: str, verb: int, zone: range) -> bool:
    """Whether a clause says an action beside a verb and what belongs to it; standing is none. A gesture that is said
    there is one, too: to clean the floor with a mop is to sweep.

    Args:
        text: In English.
        verb: The number of the word that is the verb.
        zone: Those that belong to it.
    """
    starts = said_phrases(text)["actions"]
    for action in actions_of(text):
        row, inside = lexicon().actions[action], verb < starts[action] < zone.stop
        if starts[action] != verb and (row.gesture or not inside) and not (row.vague or action == "idle"):
            return True
    return False


def named_hands(words: Sequence[str]) -> str:
    """The hands that are named: "both", "left", "right", "one", or "" for none."""
    limbs = lexicon().grammar["limbs"]
    for at, word in enumerate(words):
        after = words[at + 1 : at + 3]
        if word in ("both", "two") and limbs.intersection(after):
            return "both"
        if word in ("left", "right", "one", "single") and after and after[0] in limbs:
            return "one" if word == "single" else word
    return ""


def way_in(words: Sequence[str], zone: range) -> str:
    """The side that a thing is on: "left", "right", or "" for none. That of a hand is none."""
    limbs = lexicon().grammar["limbs"]
    for at in zone:
        after = words[at + 1] if at + 1 < len(words) else ""
        if words[at] in ("left", "right") and after not in limbs:
            return words[at]
    return ""


MOST = 99
"""How often something is done at the most."""
_OBJECT = 3
"""Words after a verb that says where a part of the body is among which the part is."""
_LIMBS = {"arms": ("arm", "hand"), "legs": ("leg", "foot"), "head": ("head",)}
"""Words for the limbs of a part of the body."""


def count_of(text: str) -> int | None:
    """How often a text says that something is done: "twice", "three times", "two jumping jacks"; None where it says
    nothing of that.
    """
    words, numbers = words_of(text)[0], lexicon().numbers
    starts = set(said_phrases(text)["actions"].values())
    for at, word in enumerate(words):
        count = numbers.get(word) or (int(word) if word.isdecimal() and len(word) <= 2 else 0)
        if not 0 < count <= MOST:
            continue
        if word in lexicon().grammar["adverbs"] or (at + 1 < len(words) and words[at + 1] in ("time", "times")):
            return count
        if at and {at + 1, at + 2} & starts:
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
    moved = [words for part, words in _LIMBS.items() if part in row.part and (row.gesture or part == "arms")]
    return frozenset(stems(word for words in moved for word in words))


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


def unseen_word(text: str, action: str) -> str:
    """The word that says an action in a text, where no watched caption has any that does; "" where one has.

    Args:
        text: In English.
        action: In the lexicon's words.
    """
    said = [word for word in words_of(text)[0] if word.isalpha() and word not in FUNCTION_WORDS]
    said = [word for word in said if stem(word) in _own(action)]
    named = _stems_of((action,))
    if any(stem(word) in named or stem(word) in caption_stems() for word in said):
        return ""
    return said[0] if said else ""


def tells_all(added: Collection[str], texts: tuple[str, ...]) -> bool:
    """Whether all of the words that a clause adds are among those of some sentences."""
    return all(stem(word) in _stems_of(texts) for word in added)
