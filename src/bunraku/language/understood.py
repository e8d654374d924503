"""What of a sentence is understood, and what is not.

A sentence is understood where it says a movement that the captions of training have. Its other words may be unknown;
they are named, since the network guesses what they mean. Typing errors are corrected, and sentences in a language of
`words` are put into English.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from bunraku.errors import NotUnderstood
from bunraku.language.lexicon import in_known_words, lexicon
from bunraku.language.lexicon import words_of as words_in
from bunraku.language.prompts import check_prompt, narrow, plain_words
from bunraku.language.sentence import UnknownWord
from bunraku.language.tokenizer import word_pieces
from bunraku.language.vocabulary import FUNCTION_WORDS, corrected, says_action, words_of
from bunraku.language.word_table import LANGUAGES

if TYPE_CHECKING:
    from bunraku.language.translation import Translation

_SHARE = 0.25
"""Share of a sentence's words that must be known: "lorem ipsum dolor sit amet" is no way to sit. Chosen by eye."""
_SURE = 0.6
"""Share of the words that are not the grammar's that must be known or nearly so for any to be a typing error; chosen by
eye.
"""


@dataclass(frozen=True)
class Understanding:
    """What is understood of a sentence."""

    prompt: str  # the sentence as it was given
    english: str  # what the network is conditioned on
    ok: bool  # whether the sentence says a movement that training shows
    language: str = "en"  # "en", "de", "fr", "es", "ja" or "zh"; "" for a script that is not read
    known: tuple[str, ...] = ()  # its words that are understood
    unknown: tuple[UnknownWord, ...] = ()  # those that are not, with their places in `prompt`
    corrected: tuple[tuple[str, str], ...] = ()  # words taken for typing errors, and what is read in their place
    denied: tuple[str, ...] = ()  # what it says that is not done, such as "does not walk"

    @property
    def nearest(self) -> tuple[str, ...]:
        """Three sentences that say what is nearest to it, where it is not all understood."""
        from bunraku.language.reader import nearest  # numpy

        return nearest(self.english or self.prompt) if self.unknown or not self.ok else ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What the writer of the sentence should know, one line each."""
        said = []
        if self.language != "en" or self.corrected:
            said.append(f"read as: {self.english}")
        if self.unknown:
            said.append(f"not understood: {_quoted(self.unknown)}")
        if self.denied:
            said.append(f"beyond it: what is not done ({', '.join(map(repr, self.denied))}); say what is done instead")
        return tuple(said)


def _quoted(unknown: tuple[UnknownWord, ...], most: int = 8) -> str:
    words = list(dict.fromkeys(f"'{one.word[:40]}'" for one in unknown))
    return ", ".join(words[:most]) + (f" and {len(words) - most} more" if len(words) > most else "")


@functools.lru_cache(maxsize=512)
def understood(prompt: str) -> Understanding:
    """What is understood of one sentence.

    Args:
        prompt: In English, German, French, Spanish, Japanese or Chinese.

    Raises:
        OptionError: It is empty, has no letters or digits, or is longer than 1,000 characters.
    """
    check_prompt(prompt)
    plain = narrow(prompt)
    if "_" in plain or (plain.isalnum() and plain not in (plain.lower(), plain.upper(), plain.title())):
        found = understood(plain_words(plain))  # the name of a clip
        return replace(found, prompt=prompt, unknown=_placed(found.unknown, prompt))
    if plain.isascii() and {word.known for word in words_of(plain)} <= {True}:
        found = _english(plain, "en")
    else:
        from bunraku.language.translation import translate  # five languages, which plain English needs not

        translation = translate(plain)
        if translation.concepts:
            found = _foreign(plain, translation)
        else:
            found = _english(plain, "en" if translation.concepts else translation.language)
    if not found.ok and any(word.lower() in word_pieces() for word in _telling(found.english)):
        from bunraku.language.reader import SURE, load_reader  # numpy, which plain sentences need not

        reader = load_reader()
        ok = bool(reader.dealt(found.english)) or any(frame.probability >= SURE for frame in reader.read(found.english))
        found = replace(found, ok=ok)
    denied, rest = _denied(found.english)
    if denied:
        found = replace(found, denied=denied, ok=found.ok and says_action(rest))
        if found.ok:
            found = replace(found, english=_without(found.english, denied))
    return found if plain is prompt else replace(found, prompt=prompt)


def _denied(english: str) -> tuple[tuple[str, ...], str]:
    """What a sentence says that is not done, and the sentence without it."""
    words, spans = words_in(english)
    auxiliaries = lexicon().grammar["auxiliaries"]
    denied, rest, start = [], "", 0
    for number, word in enumerate(words):
        before = words[number - 1] if number else ""
        if word not in ("not", "never") and not (word == "t" and before.endswith("n") and before in auxiliaries):
            continue
        stop = number + 1
        while stop < len(words) and words[stop].endswith("ly"):
            stop += 1
        if stop < len(words) and words[stop] in lexicon().lemmas:
            first = number - (before in auxiliaries)
            denied.append(english[spans[first][0] : spans[stop][1]])
            rest, start = rest + english[start : spans[first][0]], spans[stop][1]
    return tuple(denied), rest + english[start:]


def _without(english: str, denied: Sequence[str]) -> str:
    """A sentence without what it says is not done, each to the end of its clause."""
    for phrase in denied:
        joint, rest = r"(?:\s*,)?(?:\s+(?:but|and|while))?\s*", r"[^,.;]*?(?=[,.;]|\s+(?:and|but|then)\b|$)"
        english = re.sub(joint + re.escape(phrase) + rest, "", english, count=1)
    return english.strip(" ,;")


def _english(prompt: str, language: str) -> Understanding:
    said = in_known_words(prompt)
    if said != prompt:
        found = _english(said, language)
        return replace(found, prompt=prompt, unknown=_placed(found.unknown, prompt))
    words = words_of(prompt)
    slips = {word: corrected(word.text) for word in words if not word.known}
    telling = [word for word in words if word.text.lower() not in FUNCTION_WORDS]
    if sum(word.known or bool(slips[word]) for word in telling) < _SURE * len(telling):
        slips = {}
    text = prompt
    for word in reversed(words):
        if slips.get(word):
            text = text[: word.start] + slips[word] + text[word.stop :]
    text = check_prompt(text)
    known = [slips.get(word) or word.text for word in words if word.known or slips.get(word)]
    unknown = [word for word in words if not (word.known or slips.get(word))]
    ok = _says_something(text, known, len(words))
    return Understanding(
        prompt, text, ok, language, tuple(known), tuple(UnknownWord(*word[:3]) for word in unknown),
        tuple((word.text, slip) for word, slip in slips.items() if slip),
    )  # fmt: skip


def _placed(words: tuple[UnknownWord, ...], prompt: str) -> tuple[UnknownWord, ...]:
    """Words of a sentence in other words with their places in the one that was given, which has them in this order."""
    found, start = [], 0
    for word in words:
        at = prompt.find(word.word, start)
        if at >= 0:
            start = at + len(word.word)
            found.append(UnknownWord(word.word, at, start))
    return tuple(found)


def _foreign(prompt: str, translation: Translation) -> Understanding:
    """Words that the table does not have, and those whose English training does not have, are unknown."""
    known, unknown = [], []
    for concept in translation.concepts:
        if concept.kind in ("comma", "stop", "number", "ignored", "side", "unit"):
            continue
        word = UnknownWord(prompt[concept.start : concept.stop], concept.start, concept.stop)
        english = words_of(re.sub(r"<.*>", "", concept.value).replace("/", " "))
        if concept.kind == "unknown" or not all(part.known for part in english):
            unknown.append(word)
        else:
            known.append(word.word)
    ok = bool(translation.english) and says_action(translation.english)
    missing = sum(concept.stop - concept.start for concept in translation.concepts if concept.kind == "unknown")
    ok = ok and missing <= (1 - _SHARE) * sum(letter.isalnum() for letter in prompt)
    return Understanding(
        prompt, translation.english or check_prompt(prompt), ok, translation.language, tuple(known), tuple(unknown),
    )  # fmt: skip


def _telling(text: str) -> list[str]:
    """The words of a text that say something by themselves."""
    return [word for word in words_in(text)[0] if word.lower() not in FUNCTION_WORDS]


def _says_something(text: str, known: list[str], count: int) -> bool:
    """Whether a sentence says a movement, or consists of known words that say something."""
    if not count or len(known) < _SHARE * count:
        return False
    if says_action(text):
        return True
    return len(known) == count and any(word.lower() not in FUNCTION_WORDS for word in known)


def check_understood(prompt: str, force: bool = False) -> Understanding:
    """What is understood of a sentence, if a motion can be made from it.

    Args:
        prompt: A sentence.
        force: Take it even where nothing of it is understood.

    Raises:
        NotUnderstood: No movement in it is understood, none is likely, and `force` is false; the message names its
            words and the nearest sentences that are understood.
    """
    from bunraku.language.reader import guess_of  # numpy

    found = understood(prompt)
    if found.ok or force:
        return found
    # of words that exist, something may be guessed: the text encoder has them whole
    real = not found.denied and all(one.word.lower() in word_pieces() for one in found.unknown)
    if real and guess_of(found.english) is not None:
        return found
    if found.denied:
        raise NotUnderstood(
            f"{found.denied[0]!r} says what is not done, which is not understood; say what is done instead"
        )
    what = _quoted(found.unknown) if found.unknown else f"'{' '.join(prompt.split())[:60]}'"
    near = "; ".join(f"'{sentence}'" for sentence in found.nearest)
    *others, last = LANGUAGES.values()
    read = "" if not found.unknown else f", which is read in English, {', '.join(others)} and {last}"
    raise NotUnderstood(
        f"no movement is understood in the prompt ({what}){read}; sentences like it that are understood: {near}; say "
        "it in other words"
    )
