"""A sentence as clauses: what happens one after the other, and what happens at the same time."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence

from bunraku.core.request import SECONDS, USUAL
from bunraku.language.captions import is_known_clause
from bunraku.language.interactions import Handling, interaction_of, read_as, with_names
from bunraku.language.lexicon import actions_of, lexicon, longest_pattern, said_cues, said_traits, words_of
from bunraku.language.limb_phrases import names_limb
from bunraku.language.phrasing import count_of
from bunraku.language.posing import Posing, posing_of

GOING, LEAST_GOING = 2.5, 1.5
"""Seconds that walking and the like are worth beside what is done once, and the least that they get before all get
less; chosen by eye.
"""
ROUND = 1.1
"""Seconds of one round of what goes on, where rounds are counted: the median of captured loops of people who wave, nod,
shake the head, limp or walk two steps.
"""
ENDING = 0.6
"""Seconds for which a person stays as they are after what is done once; chosen by eye."""
SURELY = 0.7
"""Probability from which a half of "idle to crouch" is taken for something that is done; chosen by eye."""
SHORTEST_CLAUSE = 1.0
"""Seconds under which clauses are too short to be done one by one; the sentence stays whole then. Chosen by eye."""

_LONGEST_NAME = 3
"""Words of a subject behind an article."""


def _joint(words: Sequence[str], at: int, kind: str) -> int:
    """The number of the word after a joint of a kind of the lexicon that stands here; 0 where none does."""
    joints = [joint for joint in lexicon().joints.starting(words[at]) if joint.name == kind]
    joint = longest_pattern(joints, words, at)
    return joint[1] if joint and (*words, "on")[joint[1]][0].isalpha() else 0


def _pieces(text: str, kind: str) -> list[tuple[str, str]]:
    """What stands between the joints of a kind in a text, each behind the joint before it."""
    words, spans = words_of(text)
    pieces, joint, start = list[tuple[str, str]](), "", 0
    for at in range(1, len(words)):
        if spans[at][0] > start and (after := _joint(words, at, kind)):
            pieces.append((joint, text[start : spans[at - 1][1]]))
            start = spans[after][0] if after < len(words) else len(text)
            joint = text[spans[at - 1][1] : start]
    return [*pieces, (joint, text[start:])]


def _opened(text: str) -> str:
    """A text without what says its place in an order: "first, he walks"."""
    words, spans = words_of(text)
    after = _joint(words, 0, "first") if words else 0
    return text[spans[after - 1][1] :].strip() if after else text


def _goes_on(text: str) -> bool:
    """Whether a text only goes on with what was said: "then to the right"."""
    words = words_of(text)[0]
    return not words or not words[0][0].isalpha() or bool(_joint(words, 0, "on"))


def _begins(text: str, *forms: str) -> bool:
    """Whether a text begins with a verb in one of some forms, adverbs before it apart: "third", "gerund", "plain",
    "past", or "is" for "is" and "are" before something else.
    """
    return _verb(words_of(text)[0], *forms) is not None


def _verb(words: Sequence[str], *forms: str) -> int | None:
    """The number of the verb that some words begin with; None where they do not."""
    table = lexicon()
    known = {"third": table.third, "gerund": table.gerund, "plain": table.verbs, "past": table.past}
    for number, word in enumerate(words):
        for form in forms:
            if form != "is" and word in known[form]:
                return number
        if "is" in forms and word in ("is", "are") and number + 1 < len(words):
            return number
        if not (word in ("also", "again") or (word.endswith("ly") and len(word) > 2)):
            return None
    return None


def split_clauses(sentence: str) -> list[str]:
    """What a sentence says in order of time, one clause each; the sentence alone where nothing in it says order.

    A clause without a subject gets that of the one before, so that "a horse gallops, then eats" stays with the horse.

    Args:
        sentence: A prompt in English.
    """
    text = " ".join(sentence.replace('"', " ").split()).replace(". ", "; ").replace("! ", "; ")
    said = " ".join(piece for _, piece in _pieces(text, "by"))
    pieces = [piece for _, part in _pieces(said, "then") for piece in _hinged(part)]
    listed = [item for piece in pieces for item in _listed(piece, len(pieces) > 1)]
    clauses: list[str] = []
    for half in (half for item in listed for half in _turned_first(item)):
        clause = _opened(half).strip(" ,.;!")
        if clauses and clause and _goes_on(clause):
            clauses[-1] += f", then {clause}"  # "runs left, then right"
        elif clause:
            clauses.append(clause)
    if len(clauses) < 2 or is_known_clause(subject_of(text)[1].lower().removeprefix("is ").rstrip(" .")):
        return [sentence]  # nothing says order, or training knows it as it is
    subject, named = "", []
    for clause in clauses:
        own = subject_of(clause)[0]
        subject = own or subject
        named.append(clause if own else with_subject(clause, subject))
    return named


def subject_of(clause: str) -> tuple[str, str]:
    """Its subject, "" where it has none, and the rest."""
    names, stop = clause.split(None, _LONGEST_NAME + 1), 0
    if len(names) < 2:
        return "", clause
    first, grammar = names[0].lower(), lexicon().grammar
    most = 1 if first in grammar["subjects"] else _LONGEST_NAME + 1 if first in grammar["names"] else 0
    for number, name in enumerate(names[:most], 1):
        stop = clause.index(name, stop) + len(name)
        if number > 1 and name.lower() in ("and", "or", "of"):
            break
        if not name.replace("-", "").replace("'", "").replace("_", "").isalnum():
            break
        rest = clause[stop:].lstrip()
        if (number > 1 or most == 1) and _begins(rest, "third", "gerund", "is", "past"):
            return clause[:stop].strip(), rest
    return "", clause


def of_creature(clause: str) -> str:
    """A clause about a person, or without a subject, as one about a creature: "a person walks" as "it walks". A named
    creature stays.

    Conditioned on a person's words, the network lets a dog walk as people do.
    """
    subject, rest = subject_of(clause)
    if not subject:
        return with_subject(clause, "it")
    names = [word for word in subject.lower().split() if word not in ("a", "an", "the", "this", "that")]
    people, traits = lexicon().grammar["people"], lexicon().grammar["said of people"]
    is_person = names and names[-1] in people and len(names) < 3 and traits.issuperset(names[:-1])
    return f"it {rest}" if is_person else clause


def of_person(clause: str) -> str:
    """The clause with "a person" as its subject, if the subject says nothing of the motion: "a guard marches" as "a
    person marches", but "a drunk man walks" stays. "A chef cuts bread" becomes "a person cuts bread", since the arms
    cannot do both.

    A sentence encoder takes "guard" for a stance of boxers.
    """
    subject, rest = subject_of(clause)
    if not subject:
        return clause
    rows = lexicon().actions
    with_arms = any("arms" in rows[action].part for action in actions_of(rest))
    named = [action for action in actions_of(subject) if not (with_arms and "arms" in rows[action].part)]
    return clause if named else f"a person {rest}"


def as_caption(clause: str) -> str:
    """A clause without a subject as captions say it: "kick a ball" and "kicks a ball" as "a person kicks a ball".

    The network was trained on sentences of that form; of 40 captions made into commands, chosen motions find their
    sentence in 0.57, and in 0.62 as captions. What would say something else then ("sit ups") stays.
    """
    if subject_of(clause)[0]:
        return clause
    table = lexicon()
    words, spans = words_of(clause)
    verb = _verb(words, "third", "plain")
    if verb is None:
        return clause
    clause = clause[0].lower() + clause[1:]
    caption, copied = "a person ", 0
    for number, word in enumerate(words):  # "run and clap": the second verb, too
        if number == verb or (words[number - 1] in ("and", "or", ",") and words[verb] in table.verbs):
            form = table.verbs[word][0] if word in table.verbs else word
        elif word in ("your", "my"):
            form = "their"
        else:
            continue
        caption += clause[copied : spans[number][0]] + form
        copied = spans[number][1]
    caption += clause[copied:]
    same = all(read(caption) == read(clause) for read in (actions_of, said_cues, said_traits))
    return caption if same else clause


def as_parsed(text: str) -> str:
    """A sentence whose verbs are participles with finite verbs: "an old guard in a coat, walking and looking around" as
    "a person is walking and looking around", and "a person walking forward picks something up" as "a person is walking
    forward and picks something up".
    """
    subject, rest = subject_of(text)
    if not subject:
        words, spans = words_of(text)
        at = next((number for number in range(2, len(words)) if _verb(words[number:], "gerund") is not None), 0)
        described = text[: spans[at - 1][1]].rstrip(" ,")
        if not at or words[0] not in ("a", "an", "the") or {*".,;"} & {*described} or actions_of(described):
            return text
        subject, rest = "a person", text[spans[at][0] :]
        text = f"{subject} is {rest}"
    if _begins(rest, "third", "past"):
        return _finite(text)
    if not _begins(rest, "gerund"):
        return text
    words, spans = words_of(rest)
    along = lexicon().grammar["along"]
    for number, word in enumerate(words[2:], 2):
        before = words[number - 1]
        if word in lexicon().third and (before.endswith("ly") or before in along) and words[number - 2] != ",":
            start = spans[number][0]
            return f"{subject} is {rest[:start].rstrip()} and {rest[start:]}"
    return text


def _finite(text: str) -> str:
    """ "And is waving" as "and waves", since what was said before has a finite verb."""
    (words, spans), table = words_of(text), lexicon()
    for at in range(len(words) - 1, 1, -1):
        ongoing = words[at] in table.gerund and words[at - 1] in table.grammar["auxiliaries"]
        if ongoing and words[at - 2] in ("and", "then"):
            text = text[: spans[at - 1][0]] + table.verbs[table.lemmas[words[at]]][0] + text[spans[at][1] :]
    return text


def as_present(clause: str) -> str:
    """A clause in the past as one in the present, as captions are: "the man walked" as "the man walks"."""
    subject, rest = subject_of(clause)
    return f"{subject} {_now(rest)}" if subject else clause


def _now(predicate: str) -> str:
    """What begins with a verb in the past, in the present; others as they are."""
    words, spans = words_of(predicate)
    verb = _verb(words, "past")
    if verb is None:
        return predicate
    start, stop = spans[verb]
    return f"{predicate[:start]}{lexicon().verbs[lexicon().past[words[verb]]][0]}{predicate[stop:]}"


def handed_on(clauses: Sequence[tuple[str, float]]) -> list[tuple[str, float]]:
    """Clauses with their seconds, some of them joined: if a thing is taken in one and put somewhere in the next, since
    hands do not let go of it between; if one says more of a posture ("sits down", "crosses the legs"); and if limbs do
    both ("kneels", "raises both arms").

    Args:
        clauses: Texts in English, and seconds of each.
    """
    found: list[tuple[str, float]] = []
    for text, seconds in clauses:
        joined = _joined(found[-1][0], text) if found else ""
        if joined:
            found[-1] = joined, found[-1][1] + seconds
        else:
            found.append((text, seconds))
    return found


def _joined(before: str, text: str) -> str:
    """Two clauses as one; "" where they are done one after the other."""
    first, predicate = before.rstrip(" .,"), subject_of(text)[1]
    joined = f"{first}, then {predicate}"
    if not {"it", "them"}.isdisjoint(words_of(predicate)[0]):
        taken, put = read_as(Handling, before), read_as(Handling, text)
        held = taken and put and taken.steps[-1].does != "put" and put.steps[0].does == "hold"
        if held and read_as(Handling, joined):
            return joined
    limbs = limbs_described(joined)
    if limbs is not None and not limbs.rest:
        return joined
    rows, earlier, later = lexicon().actions, actions_of(before), actions_of(text)
    covered = frozenset[str]().union(*(rows[action].covers for action in later))
    more = earlier and later and all(rows[action].down for action in (*earlier, *later)) and covered.issuperset(earlier)
    return f"{first} and {predicate}" if more else ""


def limbs_described(clause: str) -> Posing | None:
    """What a clause says limbs do, whether its subject is a person or a limb; None where it says nothing of that."""
    subject, predicate = subject_of(clause)
    posing = posing_of(clause if subject and names_limb(subject) else predicate)
    words, spans = words_of(predicate)
    at = int(words[:1] == ["is"])
    if posing or len(words) < at + 2 or lexicon().lemmas.get(words[at]) not in ("do", "perform"):
        return posing
    posing = posing_of(predicate[spans[at + 1][0] :])  # "is doing left arm circles"
    return posing if posing and not posing.rest else None


def parts_of(clause: str) -> list[str]:
    """What a clause says one after the other, each with its subject, if it cannot be done all at once: "a boy throws a
    ball and stretches" as "a boy throws a ball" and "a boy stretches". None where it says one thing, or two at once
    ("while").

    Args:
        clause: In English.
    """
    subject, rest = subject_of(clause)
    if not {"while", "whilst"}.isdisjoint(words_of(rest)[0]):
        return []
    (_, first), *pieces = _pieces(_now(rest.removeprefix("is ").removeprefix("are ")), "added")
    forms = [form for form in ("third", "gerund", "plain") if _begins(first, form)]
    parts = [first]
    for joint, piece in [(joint, _now(piece)) for joint, piece in pieces]:
        if _begins(piece, *forms) and not _goes_on(piece) and all(map(_says, (piece, parts[-1]))):
            parts.append(piece)
        else:
            parts[-1] += joint + piece
    actions = [frozenset(actions_of(part)) for part in parts]
    parts = with_names(parts)
    if len(parts) < 2 or any(before & after for before, after in itertools.pairwise(actions)):
        return []
    return [as_caption(with_subject(part, subject)) for part in parts]


def passing(clause: str) -> list[str]:
    """The halves of a clause that passes from one thing to another, as the names of clips do: "rifle idle to crouch"
    as "rifle idle" and "crouch". None unless each half alone surely says something, and another thing.
    """
    from bunraku.language.reader import frames_of  # numpy

    (words, spans), grammar = words_of(clause), lexicon().grammar
    for number, word in enumerate(words[:-1]):
        if number and word in grammar["to"] and words[number + 1] not in grammar["determiners"]:
            halves = [clause[: spans[number][0]].strip(), clause[spans[number][1] :].strip()]
            first, second = ({one.action for one in frames_of(half) if one.probability > SURELY} for half in halves)
            if first and second and not first & second:
                return halves
    return []


def _held(clause: str) -> Handling | None:
    """What is held all the time, if not as captured people carry it; None for nothing."""
    held = read_as(Handling, clause)
    return held if held is not None and held.only_held and (held.said or not actions_of(clause)) else None


def on_foot(clause: str) -> str:
    """A clause that says that a thing is carried, but not as captured people carry it, as one that says the walk, too;
    others as they are.
    """
    subject, rest = subject_of(clause)
    alone = bool(subject) and actions_of(rest) == ("carry",) and _held(clause) is not None
    return f"{subject} walks and {rest}" if alone else clause


def _says(piece: str) -> bool:
    return bool(actions_of(piece)) or interaction_of(piece) is not None


def shared(clauses: Sequence[str], seconds: float) -> list[float]:
    """Seconds of each of some clauses in a row: what is done once gets its `Action.seconds`, and what goes on (walking,
    waving) shares the rest evenly. Where there is not enough time, or nothing goes on, all get more or less in
    proportion. Standing or crouching before or after something takes `LEAST_GOING`.
    """
    once = [_time_of(clause) or LEAST_GOING * _is_state(clause) for clause in clauses]
    going = once.count(0.0)
    rest = seconds - sum(once)
    if going and rest >= going * LEAST_GOING:
        times = [time or rest / going for time in once]
    else:
        worth = [time or GOING for time in once]
        times = [seconds * time / sum(worth) for time in worth]
    return [seconds / len(clauses)] * len(clauses) if min(times) < SHORTEST_CLAUSE else times


def fitting(clauses: Sequence[str]) -> float:
    """Seconds that clauses in a row take by themselves, at most 120: what is done once as long as captured people take
    for it, as often as is said. With anything that goes on it is `USUAL` at the least.
    """
    once = list(map(_time_of, clauses))
    seconds = sum(time or GOING for time in once)
    return min(max(seconds, USUAL) if 0.0 in once else seconds + ENDING, SECONDS.high)


def timed_clauses(sentence: str, seconds: float | None) -> list[tuple[str, float]]:
    """The clauses of a sentence with their shares of its seconds (`shared`), which are what they take (`fitting`) where
    they are None. Where an even share is under a second, neighbours are one clause; the sentence itself where all of
    them are.
    """
    clauses = split_clauses(sentence)
    seconds = fitting(clauses) if seconds is None else seconds
    fitting_in = max(int(seconds / SHORTEST_CLAUSE), 1)
    if len(clauses) > fitting_in:
        bounds = [round(number * len(clauses) / fitting_in) for number in range(fitting_in + 1)]
        clauses = [", then ".join(clauses[start:stop]) for start, stop in itertools.pairwise(bounds)]
    return [(sentence, seconds)] if len(clauses) < 2 else list(zip(clauses, shared(clauses, seconds), strict=True))


def _done_in(clause: str) -> list[str]:
    """What is done in a clause, as it is read where it is done."""
    from bunraku.language.reader import frames_of  # numpy

    return [frame.action for frame in frames_of(of_person(as_caption(as_present(clause))))]


def _time_of(clause: str) -> float:
    """Time that a clause takes by itself [s], what it says in a row together; 0 for what goes on."""
    rows, count, pieces = lexicon().actions, count_of(clause), parts_of(clause) or passing(clause) or [clause]
    read = [[rows[action].seconds for action in _done_in(piece)] for piece in pieces]
    times = [max(piece) if piece and min(piece) > 0 else 0.0 for piece in read]
    if count and len(pieces) == 1:
        return count * (times[0] or ROUND)
    return sum(times) if min(times) > 0 else 0.0


def _is_state(clause: str) -> bool:
    """Whether a body does nothing in a clause but stand or crouch: "idle", "crouch idle"."""
    actions = _done_in(clause)
    return bool(actions) and all(action.endswith("idle") for action in actions)


def _hinged(piece: str) -> list[str]:
    """A piece parted at "before" and "after", in the order in which things happen."""
    words, spans = words_of(piece)
    for at, word in enumerate(words[:-1]):
        if word not in ("before", "after") or words[at + 1] in ("landing", "being"):
            continue
        rest = piece[spans[at + 1 + (words[at + 1] == "having" and at + 2 < len(words))][0] :]
        earlier, _, later = rest.partition(",")
        finite = ("third", "gerund", "plain", "is")
        if not at and word == "after" and _begins(earlier, "gerund") and _begins(subject_of(later)[1], *finite):
            return [earlier, *_hinged(later.strip())]
        subject, predicate = subject_of(rest)
        if at and (_begins(rest, "gerund") or (subject and _begins(predicate, "third", "is"))):
            head = piece[: spans[at - 1][1]].rstrip(" ,")
            return [head, *_hinged(rest)] if word == "before" else [*_hinged(rest), head]
    return [piece]


def _listed(piece: str, ordered: bool) -> list[str]:
    """A list such as "a man walks, turns around and waves" as its clauses, where each begins with a verb of one form
    ("walks, looking down" does not). Only commas make a list: "walks and waves" is none. Nouns may look like verbs
    ("dances with steps, turns and jumps"), so where nothing else in the sentence says order, a list after "with" or
    "of" is none either.
    """
    first, *others = [item for _, item in _pieces(piece, "listed")]
    if not ordered and re.search(r"\b(?:with|of)\b|:", first):
        return [piece]
    begin = subject_of(_opened(first))[1]
    for form in ("third", "gerund", "plain", "past") if others else ():
        if all(_begins(item, form) for item in (begin, *others)):
            head, _, last = others[-1].rpartition(" and ")
            return [first, *others[:-1], head, last] if head and _begins(last, form) else [first, *others]
    return [piece]


def _turned_first(piece: str) -> list[str]:
    """ "turns around and waves" and "walks forward and salutes" as two halves, if the second cannot be done during
    the first: anything during a turn or getting up, and during a walk what people stop for. "Walks and waves" is one.
    """
    head, joint, last = piece.rpartition(" and ")
    if not joint or " and " in head or "," in piece or " while " in piece:
        return [piece]
    begin = subject_of(_opened(head))[1]
    if not any(_begins(begin, form) and _begins(last, form) for form in ("third", "gerund", "plain", "past")):
        return [piece]
    rows = lexicon().actions
    first, second = ([rows[action] for action in actions_of(half)] for half in (head, last))
    turned = all(row.alone for row in first) and not any(row.alone or row.turning for row in second)
    stopped = all(row.locomotion in ("walk", "run") for row in first) and all(row.halts for row in second)
    return [head, last] if first and second and (turned or stopped) else [piece]


def with_subject(clause: str, subject: str) -> str:
    """A clause that begins with its verb as one of this subject; others, and all without a subject, stay as they
    are.
    """
    if not subject:
        return clause
    if _begins(clause, "third", "past"):
        return f"{subject} {clause}"
    return f"{subject} is {clause}" if _begins(clause, "gerund") else clause


def split_voices(clause: str) -> tuple[str, ...]:
    """What a clause says of the legs and what of the arms or the head, said as clauses of their own; none where it does
    not say both.

    Args:
        clause: In English.
    """
    text = " ".join(clause.split())
    words, spans = words_of(text)
    last = max((start for word, (start, _) in zip(words, spans, strict=True) if word.endswith("ing")), default=0)
    ongoing = [("", text[:last]), ("", text[last:])]  # "is strolling along, carrying a tray"
    for pieces in (_pieces(text, "while"), _pieces(text, "and"), ongoing):
        halves = [half.strip(" ,.;!") for _, half in pieces]
        if len(halves) != 2 or not all(halves):
            continue
        first, second = halves[0], with_subject(halves[1], subject_of(halves[0])[0])
        parts = [moved_part(half) for half in (first, second)]
        if "legs" in parts and not {"", "legs"}.issuperset(parts):
            return (first, second) if parts[0] == "legs" else (second, first)
    return ()


def moved_part(clause: str) -> str:
    """What is moved in it first: "legs", "arms", "head", "arms and head", or "" for neither or all."""
    from bunraku.language.reader import frames_of  # numpy

    rows = lexicon().actions
    shown = [rows[frame.action] for frame in frames_of(clause)]
    parts = ["legs" if row.locomotion in ("walk", "run") else row.part for row in shown]
    if parts[:1] == ["legs"]:
        return "legs"
    if _held(clause) is not None:
        return "arms"
    if not parts:
        return ""
    gestures = set(parts)
    if gestures & {"", "legs"}:
        return parts[0]
    return parts[0] if len(gestures) == 1 else "arms and head"
