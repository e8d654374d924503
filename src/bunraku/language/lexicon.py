"""The lexicon: one row for each action and all tables of words (`lexicon.json`), and what a text says by them."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any, NamedTuple


@dataclass(frozen=True)
class Action:
    """A row of `actions`."""

    said: tuple[str, ...]  # phrases that say it
    locomotion: str = ""  # the locomotion of its verbs: "fly", "swim", "slither", "crawl", "walk", "run"; "" for none
    part: str = ""  # what its verbs move: "legs", "arms", "head", "arms and head"; "" for neither or all
    limb: str = ""  # "arm" or "leg", where all of the body moves and one of them does it: a kick, a throw
    cyclic: bool = False  # it is still the same when it is done again
    # how long captured people take for it when it is done once, a median, rounded up [s]; 0 for what goes on
    seconds: float = 0.0
    covers: frozenset[str] = frozenset()  # actions that a sentence that says this one says no more
    gesture: bool = False  # it is made by code, since hardly any was captured
    alone: bool = False  # nothing else is done meanwhile but what is `turning`: turning, getting up
    turning: bool = False  # it goes together with a turn
    halts: bool = False  # a person who walks stops for it, if it is not said that both are done at once
    turns: bool = False  # people turn in it, or are upside down, so that a heading says nothing
    ahead: bool = False  # it leads somewhere, so that "forward" says something of it
    down: bool = False  # the body is down at its end, if it is not said that it gets up
    vague: bool = False  # it is said only where nothing else is
    like: str = ""  # the action that is shown in its place where no motion of it is known; "" for none
    posture: str = ""  # in which it is done if nothing else is said, as the reader names it
    # it hardly disturbs in an example of something else: standing, a few steps, a thing in the hand
    passing: bool = False


@dataclass(frozen=True)
class Otherwise:
    """A row of `otherwise`."""

    locomotion: Sequence[str]  # kinds of locomotion
    bodies: Sequence[str]  # kinds of body, as `parse.for_body` has them
    verb: str = ""  # what is said in place of the verb, in the third person; "" for nothing else
    moves: str = ""  # how the body then moves, as `Clause.moves`
    note: str = ""  # the note that is printed then; "{clause}" stands for the clause


class Pattern(NamedTuple):
    """A phrase of which no word may be missing."""

    section: str  # of the lexicon
    name: str  # of its row
    words: tuple[frozenset[str] | None, ...]  # what each word may be; None for any
    before: frozenset[str]  # what the word before must not be
    # what the word after must not be, or, where `ahead` holds, what the words after must be
    after: tuple[frozenset[str], ...]
    ahead: bool  # whether `after` is asked for
    first: bool  # whether the text must begin with it
    last: bool  # whether the text must end with it
    alone: bool  # whether it is one word, whatever stands around it


def _any_of(words: Iterable[str], forms: Mapping[str, frozenset[str]]) -> frozenset[str]:
    """Some words, with what the signs among them stand for."""
    return frozenset[str]().union(*[forms.get(word, (word,)) for word in words])


class Phrases:
    """The phrases of some rows. A phrase becomes a `Pattern` when a text first has a word that it may begin with.

    Args:
        rows: Section, name, and what says it.
        forms: What the signs for verbs and classes stand for: "{walk}", "{walk+}", "<hands>".
    """

    def __init__(self, rows: Iterable[tuple[str, str, Iterable[str]]], forms: Mapping[str, frozenset[str]]) -> None:
        self.forms = forms
        self.rows: list[tuple[str, str, str]] = []
        self.words: set[str] = set()  # all that phrases of actions and limbs have
        self._first: dict[str, list[int]] = {}  # the numbers of the rows that begin with a word
        self._ready: dict[int, list[Pattern]] = {}
        self._starting: dict[str, list[Pattern]] = {}
        for section, name, said in rows:
            for text in said:
                begins = True
                for part in text.split():
                    if part in "^$":
                        continue
                    words = _any_of(part.strip("!=?").split("/"), forms)
                    if section in ("actions", "posing"):
                        self.words.update(words)
                    if begins and part[0] not in "!=":
                        begins = part[-1] == "?"
                        for word in words:
                            numbers = self._first.setdefault(word.partition("_")[0], [])
                            if numbers[-1:] != [len(self.rows)]:
                                numbers.append(len(self.rows))
                self.rows.append((section, name, text))

    def starting(self, word: str) -> list[Pattern]:
        """Those that may begin with a word, in the order of the rows."""
        found = self._starting.get(word)
        if found is None:
            found = self._starting[word] = []
            for number in self._first.get(word, ()):
                if number not in self._ready:
                    self._ready[number] = self._patterns(*self.rows[number])
                for pattern in self._ready[number]:
                    if pattern.words[0] is not None and word in pattern.words[0]:
                        found.append(pattern)
        return found

    def of(self, section: str, name: str) -> list[Pattern]:
        """Those of one row."""
        return [one for row in self.rows if row[:2] == (section, name) for one in self._patterns(*row)]

    def _patterns(self, section: str, name: str, text: str) -> list[Pattern]:
        """A phrase with and without the words that may be missing."""
        before, ahead = frozenset[str](), False
        after: list[frozenset[str]] = []
        variants: list[tuple[frozenset[str] | None, ...]] = [()]
        parts = text.split()
        for part in parts:
            if part in "^$":
                continue
            plain, optional = part.strip("!=?"), part[-1] == "?"
            words = _any_of(plain.split("/"), self.forms)
            if part[0] == "!" and not variants[0]:
                before = words
            elif part[0] in "!=":
                ahead = part[0] == "="
                after.append(words | {""} if optional else words)
            else:
                choice: frozenset[str] | None = None if plain == "*" else words
                ways: list[tuple[frozenset[str] | None, ...]] = [(), (choice,)] if optional else [(choice,)]
                if "_" in plain:
                    ways += [tuple(map(frozenset, zip(word.split("_")))) for word in words if "_" in word]
                longer: list[tuple[frozenset[str] | None, ...]] = []
                for row in variants:
                    for way in ways:
                        longer.append(row + way)
                variants = longer
        first, last = "^" in parts, "$" in parts
        bare = not (before or after or first or last)
        signs = tuple(after), ahead, first, last
        made = []
        for row in filter(None, variants):
            made.append(Pattern(section, name, row, before, *signs, bare and len(row) == 1))
        return made


@dataclass(frozen=True)
class Lexicon:
    """The tables, ready to be looked up."""

    verbs: dict[str, tuple[str, ...]]  # verbs with their forms: third person, gerund, and any others
    third: frozenset[str]  # all forms in the third person
    gerund: frozenset[str]  # all gerunds
    past: dict[str, str]  # the verb of each form of the past that is no other form of a verb
    lemmas: dict[str, str]  # the verb of each form, its own plain one among them
    actions: dict[str, Action]  # the rows of that section
    locomotion: dict[str, str]  # the locomotion of each form of a verb that has one
    phrases: Phrases  # all but those of limbs
    cues: tuple[str, ...]  # the names of that section
    # what a side may be the side of ("arm", "leg", "turn", "go"), by "nouns" and "verbs", and the words that say it
    places: dict[str, dict[str, frozenset[str]]]
    synonyms: dict[str, str]  # what is read in place of each synonym, by its name
    ground: dict[str, str]  # how a body that moves so is on the ground
    otherwise: tuple[Otherwise, ...]  # what some kinds of body do in place of a locomotion
    numbers: dict[str, int]  # what words count
    holding: frozenset[str]  # verbs that say where a part of the body is, in all their forms
    levels: dict[str, float]  # heights of things in metres, for a body of 1.84 m
    # `fields`, the cues for what the reader says of an action, by "field value"; `beside things`, actions that are no
    # more than walking or looking there, or handling a thing; `stances`, the `Stance` in a posture and after an action;
    # `gazes`, by what is seen the pitch, sweep and lean of
    # `Gaze`, chosen by eye on sheets of the sentences of benchmarks/things.txt; `shown`, cues that an example must say
    # too; `added`, cues and traits that a gesture does not do by itself
    reading: dict[str, Any]
    contrary: tuple[frozenset[str], ...]  # cues and traits of which an example does not say another than is said
    grammar: dict[str, frozenset[str]]  # sets of words, by what they are
    irregular: dict[str, str]  # the plain form of inflected words that no rule of `vocabulary.stem` has
    # `parts`, the limb of each part of the body that can go somewhere; `goes`, where a limb goes by a verb alone;
    # `low`, places that hands reach by bending, with the joint that each is at; `of verbs`, parts that go without
    # saying with a verb, unless the sentence names their side
    limbs: dict[str, Any]
    posing: Phrases  # those of limbs
    joints: Phrases  # what stands between the clauses of a sentence, at the beginning of one, or where one goes on
    words: frozenset[str]  # all words of the phrases, and of the rows' names


@functools.cache
def lexicon() -> Lexicon:
    """The lexicon of the package."""
    data: dict[str, Any] = json.loads(
        resources.files("bunraku.language").joinpath("lexicon.json").read_text(encoding="utf-8")
    )
    verbs: dict[str, tuple[str, ...]] = {}
    lemmas: dict[str, str] = {}
    past: dict[str, str] = {}
    third, gerund = set(), set()
    signs: dict[str, frozenset[str]] = {}  # what stands for words in phrases
    for verb, listed in data["verbs"].items():
        forms = verbs[verb] = tuple(listed.split())
        signs[f"{{{verb}}}"], signs[f"{{{verb}+}}"] = frozenset((verb, *forms[:2])), frozenset((verb, *forms))
        for form in (verb, *forms):
            lemmas.setdefault(form, verb)
        third.add(forms[0])
        gerund.add(forms[1])
        for form in forms[2:]:
            past[form] = verb
    actions = {}
    for name, row in data["actions"].items():
        covers = frozenset((*row.get("covers", ()), *(data["gestures cover"] if row.get("gesture") else ())))
        actions[name] = Action(**{**row, "said": tuple(row["said"]), "covers": covers})
    moving = _of_verbs(actions, data["locomotion"])
    classes = data["classes"]
    classes["verb"] = "{" + "} {".join(verbs) + "}"
    classes["gerund"] = " ".join(gerund)
    classes["going"] = " ".join(f"{{{verb}+}}" for verb, way in moving.items() if way in ("walk", "run"))
    for name, listed in classes.items():
        signs[f"<{name}>"] = _any_of(listed.split(), signs)
    rows: list[tuple[str, str, Iterable[str]]] = [("actions", name, action.said) for name, action in actions.items()]
    rows += [(section, name, said) for section in ("cues", "traits") for name, said in data[section].items()]
    rows += [("synonyms", said, (said,)) for said, _ in data["synonyms"]]
    phrases = Phrases(rows, signs)
    posing, joints = (Phrases([(name, *row) for row in data[name].items()], signs) for name in ("posing", "joints"))
    places = {
        kind: {name: _any_of(said.split("/"), signs) for name, said in named.items()}
        for kind, named in data["places"].items()
    }
    return Lexicon(
        verbs=verbs, third=frozenset(third), gerund=frozenset(gerund), lemmas=lemmas, actions=actions, phrases=phrases,
        posing=posing, joints=joints, past={form: past[form] for form in past.keys() - verbs.keys() - third - gerund},
        locomotion={form: way for verb, way in moving.items() for form in (verb, *verbs[verb])}, places=places,
        cues=tuple(data["cues"]), synonyms=dict(data["synonyms"]), ground=data["ground"], numbers=data["numbers"],
        otherwise=tuple(Otherwise(**row) for row in data["otherwise"]), holding=signs["<holding>"],
        contrary=tuple(map(frozenset, data["contrary"])), reading=data["reading"], levels=data["levels"],
        grammar={name: frozenset(listed.split()) for name, listed in data["grammar"].items()}, limbs=data["limbs"],
        irregular={form: word for word, listed in data["irregular"].items() for form in listed.split()},
        words=frozenset(phrases.words | posing.words).union(" ".join(actions).replace("-", " ").split()),
    )  # fmt: skip


def cues_of(field: str) -> frozenset[str]:
    """The cues for all that the reader says in a field (`reader.FIELDS`), such as its "speed"."""
    said = lexicon().reading["fields"].items()
    return frozenset(cue for name, cues in said if name.startswith(f"{field} ") for cue in cues.split(", "))


def _of_verbs(actions: Mapping[str, Action], others: Mapping[str, str]) -> dict[str, str]:
    """The locomotion of each verb: of the actions that it says alone, and of a table of others."""
    found: dict[str, str] = {}
    for action in actions.values():
        for phrase in action.said if action.locomotion else ():
            first, _, more = phrase.partition(" ")
            if not more or (" " not in more and more[0] in "!$"):
                for word in first.split("/"):
                    if word[0] == "{":
                        found[word.strip("{+}")] = action.locomotion
    for value, some in others.items():
        for verb in some.split():
            found[verb] = value
    return found


LIMB_CUES = frozenset(cue for cue in lexicon().reading["shown"] if cue.endswith((" arm", " leg")))
"""Cues for the limb of a side: "left arm"."""
_WORD = re.compile(r"[^\W_]+|[^\w\s'’-]")


@functools.lru_cache(maxsize=1024)
def words_of(text: str) -> tuple[list[str], list[tuple[int, int]]]:
    """The words of a text in small letters and where each stands; a sign of punctuation is a word, and hyphens and
    apostrophes part words. The lists are shared and must not be changed.
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
    found: dict[str, dict[str, int]] = {"actions": {}, "cues": {}, "traits": {}, "synonyms": {}}
    for start, word in enumerate(words):
        after = words[start + 1] if start + 1 < len(words) else ""
        for phrase in phrases.starting(word):
            if phrase.name in found[phrase.section]:
                continue
            second = phrase.words[1] if len(phrase.words) > 1 else None
            if second is not None and after not in second:
                continue  # as for nearly all, found without a call
            if phrase.alone or _end(phrase, words, start):
                found[phrase.section][phrase.name] = start
    return found


def _end(pattern: Pattern, words: Sequence[str], start: int) -> int:
    """The number of the word after a pattern whose first word stands here; 0 where it does not stand here."""
    _, _, sets, before, after, ahead, first, last, _ = pattern
    if (first and start) or (start and words[start - 1] in before):
        return 0
    stop = start + len(sets)
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


def longest_pattern(patterns: Iterable[Pattern], words: Sequence[str], start: int) -> tuple[Pattern, int] | None:
    """The longest of some patterns that stands here, and the number of the word after it; None where none does."""
    best: tuple[Pattern, int] | None = None
    for pattern in patterns:
        stop = _end(pattern, words, start)
        if stop and (best is None or stop > best[1]):
            best = pattern, stop
    return best


def actions_of(text: str) -> tuple[str, ...]:
    """Canonical words of a text in the order in which it says them; none where it says nothing known."""
    found = said_phrases(text)["actions"]
    if len(found) < 2:
        return tuple(found)
    return tuple(sorted(uncovered(found), key=found.__getitem__))


def uncovered(actions: Collection[str]) -> list[str]:
    """Those of some actions that no other of them says already, without vague ones where others are clear."""
    rows, covered = lexicon().actions, set[str]()
    for action in actions:
        covered |= rows[action].covers
    names = [action for action in actions if action not in covered]
    return [action for action in names if not rows[action].vague] or names


def main_actions(texts: Sequence[str]) -> tuple[str, ...]:
    """What the sentences of one stretch agree on: the words of the tersest that says any, or, where none does,
    "other".
    """
    said = [found for text in reversed(texts) if (found := actions_of(text))]
    clear = (found for found in said if not all(lexicon().actions[action].vague for action in found))
    return next(clear, said[0] if said else ("other",))


def goes_ahead(actions: Iterable[str]) -> bool:
    """Whether any of some actions leads somewhere."""
    rows = lexicon().actions
    return any(action in rows and rows[action].ahead for action in actions)


def is_cyclic(action: str) -> bool:
    """Whether an action is still the same when it is done again; no for a word that the lexicon does not have."""
    row = lexicon().actions.get(action)
    return row is not None and row.cyclic


def done_once(actions: Collection[str]) -> bool:
    """Whether any of some actions is done once and does not go on."""
    rows = lexicon().actions
    return any(action in rows and rows[action].seconds for action in actions)


def stays_down(action: str) -> bool:
    """Whether the body is down at the end of an action; no for a word that the lexicon does not have."""
    row = lexicon().actions.get(action)
    return row is not None and row.down


def said_traits(text: str) -> frozenset[str]:
    """The names of the traits that a text says."""
    return frozenset(said_phrases(text)["traits"])


def locomotion_of(predicate: str) -> str:
    """The locomotion of the first verb that has one; "" where none has."""
    known = lexicon().locomotion
    return next((known[word] for word in words_of(predicate)[0] if word in known), "")


def said_otherwise(predicate: str, verb: str) -> str:
    """A predicate with its verb of moving replaced: "crawls ahead" becomes "walks ahead", and so does "is crawling".

    Args:
        predicate: What is said of a subject.
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
        own = [phrase for phrase in table.phrases.starting(words[index]) if phrase.section == "synonyms"]
        best = longest_pattern(own, words, index)
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


def _place_of(words: list[str], at: int) -> str:
    """What the side at this word is the side of: the noun right after it, else the nearest verb before it, else one
    after it; "to the left" is never said of a leg.
    """
    known = lexicon().places
    aside = words[max(at - 2, 0) : at] == ["to", "the"]
    for word in words[at + 1 : at + 3]:
        for part, nouns in known["nouns"].items():
            if word in nouns:
                return part
    for word in [*reversed(words[:at]), *words[at + 1 :]]:
        for part, verbs in known["verbs"].items():
            if word in verbs:
                return "go" if part == "leg" and aside else part
    return "go"


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
