"""Which stretches of captured clips the sampler may start from, packed into one file."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bunraku.anatomy.anatomy import reference_anatomy
from bunraku.core.body.joint_rotations import skeleton_from_handles
from bunraku.core.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion
from bunraku.core.nn.checkpoints import load_checkpoint, shipped_checkpoint
from bunraku.generation.extractor import RADIUS, Extractor, embed_motions, load_ranker
from bunraku.generation.features import FeatureStatistics, body_handle_motion, decode, encode, mirror
from bunraku.generation.library import all_clips
from bunraku.generation.pack import (
    BUSY,
    FPS,
    IDLE,
    KIND,
    MADE,
    OWN,
    Example,
    ExamplePack,
    Said,
    fingerprint,
    read_pack,
    said_by,
)
from bunraku.generation.verifier import SIDES, Track
from bunraku.gestures.catalogue import STANDING, gestures
from bunraku.gestures.play import gesture_motion, stands_well
from bunraku.language.captions import mirror_words
from bunraku.language.encoders import TextEncoder, text_encoder
from bunraku.language.lexicon import main_actions
from bunraku.language.vocabulary import is_known, own_words, words_of, write_own_words
from bunraku_lab.datasets.motions.build import split_of
from bunraku_lab.datasets.motions.clips import action_labels, load_watched, packed_stretch, write_pack
from bunraku_lab.description.phrases import runs
from bunraku_lab.description.wording import computed_sentence, inside
from bunraku_lab.nn.text import embed_sentences
from bunraku_lab.training.rows.banks import batched
from bunraku_lab.training.rows.clip_rows import ClipSet, Mixture, standing_stretches
from bunraku_lab.training.rows.clips import ClipEntry, load_clips


@dataclass(frozen=True)
class IdleBounds:
    """Bounds of people who stand and do nothing, or something with the hands.

    Args:
        busy: The hands do something.
        shortest: Of a stretch [s].
        longest: The same [s].
        level: How far ankles are from their height at rest at the most [m].
        apart: How far apart they are at the most [m].
        slides: How fast they are at the most [m/s].
        leans: How far the trunk leans at the most [degrees].
        sinks: How far the pelvis is lower than at rest at the most [m].
        shifts: How far it goes over the ground at the most [m].
        hangs: Least distance of idle wrists under the shoulders [m].
        swings: Highest mean speed of hands seen from the pelvis [m/s]; of busy hands the least of the faster one.
    """

    busy: bool = False
    shortest: float = 3.0
    longest: float = 9.0
    level: float = 0.03
    apart: float = 0.5
    slides: float = 0.12
    leans: float = 15.0
    sinks: float = 0.06
    shifts: float = 0.15
    hangs: float = 0.42
    swings: float = 0.12


IDLE_BOUNDS = IdleBounds()
# The shipped examples were packed with these.
BUSY_BOUNDS = IdleBounds(busy=True, sinks=0.1, shifts=0.3, swings=0.2)


def idling(clips: Mapping[str, ClipEntry], bounds: IdleBounds = IDLE_BOUNDS) -> Iterator[tuple[str, np.ndarray]]:
    """The longest such stretch of each clip, as its name and its features, the longest first."""
    found: list[tuple[str, np.ndarray]] = []
    for name, entry in clips.items():
        stretch = _longest(entry["features"], bounds)
        if stretch is not None:
            found.append((name, entry["features"][stretch]))
    yield from sorted(found, key=lambda one: -len(one[1]))


def _longest(features: np.ndarray, bounds: IdleBounds) -> slice | None:
    """The frames of the longest stretch in which a person stands so; None where there is none."""
    motion = decode(features)
    if len(motion) < bounds.shortest * motion.fps:
        return None
    track = Track.of(motion)
    ankles = np.stack([track.points[f"{side}_ankle"] for side in SIDES], axis=1)
    speed = np.linalg.norm(np.diff(ankles, axis=0, prepend=ankles[:1]), axis=-1).max(axis=1) * motion.fps
    calm = (np.ptp(ankles[..., 1], axis=1) < bounds.level) & (ankles[..., 1].max(axis=1) < 0.081 + bounds.level)
    calm &= (np.linalg.norm(ankles[:, 0] - ankles[:, 1], axis=1) < bounds.apart) & (speed < bounds.slides)
    calm &= track.height > -bounds.sinks
    shoulders, hips = (
        np.mean([track.points[f"{side}_{part}"] for side in SIDES], axis=0) for part in ("shoulder", "hip")
    )
    trunk = shoulders - hips
    calm &= trunk[:, 1] > np.cos(np.radians(bounds.leans)) * np.linalg.norm(trunk, axis=1)
    for side in () if bounds.busy else SIDES:
        wrist, shoulder = (track.points[f"{side}_{part}"][:, 1] for part in ("wrist", "shoulder"))
        calm &= wrist < shoulder - bounds.hangs
    best: slice | None = None
    for start, stop in runs(calm):
        stop = min(stop, start + round(bounds.longest * motion.fps))
        part = slice(start, stop)
        if stop - start < max(bounds.shortest * motion.fps, best.stop - best.start if best else 0):
            continue
        swing = max(
            float(np.linalg.norm(np.diff(track.relative(f"{side}_wrist")[part], axis=0), axis=1).mean()) * motion.fps
            for side in SIDES
        )
        if (
            np.ptp(motion.root_translation[part], axis=0).max() < bounds.shifts
            and (swing > bounds.swings) == bounds.busy
        ):
            best = part
    return best


LONGEST = 196
_MARGIN = 8
"""Frames around what is cut out by its numbers."""
_OF_ONE_CLIP = 3
_BUSY_OF_ONE = 2
HOVERS = 0.05
"""Height [m] over the ground from which on nothing touches it, as the shipped examples were packed."""
_GOES = {"walk", "run", "backward", "sidestep", "turn", "turn around", "circle"}
_BUSY = re.compile(
    r"\b(arms?|hands?|balls?|pass(es|ing)?|strokes?|swings?|throws?|fight\w*|karate|push\w*|shov\w*)\b", re.I
)
_WORDINGS = 3
_BYTES = 41
"""Of a packed frame, about, as measured on 60 stretches."""


@dataclass(frozen=True)
class ExampleSettings:
    """What is packed.

    Args:
        data: Folder that `bunraku data motions` wrote.
        out: File to write.
        stretches: Of one action, at the most; of two in a row, a quarter of that.
        events: Of one kind that is plain to see, at the most.
        standing: Stretches of standing that others are joined to.
        idles: Stretches of people who stand, for gestures.
        busy: People who stand and use their hands, two of one clip at the most.
        ranker: Weights in place of the shipped ones; what is packed works with these alone.
        seed: Of the wordings.
        add_to: A pack that is written again with the gestures that it lacks, and with the vectors of `ranker` where
            those are of another; no captured clips are needed, but for idles and busy people where it has none.
        captions: Folder with `captions_watched.json` and `captions_asked.tsv`: the pack of `add_to` gets the sentences
            in which people ask for its stretches, and, where there is `data`, its stretches that show what the pack
            does not.
        motion: Bytes of captured motion that such a pack may have.
    """

    data: Path = Path("runs/data/motions")
    out: Path = Path("runs/examples.safetensors")
    stretches: int = 12
    events: int = 8
    standing: int = 12
    idles: int = 28
    busy: int = 20
    ranker: Path | None = None
    seed: int = 0
    add_to: Path | None = None
    captions: Path | None = None
    motion: int = 5_200_000


GESTURE = "gesture"
"""Kind of what is made by code."""


class _Stretch(NamedTuple):
    name: str
    kind: str
    texts: tuple[str, ...]
    features: np.ndarray
    loop: tuple[int, int] | None
    skeleton: SkeletalMotion | None = None
    asked: tuple[str, ...] = ()
    spare: bool = False  # of a body so unlike a person's that it serves only for actions that others show too rarely


def build_examples(
    settings: ExampleSettings, encoder: TextEncoder | None = None, progress: Callable[[str, float], None] | None = None
) -> ExamplePack:
    """Choose stretches and write them.

    Raises:
        FormatError: The data are missing or damaged.
        WeightsError: The ranker or that pack is damaged.
    """
    progress = progress or (lambda stage, done: None)
    path = settings.ranker or shipped_checkpoint("ranker")
    ranker = load_ranker(path)
    encoder = encoder or batched(text_encoder(ranker.config.text_encoder))
    if settings.add_to is not None:
        return _with_what_it_lacks(settings, ranker, encoder, progress)
    clips = _people(settings, progress)
    statistics = FeatureStatistics.measure([entry["features"] for entry in clips.values()])
    rows = ClipSet(clips, statistics, "train", mixture=Mixture(creatures=0.0, borrowed=0.0))
    found = [
        *(one for one in _stretches(rows, clips) if not one.spare), *_events(rows, settings.seed), *_gestures(),
        *_standing(rows), *_idles(clips), *_busy(clips),
    ]  # fmt: skip
    progress("vectors", 0.0)
    texts, motions, owners = _vectors(found, ranker, encoder)
    own = np.zeros(len(found))
    np.add.at(own, owners, np.einsum("tv,tv->t", texts[0], motions[0, owners]))
    own /= np.maximum(np.bincount(owners, minlength=len(found)), 1)
    kept = _clearest(found, own, settings)
    data = []
    for number, index in enumerate(kept):
        skeleton = found[index].skeleton or skeleton_from_handles(decode(found[index].features), rounds=1)
        data.append(packed_stretch(skeleton.root_translation, skeleton.rotations))
        progress("pack", (number + 1) / len(kept))
    examples = tuple(Example(one.name, one.texts, len(one.features), one.loop) for one in (found[i] for i in kept))
    chosen = np.isin(owners, kept)
    place_of = {index: number for number, index in enumerate(kept)}
    pack = ExamplePack(
        examples, tuple(data), np.array([place_of[owner] for owner in owners[chosen].tolist()], np.int32),
        texts[:, chosen], motions[:, kept], fingerprint(path), readings=shown_by(examples),
    )  # fmt: skip
    licences = Counter(
        "Apache-2.0" if one.made else str(clips[one.name.split("#")[0]].get("licence", "unknown")) for one in examples
    )
    write_pack(settings.out, pack, {"licences": dict(licences), "frames": sum(one.frames for one in examples)})
    return pack


def _people(settings: ExampleSettings, progress: Callable[[str, float], None]) -> dict[str, ClipEntry]:
    """Clips of people to train on."""
    found = load_clips(settings.data, lambda done, total: progress("clips", done / total), splits={"train"})
    return {name: entry for name, entry in found.items() if not entry.get("species")}


def _with_what_it_lacks(
    settings: ExampleSettings, ranker: Extractor, encoder: TextEncoder, progress: Callable[[str, float], None]
) -> ExamplePack:
    """The pack of `settings.add_to` with the gestures whose sentences it lacks, idles and busy people where it has none
    and there are captured clips, and all clips of one's own (`datasets.takes.captioned`) that have become data. The
    words that these alone say are written beside it (`language.known.own_words`). Where the pack was made with another
    ranker, all of its vectors are made anew.
    """
    assert settings.add_to is not None
    base = read_pack(settings.add_to)
    ranked = fingerprint(settings.ranker or shipped_checkpoint("ranker"))
    if base.ranker != ranked:
        progress("vectors", 0.0)
        texts, motions, whose = _vectors(
            [_unpacked(base, index) for index in range(len(base.examples))], ranker, encoder
        )
        base = replace(base, texts=texts, motions=motions, owners=np.asarray(whose, np.int32), ranker=ranked)
    known = {one.texts for one in base.examples}
    found = [one for one in _gestures() if one.texts not in known]
    licences = Counter({"Apache-2.0": len(found)})
    lacking = [(IDLE, _idles, settings.idles, base.idles), (BUSY, _busy, settings.busy, base.busy)]
    clips = _people(settings, progress) if settings.data.exists() else {}
    for suffix, people, most, there in lacking:
        some = [] if there else list(islice(people(clips), most))
        licences.update(str(clips[one.name.removesuffix(suffix)].get("licence", "unknown")) for one in some)
        found += some
    own = {name: entry for name, entry in clips.items() if name.startswith(OWN)}
    if own:
        found += [one for one in _of_ones_own(own) if one.texts not in known]
        licences.update(str(own[one.name].get("licence", "unknown")) for one in found if one.kind == OWN)
        said = {word.text for entry in own.values() for text in entry["texts"] for word in words_of(text)}
        write_own_words(settings.out.parent, {word for word in said if not is_known(word)} | own_words())
    names = _names(clips)
    if settings.captions is not None:
        base = _with_asked(base, _asked(settings.captions), names, ranker, encoder)
    if settings.captions is not None and clips:
        shown = {one.name for one in base.examples}
        rows = ClipSet(clips, FeatureStatistics.measure([entry["features"] for entry in clips.values()]))
        captured = [
            one._replace(asked=one.asked + names.get(one.name, ()))
            for one in _stretches(rows, clips)
            if one.name not in shown
        ]
        base, captured = _widest(base, captured, ranker, encoder, settings.motion)
        licences.update(str(clips[one.name].get("licence", "unknown")) for one in captured)
        found += captured
    texts, motions, owners = _vectors(found, ranker, encoder) if found else (base.texts[:, :0], base.motions[:, :0], [])
    added = [one.skeleton or skeleton_from_handles(decode(one.features), rounds=1) for one in found]
    examples = base.examples + tuple(Example(one.name, one.texts, len(one.features), one.loop) for one in found)
    pack = ExamplePack(
        examples,
        base.data + tuple(packed_stretch(one.root_translation, one.rotations) for one in added),
        np.concatenate([base.owners, np.asarray(owners, np.int32) + len(base.examples)]),
        np.concatenate([base.texts, texts], axis=1),
        np.concatenate([base.motions, motions], axis=1),
        base.ranker,
        readings=shown_by(examples),
    )
    notes = load_checkpoint(settings.add_to, KIND)[1]["notes"]
    licences.update(notes["licences"])
    frames = sum(one.frames for one in pack.examples)
    write_pack(settings.out, pack, notes | {"licences": dict(licences), "frames": frames})
    return pack


def shown_by(examples: Sequence[Example]) -> list[Said]:
    """What each example shows: of a captured stretch the actions that it is labelled with, of a gesture its
    own, of others what the lexicon reads.
    """
    labels, readings = action_labels(), []
    for example in examples:
        said = said_by(example.texts, example.gesture)
        if example.name in labels:
            actions, besides = map(frozenset, labels[example.name])
            said = said._replace(actions=actions or frozenset(("other",)), besides=besides - actions)
        readings.append(said)
    return readings


def _asked(folder: Path) -> dict[str, tuple[str, ...]]:
    """Sentences that ask for what is seen in stretches of training clips, by the fullest caption of each."""
    clips = json.loads((folder / "captions_watched.json").read_text(encoding="utf-8"))["clips"]
    stretches = load_watched(folder, dict.fromkeys((name for name in clips if split_of(name) == "train"), 10**6))
    return {one.texts[0]: one.asked for rows in stretches.values() for one in rows}


def _with_asked(
    pack: ExamplePack, asked: Mapping[str, tuple[str, ...]], names: Mapping[str, tuple[str, ...]],
    ranker: Extractor, encoder: TextEncoder,
) -> ExamplePack:  # fmt: skip
    """A pack with vectors of the sentences that ask for its captured stretches and of their names, where it lacks
    them: captions come first, then these, then those.
    """
    sizes = np.bincount(pack.owners, minlength=len(pack.examples))
    rows = [
        (index, text)
        for index, one in enumerate(pack.examples)
        if one.texts and not one.unranked and sizes[index] >= len(one.texts)
        for text in (asked.get(one.texts[0], ()) + names.get(one.name, ()))[sizes[index] - len(one.texts) :]
    ]
    vectors = _sentence_vectors([text for _, text in rows], ranker, encoder)
    owners = np.concatenate([pack.owners, np.array([index for index, _ in rows], np.int32)])
    return replace(pack, texts=np.concatenate([pack.texts, vectors], axis=1), owners=owners)


EACH = 4
"""Stretches of each action that stay whatever else would fill the bytes, so that candidates and seeds differ."""


def _widest(
    base: ExamplePack, found: list[_Stretch], ranker: Extractor, encoder: TextEncoder, most: int
) -> tuple[ExamplePack, list[_Stretch]]:
    """A pack without the captured stretches that others in it replace best, but for those of the clip library, and of
    new ones those that show what it does not, until its captured motion has `most` bytes: first some that show each
    action alone (`EACH`), and then each time the stretch, of all that are there, to which the most sentences come
    nearer for its bytes.
    """
    texts = _sentence_vectors([text for one in found for text in one.texts + one.asked], ranker, encoder)[0]
    owners = np.array([index for index, one in enumerate(found) for _ in one.texts + one.asked], int)
    sentences = np.concatenate([base.texts[0], texts])
    whose = np.concatenate([base.owners, owners + len(base.examples)])
    clips = {clip.stretch for clip in all_clips()}
    free = [
        index for index, one in enumerate(base.examples)
        if one.texts and "#" not in one.name and not one.unranked and one.name not in clips
    ]  # fmt: skip
    ours = [index for index, one in enumerate(base.examples) if index not in set(free)]
    bytes_of = np.array([len(part) for part in base.data] + [_BYTES * len(one.features) for one in found], float)
    stretches = [*free, *range(len(base.examples), len(base.examples) + len(found))]
    near = np.stack([(sentences @ sentences[whose == index].T).max(axis=1) for index in stretches], axis=1) ** 2
    covered = np.full(len(sentences), 0.0)
    left = most - sum(bytes_of[index] for index in ours if not base.examples[index].made)
    kept: list[int] = []
    gains = np.full(len(stretches), np.inf)
    spare = np.array([index >= len(base.examples) and found[index - len(base.examples)].spare for index in stretches])
    shown = Counter(said.actions for said in shown_by([base.examples[index] for index in ours]))
    rows = [*base.examples, *(Example(one.name, one.texts, len(one.features)) for one in found)]
    for place, said in enumerate(shown_by([rows[index] for index in stretches])):
        enough = EACH // 2 if spare[place] else EACH
        if len(said.actions) == 1 and not said.besides and shown[said.actions] < enough:
            shown[said.actions] += 1
            covered = np.maximum(covered, near[:, place])
            left -= bytes_of[stretches[place]]
            kept.append(stretches[place])
            gains[place] = -1
    gains[spare] = -1
    while True:
        place = int(np.argmax(gains))
        if gains[place] <= 0 or left <= 0:
            break
        gain = float(np.maximum(near[:, place] - covered, 0).sum()) / bytes_of[stretches[place]]
        if gain < gains[place] and gain < np.partition(gains, -2)[-2]:
            gains[place] = gain  # what was last known of the others is more: they are looked at again first
            continue
        covered = np.maximum(covered, near[:, place])
        left -= bytes_of[stretches[place]]
        kept.append(stretches[place])
        gains[place] = -1
    stays = sorted([*ours, *(index for index in kept if index < len(base.examples))])
    place_of = {index: number for number, index in enumerate(stays)}
    kept_rows = np.isin(base.owners, stays)
    slim = replace(
        base, examples=tuple(base.examples[index] for index in stays), data=tuple(base.data[index] for index in stays),
        owners=np.array([place_of[owner] for owner in base.owners[kept_rows].tolist()], np.int32),
        texts=base.texts[:, kept_rows], motions=base.motions[:, stays], stand=None,
        readings=None,
    )  # fmt: skip
    return slim, [found[index - len(base.examples)] for index in sorted(kept) if index >= len(base.examples)]


def _unpacked(pack: ExamplePack, index: int) -> _Stretch:
    """An example of a pack, as it was before it was packed."""
    one = pack.examples[index]
    kind = OWN if one.name.startswith(OWN) else GESTURE if one.made else ""
    return _Stretch(one.name, kind, one.texts, pack.features(index), one.loop)


def _of_ones_own(clips: Mapping[str, ClipEntry]) -> Iterator[_Stretch]:
    """All clips that are no longer than what is drawn at once."""
    rows = ClipSet(clips, FeatureStatistics.measure([entry["features"] for entry in clips.values()]))
    for clip in rows.clips:
        if len(clip.values) <= LONGEST:
            yield _Stretch(clip.name, OWN, clip.texts, clips[clip.name]["features"], clip.loop)


def _stretches(rows: ClipSet, clips: Mapping[str, ClipEntry]) -> Iterator[_Stretch]:
    for clip in sorted(rows.clips, key=lambda clip: -clip.weight):
        if clip.watched and len(clip.values) <= LONGEST:
            kind = "action: " + " and ".join(clip.actions)
            features, spare = clips[clip.name]["features"], clip.weight < 0.5
            yield _Stretch(clip.name, kind, clip.texts, features, clip.loop, asked=clip.asked, spare=spare)


def _names(clips: Mapping[str, ClipEntry]) -> dict[str, tuple[str, ...]]:
    """What the archive calls clips that are watched as one stretch: names, as makers of games write them."""
    stretches = Counter(name.split("@")[0] for name in clips)
    return {
        name: tuple(entry.get("labels") or ()) for name, entry in clips.items() if stretches[name.split("@")[0]] == 1
    }


def _events(rows: ClipSet, seed: int) -> Iterator[_Stretch]:
    pool = rows.event_pool()
    for kind, members in sorted(pool.kinds.items()):
        for index, phrase in members:
            clip = rows.clips[index]
            start, stop = max(phrase.start - _MARGIN, 0), min(phrase.stop + _MARGIN, len(clip.values))
            described = [one for one in inside(pool.phrases[index], start, stop) if one.kind != "still"]
            random = np.random.default_rng([seed, index, phrase.start])
            made = [computed_sentence(described, [()], stop - start, random, None) for _ in range(_WORDINGS)]
            texts = tuple(dict.fromkeys(text for text in made if text))
            if texts and clip.weight >= 0.5 and _seen(texts, clip.texts):
                features = rows.statistics.restore(clip.values[start:stop])
                if "jump" not in kind and _hovers(features):
                    continue
                yield _Stretch(f"{clip.name}#{start}", f"event: {kind}", texts, features, None)


def _hovers(features: np.ndarray) -> bool:
    """Whether nothing of the body is near the ground in a quarter of the frames: a floor that was found too low."""
    body = reference_body()
    heights = reference_anatomy().surface_reach.lowest(decode(features).transforms(body.handles.positions))
    return bool((heights > HOVERS).mean() > 0.25)


def _seen(computed: Sequence[str], watched: Sequence[str]) -> bool:
    """Whether the watched captions of a stretch name every action that its numbers name. A stretch of travel in which
    the hands are busy does not count: a person who backs up to pass a ball is no example of walking backwards.
    """
    said = set(main_actions(computed))
    busy = said <= _GOES and any(_BUSY.search(text) for text in watched)
    return said <= set(main_actions(watched)) and not busy


def _gestures() -> Iterator[_Stretch]:
    for number, gesture in enumerate(gestures()):
        loop = None
        if gesture.cycle is not None:
            loop = round(gesture.cycle[1] * FPS), round(gesture.cycle[0] * FPS)
        motion = gesture_motion(gesture)
        features = encode(body_handle_motion(motion))
        name = f"{MADE}{gesture.name.replace(' ', '_')}_{number}"
        yield _Stretch(name, GESTURE, gesture.texts, features, loop, motion)
    motion = gesture_motion(STANDING)
    yield _Stretch(f"{MADE}{STANDING.name}", GESTURE, (), encode(body_handle_motion(motion)), None, motion)


def _standing(rows: ClipSet) -> list[_Stretch]:
    """Stretches of standing, the longest first."""
    found = [
        _Stretch(f"{clip.name}#{number}", "standing", (), rows.statistics.restore(values[:LONGEST]), None)
        for clip in rows.clips
        for number, values in enumerate(standing_stretches(clip.values, rows.statistics))
    ]
    return sorted(found, key=lambda one: -len(one.features))


def _idles(clips: Mapping[str, ClipEntry]) -> Iterator[_Stretch]:
    for name, features in idling(clips):
        yield _Stretch(f"{name}{IDLE}", "idle", (), features, None)


def _busy(clips: Mapping[str, ClipEntry]) -> Iterator[_Stretch]:
    """People who stand well and do something with their hands, the longest first."""
    of_clip: Counter[str] = Counter()
    for name, features in idling(clips, BUSY_BOUNDS):
        clip = name.split("@")[0]
        skeleton = skeleton_from_handles(decode(features), rounds=1)
        if of_clip[clip] < _BUSY_OF_ONE and stands_well(skeleton):
            of_clip[clip] += 1
            yield _Stretch(f"{name}{BUSY}", "busy", (), features, None, skeleton)


def _sentence_vectors(sentences: Sequence[str], ranker: Extractor, encoder: TextEncoder) -> np.ndarray:
    """Unit vectors of sentences, as they are and in the mirror, shape (2, T, V)."""
    both = [list(sentences), list(map(mirror_words, sentences))]
    vectors = embed_sentences(ranker, encoder, [text for texts in both for text in texts])
    size = next(iter(vectors.values())).shape[-1] if vectors else ranker.config.embedding
    return np.array([[vectors[text] for text in some] for some in both]).reshape(2, len(sentences), size) / RADIUS


def _vectors(
    found: list[_Stretch], ranker: Extractor, encoder: TextEncoder
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors of all sentences (2, T, V) and motions (2, E, V), as they are and in the mirror, and which stretch
    each sentence is of, (T,).
    """
    owners = np.array([index for index, one in enumerate(found) for _ in one.texts + one.asked], int)
    texts = _sentence_vectors([text for one in found for text in one.texts + one.asked], ranker, encoder)
    motions = np.array([embed_motions(ranker, [way(one.features) for one in found]) for way in (np.asarray, mirror)])
    motions /= RADIUS
    for index, one in enumerate(found):
        if one.kind in (GESTURE, OWN) and one.texts:  # the ranker never saw them, and they are what their sentences say
            centre = texts[:, owners == index].mean(axis=1)
            motions[:, index] = centre / np.linalg.norm(centre, axis=-1, keepdims=True)
    return texts, motions, owners


def _clearest(found: list[_Stretch], own: np.ndarray, settings: ExampleSettings) -> list[int]:
    """Places of what is kept: of each kind those whose motion is nearest to their own sentences."""
    most: int
    counts: Counter[str] = Counter()
    of_clip: Counter[tuple[str, str]] = Counter()
    kept = []
    for index in np.argsort(-own, kind="stable").tolist():
        kind, clip = found[index].kind, found[index].name.split("@")[0]
        if kind == GESTURE:
            most, clip = len(found), found[index].name
        elif kind == "standing":
            most, clip = settings.standing, found[index].name
        elif kind == "idle":
            most, clip = settings.idles, found[index].name
        elif kind == "busy":
            most, clip = settings.busy, found[index].name
        elif kind.startswith("event"):
            most = settings.events
        else:  # of what is done in a row, sentences seldom ask for the very same
            most = settings.stretches // 4 ** kind.count(" and ")
        if counts[kind] < most and of_clip[kind, clip] < _OF_ONE_CLIP:
            counts[kind] += 1
            of_clip[kind, clip] += 1
            kept.append(index)
    return sorted(kept)
