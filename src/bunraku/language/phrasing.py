"""The grammar that readers of clauses share: where a verb stands, how far what belongs to it goes, and which hands it
names. The words are those of the lexicon's table `grammar`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bunraku.language.lexicon.reading import actions_of, said_phrases
from bunraku.language.lexicon.tables import lexicon

__all__ = ["does_else", "named_hands", "names_a_thing", "object_of", "verbs_in", "way_in", "zone_of"]


def verbs_in(words: Sequence[str], verbs: Mapping[str, str]) -> list[tuple[int, str]]:
    """The numbers of the words that are verbs of a table, and what each says. After "the" and "from" no verb stands,
    and what is a noun to the lexicon is a verb where something follows that it has: "hands a letter".
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
    body = table.grammar["limbs"] | table.grammar["parts"] | {*table.body}
    return len(own) > 1 and own[0] in table.grammar["determiners"] and not body.intersection(own)


def does_else(text: str, verb: int, zone: range) -> bool:
    """Whether a clause says an action beside a verb and what belongs to it; standing is none. A gesture that is said
    there is one, too: who cleans the floor with a mop sweeps.

    Args:
        text: In English.
        verb: The number of the word that is the verb.
        zone: Those that belong to it.
    """
    rows, starts = lexicon().actions, said_phrases(text)["actions"]
    others = [action for action in actions_of(text) if starts[action] != verb]
    return any(
        (rows[action].gesture or not verb < starts[action] < zone.stop) and not (rows[action].vague or action == "idle")
        for action in others
    )


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
