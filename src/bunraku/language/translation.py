"""Japanese, Chinese, German, French and Spanish as plain English, through a table of words."""

from __future__ import annotations

import functools
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from bunraku.language.captions import conjugate
from bunraku.language.foreign_words import listed, scan_spaced, scan_unspaced
from bunraku.language.lexicon import actions_of, goes_ahead, lexicon
from bunraku.language.vocabulary import words_of
from bunraku.language.word_table import Concept, table


@dataclass
class VerbPhrase:
    """A verb with what belongs to it."""

    link: str = ""  # the connector before it: "then", "and", "while", "comma", or ""
    subject: str = ""  # the subject, where it is named anew
    verb: str = ""  # in English with braces; "" where the verb before it goes on
    items: list[Concept] = field(default_factory=list)  # parts, directions, manners and the like


def clauses_of(concepts: Sequence[Concept], language: str) -> list[VerbPhrase]:
    """What a sentence says in the order in which it happens, a clause for each verb.

    Args:
        concepts: What a scan found.
        language: "de", "fr", "es", "ja" or "zh".
    """
    words = [
        concept
        for concept in concepts
        if concept.kind not in ("ignored", "unknown") or concept.value in listed("markers")
    ]
    words = _parts(_measures(words), part_first=language in ("fr", "es"))
    return _ordered(_clauses(words, language), asian=language in ("ja", "zh"))


def _own_parts(verb: str) -> list[str]:
    """Parts of the body that go without saying with a verb."""
    return str(lexicon().limbs["of verbs"].get(verb, "")).split()


def with_article(noun: str) -> str:
    """ "a dog", "an old man"."""
    return ("an " if noun[0] in "aeiou" else "a ") + noun


def _measures(words: Sequence[Concept]) -> list[Concept]:
    """Numbers with what they count: "three steps", "twice", "90 degrees"; sides said of one part as "both"."""
    concepts: list[Concept] = []
    index = 0
    while index < len(words):
        word = words[index]
        after = words[index + 1] if index + 1 < len(words) else None
        if word.kind == "time":
            word = replace(word, kind="count", value=_measure(word.value.split()[0], "times"))
        elif word.kind == "number" and after and after.kind == "unit":
            kind = "count" if after.value in ("times", "turns") else after.value
            word = replace(word, kind=kind, value=_measure(word.value, after.value), stop=after.stop)
            index += 1
        elif word.kind == "number" and after and after.kind == "part" and word.value in ("1", "2"):
            word = replace(word, kind="side", value="one" if word.value == "1" else "both")
        elif word.kind == "unit":
            if word.value != "steps":
                index += 1
                continue
            word = replace(word, kind="steps", value="a step")
        elif word.kind == "side":
            pair = words[index : index + 3]
            if [one.kind for one in pair] == ["side", "and", "side"] and pair[0].value != pair[2].value:
                word, index = replace(word, value="both"), index + 2
        concepts.append(word)
        index += 1
    return concepts


def _measure(number: str, unit: str) -> str:
    name = {str(count): word for word, count in lexicon().numbers.items()}.get(number, number)
    if unit in ("times", "turns"):
        return {"1": "once", "2": "twice"}.get(number) or f"{name} times"
    if unit == "steps":
        return "one step" if number == "1" else f"{name} steps"
    return f"{'for ' if unit == 'seconds' else ''}{number} {unit}"


def _parts(words: Sequence[Concept], part_first: bool) -> list[Concept]:
    """Sides joined with their parts: "the left hand"; a side alone is a direction."""
    items: list[Concept] = []
    skip: set[int] = set()
    kinds = {
        index: word
        for index, word in enumerate(words)
        if not (word.kind == "number" or word.value in listed("markers"))
    }
    for index, word in enumerate(words):
        if word.kind != "side":
            continue
        ways = ((-1, 1) if word.value in ("left", "right") else (1, -1)) if part_first else (1, -1)
        for way in ways:
            near = index + way
            if near in kinds and kinds[near].kind == "part" and near not in skip:
                part = kinds[near]
                skip.update((index, near))
                value = f"{word.value} {part.value}"
                items.append(Concept("part", value, min(word.start, part.start), max(word.stop, part.stop), part.mark))
                break
    last = ""  # the part that a side alone goes back to: "el brazo izquierdo y luego el derecho"
    for index, word in enumerate(words):
        last = word.value if word.kind == "part" else "" if word.kind == "verb" else last
        if index in skip:
            continue
        if word.kind == "side" and last and word.value in ("left", "right"):
            items.append(replace(word, kind="part", value=f"{word.value} {last}"))
        elif word.kind == "side":
            near = index - 1 if part_first else index + 1
            verb = words[near] if 0 <= near < len(words) else None  # 左手を振る, "salue de la main gauche"
            if verb and verb.kind == "verb" and (parts := _own_parts(head_of(verb.value))):
                items.append(replace(word, kind="part", value=f"{word.value} {parts[0]}/"))
            elif word.value in ("left", "right"):
                items.append(replace(word, kind="direction", value=f"to the {word.value}"))
        else:
            items.append(word)
    return sorted(items, key=lambda word: word.start)


def head_of(verb: str) -> str:
    """The verb alone: "raise" of "{raise} <the arms>"."""
    match = re.search(r"\{(\w+)\}", verb)
    return match.group(1) if match else ""


def _clauses(words: Sequence[Concept], language: str) -> list[VerbPhrase]:
    """Verbs with what belongs to each."""
    clauses = [VerbPhrase()]
    waiting: list[Concept] = []  # Chinese: what stands before its verb
    ahead, like = False, False
    for index, word in enumerate(words):
        now = clauses[-1]
        if word.kind == "ignored":
            ahead = True
        elif word.kind in ("then", "and", "while", "before", "after", "first", "comma", "stop"):
            now.items += waiting
            waiting, ahead = [], False
            kind = "comma" if word.kind == "stop" else word.kind
            if word.mark == "inside":
                now.link = "then" if len(clauses) > 1 else now.link
                continue
            if kind == "first" or (kind == "comma" and language == "ja"):
                continue
            if now.verb or now.items:
                clauses.append(VerbPhrase(link=kind))
            elif kind in ("while", "before", "after") or not now.link or now.link == "comma":
                now.link = kind
        elif word.kind == "verb":
            if now.verb and _same(now.verb, word.value):
                if len(word.value) > len(now.verb):
                    now.verb = word.value
                continue
            goes_to = now.verb == "{go}" and (word.mark == "infinitive" or language == "zh") and not now.items
            if goes_to or (now.verb in ("{walk}", "{go}") and word.mark == "adverb"):
                now.verb = word.value
                continue
            if now.verb:
                link = "while" if word.mark == "gerund" else "then" if language in ("ja", "zh") else "and"
                clauses.append(VerbPhrase(link=link))
                now = clauses[-1]
            now.verb = word.value
            now.items += waiting
            waiting, ahead = [], False
            if language == "ja" and index + 1 < len(words):
                after = words[index + 1].kind
                later = any(other.kind == "verb" for other in words[index + 1 :])
                if later and after not in ("then", "and", "while", "before", "after", "stop"):
                    clauses.append(VerbPhrase(link="then"))
        elif word.kind == "like":
            if language == "ja" and now.items and now.items[-1].kind in ("being", "noun"):
                now.items[-1] = replace(now.items[-1], kind="likeness")
            elif language == "ja" and now.subject and not now.verb:
                now.items.append(replace(word, kind="likeness", value=now.subject))
                now.subject = ""
            else:
                like = True
        elif word.kind in ("being", "noun") and like:
            (waiting if ahead else now.items).append(replace(word, kind="likeness"))
            like = False
        elif word.kind == "being" and not now.subject and not (now.verb and "<" in now.verb):
            now.subject = word.value
        elif word.kind == "number":
            continue
        elif language == "zh" and now.verb and (ahead or word.kind in ("direction", "manner")):
            waiting.append(word)
        else:
            now.items.append(word)
    clauses[-1].items += waiting
    return _adjectives([clause for clause in clauses if clause.verb or clause.items or clause.subject])


def _same(one: str, other: str) -> bool:
    return head_of(one) == head_of(other) and (one.startswith(other) or other.startswith(one))


def _adjectives(clauses: list[VerbPhrase]) -> list[VerbPhrase]:
    """Manners said of the subject before or after it go in front of its name; verbless beginnings join what follows."""
    rows = {row["en"].split("/")[0]: row["en"].split("/")[1] for row in table()["manners"]}
    while len(clauses) > 1 and not clauses[0].verb and not any(item.kind == "steps" for item in clauses[0].items):
        first, second = clauses[0], clauses[1]
        subject = " and ".join(with_article(noun) for noun in (first.subject, second.subject) if noun)
        link = first.link if first.link in ("while", "before", "after") else ""
        clauses[:2] = [VerbPhrase(link, subject, second.verb, first.items + second.items)]
    for clause in clauses:
        kept = []
        for item in clause.items:
            adverb = item.value.split("/")[0]
            if item.kind == "manner" and adverb in lexicon().grammar["of people alone"]:
                if clause.subject and not clause.subject.startswith(("a ", "an ")):
                    clause.subject = f"{rows[adverb]} {clause.subject}"
            elif item.kind == "manner":
                kept.append(replace(item, value=adverb))
            else:
                kept.append(item)
        clause.items = kept
    return clauses


def _ordered(clauses: list[VerbPhrase], asian: bool) -> list[VerbPhrase]:
    """Clauses in the order in which things happen: "before" and "after" become "then"."""
    order: list[VerbPhrase] = []
    index = 0
    while index < len(clauses):
        clause = clauses[index]
        after = clauses[index + 1] if index + 1 < len(clauses) else None
        if asian and after and after.link == "before" and after.verb:  # "before" stands after its verb
            order += [replace(after, link=clause.link, subject=clause.subject or after.subject)]
            order += [replace(clause, link="then", subject="")]
            index += 2
            continue
        if not asian and clause.link in ("before", "after"):
            if not order and after:  # "bevor er springt, läuft er"
                first, second = (after, clause) if clause.link == "before" else (clause, after)
                subject = clause.subject or after.subject
                order += [replace(first, link="", subject=subject), replace(second, link="then", subject="")]
                index += 2
                continue
            if order and clause.link == "after":
                last = order.pop()
                order += [replace(clause, link=last.link, subject=last.subject), replace(last, link="then", subject="")]
                index += 1
                continue
            clause = replace(clause, link="then" if order else "")
        order.append(clause)
        index += 1
    if len(order) > 1:
        first, second = order[:2]
        leads = first.link == "while" and second.link != "while"  # "während er läuft, winkt er"
        if leads or (asian and second.link == "while" and first.link != "while"):  # 歩きながら手を振る
            subject = first.subject or second.subject
            order[:2] = [replace(second, link="", subject=subject), replace(first, link="while", subject="")]
    return order


_SLOT = re.compile(r"<([^>]*)>")


def english_sentence(concepts: Sequence[Concept], language: str) -> str:
    """The sentence; "" where no word of it is in the table.

    Args:
        concepts: What a scan found.
        language: "de", "fr", "es", "ja" or "zh".
    """
    clauses = clauses_of(concepts, language)
    return _joined(clauses) if any(clause.verb or clause.items for clause in clauses) else ""


def _joined(clauses: list[VerbPhrase]) -> str:
    subject = next((clause.subject for clause in clauses if clause.subject), "person")
    text = subject if subject.startswith(("a ", "an ")) else with_article(subject)
    plural = " and " in text
    last = next((index for index in range(len(clauses) - 1, 0, -1) if clauses[index].link == "and"), 0)
    verb = ""
    for index, clause in enumerate(clauses):
        if not clause.verb and any(item.kind == "part" for item in clause.items):
            clause = replace(clause, verb=verb)  # "raises the left arm, then raises the right arm"
        verb = clause.verb or verb
        phrase = _phrase(clause)
        start = f"{with_article(clause.subject)} " if index and clause.subject and clause.subject != subject else ""
        if not index:
            text += " " + conjugate(phrase, "plain" if plural else "third")
        elif clause.link == "while" and clause.verb:
            text += " while " + conjugate(phrase, "gerund")
        else:
            form = "plain" if plural and not start else "third"
            listed = clause.link == "comma" and index < last and clause.verb
            link = " and " if clause.link == "and" else ", " if listed else ", then "
            text += link + start + conjugate(phrase, form)
    return re.sub(r"\bt-pose\b", "T-pose", " ".join(text.split()))


def _phrase(clause: VerbPhrase) -> str:
    """A clause without its subject, the verb in braces."""
    items, verb = list(clause.items), clause.verb
    steps = next((item for item in items if item.kind == "steps"), None)
    if steps and (not verb or head_of(verb) == "step"):  # "takes three steps back"
        verb = f"{{take}} {steps.value}{verb.replace('{step}', '').rstrip()}"
        items.remove(steps)
    if verb.startswith("{turn} around") and any(
        item.kind == "degrees" or item.value.endswith((" left", " right")) for item in items
    ):
        verb = "{turn}"
    head, slot = head_of(verb), _SLOT.search(verb)
    given = None
    if slot:
        given = _object(items, slot.group(1), head)
        verb = _SLOT.sub(_named(given, slot.group(1)) if given else slot.group(1), verb)
    phrases = [_said(item, verb, head, bool(slot)) for item in items if item is not given]
    described = dict.fromkeys(text for _, text in sorted(phrases, key=lambda phrase: phrase[0]) if text)
    return " ".join([verb, *described]).strip()


def _object(items: Sequence[Concept], default: str, head: str) -> Concept | None:
    """What a verb is done to: a part of the body where that is usual, or else a thing or a being."""
    bodily = default.removeprefix("the ") in _body()
    if bodily or head in lexicon().grammar["touched"]:
        part = next((item for item in items if item.kind == "part"), None)
        if part:
            return part
    kinds = ("noun",) if bodily else ("noun", "being")
    return next((item for item in items if item.kind in kinds), None)


def _named(item: Concept, default: str) -> str:
    if item.kind == "part":
        word = _part(item)
        unsaid = word.removeprefix("the ") == default.removeprefix("the ").rstrip("s") and not item.mark
        return default if unsaid and not _sided(item) else word
    name = item.value.partition("/")[0]
    return name if name in lexicon().grammar["no article"] else with_article(name)


def _said(item: Concept, verb: str, head: str, slot: bool) -> tuple[float, str]:
    """What a word adds after the verb, and its place there."""
    words = verb.split()
    if item.kind == "part":
        if head == "move" and not slot:
            return 0, _part(item)
        if not _sided(item) and item.value.split("/")[0] in _own_parts(head):
            return 1, ""
        return 1, f"{'on' if head in lexicon().grammar['on a part'] and not slot else 'with'} {_part(item)}"
    if item.kind in ("noun", "being"):
        name, _, position = item.value.partition("/")
        if name in words or (name == "water" and slot):
            return 2, ""
        if head == "climb" and name in lexicon().grammar["climbed"]:
            return 1, "the stairs" if name == "stairs" else with_article(name)
        goal = item.kind == "noun" and name in lexicon().grammar["goals"]
        if goal and goes_ahead(actions_of(conjugate(f"{{{head}}} to", "third"))):
            return 2, f"to the {name}"
        if "} up" in verb and head in ("stand", "get"):
            return 2, position.replace("on ", "from ")
        return 2, position or f"with {with_article(name)}"
    if item.kind == "likeness":
        return 4, f"like {with_article(item.value.split('/')[0])}"
    if item.kind == "direction":
        sided = head == "turn" and item.value.endswith((" left", " right"))
        value = item.value.removeprefix("to the ") if sided else item.value
        double = (value == "backward" and "back" in words) or value.split()[-1] in words
        return 3, "" if double else value
    order = {"steps": 0, "degrees": 3.5, "manner": 4, "count": 5, "seconds": 6}.get(item.kind)
    return (order, item.value) if order is not None and item.value not in words else (9, "")


@functools.cache
def _body() -> frozenset[str]:
    return frozenset(name for row in table()["parts"] for name in row["en"].split("/"))


def _sided(item: Concept) -> bool:
    return item.value.startswith(("left ", "right ", "both ", "one "))


def _part(item: Concept) -> str:
    """ "the left hand", "both hands", "one leg", "the arms"."""
    side, _, rest = item.value.rpartition(" ") if _sided(item) and "/" not in item.value else ("", "", item.value)
    if not side and _sided(item):
        side, rest = item.value.split(" ", 1)
    single, _, many = rest.partition("/")
    if side == "both":
        return f"both {many or single + 's'}"
    if side == "one":
        return f"one {single}"
    name = many if item.mark == "plural" and not side else single
    return f"the {side} {name}" if side else f"the {name}"


_MOST, _SOME = 0.4, 0.3
"""Share of a sentence's words that a language's table must have, with a verb among them and without; chosen by eye."""


@dataclass(frozen=True)
class Translation:
    """A sentence in English."""

    # "a person walks forward, then waves with the left hand"; the sentence itself where it is English or in no
    # language of the table, and "" where it is in one and the table has no word of it
    english: str
    language: str  # "en", "de", "fr", "es", "ja" or "zh"; "" for another script
    # words of the table in their order, those that neither it nor the tagger has as "unknown"; none of English
    concepts: tuple[Concept, ...] = ()

    @property
    def unknown(self) -> tuple[str, ...]:
        """Words that are not read."""
        return tuple(concept.value for concept in self.concepts if concept.kind == "unknown")


def translate(prompt: str) -> Translation:
    """A sentence in English, as the captions of training say it, with order, sides and numbers kept.

    Args:
        prompt: In English or a language of the table, which follows from its script and from the words that it shares
            with the table.
    """
    scripts = set() if prompt.isascii() else {_script(letter) for letter in prompt if letter.isalpha()}
    if "kana" in scripts:
        return _translated(prompt, "ja", scan_unspaced(prompt, "ja"))
    if "han" in scripts:
        chinese, japanese = scan_unspaced(prompt, "zh"), scan_unspaced(prompt, "ja")
        if _missing(japanese) < _missing(chinese):
            return _translated(prompt, "ja", japanese)
        return _translated(prompt, "zh", chinese)
    if scripts and "latin" not in scripts:
        return Translation(prompt, "")
    words = words_of(prompt)
    english = sum(word.known for word in words) / len(words) if words else 1.0
    shares = []
    for other in ("de", "fr", "es") if english < 1 else ():
        concepts = scan_spaced(prompt, other)
        counted = [concept.kind for concept in concepts if concept.kind not in ("comma", "stop", "number")]
        share = (len(counted) - counted.count("unknown")) / len(counted) if counted else 0.0  # a tie is one in floats
        says = "verb" in counted or "unit" in counted
        if share > max(english, _MOST if says else _SOME):
            shares.append((says, share, other, concepts))
    if shares:
        says, _, language, concepts = max(shares, key=lambda found: found[:2])
        found = _translated(prompt, language, concepts)
        if says or any(concept.kind == "verb" for concept in found.concepts):
            return found
    return Translation(prompt, "en")


def _translated(prompt: str, language: str, concepts: list[Concept]) -> Translation:
    if any(concept.kind == "unknown" for concept in concepts):
        from bunraku.language.foreign_tagger import tagged  # numpy, which English needs not

        concepts = tagged(prompt, language, concepts)
    return Translation(english_sentence(concepts, language), language, tuple(concepts))


def _missing(concepts: list[Concept]) -> int:
    return sum(concept.stop - concept.start for concept in concepts if concept.kind == "unknown")


def _script(letter: str) -> str:
    name = unicodedata.name(letter, "")
    if name.startswith(("HIRAGANA", "KATAKANA")):
        return "kana"
    if name.startswith("CJK UNIFIED"):
        return "han"
    return "latin" if "LATIN" in name else "other"
