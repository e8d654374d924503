"""The lexicon: one data file, `lexicon.json`, with a row for each action, and all other tables of words.

| section | a row |
| --- | --- |
| `verbs` | a verb and its forms: third person, gerund, past |
| `classes` | a name and words that stand for each other; `going` is all verbs that walk or run, `verb` all |
| `actions` | a canonical word and what is known of it (see `Action`), the more special first |
| `locomotion`, `parts` | verbs that move, or move a part of the body, otherwise than the action that they say |
| `ground` | how somebody who moves so is on the ground, as `Clause.moves`; "stay" is for all others |
| `otherwise` | what some kinds of body do in place of a locomotion (see `Otherwise`); the first that fits counts |
| `cues` | what `cues.sentence_cues` counts and the network is conditioned on: training knows it, it stays as it is |
| `places` | what a "left" or "right" may be the side of |
| `handling` | verbs of who takes, holds and puts things, and words for heights, in metres too (`language.handling`) |
| `grammar` | words that part a clause (`language.phrasing`): what may stand before a noun, after a thing, and so on |
| `posing` | limbs, their ways and places, and verbs of who poses them (`language.limbs.phrases`), by kind and value |
| `contrary` | cues and traits that exclude each other |
| `traits` | what else a clause says (`Clause.traits`) |
| `numbers`, `adverbs` | words that count, and those of them that count alone: "twice" |
| `body` | words for parts of the body, beside those of `foreign.table` |
| `synonyms` | words that training hardly has, and what is read in their place: "" where they stay, "=" for the first |

A phrase is words in a row, with these signs: `walk/run` either; `{walk}` a verb, plain, in the third
person or as a gerund, `{walk+}` in the past too; `<own>` any word of a
class; `left?` may be missing; `*` any word; `a_few` two words as one choice; `...` any words between; `^` and `$` the
text's beginning and end; `!the` at the end (or beginning) another word after (or before) than these; `=left` at the end
must follow and is no part of it. Punctuation parts phrases, hyphens and apostrophes do not. Verbs of the class
`holding` say where a part of the body is.

**A new action** is a row of `actions`: `"yodel": {"said": ["{yodel}"], "part": "head", "cyclic": true}`, and its verb a
row of `verbs`: `"yodel": "yodels yodeling yodeled"`. It is then understood, counted, balanced in training, and timed;
with a `gesture` of its name among the captured examples it is shown too. A verb that says a known action is one word
in that action's `said`.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from typing import Any, NamedTuple, TypedDict

__all__ = ["Action", "Lexicon", "Otherwise", "Phrase", "lexicon"]

GESTURES_COVER = ("idle", "raise arm", "talk", "twist", "put down", "reach", "stretch")
"""What a sentence that says a gesture says no more than that."""
_LEGS = ("walk", "run")


@dataclass(frozen=True)
class Action:
    """A row of `actions`.

    Args:
        said: Phrases that say it.
        locomotion: The locomotion of its verbs: "fly", "swim", "slither", "crawl", "walk", "run"; "" for none.
        part: What its verbs move: "legs", "arms", "head", "arms and head"; "" for neither or all.
        cyclic: It is still the same when it is done again.
        seconds: How long captured people take for it when it is done once, a median, rounded up [s]; 0 for what goes
            on.
        covers: Actions that a sentence that says this one says no more.
        gesture: It is made by code, since hardly any was captured.
        alone: Nobody does anything else meanwhile but what is `turning`: turning, getting up.
        turning: It goes together with a turn.
        halts: People who go stop for it, if it is not said that they do both at once.
        ahead: Who does it goes somewhere, so that "forward" says something of it.
        down: Who does it is down at its end, if it is not said that he gets up.
        vague: It is said only where nothing else is.
        passing: It hardly disturbs in an example of something else: standing, a few steps, a thing in the hand.
    """

    said: tuple[str, ...]
    locomotion: str = ""
    part: str = ""
    cyclic: bool = False
    seconds: float = 0.0
    covers: frozenset[str] = frozenset()
    gesture: bool = False
    alone: bool = False
    turning: bool = False
    halts: bool = False
    ahead: bool = False
    down: bool = False
    vague: bool = False
    passing: bool = False


@dataclass(frozen=True)
class Otherwise:
    """A row of `otherwise`.

    Args:
        locomotion: Kinds of locomotion.
        bodies: Kinds of body (`language.bodies.KINDS`).
        verb: What is said in place of the verb, in the third person; "" for nothing else.
        moves: How the body then moves, as `Clause.moves`.
        note: The note that is printed then; "{clause}" stands for the clause.
    """

    locomotion: tuple[str, ...]
    bodies: tuple[str, ...]
    verb: str = ""
    moves: str = ""
    note: str = ""


class Phrase(NamedTuple):
    """A phrase of which no word may be missing.

    Args:
        section: Of the lexicon.
        name: Of its row.
        words: What each word may be; None for any.
        before: What the word before must not be.
        after: What the word after must not be, or, where `ahead` holds, what the words after must be.
        ahead: Whether `after` is asked for.
        first: Whether the text must begin with it.
        last: Whether the text must end with it.
        gap: Whether its last word may stand anywhere later.
        alone: Whether it is one word, whatever stands around it.
    """

    section: str
    name: str
    words: tuple[frozenset[str] | None, ...]
    before: frozenset[str]
    after: tuple[frozenset[str], ...]
    ahead: bool
    first: bool
    last: bool
    gap: bool
    alone: bool


@dataclass(frozen=True)
class Lexicon:
    """The tables, ready to be looked up.

    Args:
        verbs: Verbs with their forms: third person, gerund, and any others.
        third: All forms in the third person.
        gerund: All gerunds.
        past: The verb of each form of the past that is no other form of a verb.
        lemmas: The verb of each form, its own plain one among them.
        actions: The rows of that section.
        locomotion: The locomotion of each form of a verb that has one.
        parts: What each form of a verb moves, where it moves a part of the body.
        phrases: All phrases by the words that they may begin with.
        names: Names of the rows of each section.
        places: What a side may be the side of, and the words that say it.
        synonyms: What is read in place of each synonym, by its name.
        ground: How somebody who moves so is on the ground.
        otherwise: What some kinds of body do in place of a locomotion.
        numbers: What words count.
        adverbs: Those of them that count alone.
        body: Words for parts of the body.
        holding: Verbs that say where a part of the body is, in all their forms.
        handling_verbs: What each form of a verb does with a thing.
        heights: Words for places of things, by their heights.
        levels: What these are in metres, for a body of 1.84 m.
        aside: Words for a place beside.
        contrary: Cues and traits of which an example does not say another than is said.
        grammar: Words that part a clause, by what they are.
        posing: Phrases of limbs, by the words that they may begin with.
        words: All words of the phrases, and of the rows' names.
    """

    verbs: dict[str, tuple[str, ...]]
    third: frozenset[str]
    gerund: frozenset[str]
    past: dict[str, str]
    lemmas: dict[str, str]
    actions: dict[str, Action]
    locomotion: dict[str, str]
    parts: dict[str, str]
    phrases: dict[str, list[Phrase]]
    names: dict[str, tuple[str, ...]]
    places: dict[str, frozenset[str]]
    synonyms: dict[str, str]
    ground: dict[str, str]
    otherwise: tuple[Otherwise, ...]
    numbers: dict[str, int]
    adverbs: frozenset[str]
    body: tuple[str, ...]
    holding: frozenset[str]
    handling_verbs: dict[str, str]
    heights: dict[str, frozenset[str]]
    levels: dict[str, float]
    aside: frozenset[str]
    contrary: tuple[frozenset[str], ...]
    grammar: dict[str, frozenset[str]]
    posing: dict[str, list[Phrase]]
    words: frozenset[str]


class _Table(TypedDict):
    """What `lexicon.json` holds, as its head says it."""

    verbs: dict[str, str]
    actions: dict[str, dict[str, Any]]
    locomotion: dict[str, str]
    parts: dict[str, str]
    classes: dict[str, str]
    cues: dict[str, list[str]]
    traits: dict[str, list[str]]
    places: dict[str, list[str]]
    handling: dict[str, Any]
    contrary: list[list[str]]
    grammar: dict[str, str]
    posing: dict[str, list[str]]
    synonyms: list[tuple[str, str]]
    ground: dict[str, str]
    otherwise: list[dict[str, Any]]
    numbers: dict[str, int]
    adverbs: str
    body: str


@functools.cache
def lexicon() -> Lexicon:
    """The lexicon of the package."""
    data: _Table = json.loads(
        resources.files("bunraku.language.lexicon").joinpath("lexicon.json").read_text(encoding="utf-8")
    )
    verbs: dict[str, tuple[str, ...]] = {}
    lemmas: dict[str, str] = {}
    third, gerund = set(), set()
    for verb, forms in data["verbs"].items():
        verbs[verb] = tuple(forms.split())
        third.add(verbs[verb][0])
        gerund.add(verbs[verb][1])
        for form in (verb, *verbs[verb]):
            lemmas.setdefault(form, verb)
    actions: dict[str, Action] = {}
    moving: dict[str, str] = {}
    parts: dict[str, str] = {}
    for name, row in data["actions"].items():
        row["said"] = tuple(row["said"])
        row["covers"] = frozenset((*row.get("covers", ()), *(GESTURES_COVER if row.get("gesture") else ())))
        actions[name] = action = Action(**row)
        for phrase in action.said:
            first, _, others = phrase.partition(" ")
            if not others or (" " not in others and others[0] in "!$"):
                for word in first.split("/"):
                    if word[0] == "{" and action.locomotion:
                        moving[word.strip("{+}")] = action.locomotion
                    if word[0] == "{" and action.part:
                        parts[word.strip("{+}")] = action.part
    for table, found in ((data["locomotion"], moving), (data["parts"], parts)):
        for value, some in table.items():
            for verb in some.split():
                found[verb] = value
    by_form: list[dict[str, str]] = [{}, {}]
    for forms_of, found in zip(by_form, (moving, parts), strict=True):
        for verb, value in found.items():
            for form in (verb, *verbs[verb]):
                forms_of[form] = value
    data["classes"]["verb"] = " ".join(["{" + verb + "}" for verb in verbs])
    data["classes"]["going"] = " ".join(["{" + verb + "+}" for verb, way in moving.items() if way in _LEGS])
    held = [one.strip("{+}") for one in data["classes"]["holding"].split()]
    holding = frozenset(form for verb in held for form in (verb, *verbs[verb]))
    handled: dict[str, str] = {}
    for kind, listed in data["handling"]["verbs"].items():
        for verb in listed.split():
            handled |= dict.fromkeys((verb, *verbs[verb]), kind)
    heights = {name: frozenset(listed.split()) for name, listed in data["handling"]["heights"].items()}
    past = {form: verb for verb, forms in verbs.items() for form in forms[2:]}
    past = {form: verb for form, verb in past.items() if form not in verbs and form not in third | gerund}
    rows = [("actions", name, action["said"]) for name, action in data["actions"].items()]
    rows += [(section, name, said) for section in ("cues", "traits", "places") for name, said in data[section].items()]
    rows += [("synonyms", said, (said,)) for said, _ in data["synonyms"]]
    phrases, said_words = _phrases(rows, data["classes"], verbs)
    posing, posing_words = _phrases([("posing", *row) for row in data["posing"].items()], data["classes"], verbs)
    words = said_words | posing_words | {word for name in data["actions"] for word in name.replace("-", " ").split()}
    otherwise = []
    for row in data["otherwise"]:
        otherwise.append(Otherwise(**{**row, "locomotion": tuple(row["locomotion"]), "bodies": tuple(row["bodies"])}))
    where: dict[str, frozenset[str]] = {}
    for starting in phrases.values():
        for one in starting:
            if one.section == "places":
                where[one.name] = one.words[0] or frozenset()
    return Lexicon(
        verbs, frozenset(third), frozenset(gerund), past, lemmas, actions, by_form[0], by_form[1], phrases,
        {section: tuple(data[section]) for section in ("actions", "cues", "traits")}, where,
        dict(data["synonyms"]), data["ground"], tuple(otherwise), data["numbers"],
        frozenset(data["adverbs"].split()), tuple(data["body"].split()), holding, handled, heights,
        data["handling"]["levels"], frozenset(data["handling"]["aside"].split()),
        tuple(map(frozenset, data["contrary"])),
        {name: frozenset(listed.split()) for name, listed in data["grammar"].items()}, posing,
        words.union(*heights.values()),
    )  # fmt: skip


def _phrases(
    rows: Iterable[tuple[str, str, Iterable[str]]], classes: dict[str, str], verbs: dict[str, tuple[str, ...]]
) -> tuple[dict[str, list[Phrase]], frozenset[str]]:
    """The phrases of rows (section, name, what says it) by the words that they may begin with, and all words of actions
    and limbs.
    """
    sets: dict[str, frozenset[str]] = {}  # of what stands between two spaces
    index: dict[str, list[Phrase]] = {}
    known: set[str] = set()
    for section, name, said in rows:
        for text in said:
            first = last = gap = False
            before: frozenset[str] = frozenset()
            after: list[frozenset[str]] = []
            ahead = False
            variants: list[list[frozenset[str] | None]] = [[]]
            for part in text.split():
                if part in ("^", "$", "..."):
                    first, last, gap = first or part == "^", last or part == "$", gap or part == "..."
                    continue
                sign, plain = part[0], part.strip("!=?")
                if plain not in sets:
                    some: list[str] = []
                    for word in plain.split("/"):
                        listed = classes[word[1:-1]].split() if word[0] == "<" else (word,)
                        for one in listed:
                            verb = one.strip("{+}")
                            if one[0] != "{":
                                some.append(one)
                            else:
                                some += (verb, *(verbs[verb] if "+" in one else verbs[verb][:2]))
                    sets[plain] = frozenset(some)
                    if section in ("actions", "posing"):
                        known.update(some)
                if sign == "!" and not variants[0]:
                    before = sets[plain]
                elif sign in "!=":
                    ahead = sign == "="
                    if part[-1] == "?":
                        after.append(sets[plain] | {""})
                    else:
                        after.append(sets[plain])
                else:
                    longer = []
                    for row in variants:
                        if part[-1] == "?":
                            longer.append(row)
                        if plain == "*":
                            longer.append([*row, None])
                            continue
                        longer.append([*row, sets[plain]])
                        for word in sets[plain]:
                            if "_" in word:
                                longer.append([*row, *map(frozenset, zip(word.split("_")))])
                    variants = longer
            for row in variants:
                alone = len(row) == 1 and not (before or after or first or last or gap)
                phrase = Phrase(section, name, tuple(row), before, tuple(after), ahead, first, last, gap, alone)
                for word in row[0] or ():
                    index.setdefault(word, []).append(phrase)
    return index, frozenset(known)
