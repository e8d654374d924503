"""What a text says by the lexicon: its words, actions, cues, traits, the locomotion, and known words in place of
rare ones.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Sequence

from bunraku.language.lexicon.tables import Phrase, lexicon

__all__ = [
    "actions_of",
    "goes_ahead",
    "in_known_words",
    "is_cyclic",
    "locomotion_of",
    "main_actions",
    "longest_phrase",
    "said_otherwise",
    "said_phrases",
    "said_traits",
    "stays_down",
    "words_of",
]


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
