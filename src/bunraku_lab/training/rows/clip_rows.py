"""Training rows: clips drawn, mirrored and joined, each with a sentence and a mesh."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.generation.composition import join_point, on_one_leg, splice
from bunraku.generation.features import FeatureStatistics, decode, feature_weights, mirror
from bunraku.generation.verifier import Track
from bunraku.language.captions import conjugate, mirror_words
from bunraku_lab.description.captions import caption_group, is_stative
from bunraku_lab.description.events import find_punches, find_seats
from bunraku_lab.description.phrases import Phrase
from bunraku_lab.description.wording import (
    borrowed_sentence,
    can_do,
    computed_sentence,
    creature_subjects,
    describe,
    inside,
    verbs,
)
from bunraku_lab.training.rows.clips import MIN_FRAMES, ClipEntry, TrainingClip, goes_on, joined_sentence
from bunraku_lab.training.rows.joins import FEWEST, Joins

ENOUGH = 40
"""Events of a kind from which on more do not make it more frequent."""
_MARGIN = 8  # frames of a row that are left for what stands around an event
_AWAY = ("backwards", "sideways")
_SEATED = {"sit", "stand up"}


class EventPool:
    """Events of all clips, by what is said of them; left and right count as one, since rows are mirrored."""

    def __init__(
        self, clips: Sequence[TrainingClip], phrases_of: Callable[[TrainingClip], list[Phrase]],
        motion_of: Callable[[TrainingClip], HandleMotion], frames: int,
    ):  # fmt: skip
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


_SUBJECTS = ("a person", "someone", "the character", "a human", "the person", "a man", "a woman", "he", "she")
# {1t} is the first clause in the third person, {2g} the second as a gerund, {1p} plain; {s} the subject
_TWO = (
    "{s} {1t} and then {2t}", "{s} {1t}, then {2t}", "{s} {1t} and {2t}", "{s} {1t}, and then {2t}",
    "first {s} {1t}, then {2t}",
    "{1p}, then {2p}", "{1p} and then {2p}", "first {1p}, then {2p}", "{1t}, then {2t}",
    "{s} {1t}, and after that {2t}",
    "{s} {1t} before {2g}", "{s} {1t}, followed by {2g}", "after {1g}, {s} {2t}", "{s} {2t} after {1g}",
    "{s} is {1g}, then {2g}",
    "{s} starts by {1g} and then {2t}", "{s} {1t}, afterwards {2t}", "{s} {1t} and finally {2t}",
)  # fmt: skip
_THREE = (
    "{s} {1t}, {2t} and then {3t}", "{s} {1t}, then {2t}, then {3t}", "{s} {1t}, then {2t} and {3t}",
    "first {s} {1t}, then {2t} and finally {3t}",
    "{1p}, then {2p}, then {3p}", "{1t}, {2t}, then {3t}", "{s} {1t} and then {2t} before {3g}",
    "after {1g}, {s} {2t} and then {3t}",
    "{s} starts by {1g}, then {2t}, and finally {3t}",
)  # fmt: skip


def link(phrases: Sequence[str], random: np.random.Generator, subjects: Sequence[str] = _SUBJECTS) -> str:
    """One sentence for two or three phrases that follow each other in time.

    Args:
        phrases: With their verbs in braces, as `grammar` has them.
        random: Chooses the form and the subject.
        subjects: To choose from.
    """
    frames: tuple[str, ...] = _TWO if len(phrases) == 2 else _THREE
    stative = [str(index + 1) for index, phrase in enumerate(phrases) if is_stative(phrase)]
    frames = tuple(frame for frame in frames if not any(f"{{{index}g}}" in frame for index in stative))
    words = {
        f"{index + 1}{form[0]}": conjugate(phrase, form)
        for index, phrase in enumerate(phrases)
        for form in ("plain", "third", "gerund")
    }
    sentence = frames[int(random.integers(len(frames)))].replace("{s}", subjects[int(random.integers(len(subjects)))])
    for key, text in words.items():
        sentence = sentence.replace(f"{{{key}}}", text)
    return sentence


def goes(clip: TrainingClip) -> bool:
    """Whether a person walks or runs in it, and may walk on."""
    return bool({"walk", "run"} & set(clip.actions))


def joins_of(clips: Sequence[TrainingClip], statistics: FeatureStatistics) -> Joins:
    """Banks of all stretches of standing, and of all walks and runs that can be played again."""
    people = [clip for clip in clips if clip.species is None]
    standing = [part for clip in people for part in standing_stretches(clip.values, statistics)]
    walking = [
        (clip.values, clip.loop)
        for clip in people
        if clip.loop is not None and clip.actions in (("walk",), ("run",)) and len(clip.values) >= FEWEST
    ]
    return Joins(standing, walking)


FEWEST_CLIPS, MOST_CLIPS = 20, 150
"""Bounds between which an action is drawn more often the more clips show it."""
ASKED = 0.4
"""Share of a stretch's own rows that have a sentence in which people ask for it. Chosen, not measured: the other
sentences are what the tables and the examples are compared by.
"""
_BLEND = 8


class Row(NamedTuple):
    """A motion (N, D) in network units, its sentence, its character in the mesh bank (or None), and its clips."""

    values: np.ndarray
    sentence: str
    mesh: str | None
    clips: tuple[str, ...] = ()


@dataclass(frozen=True)
class MotionBatch:
    """Padded motions with their sentences.

    Args:
        values: Normalised features, zero where padded, shape (B, N, D), float32.
        lengths: Real frames, shape (B,).
        sentences: One a row.
        meshes: One a row: the character's name in the mesh bank, None for any humanoid.
        clips: One a row: the names of the clips that it was made of.
    """

    values: np.ndarray
    lengths: np.ndarray
    sentences: list[str]
    meshes: list[str | None]
    clips: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class Mixture:
    """What is drawn how often.

    Args:
        creatures: Share of draws that are creatures' clips, where there are any; within them every action of every
            species counts the same, unless the index weighs it less.
        computed: Share of rows whose sentence is computed from the motion, where it says anything plain.
        borrowed: Share of people's rows that are given a creature's mesh, of those that do what no clip of that
            creature shows, so that a person's words move a creature too.
        events: Share of people's rows that are plain to see in the numbers, cut out of a clip and described by them.
        balance: Power of the number of an action's clips by which it is drawn.
        most_drawn: How many times as often as the median clip one is drawn at the most.
        rehearse: Share of people's draws that are of what the network knew before, where there is any.
    """

    creatures: float = 0.25
    computed: float = 0.3
    borrowed: float = 0.1
    events: float = 0.15
    balance: float = 0.5
    most_drawn: float = np.inf
    rehearse: float = 0.0


class ClipSet:
    """Clips ready to be drawn.

    Args:
        clips: What `load_clips` returned.
        statistics: Units of the network.
        split: "train", "val" or "test".
        frames: Longest crop.
        mixture: What is drawn how often.
    """

    def __init__(
        self, clips: Mapping[str, ClipEntry], statistics: FeatureStatistics, split: str = "train", frames: int = 196,
        mixture: Mixture = Mixture(),
    ):  # fmt: skip
        self.frames = frames
        self.statistics = statistics
        self.computed, self.borrowed, self.events = mixture.computed, mixture.borrowed, mixture.events
        self.balance, self.most_drawn, self.rehearse = mixture.balance, mixture.most_drawn, mixture.rehearse
        self._share = feature_weights()
        self._still = (-statistics.mean[:3] / statistics.std[:3]).astype(np.float32)  # a root at rest, in network units
        self._bucket: tuple[tuple[Any, ...], list[Row], np.ndarray] | None = None
        self._phrases: dict[str, list[Phrase]] = {}
        self._pool: EventPool | None = None
        self.clips = [
            TrainingClip.prepare(name, entry, statistics, frames)
            for name, entry in clips.items()
            if entry.get("split", "train") == split and len(entry["features"]) >= MIN_FRAMES
        ]
        self.probability = self._probability(mixture.creatures) if self.clips else np.zeros(0)
        self._named = {clip.name: clip for clip in self.clips if clip.watched}
        self.joins = joins_of(self.clips, statistics) if self._named else None
        self._of_character: dict[str | None, np.ndarray] = {}
        for character in {clip.character for clip in self.clips if clip.species} | {None}:
            members = [
                index
                for index, clip in enumerate(self.clips)
                if (clip.character if clip.species else None) == character
            ]
            self._of_character[character] = np.array(members, int)
        actions: dict[str, set[str]] = {}
        cast: dict[str, set[str]] = {}
        for clip in self.clips:
            if clip.species and clip.character:
                cast.setdefault(clip.species, set()).add(clip.character)
                if clip.action:
                    actions.setdefault(clip.species, set()).update(can_do(clip.species, clip.action))
        self._can = actions
        self._cast = {species: sorted(characters) for species, characters in cast.items()}

    def _probability(self, creatures: float) -> np.ndarray:
        """Groups of people by action, else by label: square roots of their seconds (at most two minutes)."""
        groups: dict[str, list[int]] = {}
        for index, clip in enumerate(self.clips):
            groups.setdefault(clip.label, []).append(index)
        weights = np.zeros(len(self.clips))
        animal = np.array([clip.species is not None for clip in self.clips])
        for members in groups.values():
            seconds = np.array([len(self.clips[index].values) for index in members]) / 20
            own = np.array([self.clips[index].weight for index in members])
            if animal[members[0]]:
                weights[members] = own / max(own.sum(), 1.0)
                continue
            worth = caption_group(self.clips[members[0]].texts[0]).weight
            share = np.sqrt(seconds) * own
            weights[members] = worth * np.sqrt(np.clip(seconds.sum(), 4, 120)) * share / max(share.sum(), 1e-9)
        if any(clip.watched for clip in self.clips):
            weights[~animal] = self._by_action(~animal)
        known = np.array([clip.rehearsed for clip in self.clips])
        if known.any() and (new := ~animal & ~known).any():
            weights[known] *= self.rehearse / weights[known].sum()
            weights[new] *= (1 - self.rehearse) / weights[new].sum()
        if animal.any() and not animal.all():
            weights[animal] *= creatures / weights[animal].sum()
            weights[~animal] *= (1 - creatures) / weights[~animal].sum()
        return weights / weights.sum()

    def _by_action(self, seen: np.ndarray) -> np.ndarray:
        """Weights of these clips: an action counts by a power of its clips, at least `FEWEST_CLIPS`."""
        groups: dict[str, float] = {}
        for index in np.flatnonzero(seen):
            for action in self.clips[index].actions:
                groups[action] = groups.get(action, 0.0) + self.clips[index].weight
        worth = {
            action: float(np.clip(count, FEWEST_CLIPS, MOST_CLIPS)) ** self.balance / max(count, 1.0)
            for action, count in groups.items()
        }
        clips = [self.clips[index] for index in np.flatnonzero(seen)]
        weights = np.array([clip.weight * np.mean([worth[action] for action in clip.actions]) for clip in clips])
        return np.minimum(weights, self.most_drawn * float(np.median(weights)))

    def draw(self, random: np.random.Generator, compose: float = 0.0) -> Row:
        """One motion of at most `frames` frames with its sentence and mesh."""
        clip = self.clips[int(random.choice(len(self.clips), p=self.probability))]
        mirrored = bool(random.random() < 0.5)
        pair = self._compose(clip, random) if random.random() < compose else None
        if pair is not None:
            row = self._worded(clip, *pair, random)
        elif clip.species is None and random.random() < self.events:
            row = self._event(random) or self._plain(clip, random)
        else:
            row = self._plain(clip, random)
        # the statistics are mirror-symmetric, so mirroring commutes with them
        return row._replace(values=mirror(row.values), sentence=mirror_words(row.sentence)) if mirrored else row

    def _worded(
        self, clip: TrainingClip, values: np.ndarray, sentence: str, labels: list[tuple[str, ...]],
        names: tuple[str, ...], random: np.random.Generator,
    ) -> Row:  # fmt: skip
        """A row of joined clips, sometimes with what can be computed of it for a sentence."""
        if random.random() < self.computed:
            found = self._true_in(clip, values, None)
            sentence = computed_sentence(found, labels, len(values), random, clip.species) or sentence
        return Row(values, sentence, clip.character, names)

    def _plain(self, clip: TrainingClip, random: np.random.Generator) -> Row:
        """One clip, whole where it is done once, or cut where it goes on, made longer by what its sentence allows."""
        after = self._named.get(clip.follows or "")
        if after is not None and len(clip.values) + len(after.values) <= 1.1 * self.frames and random.random() < 0.35:
            texts = [
                (one, other)
                for one, other in zip(clip.texts, after.texts, strict=False)
                if goes_on(one) and goes_on(other)
            ]
            if texts:
                values = np.concatenate([clip.values, after.values])
                start = int(random.integers(0, max(len(values) - self.frames, 0) + 1))
                return Row(
                    values[start : start + self.frames], joined_sentence(texts[int(random.integers(len(texts)))]),
                    clip.character, (clip.name, after.name),
                )  # fmt: skip
        target = int(random.integers(40, self.frames + 1)) if random.random() < 0.6 else self.frames
        values, start = clip.values, 0
        if len(values) < target and random.random() < 0.7:
            values = self._lengthened(clip, target, random)
        least = target if clip.loop is not None or not clip.watched else self.frames  # what is done once is not cut
        start = int(random.integers(0, max(len(values) - least, 0) + 1))
        whole = values is clip.values
        values = values[start : start + least]
        variants = clip.sentences()
        own = random.random() < (
            0.5 if clip.watched else 0.3 if clip.species else 0.0
        )  # as written, by those who know the clip
        if clip.asked and random.random() < ASKED:
            variants, own = clip.asked, False
        sentence = (
            clip.texts[int(random.integers(len(clip.texts)))] if own else variants[int(random.integers(len(variants)))]
        )
        mesh = clip.character
        if clip.species is None and random.random() < self.borrowed:
            mesh, sentence = self._borrow(clip, sentence, random)
        if mesh == clip.character and random.random() < (0.4 if clip.watched else 1.0) * self.computed:
            found = self._true_in(clip, values, start if whole else None)
            sentence = computed_sentence(found, [clip.phrases], len(values), random, clip.species) or sentence
        return Row(values, sentence, mesh, (clip.name,))

    def _lengthened(self, clip: TrainingClip, target: int, random: np.random.Generator) -> np.ndarray:
        if clip.loop is None and clip.species is None and self.joins is not None:
            values = self.joins.around(clip.values, target, goes(clip), random)
            if values is not clip.values:
                return values
        return clip.lengthened(target, self._still, random)

    def _event(self, random: np.random.Generator) -> Row | None:
        """What is plain to see in a clip's numbers (a rotation, a jump, a punch), cut out and described alone."""
        found = self.event_pool().draw(random)
        if found is None:
            return None
        clip, phrase, phrases = found
        start = max(phrase.start - int(random.integers(2, 14)), 0)
        stop = min(phrase.stop + int(random.integers(2, 14)), len(clip.values))
        described = [one for one in inside(phrases, start, stop) if one.kind != "still"]
        sentence = computed_sentence(described, [()], stop - start, random, None)
        if sentence is None or stop - start < MIN_FRAMES:
            return None
        values = clip.values[start:stop]
        if self.joins is not None and random.random() < 0.8:
            target = int(random.integers(stop - start, self.frames + 1))
            values = self.joins.around(values, target, goes(clip), random)
        return Row(values, sentence, clip.character, (clip.name,))

    def event_pool(self) -> EventPool:
        """What is plain to see in the clips' numbers, found once."""
        if self._pool is None:
            self._pool = EventPool(self.clips, self._all_phrases, self._motion, self.frames)
        return self._pool

    def _motion(self, clip: TrainingClip) -> HandleMotion:
        return decode(self.statistics.restore(clip.values))

    def _all_phrases(self, clip: TrainingClip) -> list[Phrase]:
        """What can be said of the whole clip by its numbers, found once."""
        if clip.name not in self._phrases:
            self._phrases[clip.name] = describe(self._motion(clip), clip.species is None)
        return self._phrases[clip.name]

    def _true_in(self, clip: TrainingClip, values: np.ndarray, start: int | None) -> list[Phrase]:
        """What can be said of a row: the clip's phrases for a plain crop of it, else computed from the row."""
        if start is None:
            return inside(describe(decode(self.statistics.restore(values)), clip.species is None), 0, len(values))
        return inside(self._all_phrases(clip), start, start + len(values))

    def _borrow(self, clip: TrainingClip, sentence: str, random: np.random.Generator) -> tuple[str | None, str]:
        """A creature that cannot do this by itself, with words for it; nothing where every creature can."""
        wanted = verbs(clip.phrases)
        able = sorted(species for species, own in self._can.items() if wanted and not wanted & own)
        if not able:
            return None, sentence
        species = able[int(random.integers(len(able)))]
        characters = self._cast[species]
        return characters[int(random.integers(len(characters)))], borrowed_sentence(
            clip.phrases, clip.sentences(), species, random
        )

    def _compose(
        self, clip: TrainingClip, random: np.random.Generator
    ) -> tuple[np.ndarray, str, list[tuple[str, ...]], tuple[str, ...]] | None:
        """The clip, then one or two others that go well with its end: "a person walks forward and then waves".

        People follow people, and a creature's clips those of the same character.
        """
        described, names = [clip.phrases], [clip.name]
        if not described[0]:
            return None
        partners = self._of_character.get(clip.character if clip.species else None, np.zeros(0, int))
        chance = self.probability[partners]
        if not chance.sum() > 0:
            return None
        count = 3 if random.random() < 0.3 else 2
        least, most = (0.2, 0.56) if count == 2 else (0.15, 0.36)
        span = [int(random.integers(int(least * self.frames), int(most * self.frames) + 1)) for _ in range(count)]
        if clip.watched and clip.loop is None:  # what is done once is not cut
            span[0] = max(span[0], len(clip.values))
            if span[0] > 0.7 * self.frames:
                return None
        values = clip.lengthened(span[0], self._still, random)
        begin = int(random.integers(0, max(len(values) - span[0], 0) + 1))
        values, last, labels = values[begin : begin + span[0]], 0, [clip.label]
        for number in range(1, count):
            best: tuple[float, int, int, np.ndarray, TrainingClip] | None = None
            for index in random.choice(partners, size=6, p=chance / chance.sum()):
                other = self.clips[int(index)]
                if other.label in labels or not other.phrases or len(other.values) < 12 or len(values) - last < 12:
                    continue
                rest = span[number] if number + 1 < count else self.frames
                if (
                    other.watched
                    and other.loop is None
                    and len(other.values) > self.frames - len(values) + len(values) // 4
                ):
                    continue
                head = other.lengthened(span[number], self._still, random)
                head = head if other.watched and other.loop is None else head[:rest]
                i, j, distance = join_point(values[last:], head, self._share)
                if best is None or distance < best[0]:
                    best = (distance, last + i, j, head, other)
            if best is None or best[0] > 0.5:
                break
            _, i, j, head, other = best
            values, last = splice(values, head, i, j, _BLEND), i
            labels.append(other.label)
            described.append(other.phrases)
            names.append(other.name)
        if len(described) < 2:
            return None
        words = [phrases[int(random.integers(len(phrases)))] for phrases in described]
        sentence = link(words, random, *([creature_subjects(clip.species)] if clip.species else []))
        return values[: self.frames], sentence, described, tuple(names)

    def batch(self, seed: int, number: int, size: int, compose: float = 0.0, bucket: int = 4) -> MotionBatch:
        """Batch `number` of the endless series of a seed; `bucket` neighbours share draws, sorted by length."""
        key = (seed, number // bucket, size, compose, bucket)
        if self._bucket is None or self._bucket[0] != key:
            random = np.random.default_rng([seed, number // bucket, 7])
            items = [self.draw(random, compose) for _ in range(size * bucket)]
            items.sort(key=lambda item: len(item.values))
            self._bucket = (key, items, random.permutation(bucket))
        _, items, order = self._bucket
        index = int(order[number % bucket])
        return pad(items[index * size : (index + 1) * size])

    def fixed(self, size: int, seed: int = 0) -> MotionBatch:
        """The same unmirrored crops every time, for validation: each clip from its start, with a fixed sentence."""
        random = np.random.default_rng(seed)
        rows = []
        for index in random.permutation(len(self.clips))[:size]:
            clip = self.clips[index]
            rows.append(Row(clip.values[: self.frames], clip.sentences()[0], clip.character, (clip.name,)))
        return pad(rows)

    def sentences(self) -> list[str]:
        """All sentences of labels, sorted, to encode before training; computed ones are without end."""
        found = {sentence for clip in self.clips for mirrored in (False, True) for sentence in clip.sentences(mirrored)}
        own = {text for clip in self.clips if clip.species for text in clip.texts}
        return sorted(found | own | set(map(mirror_words, own)))


def pad(rows: list[Row]) -> MotionBatch:
    """Rows of one length, the longest, zero behind their end."""
    lengths = np.array([len(row.values) for row in rows])
    values = np.zeros((len(rows), int(lengths.max()), rows[0].values.shape[1]), np.float32)
    for position, row in zip(values, rows, strict=True):
        position[: len(row.values)] = row.values
    return MotionBatch(
        values, lengths, [row.sentence for row in rows], [row.mesh for row in rows], tuple(row.clips for row in rows)
    )


def standing_stretches(values: np.ndarray, statistics: FeatureStatistics) -> list[np.ndarray]:
    """Stretches in which the person stands upright on both legs and hardly moves."""
    if len(values) < FEWEST:
        return []
    features = statistics.restore(values)
    change = (np.diff(values[:, 4:], axis=0, prepend=values[:1, 4:]) ** 2).mean(1)
    calm = (
        (change < 0.004) & (np.abs(features[:, :3]).max(1) < 0.25) & (features[:, 3] > -0.1) & (features[:, 8] > 0.95)
    )
    edges = np.flatnonzero(np.diff(np.concatenate([[0], calm.astype(np.int8), [0]])))
    return [
        values[start:stop]
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
        if stop - start >= FEWEST and not on_one_leg(features[start:stop])
    ]
