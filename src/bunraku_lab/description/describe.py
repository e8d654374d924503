"""Sentences computed from a motion itself: "turns left twice, then runs forward".

`describe` finds phrases with the frames in which they hold (`travel` and `events` have the rules), so a
crop of the motion gets only words that are true in it; `sentences` puts them in order.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from bunraku.core.motion import HandleMotion
from bunraku.language.captions.grammar import conjugate
from bunraku.language.description.track import Phrase, Track
from bunraku_lab.description.events import find_arms, find_bends, find_jumps, find_kicks, find_stillness
from bunraku_lab.description.travel import find_gaits, find_turns

__all__ = ["chain", "describe", "inside", "joined", "sentences"]

_LEAST = 16  # frames of a state that are worth a word
_TIMES = {2: "twice", 3: "three times", 4: "four times", 5: "five times"}
_COUNTED = {"turn", "jump", "kick", "bend"}


def describe(motion: HandleMotion, human: bool = True) -> list[Phrase]:
    """What a motion of the reference body plainly does, in order of time.

    Args:
        motion: Of 30 handles.
        human: False for creatures, of which only directions and turns are described.
    """
    track = Track.of(motion)
    if len(track) < 8:
        return []
    turns = find_turns(track)
    ways = find_gaits(track, turns, human)
    circles = [way for way in ways if any("circle" in word for word in way.manner)]
    found = ways + [turn for turn in turns if _overlap(turn, circles) < 0.5]
    if human:
        jumps = find_jumps(track)
        found = [phrase for phrase in found if phrase.kind != "go" or _overlap(phrase, jumps) < 0.2]
        bends = [phrase for phrase in find_bends(track) if _overlap(phrase, jumps) < 0.2]
        found += jumps + find_kicks(track) + find_arms(track) + bends + find_stillness(track)
    occurrences = Counter((phrase.start, phrase.stop, phrase.kind) for phrase in found)
    # two of a kind in the very same frames have no order that a mirror would keep
    found = [phrase for phrase in found if occurrences[phrase.start, phrase.stop, phrase.kind] == 1]
    return sorted(found, key=lambda phrase: (phrase.start, phrase.stop, phrase.kind))


def _overlap(phrase: Phrase, others: Sequence[Phrase]) -> float:
    shared = sum(max(min(phrase.stop, other.stop) - max(phrase.start, other.start), 0) for other in others)
    return shared / max(phrase.stop - phrase.start, 1)


def inside(phrases: Sequence[Phrase], start: int, stop: int) -> list[Phrase]:
    """The phrases that are true in frames `start` to `stop` - 1, with frames counted from `start`; repeats are counted
    in words.
    """
    kept, broken = [], []
    for phrase in phrases:
        a, b = max(phrase.start, start), min(phrase.stop, stop)
        if phrase.start >= start and phrase.stop <= stop:
            kept.append(replace(phrase, start=a - start, stop=b - start))
        elif phrase.part and b - a >= _LEAST:
            manner = phrase.manner if phrase.part == phrase.texts else ()
            kept.append(replace(phrase, texts=phrase.part, start=a - start, stop=b - start, manner=manner))
        elif b > a:
            broken.append((phrase.kind, set(phrase.texts)))
    return _counted(kept, broken)


def _counted(phrases: list[Phrase], broken: list[tuple[str, set[str]]]) -> list[Phrase]:
    """Neighbours that say the same become one, with how often; no number where the crop cuts one of them."""
    out: list[tuple[Phrase, int]] = []
    for phrase in phrases:
        if out and out[-1][0].kind == phrase.kind and out[-1][0].texts == phrase.texts:
            last, times = out[-1]
            out[-1] = (replace(last, stop=max(last.stop, phrase.stop)), times + 1)
        else:
            out.append((phrase, 1))
    found = []
    for phrase, times in out:
        if times > 1 and phrase.kind in _COUNTED:
            sure = all(kind != phrase.kind for kind, _ in broken)
            often = _TIMES.get(times, "several times") if sure else "more than once"
            phrase = replace(phrase, texts=tuple(f"{text} {often}" for text in phrase.texts if " and " not in text))
        found.append(phrase)
    return found


def _texts(phrases: Sequence[Phrase], variant: int) -> list[str]:
    return [phrase.texts[variant * (index + 1) % len(phrase.texts)] for index, phrase in enumerate(phrases)]


def joined(phrases: Sequence[Phrase], variant: int = 0, most: int = 4) -> str:
    """Phrases in order as one, verbs in braces: "{turn} left twice, then {run} forward"; empty without phrases.

    Args:
        phrases: From `inside`.
        variant: Chooses rewordings and links.
        most: Phrases to name; standing still is left out first.
    """
    described = list(phrases)
    if len(described) > 1:
        moving = [phrase for phrase in described if phrase.kind != "still"]
        described = moving if len(described) > most and moving else described
    described = described[:most]
    groups: list[str] = []
    for index, (phrase, text) in enumerate(zip(described, _texts(described, variant), strict=True)):
        before = described[index - 1]
        together = min(before.stop, phrase.stop) - max(before.start, phrase.start)
        if index and together > 0.5 * min(before.stop - before.start, phrase.stop - phrase.start):
            groups[-1] += f" and {text}" if " and " not in groups[-1] + text else f", {text}"
        else:
            groups.append(text)
    return chain(groups, variant)


def chain(parts: Sequence[str], variant: int = 0) -> str:
    """Clauses in order of time with the word "then", in one of three ways."""
    if len(parts) < 2:
        return "".join(parts)
    if variant % 3 == 0:
        return ", then ".join(parts)
    return ", ".join(parts[:-1]) + (" and then " if variant % 3 == 1 else ", and then ") + parts[-1]


def sentences(phrases: Sequence[Phrase], start: int, stop: int) -> list[str]:
    """What happens in frames `start` to `stop` - 1, in order, in several wordings of the third person without a
    subject.

    Args:
        phrases: From `describe`.
        start: First frame of the crop.
        stop: Frame after its last.
    """
    found = inside(phrases, start, stop)
    if not found:
        return []
    return list(dict.fromkeys(conjugate(joined(found, variant), "third") for variant in range(6)))
