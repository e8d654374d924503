"""The lexicon: one row for each action and all tables of words (`lexicon.json`), and what a text says by them."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any, NamedTuple, TypedDict

import numpy as np

__all__ = [
    "Action",
    "CUES",
    "Lexicon",
    "Otherwise",
    "Phrase",
    "actions_of",
    "goes_ahead",
    "in_known_words",
    "is_cyclic",
    "lexicon",
    "locomotion_of",
    "longest_phrase",
    "main_actions",
    "said_cues",
    "said_otherwise",
    "said_phrases",
    "said_traits",
    "sentence_cues",
    "stays_down",
    "words_of",
]


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
    data: _Table = json.loads(resources.files("bunraku.language").joinpath("lexicon.json").read_text(encoding="utf-8"))
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


_WORD = re.compile(r"[^\W_]+|[^\w\s'’-]")


def words_of(text: str) -> tuple[list[str], list[tuple[int, int]]]:
    """The words of a text in small letters and where each stands; a sign of punctuation is a word, and hyphens and
    apostrophes part words.
    """
    words: list[str] = []
    spans: list[tuple[int, int]] = []
    for found in _WORD.finditer(text):
        words.append(found.group().lower())
        spans.append(found.span())
    return words, spans


@functools.lru_cache(maxsize=4096)
def said_phrases(text: str) -> dict[str, dict[str, int]]:
    """The rows of each section of the lexicon that a text says, with the number of the word at which each begins."""
    phrases = lexicon().phrases
    words = words_of(text)[0]
    found: dict[str, dict[str, int]] = {"actions": {}, "cues": {}, "traits": {}, "places": {}, "synonyms": {}}
    for start, word in enumerate(words):
        after = words[start + 1] if start + 1 < len(words) else ""
        for phrase in phrases.get(word, ()):
            if phrase.name in found[phrase.section]:
                continue
            second = phrase.words[1] if len(phrase.words) > 1 else None
            if second is not None and not phrase.gap and after not in second:
                continue  # as nearly all, and told without a call
            if phrase.alone or _end(phrase, words, start):
                found[phrase.section][phrase.name] = start
    return found


def _end(phrase: Phrase, words: Sequence[str], start: int) -> int:
    """The number of the word after a phrase whose first word stands here; 0 where it does not stand here."""
    _, _, sets, before, after, ahead, first, last, gap, _ = phrase
    if (first and start) or (start and words[start - 1] in before):
        return 0
    stop = start + len(sets)
    if gap:
        return stop if any(word in sets[-1] for word in words[start + 1 :]) else 0  # type: ignore[operator]
    if stop > len(words) or (last and stop != len(words)):
        return 0
    for index in range(start + 1, stop):
        allowed = sets[index - start]
        if (words[index] not in allowed) if allowed is not None else not words[index].isalnum():
            return 0
    if ahead:
        index = stop
        for allowed in after:
            if index < len(words) and words[index] in allowed:
                index += 1
            elif "" not in allowed:
                return 0
    elif after and stop < len(words) and words[stop] in after[0]:
        return 0
    return stop


def longest_phrase(phrases: Iterable[Phrase], words: Sequence[str], start: int) -> tuple[Phrase, int] | None:
    """The longest of some phrases that stands here, and the number of the word after it; None where none does."""
    best: tuple[Phrase, int] | None = None
    for phrase in phrases:
        stop = _end(phrase, words, start)
        if stop and (best is None or stop > best[1]):
            best = phrase, stop
    return best


def actions_of(text: str) -> tuple[str, ...]:
    """Canonical words of a text in the order in which it says them; none where it says nothing known."""
    rows = lexicon().actions
    found = said_phrases(text)["actions"]
    covered: set[str] = set()
    for action in found:
        covered |= rows[action].covers
    names = [action for action in rows if action in found and action not in covered]
    names = [action for action in names if not rows[action].vague] or names
    return tuple(sorted(names, key=found.__getitem__))


def main_actions(texts: Sequence[str]) -> tuple[str, ...]:
    """What the sentences of one stretch agree on: the words of the tersest that says any, or, where none does,
    "other".
    """
    said = [found for text in reversed(texts) if (found := actions_of(text))]
    clear = (found for found in said if not all(lexicon().actions[action].vague for action in found))
    return next(clear, said[0] if said else ("other",))


def goes_ahead(actions: Iterable[str]) -> bool:
    """Whether who does any of some actions goes somewhere."""
    rows = lexicon().actions
    return any(action in rows and rows[action].ahead for action in actions)


def is_cyclic(action: str) -> bool:
    """Whether an action is still the same when it is done again; no for a word that the lexicon does not have."""
    row = lexicon().actions.get(action)
    return row is not None and row.cyclic


def stays_down(action: str) -> bool:
    """Whether who does it is down at its end; no for a word that the lexicon does not have."""
    row = lexicon().actions.get(action)
    return row is not None and row.down


def said_traits(text: str) -> frozenset[str]:
    """The names of the traits that a text tells."""
    return frozenset(said_phrases(text)["traits"])


def locomotion_of(predicate: str) -> str:
    """The locomotion of the first verb that has one; "" where none has."""
    known = lexicon().locomotion
    return next((known[word] for word in words_of(predicate)[0] if word in known), "")


def said_otherwise(predicate: str, verb: str) -> str:
    """A predicate with its verb of moving replaced: "crawls ahead" becomes "walks ahead", and so does "is crawling".

    Args:
        predicate: What is said of somebody.
        verb: In the third person.
    """
    known = lexicon().locomotion
    words, spans = words_of(predicate)
    for number, word in enumerate(words):
        if word in known:
            start = 0 if number == 1 and words[0] == "is" else spans[number][0]
            return predicate[:start] + verb + predicate[spans[number][1] :]
    return predicate


def in_known_words(text: str) -> str:
    """A text in English with rare words for movements put into those that training has, in the same form."""
    if not said_phrases(text)["synonyms"]:
        return text
    table = lexicon()
    words, spans = words_of(text)
    out, copied, index = "", 0, 0
    while index < len(words):
        own = [phrase for phrase in table.phrases.get(words[index], ()) if phrase.section == "synonyms"]
        best = longest_phrase(own, words, index)
        if best is None:
            index += 1
            continue
        phrase, stop = best
        known = table.synonyms[phrase.name]
        if known:
            first = text[spans[index][0] : spans[index][1]]
            out += text[copied : spans[index][0]] + (first if known == "=" else _in_form(known, words[index]))
            copied = spans[stop - 1][1]
        index = stop
    return out + text[copied:]


def _in_form(known: str, like: str) -> str:
    """A phrase with its verb in braces in the form of another verb."""
    if "{" not in known:
        return known
    verb = known[known.find("{") + 1 : known.find("}")]
    table = lexicon()
    forms = (verb, *table.verbs[verb])
    own = (table.lemmas.get(like, like), *table.verbs.get(table.lemmas.get(like, like), ()))
    form = forms[min(own.index(like), len(forms) - 1)] if like in own else verb
    return known.replace("{" + verb + "}", form)


_PLACES = ("arm", "leg", "turn", "go")
_VERBS = (("arm", "arm verb"), ("turn", "turn verb"), ("leg", "leg verb"), ("go", "go verb"))
_NOUNS = (("turn", "turn noun"), ("leg", "leg"), ("arm", "arm"))

CUES: tuple[str, ...] = (
    *(f"{side} {place}" for place in _PLACES for side in ("left", "right")),
    *lexicon().names["cues"],
)
"""What the numbers of `sentence_cues` stand for."""


def _place_of(words: list[str], at: int) -> str:
    """What the side at this word is the side of: the noun right after it, else the nearest verb before it, else one
    after it; of who does something "to the left" never a leg.
    """
    known = lexicon().places
    aside = words[max(at - 2, 0) : at] == ["to", "the"]
    for word in words[at + 1 : at + 3]:
        for part, noun in _NOUNS:
            if word in known[noun]:
                return part
    for word in [*reversed(words[:at]), *words[at + 1 :]]:
        for part, verb in _VERBS:
            if word in known[verb]:
                return "go" if part == "leg" and aside else part
    return "go"


def sentence_cues(sentence: str) -> np.ndarray:
    """What a sentence says of sides, directions, turns, counts, speeds and postures.

    The cues of a sentence with left and right exchanged are the cues with their sides exchanged.

    Args:
        sentence: In English.

    Returns:
        One for each of `CUES` that is said, else zero, shape (30,), float32.
    """
    said = said_cues(sentence)
    return np.array([cue in said for cue in CUES], np.float32)


def said_cues(sentence: str) -> frozenset[str]:
    """The names of the cues that a sentence has."""
    found = set(said_phrases(sentence)["cues"])
    words = [word for word in words_of(sentence)[0] if word.isalnum()]
    for at, word in enumerate(words):
        if word in ("left", "right"):
            found.add(f"{word} {_place_of(words, at)}")
        elif word in ("clockwise", "counterclockwise", "anticlockwise"):
            found.add("right turn" if word == "clockwise" else "left turn")
    return frozenset(found)
