"""Whether an English sentence says a movement as captions do: "I saw your brother" is no sawing.

The rules find words. How near the sentence's vector is to that of the nearest caption with the same movement tells
what they mean; the text encoder is the one that `animate` reads with.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from bunraku.formats.files import atomic_write
from bunraku.language.captions.grammar import conjugate
from bunraku.language.captions.phrases import known_phrases
from bunraku.language.encoders import MiniLMEncoder
from bunraku.language.lexicon.reading import actions_of, said_phrases, words_of
from bunraku_lab.training.language.pairs import lot

__all__ = ["MEANT", "NOT_MEANT", "Likeness", "likeness_of", "measure"]

MEANT, NOT_MEANT = 0.36, 0.28
"""Cosines from which a movement is meant, and under which it is not; what lies between teaches nothing."""
_CAPTIONS = 6
"""Captions of a movement, the shortest."""
_LEAST = 3
"""Sentences with the same word for the same movement that tell what it means in others."""
Likeness = dict[str, dict[str, float]]
"""The cosine of each movement in each sentence."""


def measure(
    sentences: Iterable[str],
    path: Path,
    most: int = 250,
    encoder: MiniLMEncoder | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> Likeness:
    """How near sentences are to captions of what the rules find in them, kept in a file.

    Args:
        sentences: In English.
        path: A JSON file, which is gone on with.
        most: Sentences of each movement, drawn by lot.
        encoder: In place of the built-in one.
        progress: Called with the share done.
    """
    found: Likeness = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    counts: Counter[str] = Counter()
    todo = []
    for sentence in sorted(set(sentences), key=lambda one: lot(one, "likeness")):
        actions = actions_of(sentence)
        if actions and min(counts[action] for action in actions) < most:
            counts.update(actions)
            if sentence not in found:
                todo.append(sentence)
    if not todo:
        return found
    encoder = encoder or MiniLMEncoder()
    captions = _captions(encoder)
    for number, sentence in enumerate(todo, 1):
        vector = encoder.encode([sentence]).pooled[0]
        found[sentence] = {
            action: round(float((captions[action] @ vector).max()), 3)
            for action in actions_of(sentence)
            if action in captions
        }
        progress(number / len(todo))
    with atomic_write(path) as file:
        file.write(json.dumps(found, ensure_ascii=False).encode())
    return found


def _captions(encoder: MiniLMEncoder) -> dict[str, np.ndarray]:
    by_action: dict[str, set[str]] = defaultdict(set)
    for phrase in known_phrases():
        caption = f"a person {conjugate(phrase, 'third')}"
        for action in actions_of(caption):
            by_action[action].add(caption)
    return {
        action: np.concatenate([
            encoder.encode([caption]).pooled
            for caption in sorted(captions, key=lambda one: (len(actions_of(one)), len(one), one))[:_CAPTIONS]
        ])
        for action, captions in by_action.items()
    }  # fmt: skip


def likeness_of(found: Likeness) -> Callable[[str], dict[str, float]]:
    """A function that gives the cosine of each movement of a sentence: its own, or else the mean of those that say
    the movement by the same word.
    """
    by_word: dict[tuple[str, str], list[float]] = defaultdict(list)
    for sentence, cosines in found.items():
        for action, word in _said_by(sentence).items():
            if action in cosines:
                by_word[action, word].append(cosines[action])
    means = {key: float(np.mean(some)) for key, some in by_word.items() if len(some) >= _LEAST}

    def of(sentence: str) -> dict[str, float]:
        if sentence.startswith("a person "):  # a caption
            return dict.fromkeys(actions_of(sentence), 1.0)
        if sentence in found:
            return found[sentence]
        said = _said_by(sentence)
        return {action: means[action, word] for action, word in said.items() if (action, word) in means}

    return of


def _said_by(sentence: str) -> dict[str, str]:
    """The word at which each movement of a sentence begins."""
    words, at = words_of(sentence)[0], said_phrases(sentence)["actions"]
    return {action: words[at[action]] for action in actions_of(sentence)}
