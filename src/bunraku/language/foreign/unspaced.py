"""Words of the table in Japanese and Chinese: the longest word that begins at each place."""

from __future__ import annotations

import functools
import re
import unicodedata

from bunraku.language.foreign.table import Concept, forms

__all__ = ["scan_unspaced"]

_GODAN = {
    "く": ("き", "いて", "いた", "か", "け", "こう"), "ぐ": ("ぎ", "いで", "いだ", "が", "げ", "ごう"),
    "す": ("し", "して", "した", "さ", "せ", "そう"), "つ": ("ち", "って", "った", "た", "て", "とう"),
    "ぬ": ("に", "んで", "んだ", "な", "ね", "のう"), "ぶ": ("び", "んで", "んだ", "ば", "べ", "ぼう"),
    "む": ("み", "んで", "んだ", "ま", "め", "もう"), "る": ("り", "って", "った", "ら", "れ", "ろう"),
    "う": ("い", "って", "った", "わ", "え", "おう"),
}  # fmt: skip
"""Ends of a verb with a changing last sound: before ます, with て and た, before ない, as an order, and as "let us"."""
_AFTER_TE = re.compile(
    r"(?:い(?:ます|ました|る|た|て)|る(?=$|[、。\s])|ください|下さい|おり|いき(?:ます)?|いく|きます|くる|みる|みます)"
)
_AFTER_STEM = re.compile(r"(?:ます|ました|ましょう|なさい|たい|始め(?:る|ます)|続け(?:る|ます)|出す|つつ|方)")
_DIGITS = re.compile(r"\d+")


@functools.cache
def _lexicon(language: str) -> tuple[dict[str, list[tuple[str, str, str]]], int]:
    """Kind, English and mark of each surface, and the length of the longest."""
    found: dict[str, list[tuple[str, str, str]]] = {}
    for form, kind, value, _ in forms(language):
        surfaces = [(form, "")]
        if kind == "verb":
            surfaces = _conjugated(form) if language == "ja" else _doubled(form)
        for surface, mark in surfaces:
            rows = found.setdefault(surface, [])
            if kind not in [other for other, _, _ in rows]:
                rows.append((kind, value, mark))
    return found, max(map(len, found))


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
        gaps = ("", "を")
        return [
            (noun, "plain"),
            *((noun + gap + end, mark) for gap in gaps for end, mark in _surus()),
        ]
    if "・" in form:
        stem = form.replace("・る", "")
        ends = (("る", "plain"), ("", "stem"), ("て", "te"), ("た", "plain"), ("ろ", "plain"), ("よう", "plain"))
        return [(stem + end, mark) for end, mark in ends]
    if form.endswith("行く"):
        ends = (("き", "stem"), ("って", "te"), ("った", "plain"), ("け", "plain"), ("こう", "plain"), ("く", "plain"))
        return [(form[:-1] + end, mark) for end, mark in ends]
    stem, last = form[:-1], form[-1]
    if last not in _GODAN:
        return [(form, "plain")]
    before, te, past, negative, order, let = _GODAN[last]
    return [
        (form, "plain"), (stem + before, "stem"), (stem + te, "te"), (stem + past, "plain"),
        (stem + order, "plain"), (stem + let, "plain"), (stem + negative + "ない", "plain"),
    ]  # fmt: skip


def _surus() -> list[tuple[str, str]]:
    """する, and やる for games and music."""
    return [
        ("する", "plain"), ("し", "stem"), ("して", "te"), ("した", "plain"), ("しろ", "plain"), ("しよう", "plain"),
        ("やる", "plain"), ("やり", "stem"), ("やって", "te"), ("やった", "plain"),
    ]  # fmt: skip


def scan_unspaced(text: str, language: str) -> list[Concept]:
    """The words of a sentence in their order.

    Args:
        text: A sentence.
        language: "ja" or "zh".
    """
    lexicon, longest = _lexicon(language)
    plain = "".join(  # wide digits and letters as narrow ones, each still one letter
        wide if len(wide := unicodedata.normalize("NFKC", letter)) == 1 else letter for letter in text
    ).lower()
    found: list[Concept] = []
    index = 0
    while index < len(plain):
        letter = plain[index]
        if letter.isspace():
            index += 1
            continue
        if not letter.isalnum() and letter not in "ー々":
            found.append(Concept("comma" if letter in "、,，；;：:" else "stop", letter, index, index + 1))
            index += 1
            continue
        digits = _DIGITS.match(plain, index)
        if digits:
            found.append(Concept("number", digits.group(), index, digits.end()))
            index = digits.end()
            continue
        most = min(longest, len(plain) - index)
        size = next((size for size in range(most, 0, -1) if plain[index : index + size] in lexicon), 0)
        if size:
            concept, index = _read(plain, index, size, lexicon[plain[index : index + size]], language, found)
            found.append(concept)
            continue
        stop = index + 1
        if letter.isascii():
            stop = index + len(re.match(r"[a-z0-9'-]+", plain[index:]).group())  # type: ignore[union-attr]
        if found and found[-1].kind == "unknown" and found[-1].stop == index and not letter.isascii():
            found[-1] = Concept("unknown", text[found[-1].start : stop], found[-1].start, stop)
        else:
            found.append(Concept("unknown", text[index:stop], index, stop))
        index = stop
    return found


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
        if kind == "verb" and mark == "te":
            tail = _AFTER_TE.match(plain, after)
            if tail:
                after, mark = tail.end(), "te" if tail.group().endswith("て") else "plain"
        elif kind == "verb" and mark == "stem":
            tail = _AFTER_STEM.match(plain, after)
            if tail:
                after, mark = tail.end(), "plain"
    return Concept(kind, value, index, after, mark), after
