"""What happens one after the other in a sentence: "a person walks, then waves" is "a person walks" and "a person
waves".

Each clause is generated from its own words, as the prompts of a sequence are: conditioned on "then", the network often
does only one of both. Words that say order part a sentence, and commas between verbs; "walks and waves" is for
`body_part_prompts`.
"""

from __future__ import annotations

import functools
import re

from bunraku.language.actions import actions_of
from bunraku.language.captions import known_clauses, known_verbs
from bunraku.language.captions.grammar import conjugate

__all__ = [
    "SHORTEST_CLAUSE",
    "clause_verbs",
    "of_creature",
    "of_person",
    "split_clauses",
    "subject_of",
    "timed_clauses",
    "with_subject",
]

ONCE = {
    "jump": 2.0, "long jump": 2.3, "kick": 2.0, "reach": 2.2, "sword": 1.6, "pick up": 3.2, "put down": 2.7,
    "stand up": 2.5, "raise arm": 2.5, "turn": 2.0, "turn around": 2.5, "fall": 2.4, "roll": 2.0, "cartwheel": 3.0,
    "flip": 2.0, "throw": 2.4, "kneel": 2.5, "catch": 2.4, "bow": 2.5, "lunge": 1.8, "shoot": 1.8, "shoot a ball": 3.0,
    "salute": 2.2, "point": 2.2, "shrug": 2.0, "kiss": 2.5, "thumbs up": 2.4, "stop": 2.4, "facepalm": 2.6,
    "shake hands": 2.6, "high five": 2.0, "hug": 3.2, "sneeze": 2.3, "cast": 2.8, "open door": 2.5, "watch": 2.4,
    "photo": 2.9, "yawn": 3.2, "propose": 3.4, "both knees": 3.2, "pitch": 3.0, "serve": 3.2, "bat": 3.2, "golf": 3.8,
    "stumble": 3.2, "jump over": 2.5,
}  # fmt: skip
"""How long captured people take for what is done once [s], by the words of `language.actions`: medians, rounded up."""
_FIRST = {"turn", "turn around", "stand up"}
_WHEELS = {"jump", "hop", "kick", "spin", "circle", "dance", "ballet", "salsa", "backward", "sidestep", "idle", "talk"}
"""What goes together with a turn."""
_GOES = {"walk", "run", "march", "sneak", "backward", "sidestep", "skip", "circle"}
_STOPS = {
    "salute", "look far", "bow", "kneel", "both knees", "propose", "pray", "stop", "facepalm", "hands on hips",
    "shake hands", "high five", "hug", "photo", "knock", "open door", "write", "cast", "stretch", "pick up", "put down",
    "throw", "jump over", "ladder", "golf", "bat", "pitch", "serve", "piano", "shoot", "sit", "lie", "fall", "squat",
    "push-up", "sit-up", "stumble",
}  # fmt: skip
"""What people who go stop for, if it is not said that they do both at once."""
GOING, LEAST_GOING = 2.5, 1.5
"""Time that goes on doing something is worth beside these, and the least that it gets before they get less [s]."""
SHORTEST_CLAUSE = 1.0
"""Seconds under which clauses are too short to be done one by one; the sentence stays whole then."""

_LATER = r"(?:then|after\s+that|after\s+this|after\s+which|afterwards?|finally|lastly|next(?!\s+to)|subsequently)"
_ORDER = re.compile(
    rf"\s*[.!]+\s+(?:(?:and\s+)?{_LATER}\b,?\s+)?(?=[a-z])"  # "He walks. Then he jumps."
    rf"|\s*,?\s*(?<!now)(?<!now )\b(?:and|but)\s+{_LATER}\b\s*,?\s*"  # "walks and then jumps"
    rf"|\s*,\s*{_LATER}\b\s*,?\s*"  # "walks, then jumps"
    r"|\s*(?<!now and)(?<!\bor)(?<!\beven)(?<!\buntil)(?<!\bsince)(?<!\bback)(?<!\bby)\s+then\s+"  # "walks then jumps"
    r"|\s*,?\s*\bfollowed\s+by\s+",
    re.IGNORECASE,
)
_OPENING = re.compile(rf"^(?:(?:at\s+)?first(?:ly)?\b|{_LATER}\b|to\s+begin\s+with\b)\s*,?\s*", re.IGNORECASE)
_BEGINS = re.compile(r"\b(?:starts|begins|start|begin)\s+(?:off\s+)?by\s+(?=\w+ing\b)", re.IGNORECASE)
_AFTER_FIRST = re.compile(r"^after\s+(?:having\s+)?(?P<earlier>[^,]+?),\s*(?P<later>.+)$", re.IGNORECASE | re.DOTALL)
_HINGE = re.compile(
    r"\s*,?\s+(?P<word>before|after)\s+(?:having\s+)?(?P<rest>(?!landing|being).+)$", re.IGNORECASE | re.DOTALL
)
_COMMA = re.compile(r"\s*,\s*(?:and\s+)?", re.IGNORECASE)
_NOUN = (
    r"(?:(?:a|an|the|one|this|that|my|our|his|her|their|its)\s+(?:(?!(?:and|or)\b)[\w'-]+\s+){1,3}?"
    r"|(?:someone|somebody|he|she|it|they)\s+)"
)
_MORE_VERBS = (
    "approach", "bark", "beckon", "blow", "brush", "chase", "check", "comb", "conduct", "cook", "cough", "cover",
    "cross", "cry", "dab", "descend", "dig", "draw", "drum", "enter", "escape", "facepalm", "flee", "flex", "fold",
    "grow", "growl", "hiss", "howl", "hug", "hunt", "kiss", "knock", "photograph", "pour", "pray", "propose", "read",
    "relax", "salute", "scream", "search", "shade", "shiver", "shout", "shrug", "sigh", "smile", "sneeze", "sniff",
    "sob", "speed", "stalk", "stir", "strum", "surrender", "tremble", "try", "type", "wake", "weep", "write", "yawn",
    "yell",
)  # fmt: skip
_NO_VERB = re.compile(
    r"(?:left|right|forwards?|backwards?|back(?!\s+(?:up|away|off))|sideways|to|towards?|into|onto|in|on|at|around|up|down|away|out|off|again|over|with|from"
    r"|the\s+other|another|some|for|once|twice|faster|slower|more|less|higher|lower)\b",
    re.IGNORECASE,
)
_ADVERBS = r"(?:(?:\w+ly|also|again)\s+)*"


def clause_verbs() -> frozenset[str]:
    """Verbs that a clause may begin with, plain."""
    return known_verbs() | frozenset(_MORE_VERBS)


_PEOPLE = re.compile(
    r"(an? |the |this |that )?(old |young |tired |happy |sad )?"
    r"(person|someone|somebody|man|woman|boy|girl|guy|human|character|figure|he|she|they|people|body)"
)


@functools.cache
def _forms() -> tuple[str, str, str]:
    """Patterns of a verb in the third person, as a gerund, and plain."""

    def pattern(words: set[str]) -> str:
        return r"(?:" + "|".join(sorted(map(re.escape, words), key=len, reverse=True)) + r")\b"

    verbs = clause_verbs()
    third, gerund = ({conjugate(f"{{{verb}}}", form) for verb in verbs} for form in ("third", "gerund"))
    return pattern(third), pattern(gerund), pattern(set(verbs))


@functools.cache
def _begins(what: str) -> re.Pattern[str]:
    """What begins a clause: a "subject", a verb in the "third" person, as a "gerund" or "plain", any "clause", or a
    "finite" one. Each is compiled when it is asked for first: with all verbs in them that takes a tenth of a second.
    """
    third, gerund, plain = _forms()
    text = {
        "subject": rf"(?P<subject>{_NOUN})(?={_ADVERBS}(?:{third}|{gerund}|is\s+|are\s+))",
        "third": rf"{_ADVERBS}{third}",
        "gerund": rf"{_ADVERBS}{gerund}",
        "clause": rf"(?:{_NOUN})?{_ADVERBS}(?:{third}|{gerund}|{plain}|is\s|are\s)",
        "plain": rf"{_ADVERBS}{plain}",
        "finite": rf"{_NOUN}{_ADVERBS}(?:{third}|is\s|are\s)",
    }[what]
    return re.compile(text, re.IGNORECASE)


def split_clauses(sentence: str) -> list[str]:
    """What a sentence says in order of time, one clause each; the sentence alone where nothing in it says order.

    A clause without a subject gets that of the one before, so that "a horse gallops, then eats" stays with the horse.

    Args:
        sentence: A prompt in English.
    """
    text = " ".join(sentence.replace('"', " ").split())
    if subject_of(text)[1].lower().removeprefix("is ").rstrip(" .") in known_clauses():
        return [sentence]  # training knows it as it is
    parts = _ORDER.split(_BEGINS.sub("", text))
    pieces = [piece for part in parts for piece in _hinged(part)]
    items = [item for piece in pieces for item in _listed(piece, len(pieces) > 1)]
    clauses: list[str] = []
    for item in (item for one in items for item in _turned_first(one)):
        clause = _OPENING.sub("", item).strip(" ,.;!")
        if clauses and clause and (_NO_VERB.match(clause) or not clause[0].isalpha()):
            clauses[-1] += f", then {clause}"  # "runs left, then right"
        elif clause:
            clauses.append(clause)
    if len(clauses) < 2:
        return [sentence]
    subject, named = "", []
    for clause in clauses:
        own = subject_of(clause)[0]
        subject = own or subject
        named.append(clause if own else with_subject(clause, subject))
    return named


def subject_of(clause: str) -> tuple[str, str]:
    """Its subject, "" where it has none, and the rest."""
    found = _begins("subject").match(clause)
    return (found["subject"].strip(), clause[found.end() :]) if found else ("", clause)


def of_creature(clause: str) -> str:
    """What is said of a person, or of nobody, said of the creature that does it: "a person walks" as "it walks".

    Conditioned on a person's words, the network lets a dog walk as people do. A creature that is named stays.
    """
    subject, rest = subject_of(clause)
    if not subject:
        return with_subject(clause, "it")
    return f"it {rest}" if _PEOPLE.fullmatch(subject.lower()) else clause


def of_person(clause: str) -> str:
    """The clause with "a person" for whoever does it, where that says nothing of how: "a guard marches" as "a person
    marches". "A drunk man walks" stays.

    A sentence encoder takes "guard" for a stance of boxers.
    """
    subject, rest = subject_of(clause)
    return clause if not subject or actions_of(subject) else f"a person {rest}"


def timed_clauses(sentence: str, seconds: float) -> list[tuple[str, float]]:
    """The clauses of a sentence with their shares of its seconds; the sentence itself where an even share is under a
    second.

    What is done once gets the time that it takes (`ONCE`), and what goes on (walking, waving) shares the rest evenly.
    Where there is not enough time, or nothing goes on, all get more or less in proportion.
    """
    clauses = split_clauses(sentence)
    if seconds / len(clauses) < SHORTEST_CLAUSE:
        return [(sentence, seconds)]
    once = [_time_of(clause) for clause in clauses]
    going = once.count(0.0)
    rest = seconds - sum(once)
    if going and rest >= going * LEAST_GOING:
        times = [time or rest / going for time in once]
    else:
        worth = [time or GOING for time in once]
        times = [seconds * time / sum(worth) for time in worth]
    short = min(times) < SHORTEST_CLAUSE
    return [(clause, seconds / len(clauses) if short else time) for clause, time in zip(clauses, times, strict=True)]


def _time_of(clause: str) -> float:
    """Time that a clause takes when it is done once [s]; 0 for what goes on."""
    times = [ONCE.get(action, 0.0) for action in actions_of(clause)]
    return max(times) if times and min(times) > 0 else 0.0


def _hinged(piece: str) -> list[str]:
    """A piece parted at "before" and "after", in the order in which things happen."""
    found = _AFTER_FIRST.match(piece)
    if found and _begins("gerund").match(found["earlier"]) and _begins("clause").match(found["later"]):
        return [found["earlier"], *_hinged(found["later"])]
    for found in re.finditer(_HINGE, piece):
        rest = found["rest"]
        if found.start() and (_begins("gerund").match(rest) or _begins("finite").match(rest)):
            head = piece[: found.start()]
            return [head, *_hinged(rest)] if found["word"].lower() == "before" else [*_hinged(rest), head]
    return [piece]


def _listed(piece: str, ordered: bool) -> list[str]:
    """A list such as "a man walks, turns around and waves" as its clauses, where each begins with a verb of one form
    ("walks, looking down" does not). Only commas make a list: "walks and waves" is none. Nouns may look like verbs
    ("dances with steps, turns and jumps"), so where nothing else in the sentence says order, a list after "with" or
    "of" is none either.
    """
    first, *others = _COMMA.split(piece)
    if not ordered and re.search(r"\b(?:with|of)\b|:", first):
        return [piece]
    begin = subject_of(_OPENING.sub("", first))[1]
    for form in ("third", "gerund", "plain") if others else ():
        verb = _begins(form)
        if all(verb.match(item) for item in (begin, *others)):
            head, _, last = others[-1].rpartition(" and ")
            return [first, *others[:-1], head, last] if head and verb.match(last) else [first, *others]
    return [piece]


def _turned_first(piece: str) -> list[str]:
    """ "turns around and waves" and "walks forward and salutes" as their two halves, where nobody does the second while
    he does the first: after a turn or getting up anything, and after a walk what people stop for. "Walks and waves" is
    one.
    """
    head, joint, last = piece.rpartition(" and ")
    if not joint or " and " in head or "," in piece or " while " in piece:
        return [piece]
    begin = subject_of(_OPENING.sub("", head))[1]
    if not any(_begins(form).match(begin) and _begins(form).match(last) for form in ("third", "gerund", "plain")):
        return [piece]
    first, second = set(actions_of(head)), set(actions_of(last))
    turned = first and first <= _FIRST and second and not second & (_FIRST | _WHEELS)
    stopped = first and first <= _GOES and second and second <= _STOPS
    return [head, last] if turned or stopped else [piece]


def with_subject(clause: str, subject: str) -> str:
    """A clause that begins with its verb as one of this subject; others, and all without a subject, stay as they
    are.
    """
    if not subject:
        return clause
    if _begins("third").match(clause):
        return f"{subject} {clause}"
    return f"{subject} is {clause}" if _begins("gerund").match(clause) else clause
