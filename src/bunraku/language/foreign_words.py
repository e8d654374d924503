"""Words of the table found in sentences: in German, French and Spanish by stems and endings, in Japanese and Chinese by
the longest word at each position.
"""

from __future__ import annotations

import functools
import re
import unicodedata
from collections.abc import Iterator
from typing import NamedTuple

from bunraku.language.captions import caption_table
from bunraku.language.prompts import narrow
from bunraku.language.word_table import Concept, forms

_TOKEN = re.compile(r"[^\W\d_]+['’]|[^\W\d_]+|\d+|[.,;:!?…]")
_PIECE = re.compile(r"[^\W\d_]+'|[^\W\d_]+~?|\d+")


@functools.cache
def listed(name: str, language: str = "") -> tuple[str, ...]:
    """Words or endings of a list of `inflections.json`."""
    rows = caption_table("inflections.json")[name]
    return tuple((rows[language] if language else rows).split(" "))


def fold(text: str) -> str:
    """Lower case without accents: "Füße" is "fusse"."""
    plain = text.casefold().replace("’", "'").replace("œ", "oe")
    if plain.isascii():
        return plain
    return "".join(letter for letter in unicodedata.normalize("NFKD", plain) if not unicodedata.combining(letter))


class _Form(NamedTuple):
    words: tuple[str, ...]
    stem: tuple[bool, ...]
    kind: str
    value: str
    others: tuple[tuple[str, bool], ...] = ()
    particle: str = ""
    reflexive: bool = False
    plural: bool = False


def _weight(form: _Form) -> tuple[int, int, int]:
    """The more words a form needs, the more surely it is meant; exact forms before stems."""
    count = len(form.words) + len(form.others) + bool(form.particle) + form.reflexive
    return count, sum(map(len, form.words)), -sum(form.stem)


def _split(text: str) -> tuple[tuple[str, ...], tuple[bool, ...]]:
    """The words of a form, and which of them are stems."""
    words = _PIECE.findall(text) if " " in text or "'" in text or "-" in text else (text,)
    return tuple(word.rstrip("~") for word in words), tuple(word.endswith("~") for word in words)


@functools.cache
def _spaced_lexicon(language: str) -> dict[str, list[_Form]]:
    """Forms by their first word."""
    lexicon: dict[str, list[_Form]] = {}
    for text, kind, value, position in forms(language, fold):
        *others, head = text.split("&")
        needed = [pair for other in others for pair in zip(*_split(other), strict=True)]
        reflexive = any(word in ("se", "sich") for word, _ in needed)
        beside = tuple(pair for pair in needed if pair[0] not in ("se", "sich"))
        particle, _, head = head.rpartition("+")
        words, stem = _split(head)
        form = _Form(words, stem, kind, value, beside, particle, reflexive, kind == "part" and position > 0)
        joined = [particle, particle + "zu", particle + "ge"] if particle else []
        for one in (*(form._replace(words=(front + words[0], *words[1:]), particle="") for front in joined), form):
            lexicon.setdefault(one.words[0], []).append(one)
    return lexicon


def _readings(token: str, language: str) -> Iterator[tuple[str, str]]:
    """A token as stems and endings; the whole first."""
    yield token, ""
    endings = listed("endings", language)
    for cut in range(len(token) - 1, 0, -1):
        if token[cut:] in endings:
            yield token[:cut], token[cut:]


def _is(token: str, word: str, stem: bool, language: str) -> bool:
    return token == word or (stem and token.startswith(word) and token[len(word) :] in listed("endings", language))


class _Scan:
    """A sentence's tokens, and which of them are read already."""

    def __init__(self, text: str, language: str):
        self.language = language
        self.spans = [match.span() for match in _TOKEN.finditer(text)]
        self.raw = [text[start:stop] for start, stop in self.spans]
        self.tokens = [fold(word) for word in self.raw]
        self.taken = [False] * len(self.tokens)

    def first_words(self, index: int) -> Iterator[tuple[_Form, bool]]:
        """Forms that may begin here, each with whether a reflexive pronoun hangs on it."""
        lexicon, token = _spaced_lexicon(self.language), self.tokens[index]
        variants = [(token, False)]
        if self.language == "es":
            variants += [
                (token[: -len(tail)], tail in ("se", "me", "te", "nos", "selo", "sela"))
                for tail in listed("clitics")
                if token.endswith(tail) and len(token) > len(tail) + 3
            ]
        if self.language == "de" and re.search("[aou]e", token):
            variants.append((re.sub("([aou])e", r"\1", token), False))
        for variant, pronoun in variants:
            for word, ending in _readings(variant, self.language):
                for form in lexicon.get(word, ()):
                    if form.stem[0] or not ending:
                        yield form, pronoun

    def in_a_row(self, form: _Form, index: int) -> bool:
        stop = index + len(form.words)
        if stop > len(self.tokens) or any(self.taken[index:stop]):
            return False
        rows = zip(self.tokens[index + 1 : stop], form.words[1:], form.stem[1:], strict=True)
        return all(_is(token, word, stem, self.language) for token, word, stem in rows)

    def scattered(self, form: _Form, at: int, pronoun: bool, clause: tuple[int, int]) -> list[int] | None:
        """Tokens of a clause that a form needs besides those in a row; None where they are not all there."""
        span = range(at, at + len(form.words))
        free = [index for index in range(*clause) if index not in span and not self.taken[index]]
        if form.reflexive and not pronoun:
            near = free if self.language == "de" else [index for index in free if index in (at - 1, at + 1)]
            if not any(self.tokens[index] in listed("reflexive") for index in near):
                return None
        used = []
        for word, stem in form.others:
            hit = next((index for index in free if _is(self.tokens[index], word, stem, self.language)), None)
            if hit is None:
                return None
            used.append(hit)
        if form.particle:
            last = clause[1] - 1
            after = [index for index in free if index >= span.stop and self.tokens[index] == form.particle]
            if form.particle in listed("prepositions"):
                after = [index for index in after if index == last]
            if not after:
                return None
            used.append(after[-1])
        return used

    def clauses(self) -> list[tuple[int, int]]:
        """For each token the first of its clause and the one after its last: what connectors and stops part."""
        edges, index = [-1], 0
        while index < len(self.tokens):
            clauses = [
                form
                for form, _ in self.first_words(index)
                if not form.others and not form.particle and not form.reflexive and self.in_a_row(form, index)
            ]
            best = max(clauses, key=_weight, default=None)
            inside = self.language == "de" and index and self.tokens[index - 1][0].isalnum() and index - 1 not in edges
            then = best is not None and best.kind == "then" and len(best.words) == 1
            if not self.tokens[index][0].isalnum() or (
                best and best.kind in listed("boundaries") and not (then and inside)
            ):
                edges.append(index)
            index += len(best.words) if best else 1
        edges.append(len(self.tokens))
        spans: list[tuple[int, int]] = []
        for first, last in zip(edges, edges[1:], strict=False):
            spans += [(first + 1, last)] * (last - first)
        return spans[1:] + [(len(self.tokens), len(self.tokens))]


def spaced_words(text: str) -> list[tuple[int, int]]:
    """Where each word of a sentence stands, without its numbers and signs."""
    return [match.span() for match in _TOKEN.finditer(text) if match.group()[0].isalpha()]


def scan_spaced(text: str, language: str) -> list[Concept]:
    """The words of a sentence in their order.

    Args:
        text: A sentence.
        language: "de", "fr" or "es".
    """
    scan, concepts = _Scan(text, language), []
    clauses = scan.clauses()
    determiners = {form for form, kind, _, _ in forms(language, fold) if kind == "determiner"}
    # verbs of several words first, so that what belongs to them is not read as something else
    best: dict[int, _Form] = {}
    options = []
    for at in range(len(scan.tokens)):
        for form, pronoun in scan.first_words(at):
            if form.kind != "determiner" and scan.in_a_row(form, at):
                noun = at > 0 and scan.tokens[at - 1] in determiners and form.kind in ("noun", "part", "being")
                count, *weight = _weight(form)
                options.append((count + 0.5 * noun, weight, -at, form, pronoun))
    for _, _, negative, form, pronoun in sorted(options, key=lambda option: option[:3], reverse=True):
        at = -negative
        used = scan.scattered(form, at, pronoun, clauses[at]) if scan.in_a_row(form, at) else None
        if used is not None:
            best[at] = form
            for index in (*range(at, at + len(form.words)), *used):
                scan.taken[index] = True
    at = 0
    while at < len(scan.tokens):
        start, stop = scan.spans[at]
        token = scan.tokens[at]
        if at in best:
            form = best[at]
            mark = "plural" if form.plural else ""
            if form.kind == "verb" and len(form.words) == 1:
                mark = "infinitive" if token.endswith(listed("infinitive", language)) else ""
                mark = "gerund" if token.endswith(listed("gerund", language)) else mark
            elif form.kind == "verb" and not any(form.stem) and not form.others:
                mark = "adverb"  # "de puntillas", "à quatre pattes"
            elif form.kind == "then" and clauses[at][0] < at < clauses[at][1]:
                mark = "inside"  # "und springt dann hoch"
            stop = scan.spans[at + len(form.words) - 1][1]
            concepts.append(Concept(form.kind, form.value, start, stop, mark))
            at += len(form.words)
            continue
        if not scan.taken[at]:
            sign = "comma" if token in ",;:" else "stop" if not token[0].isalnum() else ""
            kind = "number" if token.isdigit() else sign or ("ignored" if token in listed("reflexive") else "unknown")
            concepts.append(Concept(kind, scan.raw[at] if kind == "unknown" else token, start, stop))
        at += 1
    return concepts


_DIGITS = re.compile(r"\d+")


@functools.cache
def _unspaced_lexicon(language: str) -> tuple[dict[str, list[tuple[str, str, str]]], int]:
    """Kind, English and mark of each surface, and the length of the longest."""
    lexicon: dict[str, list[tuple[str, str, str]]] = {}
    for form, kind, value, _ in forms(language):
        surfaces = [(form, "")]
        if kind == "verb":
            surfaces = _conjugated(form) if language == "ja" else _doubled(form)
        for surface, mark in surfaces:
            rows = lexicon.setdefault(surface, [])
            if kind not in [other for other, _, _ in rows]:
                rows.append((kind, value, mark))
    return lexicon, max(map(len, lexicon))


def _doubled(form: str) -> list[tuple[str, str]]:
    """A Chinese verb and, where it has an object of one sign, as what is done lightly: 点头, 点点头, 点了点头."""
    if len(form) != 2:
        return [(form, "")]
    verb, rest = form[0], form[1]
    return [(form, ""), *((verb + between + verb + rest, "") for between in ("", "了", "一")), (f"{verb}了{rest}", "")]


def _conjugated(form: str) -> list[tuple[str, str]]:
    """A Japanese verb in the forms that sentences have, each "plain", "te" or "stem"."""
    if form.endswith("+"):
        noun = form[:-1].removesuffix("を")
        return [
            (noun, "plain"),
            *(
                (noun + gap + end, mark)
                for gap in ("", "を")
                for end, mark in caption_table("inflections.json")["する"].items()
            ),
        ]
    if "・" in form:
        stem = form.replace("・る", "")
        ends = (("る", "plain"), ("", "stem"), ("て", "te"), ("た", "plain"), ("ろ", "plain"), ("よう", "plain"))
        return [(stem + end, mark) for end, mark in ends]
    if form.endswith("行く"):
        ends = (("き", "stem"), ("って", "te"), ("った", "plain"), ("け", "plain"), ("こう", "plain"), ("く", "plain"))
        return [(form[:-1] + end, mark) for end, mark in ends]
    stem, last = form[:-1], form[-1]
    changing = caption_table("inflections.json")["changing"]
    if last not in changing:
        return [(form, "plain")]
    before, te, past, negative, order, let = changing[last].split()
    return [
        (form, "plain"), (stem + before, "stem"), (stem + te, "te"), (stem + past, "plain"),
        (stem + order, "plain"), (stem + let, "plain"), (stem + negative + "ない", "plain"),
    ]  # fmt: skip


def scan_unspaced(text: str, language: str) -> list[Concept]:
    """The words of a sentence in their order.

    Args:
        text: A sentence.
        language: "ja" or "zh".
    """
    lexicon, longest = _unspaced_lexicon(language)
    plain = narrow(text).lower()
    concepts: list[Concept] = []
    index = 0
    while index < len(plain):
        letter = plain[index]
        if letter.isspace():
            index += 1
            continue
        if not letter.isalnum() and letter not in "ー々":
            concepts.append(Concept("comma" if letter in "、,，；;：:" else "stop", letter, index, index + 1))
            index += 1
            continue
        digits = _DIGITS.match(plain, index)
        if digits:
            concepts.append(Concept("number", digits.group(), index, digits.end()))
            index = digits.end()
            continue
        most = min(longest, len(plain) - index)
        size = next((size for size in range(most, 0, -1) if plain[index : index + size] in lexicon), 0)
        if size:
            concept, index = _read(plain, index, size, lexicon[plain[index : index + size]], language, concepts)
            concepts.append(concept)
            continue
        stop = index + 1
        if letter.isascii():
            stop = index + len(re.match(r"[a-z0-9'-]+", plain[index:]).group())  # type: ignore[union-attr]
        if concepts and concepts[-1].kind == "unknown" and concepts[-1].stop == index and not letter.isascii():
            concepts[-1] = Concept("unknown", text[concepts[-1].start : stop], concepts[-1].start, stop)
        else:
            concepts.append(Concept("unknown", text[index:stop], index, stop))
        index = stop
    return concepts


def _read(
    plain: str, index: int, size: int, rows: list[tuple[str, str, str]], language: str, before: list[Concept]
) -> tuple[Concept, int]:
    """One word, what hangs on it, and where the next begins."""
    kind, value, mark = rows[0]
    after = index + size
    last = before[-1] if before else None
    if language == "ja":
        kinds = {row[0]: row for row in rows}
        if "before" in kinds and last and last.kind == "verb" and last.mark == "plain":
            kind, value, mark = kinds["before"]
        elif kind == "before":
            kind, value = "direction", "forward"
        if kind == "verb" and mark in ("te", "stem"):
            tail = max((end for end in listed("after", mark) if plain.startswith(end, after)), key=len, default="")
            after += len(tail)
            mark = "plain" if tail and not (mark == "te" and tail.endswith("て")) else mark
    return Concept(kind, value, index, after, mark), after
