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
    """Actions that it may name, too."""

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
                made.append(Composed([(text, -1)], said))
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
                for text in map(plain_words, (*stretch["texts"], *asked.get(f"{name}#{index}", ()))):
                    made.append(Composed([(text, -1)], said, frozenset(labels[key][1])))
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
        labelled: Whole sentences that are taken as they are, all that they say being known.
    """

    def __init__(
        self,
        phrases: dict[str, list[str]],
        watched: Sequence[Composed],
        seed: int,
        labelled: Sequence[Composed] = (),
    ):
        self.labelled = labelled
        self.phrases, self.watched, self.rng = phrases, watched, np.random.default_rng(seed)
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
        if self.chance(0.01):
            return self.misspelt(self.returned())
        draw = self.rng.random()
        count = 1 if draw < 0.5 else 2 if draw < 0.89 else 3
        clauses = [self.clause() for _ in range(count)]
        composed = Composed([(clauses[0][0], 0)], [(action, 0, fields) for action, fields in clauses[0][1]])
        for index, (text, said) in enumerate(clauses[1:], 1):
            kinds = ("joins", "turned joins", "together")
            kind = kinds[int(self.rng.choice(3, p=(0.76, 0.04, 0.2)))] if count == 2 else "joins"
            composed = self.joined(composed, (text, index), kind)
            composed.said += [(action, index, fields) for action, fields in said]
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
        draw, said = self.rng.random(), self.grammar
        if draw < 0.15:
            return self.gait()
        if draw < 0.18:
            action, fields = "idle", _none()
            text = (
                f"{self.pick(said['held'])} {self.pick(said['stand words'])}"
                if self.chance(0.6)
                else self.pick(said["stand words"])
            )
        elif draw < 0.235:
            return self.turn()
        elif draw < 0.255:
            return self.glance()
        elif draw < 0.265:
            return self.stairs()
        elif draw < 0.28:
            way = "starts" if self.chance(0.4) else "stops"
            gait = self.pick(("walk", "run"))
            text = self.pick(said[way]).format(gait=self.pick(said["gait words"][gait]))
            pair = [("idle", _none()), (gait, _none())]
            return text, pair if way == "starts" else pair[::-1]
        elif draw < 0.35:
            if self.chance(0.25):
                return self.pick(said["moods"]), []
            return self.spoken(plain_words(self.pick(self.phrases[NOTHING]))), []
        else:
            action = self.actions[int(self.rng.choice(len(self.actions), p=self.weights))]
            text = plain_words(self.pick(self.phrases[action]))
            fields = told(text, action)
            text = self.spoken(text)
        return self.modified(text, action, fields)

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

    def modified(self, text: str, action: str, fields: Fields) -> tuple[str, list[tuple[str, Fields]]]:
        """A clause with more said of it, in one of the fields of which it says nothing."""
        said, part = self.grammar, lexicon().actions[action].part if action in lexicon().actions else ""
        limb = said["parts"].get(part.split()[0] if part else "")
        free = {name for name, value in fields.items() if value == 0}
        if limb and "side" in free and self.chance(0.15):
            side = self.pick(FIELDS["side"])
            way = self.pick(said["sides"][side]).format(part=limb)
            text, fields["side"] = (
                (f"{text} {way}" if self.chance(0.7) else f"{way} {text}"),
                _value("side", side),
            )
        if action in said["travels"] and "direction" in free and self.chance(0.3):
            way = self.pick([one for one in FIELDS["direction"] if one != "circle"])
            before = self.chance(0.15) and way in FIELDS["direction"][:2]
            word, fields["direction"] = self.pick(said["directions"][way]), _value("direction", way)
            text = f"{word} {text}" if before else f"{text} {word}"
        elif action in said["aiming"] and "direction" in free and self.chance(0.25):
            way = self.pick(tuple(said["aims"]))
            text, fields["direction"] = f"{text} {self.pick(said['aims'][way])}", _value("direction", way)
        if {"degrees", "turn side", "direction"} <= free and not fields["direction"] and self.chance(0.045):
            text = self.turned(text, fields)
        for name in ("count", "speed"):
            if name in free and self.chance(0.07):
                value = self.pick([one for one in FIELDS[name] if one in said[f"{name}s"]])
                word = self.pick(said[f"{name}s"][value])
                before = name == "speed" and self.chance(0.4)
                text, fields[name] = f"{word} {text}" if before else f"{text} {word}", _value(name, value)
        if "posture" in free and (part or action in ("idle", "talk")) and self.chance(0.15):
            posture = self.pick(FIELDS["posture"][:5])
            word, action = self.pick(said["postures"][posture]), said["in posture"].get(f"{action} {posture}", action)
            text = f"{word} {text}" if self.chance(0.5) else f"{text} {word}"
            fields["posture"] = _value("posture", posture)
        if self.chance(0.07):
            text = f"{text} {self.pick(said['tails'])}"
        return text, [(action, fields)]

    def gait(self) -> tuple[str, list[tuple[str, Fields]]]:
        """A person goes somewhere: backwards and sideways are actions of their own, whatever the gait."""
        said, fields = self.grammar, _none()
        action = self.pick(said["gaits"]) if self.chance(0.4) else self.pick(("walk", "walk", "run"))
        text = self.pick(said["gait words"][action])
        if self.chance(0.25):
            text = f"{self.pick(said['held'])} {text}"
        if self.chance(0.65):
            way = self.pick(FIELDS["direction"][:8])
            word = self.pick(said["directions"][way])
            fields["direction"] = _value("direction", way)
            aside = way in ("left", "right")
            if self.chance(0.25):  # "strafe" turns any gait into a step aside, but not forwards
                text, aside = f"{text} {self.pick(said['strafes'])}", way in ("left", "right")
            text = f"{word} {text}" if self.chance(0.15) else f"{text} {word}"
            if action == "crouch walk" or ((aside or way.startswith("backward")) and "crouch" in text):
                fields["posture"] = _value("posture", "crouching")
            action = "sidestep" if aside else "backward" if way.startswith("backward") else action
        elif self.chance(0.15):
            turned, more = self.turn()
            return f"{text} {turned}", [(action, fields), *more]
        elif self.chance(0.15):
            side = self.pick(("left", "right", "?"))
            ways = said["directions"]["circle"] if side == "?" else said["circles turning"][side]
            text, fields["direction"] = f"{text} {self.pick(ways)}", len(FIELDS["direction"])
            if side != "?":
                fields["turn side"], fields["degrees"] = _value("turn side", side), _value("degrees", "?")
            return self.spoken(text), [("circle", fields)]
        return self.modified(self.spoken(text), action, fields)

    def stairs(self) -> tuple[str, list[tuple[str, Fields]]]:
        """A person climbs up or down."""
        said, fields = self.grammar, _none()
        action, way = self.pick(("climb", "ladder")), self.pick(("up", "down"))
        text = self.pick(said["climbs"][way]).format(self.pick(said["climbed"][action]))
        fields["direction"] = _value("direction", way)
        return self.modified(self.spoken(text), action, fields)

    def returned(self) -> Composed:
        """A person turns around and goes back, which is forward."""
        said, fields, around = self.grammar, _none(), _none()
        gait = self.pick(said["gaits"]) if self.chance(0.5) else self.pick(("walk", "run"))
        go = self.spoken(f"{self.pick(said['gait words'][gait])} {self.pick(said['returns'])}")
        fields["direction"], around["degrees"] = _value("direction", "forward"), _value("degrees", "180")
        around["turn side"] = _value("turn side", "?")
        first, joint = self.spoken(self.pick(said["turns back"])), self.pick(("and", "then", ", then", ",", "and then"))
        pieces, second = [(first, 0), (joint, -1), (go, 1)], 1
        if self.chance(0.5):
            out = self.pick(("walk", "run"))
            pieces = [(self.spoken(self.pick(said["gait words"][out])), 2), (",", -1), *pieces]
            return Composed(pieces, [(out, 2, _none()), ("turn around", 0, around), (gait, second, fields)])
        return Composed(pieces, [("turn around", 0, around), (gait, second, fields)])

    def turn(self) -> tuple[str, list[tuple[str, Fields]]]:
        """A person turns."""
        said, fields = self.grammar, _none()
        action, side, degrees = (
            self.pick(tuple(said["turns"])),
            self.pick(("left", "right")),
            self.pick(said["degrees"]),
        )
        way = self.pick(said["turns"][action])
        text = way.format(side=side, s=side[0], degrees=degrees)
        quarter = "90" if "quarter" in way else "?"
        angle = {"turn around": "180", "spin": "360"}.get(action, degrees if "{degrees}" in way else quarter)
        fields["degrees"] = _value("degrees", angle)
        fields["turn side"] = _value("turn side", side if "{s" in way else "?")
        posture = self.pick(("", "", "", "", "", "crouching", "sitting"))
        if posture:
            word, fields["posture"] = self.pick(said["postures"][posture]), _value("posture", posture)
            text = f"{word} {text}" if self.chance(0.6) else f"{text} {word}"
        return self.spoken(text), [(action, fields)]

    def turned(self, text: str, fields: Fields) -> str:
        """A clause with a turn that its action contains."""
        kind, side = self.pick(tuple(self.grammar["turned"])), self.pick(("left", "right"))
        sided = kind.endswith("side")
        fields["turn side"] = _value("turn side", side if sided else "?")
        fields["degrees"] = _value("degrees", kind.split()[0] if kind[0].isdigit() else "?")
        return str(self.pick(self.grammar["turned"][kind]).format(text, side=side))

    def glance(self) -> tuple[str, list[tuple[str, Fields]]]:
        """Eyes and head go to a side, or to both, and the body stays."""
        side, fields = self.pick(("left", "right")), _none()
        if self.chance(0.2):
            return self.modified(self.spoken(self.pick(self.grammar["glances around"])), "look around", fields)
        text = self.pick(self.grammar["glances"]).format(side=side, s=side[0])
        fields["direction"] = _value("direction", side)
        return self.modified(self.spoken(text), "look aside", fields)


def _none() -> Fields:
    return dict.fromkeys(FIELDS, 0)


def _value(name: str, value: str) -> int:
    return 1 + FIELDS[name].index(value)
