"""The clips that networks train on and are measured with: features, captions, and shipped examples."""

from __future__ import annotations

import functools
import re
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypedDict, cast

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError, OptionError
from bunraku.generation.composition import END, held, join_point, played, rests
from bunraku.generation.features import FEATURE_SIZE, HANDLE_SIZE, ROOT_SIZE, FeatureStatistics, encode, feature_weights
from bunraku.generation.pack import ExamplePack
from bunraku.language.captions import mirror_words
from bunraku.language.lexicon import is_cyclic, lexicon, main_actions
from bunraku_lab.datasets.motions.clips import load_clip, load_index, read_bundle
from bunraku_lab.description.captions import caption_clauses, caption_group, caption_variants, sentence_forms
from bunraku_lab.description.wording import all_variants, clauses

MIN_FRAMES = 8


class ClipEntry(TypedDict, total=False):
    """What is known of a clip; `features`, shape (N, D), and `frames` always are."""

    features: np.ndarray
    frames: int
    split: str
    texts: list[str]
    asked: list[str]
    labels: list[str]
    watched: bool
    weight: float
    species: str | None
    action: str | None
    character: str | None
    next: str
    source: str
    licence: str
    credit: str
    rehearsed: bool


def _features(path: Path, motion: HandleMotion) -> np.ndarray:
    if abs(motion.fps - 20) > 0.01:
        raise FormatError(
            path,
            f"the clip has {motion.fps:g} frames a second, not 20; build the data again with 'bunraku data motions'",
        )
    return encode(motion)


def load_clips(folder: str | Path, progress: Any = None, splits: Collection[str] | None = None) -> dict[str, ClipEntry]:
    """Features and index entries of clips by name.

    A clip with captions by time becomes one entry a stretch, "name@first frame", without those that are faulty.

    Args:
        folder: `index.json` and one NPZ a clip of `bunraku data motions`, or the file of `bunraku data bundle`.
        progress: Called with (done, total).
        splits: "train", "val", "test": those to load; None for all.

    Raises:
        FormatError: The index or a clip is missing or damaged.
    """
    folder = Path(folder)
    bundle = read_bundle(folder) if folder.is_file() else None
    index = load_index(folder) if bundle is None else bundle.clips
    found: dict[str, ClipEntry] = {}
    for done, (name, entry) in enumerate(sorted(index.items())):
        if (entry.get("texts") or entry.get("species")) and (splits is None or entry.get("split", "train") in splits):
            path = folder / f"{name}.npz"
            features = _features(path, load_clip(path)) if bundle is None else encode(bundle.motion(name))
            try:
                found |= _entries(name, entry, features)
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                raise FormatError(
                    folder, f"what the index says of {name} cannot be read ({error!r}); build the data again"
                ) from error
        if progress is not None:
            progress(done + 1, len(index))
    if not found:
        raise FormatError(folder, "there is no captioned clip; build the data with 'bunraku data motions'")
    return found


def load_people(
    folder: str | Path, progress: Callable[[str, float], None], labelled: bool = True
) -> tuple[dict[str, ClipEntry], dict[str, ClipEntry]]:
    """Clips of people to train on, and those to validate with.

    Args:
        folder: As of `load_clips`.
        labelled: With labelled actions of game characters.

    Raises:
        OptionError: There are none to train on.
        FormatError: The data are missing or damaged.
    """
    clips = load_clips(folder, lambda done, total: progress("clips", done / total), splits={"train", "val"})
    train, held = (people(clips, split, labelled) for split in ("train", "val"))
    if not train:
        raise OptionError(
            f"{folder}: there are no training clips of people; build the data again with 'bunraku data motions'"
        )
    return train, held


def people(clips: Mapping[str, ClipEntry], split: str, labelled: bool = False) -> dict[str, ClipEntry]:
    """Captured motions of people of one split: no creature.

    Args:
        clips: What `load_clips` returned.
        split: "train", "val" or "test".
        labelled: With labelled actions of game characters, each of which has many captions that mean the same.
    """
    others = ("species",) if labelled else ("species", "character", "action")
    return {
        name: entry
        for name, entry in clips.items()
        if entry.get("split", "train") == split and not any(entry.get(key) for key in others)
    }


def _entries(name: str, entry: Mapping[str, object], features: np.ndarray) -> dict[str, ClipEntry]:
    if "stretches" in entry:
        return _stretches(name, entry, features)
    return {name: cast(ClipEntry, {**entry, "features": features})} if len(features) >= MIN_FRAMES else {}


def _stretches(name: str, entry: Mapping[str, object], features: np.ndarray) -> dict[str, ClipEntry]:
    """Stretches as entries of their own; those that follow without a gap are named in "next"."""
    parts = entry["stretches"]
    if not isinstance(parts, list):
        raise TypeError("its stretches are no list")
    sound = [part for part in parts if "fault" not in part and part["stop"] - part["start"] >= MIN_FRAMES]
    found: dict[str, ClipEntry] = {}
    common = {key: value for key, value in entry.items() if key not in ("stretches", "texts")}
    for part, after in zip_longest(sound, sound[1:]):
        start, stop = int(part["start"]), int(part["stop"])
        own: dict[str, Any] = {
            "texts": part["texts"], "asked": part.get("asked", []), "watched": True,
            "features": features[start:stop], "frames": stop - start,
        }  # fmt: skip
        if len(sound) == 1:
            own["labels"] = entry.get("texts") or []
        if after is not None and after["start"] == stop:
            own["next"] = f"{name}@{stop}"
        found[f"{name}@{start}"] = cast(ClipEntry, common | own)
    return found


_SUBJECT = re.compile(
    r"^(?:a|the|one) (?:person|human|man|woman|figure|character)\b|^someone\b|^somebody\b", re.IGNORECASE
)
_SUBJECTS = (
    "a person", "someone", "the character", "a man", "a woman", "the person", "he", "she", "a figure", "a human",
    "somebody", "this person",
)  # fmt: skip
_LINK = re.compile(r"(,? and then |,? then |,? and |, )")


@functools.lru_cache(maxsize=8192)
def stretch_phrases(texts: tuple[str, ...]) -> tuple[str, ...]:
    """The tersest sentence with its verbs in braces, "{walk} fast, {turn} left"; none if it begins with no verb."""
    parts = _LINK.split(texts[-1])
    braced = []
    for index, part in enumerate(parts):
        first, *rest = part.split(" ", 1)
        if index % 2 == 0 and first.lower() in lexicon().verbs:
            part = " ".join(["{" + first.lower() + "}", *rest])
        elif index == 0:
            return ()
        braced.append(part)
    return ("".join(braced),)


@functools.lru_cache(maxsize=8192)
def stretch_variants(texts: tuple[str, ...], labels: tuple[str, ...] = (), mirrored: bool = False) -> tuple[str, ...]:
    """All sentences for a stretch: as written, the full ones with another subject, and the tersest in a few forms.

    Args:
        texts: Its sentences, the tersest last.
        labels: Sentences from labels that say the same (`agreeing`).
        mirrored: For the mirror image.
    """
    found = list(texts)
    for text in texts:
        subject = _SUBJECT.match(text)
        if subject:
            other = _SUBJECTS[zlib.crc32(text.encode()) % len(_SUBJECTS)]
            found.append(other + text[subject.end() :])
    for phrase in stretch_phrases(texts):
        forms = sentence_forms(phrase)
        found += [forms[0], *(forms[(zlib.crc32(phrase.encode()) + step) % len(forms)] for step in range(2))]
    found += labels
    return tuple(dict.fromkeys(map(mirror_words, found) if mirrored else found))


@functools.lru_cache(maxsize=8192)
def agreeing(texts: tuple[str, ...], labels: tuple[str, ...], most: int = 4) -> tuple[str, ...]:
    """Sentences of labels whose verbs the watched sentences have too, and whose sides and directions they do not deny.

    Args:
        texts: Sentences of a stretch.
        labels: Labels of its clip.
        most: How many to give at the most, drawn by their spelling.
    """
    seen = " ".join(texts).lower()
    found: list[str] = []
    for label in labels:
        phrases = caption_clauses(label, form="braces")
        good = [phrase for phrase in phrases if _agrees(phrase, seen)]
        if good:
            sentences = caption_variants(label)
            first = zlib.crc32(label.encode())
            found += [sentences[(first + 7 * step) % len(sentences)] for step in range(most)]
    kept = [sentence for sentence in dict.fromkeys(found) if _sides(sentence) <= _sides(seen)]
    return tuple(kept[:most])


_BRACED = re.compile(r"\{(\w+)\}")


def _agrees(phrase: str, seen: str) -> bool:
    return all(re.search(rf"\b{verb[: max(len(verb) - 1, 3)]}", seen) for verb in _BRACED.findall(phrase))


def _sides(sentence: str) -> set[str]:
    words = ("left", "right", "backward", "sideways", "around", "twice", "circle", "clockwise")
    return {word for word in words if word in sentence.lower()}


def joined_sentence(sentences: Sequence[str]) -> str:
    """Full sentences about one person as one, in order: "a person sits down, then gets up and walks off"."""
    first, *rest = sentences
    return first + "".join(f", then {_SUBJECT.sub('', text).strip()}" for text in rest)


def goes_on(text: str) -> bool:
    """Whether a sentence has a subject that the next one can do without."""
    return bool(_SUBJECT.match(text))


FARTHEST = 8.0
"""Standard deviations beyond which a velocity or a translation is a fault of capture, which would outweigh all else in
a squared error. Rotations have no such faults: a lying person is twelve deviations from standing.
"""


def is_rotation() -> np.ndarray:
    """Which features are numbers of a rotation, shape (271,), bool."""
    mask = np.zeros(FEATURE_SIZE, bool)
    mask[4:ROOT_SIZE] = True
    mask[ROOT_SIZE:].reshape(-1, HANDLE_SIZE)[:, 3:] = True
    return mask


_FARTHEST = np.where(is_rotation(), np.inf, FARTHEST).astype(np.float32)
_ONCE = re.compile(
    r"\b(then|once|twice|two|three|four|five|six|times|after|before|finally|first|ends?|ending|starts?|stops?|stopping|"
    r"begins?|halts?|until|again|turns?|turning|half ?way|back up|back to|straightens|stands? up|gets? up|rises?|"
    r"sits? down|lies? down|single|double|triple|slows?|pauses?|finish\w*|away)\b"
)
"""Words of a sentence that is no longer true when its motion is played twice."""
_FINAL = {"death", "die", "dead", "hit", "hit reaction", "attack", "jump", "land", "spawn", "fall"}
_TURNS = frozenset({"spin", "circle"})
MOST_TURN = np.radians(25)
"""Change of heading [rad] in one round of a loop; more adds up to a rotation that no caption names."""


@dataclass(frozen=True)
class TrainingClip:
    """One clip, or a stretch of one, in network units.

    Args:
        name: Its name in the index.
        values: Normalised features, shape (N, D), float32.
        texts: Its captions: labels as the archive has them, or sentences of what was watched.
        watched: The captions were written from watching just this; the fullest is first, the tersest last.
        asked: Sentences in which people ask for what was watched.
        labels: Labels of the archive for a watched clip, used where they say the same.
        weight: The index's own weight.
        loop: Frames (i, j) such that playing on from j after i is smooth and true to the captions; None without.
        rests: The clip ends at rest, so its last pose can be held.
        follows: Name of the stretch that goes on where this one ends.
        species: What creature it is of; None for people.
        action: What is done, in a canonical word, where the index says so.
        character: The creature's name in the mesh bank; None for any humanoid.
        rehearsed: It is not of the data, but something that the network knew before.
    """

    name: str
    values: np.ndarray
    texts: tuple[str, ...]
    watched: bool = False
    asked: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    weight: float = 1.0
    loop: tuple[int, int] | None = None
    rests: bool = False
    follows: str | None = None
    species: str | None = None
    action: str | None = None
    character: str | None = None
    rehearsed: bool = False

    @property
    def label(self) -> str:
        """What groups it with clips of the same meaning."""
        if self.watched:
            return " and ".join(self.actions)
        group = caption_group(self.texts[0])
        return (
            f"{self.species or 'person'}: {self.action}"
            if self.action and not (self.species is None and group.phrases)
            else group.name
        )

    @property
    def actions(self) -> tuple[str, ...]:
        """What a person does in it, in the words that the draws are balanced by."""
        return main_actions(self.texts)

    @property
    def phrases(self) -> tuple[str, ...]:
        """What it shows without a subject, verbs in braces; none where no caption has that form."""
        return stretch_phrases(self.texts) if self.watched else clauses(self.texts[0], self.species, self.action)

    def sentences(self, mirrored: bool = False) -> tuple[str, ...]:
        """All sentences that the captions give."""
        if self.watched:
            asked = tuple(map(mirror_words, self.asked)) if mirrored else self.asked
            return (*stretch_variants(self.texts, agreeing(self.texts, self.labels), mirrored), *asked)
        labels = ("",) if self.species else self.texts
        return tuple(
            dict.fromkeys(
                sentence for text in labels for sentence in all_variants(text, self.species, self.action, mirrored)
            )
        )

    @classmethod
    def prepare(cls, name: str, entry: ClipEntry, statistics: FeatureStatistics, frames: int) -> TrainingClip:
        """Bring a clip to network units and see whether it loops or ends at rest.

        Args:
            name: Its name in the index.
            entry: Its index entry with its "features", shape (N, D).
            statistics: Units of the network.
            frames: Only clips shorter than this are ever lengthened.
        """
        values = np.clip(statistics.normalise(entry["features"]).astype(np.float32), -_FARTHEST, _FARTHEST)
        species, action = entry.get("species"), entry.get("action")
        creature = (species, action, entry.get("character")) if species and action else (None, action, None)
        texts = tuple(entry.get("texts") or [f"a {species}: {action}"])
        watched, loop, ends_at_rest = bool(entry.get("watched")), None, False
        if len(values) < frames:
            if may_loop(texts, species, action):
                i, j, distance = join_point(values, values, feature_weights())
                turn = abs(float(entry["features"][j:i, 0].sum())) / 20
                if (
                    distance < (0.8 if len(values) < 60 else 0.3)
                    and i - j >= 6
                    and (turn < MOST_TURN or _TURNS & set(main_actions(texts)))
                ):
                    loop = (i, j)
            ends_at_rest = rests(values[-END:], statistics)
        asked, labels = tuple(entry.get("asked") or ()), tuple(entry.get("labels") or ())
        return cls(
            name, values, texts, watched, asked, labels, float(entry.get("weight", 1.0)), loop, ends_at_rest,
            entry.get("next"), creature[0], creature[1], creature[2], bool(entry.get("rehearsed")),
        )  # fmt: skip

    def lengthened(self, target: int, still: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """The clip repeated from its loop point, or with its last pose held, until it has `target` frames if it can.

        Args:
            target: Frames wanted.
            still: The root's velocities at rest in network units, shape (3,).
            random: Draws how long the last pose is held.

        Returns:
            The very array of the clip where nothing can be added, else a longer one, shape (N, D).
        """
        if self.loop is not None:
            return played(self.values, self.loop, target)
        if self.rests and len(self.values) < target:
            return held(self.values, min(target - len(self.values), int(random.integers(5, 40))), still)
        return self.values


def may_loop(texts: tuple[str, ...], species: str | None, action: str | None) -> bool:
    """Whether what the captions say is still true when the motion is played again."""
    if species is not None:
        return action not in _FINAL
    return all(map(is_cyclic, main_actions(texts))) and not any(_ONCE.search(text) for text in texts)


def rehearsal_clips(pack: ExamplePack) -> dict[str, ClipEntry]:
    """What is captured of a pack, with its sentences, by name.

    Args:
        pack: Examples; those made by code are left out, since they are played and not drawn.
    """
    return {
        f"rehearsed_{one.name}": ClipEntry(
            features=pack.features(index),
            frames=one.frames,
            split="train",
            texts=list(one.texts),
            watched=True,
            rehearsed=True,
        )
        for index, one in enumerate(pack.examples)
        if one.texts and not one.made and one.frames >= MIN_FRAMES
    }
