"""What is plain to see in people's training clips, by kind, so that the rare is drawn as the common is.

A punch with one hand, a half turn, a few steps backwards and sitting down are a hundredth of what clips show, but much
of what people ask for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.language.captions.phrases import mirror_words
from bunraku.language.description.track import Phrase, Track
from bunraku_lab.description.events import find_punches, find_seats
from bunraku_lab.training.rows.training_clip import TrainingClip

__all__ = ["EventPool"]

ENOUGH = 40
"""Events of a kind from which on more do not make it more frequent."""
_MARGIN = 8  # frames of a row that are left for what stands around an event
_AWAY = ("backwards", "sideways")
_SEATED = {"sit", "stand up"}


class EventPool:
    """Events of all clips, by what is said of them; left and right count as one, since rows are mirrored.

    Args:
        clips: Training clips; people's are looked at.
        phrases_of: What can be said of a clip by its numbers.
        motion_of: The motion of a clip.
        frames: Longest row.
    """

    def __init__(
        self,
        clips: Sequence[TrainingClip],
        phrases_of: Callable[[TrainingClip], list[Phrase]],
        motion_of: Callable[[TrainingClip], HandleMotion],
        frames: int,
    ):
        self.clips = clips
        self.phrases: dict[int, list[Phrase]] = {}
        self.kinds: dict[str, list[tuple[int, Phrase]]] = {}
        for index, clip in enumerate(clips):
            if clip.species is not None:
                continue
            phrases = list(phrases_of(clip))
            if clip.watched:
                track = Track.of(motion_of(clip)) if {"punch", *_SEATED} & set(clip.actions) else None
                phrases += find_punches(track) if track is not None and "punch" in clip.actions else []
                seats = find_seats(track) if track is not None and _SEATED & set(clip.actions) else []
                phrases = [phrase for phrase in phrases if not _within(phrase, seats)] + seats
            self.phrases[index] = sorted(phrases, key=lambda phrase: (phrase.start, phrase.stop, phrase.kind))
            for phrase in phrases:
                if _tells(phrase) and phrase.stop - phrase.start < frames - _MARGIN:
                    self.kinds.setdefault(_kind(phrase), []).append((index, phrase))
        self._names = sorted(self.kinds)
        worth = np.array([min(len(self.kinds[name]), ENOUGH) ** 0.5 for name in self._names])
        self._share = worth / worth.sum() if len(worth) else worth

    def draw(self, random: np.random.Generator) -> tuple[TrainingClip, Phrase, list[Phrase]] | None:
        """One event, with its clip and all that can be said of that; None where there is no event."""
        if not self._names:
            return None
        name = self._names[int(random.choice(len(self._names), p=self._share))]
        index, phrase = self.kinds[name][int(random.integers(len(self.kinds[name])))]
        return self.clips[index], phrase, self.phrases[index]


def _tells(phrase: Phrase) -> bool:
    if phrase.kind == "go":
        return any(way in part for part in phrase.manner for way in _AWAY)
    return phrase.kind != "still"


def _within(phrase: Phrase, seats: Sequence[Phrase]) -> bool:
    """Whether it is a bend that is part of sitting down or standing up."""
    return phrase.kind == "bend" and any(min(phrase.stop, seat.stop) > max(phrase.start, seat.start) for seat in seats)


def _kind(phrase: Phrase) -> str:
    return min(phrase.texts[0], mirror_words(phrase.texts[0]))
