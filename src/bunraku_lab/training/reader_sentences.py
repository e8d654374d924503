"""Sentences for training the reader: phrases of single actions, composed by a small grammar (`reader_grammar.json`),
and sentences about captured motion.
"""

from __future__ import annotations

import csv
import hashlib
import json
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bunraku.errors import FormatError
from bunraku.language.lexicon import lexicon
from bunraku.language.prompts import plain_words
from bunraku.language.reader import FIELDS
from bunraku_lab.datasets.motions.build import split_of
from bunraku_lab.datasets.motions.clips import action_labels

NOTHING = "none"
UNKNOWN = -1
"""Of a field about which a sentence may say something that is not known here."""
HELD_OUT = 0.05
"""Share of the phrases of each action, and of what else is written, that is validated on and not learned."""
HANDLING = 0.08
"""Share of an action's phrases that say something done with things from which any of them may; chosen by eye on the
list of actions: above are "drink" and "drag a heavy thing", below "climb" and "phone".
"""
OF_DEALINGS = ("side", "direction", "height", "surface")
"""Fields of what is done with things."""
_SLOT = re.compile(r"\{([^{}]+)\}")
Fields = dict[str, int]


@dataclass
class Composed:
    """A sentence in pieces.

    Args:
        pieces: Words, and the clause that they belong to; -1 for none.
        said: Of each action that is named its name, its clause and its fields; the clause is -1 if it may be anywhere.
    """

    pieces: list[tuple[str, int]]
    said: list[tuple[str, int, Fields]] = field(default_factory=list)
    open: frozenset[str] = frozenset()
    """What else it may say: names of actions, "actions" for any, "dealings" for anything that is done with things."""

    @property
    def text(self) -> str:
        """The sentence."""
        return " ".join(piece for piece, _ in self.pieces)


def phrases_of(files: Sequence[Path]) -> dict[str, list[str]]:
    """Phrases by action, of files with an action, a tab and a phrase in each line; a phrase alone names no action. Of a
    phrase that is there more than once, the last line counts.

    Raises:
        FormatError: A file is missing or damaged.
    """
    actions: dict[str, str] = {}
    for path in files:
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise FormatError(path, f"the phrases cannot be read ({error}); give actions and phrases") from error
        for line in filter(None, lines):
            action, _, phrase = line.rpartition("\t")
            actions[phrase] = action or NOTHING
    found: dict[str, list[str]] = defaultdict(list)
    for phrase, action in actions.items():
        found[action].append(phrase)
    return dict(found)


def dealings_of(file: Path) -> dict[str, list[tuple[str, Fields]]]:
    """What is done with things in some clauses, of a file with labels in JSON, a tab and a clause in each line.

    Raises:
        FormatError: It is missing or damaged.
    """
    try:
        rows = [line.split("\t") for line in file.read_text(encoding="utf-8").splitlines()]
        return {text: [(name, _dealt(said)) for name, said in json.loads(labels)] for labels, text in rows}
    except (OSError, ValueError, KeyError) as error:
        raise FormatError(file, f"the clauses cannot be read ({error}); give labels and clauses") from error


def labelled_sentences(files: Sequence[Path], actions: Collection[str]) -> list[Composed]:
    """Whole sentences with all that is said in them, of files with an object of JSON in each line: "sentence", and
    "clauses" with an action each and what is said of it, as `benchmarks/reader_300.md` describes. Those with other
    actions than the given ones are left out.

    Raises:
        FormatError: A file is missing or damaged.
    """
    made = []
    for path in files:
        try:
            rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
            read = [(plain_words(row["sentence"]), [(one["action"], one) for one in row["clauses"]]) for row in rows]
        except (OSError, ValueError, KeyError) as error:
            raise FormatError(path, f"the sentences cannot be read ({error}); give labelled sentences") from error
        for text, clauses in read:
            said = [(action, -1, _labelled(fields)) for action, fields in clauses if action != NOTHING]
            if text and {action for action, _, _ in said} <= set(actions):
                made.append(Composed([(text, -1)], said, frozenset(("dealings",)) | _aside(said)))
    return made


def _labelled(said: Mapping[str, Any]) -> Fields:
    """The fields of a labelled clause."""
    degrees, _, side = str(said.get("turn", "")).partition(" ")
    values = {**said, "degrees": degrees, "turn side": side}
    fields = _none()
    for name in ("side", "direction", "turn side", "degrees", "count", "speed", "posture"):
        if value := str(values.get(name, "")):
            fields[name] = _value(name, value) if value in FIELDS[name] else UNKNOWN
    return fields


def _aside(said: Sequence[tuple[str, int, Fields]]) -> frozenset[str]:
    """The step aside, where a gait goes to a side: either may be meant."""
    sides = {_value("direction", side) for side in ("left", "right")}
    gaits = grammar()["gaits"]
    return frozenset(["sidestep"] * any(action in gaits and fields["direction"] in sides for action, _, fields in said))


def _dealt(said: dict[str, str]) -> Fields:
    fields = dict.fromkeys(FIELDS, UNKNOWN) | dict.fromkeys(OF_DEALINGS, 0)
    return fields | {name: _value(name, value) for name, value in said.items()}


def drawn(text: str) -> float:
    """A number from 0 to 1, fixed for ever by a text."""
    return int(hashlib.sha256(text.lower().encode()).hexdigest()[:8], 16) / 2**32


def watched_sentences(data: Path, split: str) -> list[Composed]:
    """What people wrote about captured stretches whose actions are known (`clips.action_labels`): captions, and
    sentences that ask for such a motion.

    Args:
        data: Folder with `captions_watched.json` and `captions_asked.tsv`.
        split: Of the clips: "train" or "val".
    """
    clips = json.loads((data / "captions_watched.json").read_text(encoding="utf-8"))["clips"]
    with (data / "captions_asked.tsv").open(encoding="utf-8", newline="") as file:
        asked = {key: texts for key, *texts in csv.reader(file, delimiter="\t", quoting=csv.QUOTE_NONE)}
    made: list[Composed] = []
    labels, unknown = action_labels(), dict.fromkeys(FIELDS, UNKNOWN)
    for name, stretches in clips.items():
        for index, stretch in enumerate(stretches if split_of(name) == split else ()):
            key = f"{name}@{round(stretch['start'] * 20)}"  # frames a second of the archive
            if key in labels:
                said = [(action, -1, unknown) for action in labels[key][0] if action != NOTHING]
                more = frozenset(("dealings", *labels[key][1]))
                for text in map(plain_words, (*stretch["texts"], *asked.get(f"{name}#{index}", ()))):
                    made.append(Composed([(text, -1)], said, more))
    return [sentence for sentence in made if sentence.text]


@cache
def grammar() -> dict[str, Any]:
    """What sentences are made with."""
    read: dict[str, Any] = json.loads(Path(__file__).with_name("reader_grammar.json").read_text(encoding="utf-8"))
    return read


@cache
def _words_of_fields() -> dict[str, frozenset[str]]:
    """Words that may say something of a field."""
    telling = {name: frozenset(words.split()) for name, words in grammar()["telling"].items()}
    turning = telling.pop("turn")
    return telling | {"turn side": turning, "degrees": turning}


@cache
def _tellers(action: str) -> tuple[re.Pattern[str], dict[str, tuple[str, str]]]:
    """Words that surely say a value of a field in phrases of an action: what finds them, and what each says."""
    says: dict[str, tuple[str, str]] = {}
    for row in grammar()["told"]:
        if action in row.get("actions", (action,)) and action not in row.get("but", ()):
            for value, forms in row["values"].items():
                for form in forms:
                    for limb in grammar()["limbs"] if "{limb}" in form else ("",):
                        says[form.format(limb=limb)] = (row["field"], value)
    longest = sorted(says, key=len, reverse=True)
    return re.compile(rf"(?<!\w)(?:{'|'.join(map(re.escape, longest))})(?!\w)"), says


def told(text: str, action: str) -> Fields:
    """What a phrase of an action says of it: a value that its words surely say, "nothing" where no word tells anything
    of a field, otherwise `UNKNOWN`.
    """
    said, fields = grammar(), _none()
    finder, says = _tellers(action)
    values: dict[str, set[str]] = defaultdict(set)
    for name, value in (says[form] for form in finder.findall(text.lower())):
        if value:  # "picks up" and the like say nothing
            values[name].add(value)
    rest = set(finder.sub(" ", text.lower()).split())
    going = action in said["gaits"] or action in said["travels"] or action in said["aiming"] or action in said["ways"]
    for name, words in _words_of_fields().items():
        usual = said["of actions"].get(name, {}).get(action, "")
        upright = name == "direction" and not going
        if rest & (words & set(said["telling sides"].split()) if upright else words) or len(values[name]) > 1:
            fields[name] = UNKNOWN
        if len(values[name]) == 1 and fields[name] != UNKNOWN:
            fields[name] = _value(name, *values[name])
        elif usual and not values[name] and (fields[name] != UNKNOWN or name == "posture"):
            fields[name] = _value(name, usual)
    return fields


@cache
def _forms() -> dict[str, tuple[str, ...]]:
    """Any form of a verb -> its forms: plain, third person, participle."""
    return {form: (verb, *forms) for verb, forms in lexicon().verbs.items() for form in (verb, *forms[:2])}


class Composer:
    """Makes sentences.

    Args:
        phrases: By action; `NOTHING` for those that name none.
        watched: What people wrote about captured motion.
        seed: Of the draw.
        dealings: What is done with things, by clause; phrases of actions may be among them.
        labelled: Whole sentences that are taken as they are, all that they say being known.
    """

    def __init__(
        self,
        phrases: dict[str, list[str]],
        watched: Sequence[Composed],
        seed: int,
        dealings: Mapping[str, list[tuple[str, Fields]]] = MappingProxyType({}),
        labelled: Sequence[Composed] = (),
    ):
        self.labelled = labelled
        self.phrases, self.watched, self.rng = phrases, watched, np.random.default_rng(seed)
        known = {phrase for listed in phrases.values() for phrase in listed}
        self.dealings = dealings
        shares = {action: np.mean([text in dealings for text in listed]) for action, listed in phrases.items()}
        self.handling = {action for action, share in shares.items() if share > HANDLING}
        by_label: dict[str, list[str]] = defaultdict(list)
        for text, said in dealings.items():
            if text not in known:
                by_label[said[0][0]].append(text)
        self.dealt = list(by_label.values())
        roots = np.array([len(texts) for texts in self.dealt]) ** 0.5
        self.dealt_shares = roots / max(roots.sum(), 1.0)
        counts = Counter(action for sentence in watched for action, _, _ in sentence.said)
        self.actions = [action for action in phrases if action != NOTHING]
        weights = np.array([1 + min(counts[action] / 100, 9) ** 0.5 for action in self.actions])
        self.weights = weights / weights.sum()
        self.grammar = grammar()

    def pick(self, values: Sequence[Any]) -> Any:
        return values[int(self.rng.integers(len(values)))]

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def sentence(self) -> Composed:
        """A sentence."""
        draw, shares = self.rng.random(), self.grammar["whole"]
        for given, share in ((self.watched, shares["watched"]), (self.labelled, shares["labelled"])):
            if given and draw < share:
                chosen: Composed = self.pick(given)
                return self.misspelt(replace(chosen, pieces=list(chosen.pieces)))
            draw -= share
        if self.chance(0.14):
            return self.misspelt(self.clip())
        draw = self.rng.random()
        count = 1 if draw < 0.47 else 2 if draw < 0.84 else 3 if draw < 0.96 else 4
        clauses = [self.clause() for _ in range(count)]
        composed = Composed([(clauses[0][0], 0)], [(action, 0, fields) for action, fields in clauses[0][1]])
        for index, (text, said) in enumerate(clauses[1:], 1):
            kinds = ("joins", "turned joins", "together")
            kind = kinds[int(self.rng.choice(3, p=(0.76, 0.04, 0.2)))] if count == 2 else "joins"
            composed = self.joined(composed, (text, index), kind)
            composed.said += [(action, index, fields) for action, fields in said]
        if any(said and all(name not in self.phrases for name, _ in said) for _, said in clauses):
            composed.open = frozenset(("actions",))
        composed.open |= _aside(composed.said) | self.beside(composed.said)
        if count == 1 or self.chance(0.3):
            if self.chance(0.16):
                composed.pieces.insert(0, (self.pick(self.grammar["before"]), -1))
            if self.chance(0.2):
                composed.pieces.append((self.pick(self.grammar["behind"]), -1))
        return self.misspelt(composed)

    def joined(self, first: Composed, second: tuple[str, int], kind: str) -> Composed:
        pieces: list[tuple[str, int]] = []
        for part in self.pick(self.grammar[kind]).split():
            pieces += first.pieces if part == "{0}" else [second] if part == "{1}" else [(part, -1)]
        return Composed(pieces, first.said)

    def misspelt(self, composed: Composed) -> Composed:
        """The sentence with a letter wrong, now and then."""
        if self.chance(0.07):
            at = int(self.rng.integers(len(composed.pieces)))
            words = composed.pieces[at][0].split()
            index = int(self.rng.integers(len(words)))
            word, spot = words[index], int(self.rng.integers(1, max(len(words[index]) - 1, 2)))
            if len(word) > 3:
                swapped = word[:spot] + word[spot + 1 : spot + 2] + word[spot] + word[spot + 2 :]
                words[index] = self.pick((swapped, word[:spot] + word[spot + 1 :], word[:spot] + word[spot - 1 :]))
                composed.pieces[at] = (" ".join(words), composed.pieces[at][1])
        return composed

    def clause(self) -> tuple[str, list[tuple[str, Fields]]]:
        """A clause, and what it says."""
        if self.dealt and self.chance(0.25):
            text = self.pick(self.dealt[int(self.rng.choice(len(self.dealt), p=self.dealt_shares))])
            return text, self.dealings[text]
        draw = self.rng.random()
        if draw < 0.07:
            mood = self.chance(0.25)
            text = self.pick(self.grammar["moods"] if mood else self.phrases[NOTHING])
            return text if mood else self.spoken(plain_words(text)), []
        if draw < 0.35:
            text, said = self.filled(self.row("templates"))
        else:
            action = self.actions[int(self.rng.choice(len(self.actions), p=self.weights))]
            phrase = self.pick(self.phrases[action])
            text = plain_words(phrase)
            said = [(action, told(text, action)), *self.dealings.get(phrase, ())]
        text = self.spoken(text)
        return self.modified(text, *said[0]) if len(said) == 1 else (text, said)

    def beside(self, said: Sequence[tuple[str, int, Fields]]) -> frozenset[str]:
        """What else may be said: something done with things where an action is that, labelled or not."""
        return frozenset(["dealings"] * any(action in self.handling for action, _, _ in said))

    def row(self, name: str) -> dict[str, Any]:
        """One of the grammar's rows, by their shares."""
        rows = self.grammar[name]
        ends = np.cumsum([row["share"] for row in rows])
        chosen: dict[str, Any] = rows[int(np.searchsorted(ends, self.rng.random() * ends[-1], side="right"))]
        return chosen

    def filled(self, row: Mapping[str, Any]) -> tuple[str, list[tuple[str, Fields]]]:
        """A text in one of the forms of a row, and what that says.

        Args:
            row: "forms" have names of the grammar's lists, or of what varies, in braces, and after a point the part of
                a list, itself with "$" where that varies; "says" has actions and their fields, with "$", too. A field
                that varies and is not in the text is "?".
        """
        values, said = {name: self.pick(some) for name, some in row["vary"].items()}, self.grammar
        used: set[str] = set()

        def fill(match: re.Match[str]) -> str:
            name, _, key = match[1].partition(".")
            used.update((name, key.removeprefix("$"), "side" if name == "s" else ""))
            if name in values or name == "s":
                return str(values["side"][0] if name == "s" else values[name])
            some = said[name][values.get(key[1:], key)] if key else said[name]
            return _SLOT.sub(fill, self.pick(some))

        text, frames = _SLOT.sub(fill, self.pick(row["forms"])), []
        for action, told_of in row["says"]:
            action = values.get(action[1:], action)
            given = {f"${name}": value if name in used else "?" for name, value in values.items()}
            known = {name: given.get(value, value) for name, value in told_of.items()}
            usual = said["of actions"]["posture"]
            posture = known.get("posture") or usual.get(action) or usual.get(values.get("gait", ""), "")
            action = said["in posture"].get(f"{action} {posture}", action)
            known |= {"posture": posture} if posture else {}
            frames.append((action, _none() | {name: _value(name, value) for name, value in known.items()}))
        return text, frames

    def spoken(self, text: str) -> str:
        """A phrase with its first verb in another form, and with a subject."""
        first, _, rest = text.partition(" ")
        if first.lower() in ("is", "gets", "was", "being") and self.chance(0.6):
            return f"{self.pick(self.grammar['subjects'])} {'is ' * (first.lower() == 'being')}{text}"
        forms = _forms().get(first.lower())
        if forms is None or len(forms) < 3 or self.chance(0.4):
            return f"{self.pick(self.grammar['performs'])} {text}" if self.chance(0.12) else text
        form = int(self.rng.integers(3))
        before = (
            self.pick(self.grammar["orders"]) if form == 0 else self.pick(self.grammar["subjects"])
        ) if self.chance(0.5) else ""  # fmt: skip
        return f"{before} {'is ' if form == 2 and before else ''}{forms[form]} {rest}".strip()

    def modified(
        self, text: str, action: str, fields: Fields, name: bool = False
    ) -> tuple[str, list[tuple[str, Fields]]]:
        """A clause with more said of it, in one of the fields of which it says nothing.

        Args:
            text: The clause.
            action: What it says.
            fields: What of it; changed.
            name: Whether it is the name of a clip, where side, way and posture are said often, and by codes.
        """
        said, part = self.grammar, lexicon().actions[action].part if action in lexicon().actions else ""
        limb = said["parts"].get(part.split()[0] if part else "")
        free, often = {known for known, value in fields.items() if value == 0}, 2 if name else 1
        lists = ("side codes", "codes", "codes", "poses") if name else ("sides", "directions", "aims", "postures")
        sides, ways, aims, postures = (said[listed] for listed in lists)
        if limb and "side" in free and self.chance(0.15 * often):
            side = self.pick(FIELDS["side"])
            word, fields["side"] = self.pick(sides[side]).format(part=limb), _value("side", side)
            text = f"{text} {word}" if self.chance(0.7) else f"{word} {text}"
        if action in said["travels"] and "direction" in free and self.chance(0.4 * often):
            way = self.pick([one for one in FIELDS["direction"] if one != "circle"])
            before = self.chance(0.15) and way in FIELDS["direction"][:2]
            word, fields["direction"] = self.pick(ways[way]), _value("direction", way)
            text = f"{word} {text}" if before else f"{text} {word}"
        elif action in said["aiming"] and "direction" in free and not (name and limb) and self.chance(0.33 * often):
            way = self.pick(tuple(said["aims"]))
            text, fields["direction"] = f"{text} {self.pick(aims[way])}", _value("direction", way)
        if {"degrees", "turn side", "direction"} <= free and not fields["direction"] and self.chance(0.045):
            row = self.row("turned")
            text, ((_, turn),) = self.filled({**row, "vary": {**row["vary"], "0": [text]}})
            fields |= {known: turn[known] for known in ("turn side", "degrees")}
        for known in () if name else ("count", "speed"):
            if known in free and self.chance(0.09):
                value = self.pick([one for one in FIELDS[known] if one in said[f"{known}s"]])
                word = self.pick(said[f"{known}s"][value])
                before = known == "speed" and self.chance(0.4)
                text, fields[known] = f"{word} {text}" if before else f"{text} {word}", _value(known, value)
        if "posture" in free and (part or action in ("idle", "talk")) and self.chance(0.15 * often):
            posture = self.pick(FIELDS["posture"][:5])
            word, action = self.pick(postures[posture]), said["in posture"].get(f"{action} {posture}", action)
            text = f"{word} {text}" if name or self.chance(0.5) else f"{text} {word}"
            fields["posture"] = _value("posture", posture)
        if self.chance(0.07) and not name:
            text = f"{text} {self.pick(said['tails'])}"
        return text, [(action, fields)]

    def clip(self) -> Composed:
        """The name of a clip as game makers write it: what is held, posture, action, way and angle, abbreviated in any
        way, and in many orders.
        """
        text, frames = self.named() if self.chance(0.35) else self.filled(self.row("clips"))
        before, held, behind = (
            [self.pick(self.grammar[name])] * self.chance(share)
            for name, share in (("before", 0.15), ("held", 0.3), ("behind", 0.25))
        )
        text = plain_words(" ".join((*before, *held, text, *behind)))
        said = [(action, 0, fields) for action, fields in frames]
        return Composed([(text, 0)], said, self.beside(said))

    def named(self) -> tuple[str, list[tuple[str, Fields]]]:
        """Any action, with its side, way or posture, in the name of a clip."""
        action = self.actions[int(self.rng.choice(len(self.actions), p=self.weights))]
        text = plain_words(min((self.pick(self.phrases[action]) for _ in range(3)), key=len))
        return self.modified(text, action, told(text, action), name=True)


def _none() -> Fields:
    return dict.fromkeys(FIELDS, 0) | dict.fromkeys(("height", "surface"), UNKNOWN)


def _value(name: str, value: str) -> int:
    return 1 + FIELDS[name].index(value)
