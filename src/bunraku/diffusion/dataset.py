"""Training clips: loading, drawing, mirroring, lengthening and joining them.

Every batch is a pure function of the seed and its number, so a run that was killed goes on with the very batches it would
have seen.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.diffusion.captions import caption_group, caption_variants
from bunraku.diffusion.clips import load_clip, load_index
from bunraku.diffusion.features import FeatureStatistics, encode, feature_weights, mirror
from bunraku.errors import FormatError

__all__ = ["ClipSet", "MotionBatch", "join_point", "load_clips", "splice"]

MIN_FRAMES = 8
FARTHEST = 8.0  # standard deviations; beyond are faults of capture that would outweigh all else in a squared error
_BLEND = 6


@dataclass(frozen=True)
class Clip:
    """One clip in network units.

    Args:
        name: Its name in the index.
        values: Normalised features, shape (N, D), float32.
        texts: Its captions as the archive has them.
        weight: The index's own weight.
        loop: Frames (i, j) such that playing on from j after i is smooth; None where there are none.
        rests: The clip ends at rest, so its last pose can be held.
    """

    name: str
    values: np.ndarray
    texts: tuple[str, ...]
    weight: float = 1.0
    loop: tuple[int, int] | None = None
    rests: bool = False


@dataclass(frozen=True)
class MotionBatch:
    """Padded motions with their sentences.

    Args:
        values: Normalised features, zero where padded, shape (B, N, D), float32.
        lengths: Real frames, shape (B,).
        sentences: One a row.
    """

    values: np.ndarray
    lengths: np.ndarray
    sentences: list[str]


def _features(path: Path) -> np.ndarray:
    motion = load_clip(path)
    if abs(motion.fps - 20) > 0.01:
        raise FormatError(path, f"the clip has {motion.fps:g} frames a second, not 20; build the data again with 'bunraku data motions'")
    return encode(motion)


def load_clips(folder: str | Path, progress: Any = None, splits: Collection[str] | None = None) -> dict[str, dict[str, Any]]:
    """Features and index entries of clips: {name: {"features": (N, D), "texts", "split", "weight", ...}}.

    Args:
        folder: What `bunraku data motions` wrote: `index.json` and one NPZ a clip.
        progress: Called with (done, total).
        splits: "train", "val", "test": those to load; None for all.

    Raises:
        FormatError: The index or a clip is missing or damaged.
    """
    folder = Path(folder)
    index = load_index(folder)
    found = {}
    for done, (name, entry) in enumerate(sorted(index.items())):
        if entry.get("texts") and (splits is None or entry.get("split", "train") in splits):
            features = _features(folder / f"{name}.npz")
            if len(features) >= MIN_FRAMES:
                found[name] = {**entry, "features": features}
        if progress is not None:
            progress(done + 1, len(index))
    if not found:
        raise FormatError(folder, "there is no captioned clip; build the data with 'bunraku data motions'")
    return found


def join_point(tail: np.ndarray, head: np.ndarray, weights: np.ndarray, blend: int = _BLEND) -> tuple[int, int, float]:
    """Where to leave one motion and enter another so that pose and velocity agree best.

    Args:
        tail: Motion to leave in its last quarter, shape (N, D), network units.
        head: Motion to enter in its first quarter, shape (M, D).
        weights: Share of each feature, shape (D,).
        blend: Frames that both must still have after that.

    Returns:
        Frame i of the tail, frame j of the head, and the mean squared difference there.
    """
    last = max(len(tail) - blend + 1, 1)
    first = min(3 * len(tail) // 4, last - 1)
    stop = max(1, min(len(head) // 4, len(head) - blend))
    scale = np.sqrt(weights / weights.sum())
    a, b = tail[first:last] * scale, head[:stop] * scale
    distance = (a**2).sum(1)[:, None] + (b**2).sum(1) - 2 * a @ b.T
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    return first + int(i), int(j), float(max(distance[i, j], 0))


def splice(tail: np.ndarray, head: np.ndarray, i: int, j: int, blend: int = _BLEND) -> np.ndarray:
    """`tail` up to frame i, then `head` from frame j, cross-faded over the next `blend` frames of both."""
    blend = min(blend, len(tail) - i, len(head) - j)
    share = np.linspace(0, 1, blend + 2, dtype=np.float32)[1:-1, None]
    share = share * share * (3 - 2 * share)
    mixed = tail[i : i + blend] * (1 - share) + head[j : j + blend] * share
    return np.concatenate([tail[:i], mixed, head[j + blend :]])


class ClipSet:
    """Clips ready to be drawn.

    Args:
        clips: What `load_clips` returned.
        statistics: Units of the network.
        split: "train", "val" or "test".
        frames: Longest crop.
    """

    def __init__(self, clips: dict[str, dict[str, Any]], statistics: FeatureStatistics, split: str = "train", frames: int = 196):
        self.frames = frames
        self.statistics = statistics
        self._share = feature_weights()
        still = -statistics.mean[:3] / statistics.std[:3]
        self._still = still.astype(np.float32)
        self._bucket: tuple[tuple[Any, ...], list[tuple[np.ndarray, str]], np.ndarray] | None = None
        self.clips = [
            self._prepare(name, entry)
            for name, entry in clips.items()
            if entry.get("split", "train") == split and len(entry["features"]) >= MIN_FRAMES
        ]
        self.probability = self._probability() if self.clips else np.zeros(0)

    def _prepare(self, name: str, entry: dict[str, Any]) -> Clip:
        values = np.clip(self.statistics.normalise(entry["features"]).astype(np.float32), -FARTHEST, FARTHEST)
        loop, rests = None, False
        if len(values) < self.frames:
            i, j, distance = join_point(values, values, self._share)
            if distance < (0.8 if len(values) < 60 else 0.3) and i - j >= 6:
                loop = (i, j)
            speed = np.abs(entry["features"][-4:, :3]).max()
            change = float((np.diff(values[-4:], axis=0)[:, 4:] ** 2).mean())
            rests = bool(speed < 0.5 and change < 0.02)
        return Clip(name, values, tuple(entry["texts"]), float(entry.get("weight", 1.0)), loop, rests)

    def _probability(self) -> np.ndarray:
        """Square roots all through: of a group's seconds (at most two minutes count), and of a clip's share in its group."""
        groups: dict[str, list[int]] = {}
        for index, clip in enumerate(self.clips):
            groups.setdefault(caption_group(clip.texts[0]).name, []).append(index)
        weights = np.zeros(len(self.clips))
        for members in groups.values():
            seconds = np.array([len(self.clips[index].values) for index in members]) / 20
            worth = caption_group(self.clips[members[0]].texts[0]).weight
            share = np.sqrt(seconds) * [self.clips[index].weight for index in members]
            weights[members] = worth * np.sqrt(np.clip(seconds.sum(), 4, 120)) * share / max(share.sum(), 1e-9)
        return weights / weights.sum()

    def _lengthen(self, clip: Clip, target: int, random: np.random.Generator) -> np.ndarray:
        """The clip played again from its loop point, or with its last pose held, until it has `target` frames or can have no more."""
        values = clip.values
        if clip.loop is not None:
            i, j = clip.loop
            while len(values) < target:
                values = splice(values, clip.values, len(values) - len(clip.values) + i, j)
        elif clip.rests and len(values) < target:
            hold = np.repeat(values[-1:], min(target - len(values), int(random.integers(5, 40))), axis=0)
            fade = 0.5 ** np.arange(1, len(hold) + 1, dtype=np.float32)[:, None]
            hold[:, :3] = self._still + (hold[:, :3] - self._still) * fade
            values = np.concatenate([values, hold])
        return values

    def _crop(self, values: np.ndarray, random: np.random.Generator, length: int) -> np.ndarray:
        start = int(random.integers(0, max(len(values) - length, 0) + 1))
        return values[start : start + length]

    def draw(self, random: np.random.Generator, compose: float = 0.0) -> tuple[np.ndarray, str]:
        """One motion (N, D) in network units with N <= `frames`, and its sentence."""
        clip = self.clips[int(random.choice(len(self.clips), p=self.probability))]
        mirrored = bool(random.random() < 0.5)
        text = clip.texts[int(random.integers(len(clip.texts)))]
        if random.random() < compose:
            pair = self._compose(clip, text, random, mirrored)
            if pair is not None:
                return pair
        target = int(random.integers(40, self.frames + 1)) if random.random() < 0.6 else self.frames
        values = clip.values
        if len(values) < target and random.random() < 0.7:
            values = self._lengthen(clip, target, random)
        values = self._crop(values, random, target)
        variants = caption_variants(text, mirrored)
        return (self._mirror(values) if mirrored else values), variants[int(random.integers(len(variants)))]

    def _mirror(self, values: np.ndarray) -> np.ndarray:
        # the statistics are mirror-symmetric, so mirroring commutes with them
        return mirror(values)

    def _compose(self, clip: Clip, text: str, random: np.random.Generator, mirrored: bool) -> tuple[np.ndarray, str] | None:
        """The clip, then another that goes well with its end: "a person walks forward and then waves"."""
        if not caption_group(text).phrases:
            return None
        first = self._crop(clip.values, random, int(random.integers(40, 110)))
        best: tuple[float, int, int, np.ndarray, Clip] | None = None
        for index in random.choice(len(self.clips), size=6, p=self.probability):
            other = self.clips[int(index)]
            if other.name == clip.name or not caption_group(other.texts[0]).phrases or len(other.values) < 2 * _BLEND or len(first) < 2 * _BLEND:
                continue
            second = other.values[: self.frames]
            i, j, distance = join_point(first, second, self._share)
            if best is None or distance < best[0]:
                best = (distance, i, j, second, other)
        if best is None or best[0] > 0.5:
            return None
        _, i, j, second, other = best
        values = splice(first, second, i, j, 8)[: self.frames]
        words = [self._bare(one, random, mirrored) for one in (text, other.texts[0])]
        link = (" and then ", ", then ", " and ")[int(random.integers(3))]
        subject = ("a person ", "someone ", "the character ", "")[int(random.integers(4))]
        return (self._mirror(values) if mirrored else values), subject + link.join(words)

    @staticmethod
    def _bare(text: str, random: np.random.Generator, mirrored: bool) -> str:
        """A sentence of the label in the third person without its subject."""
        bare = [
            sentence[9:]
            for sentence in caption_variants(text, mirrored)
            if sentence.startswith("a person ") and not sentence.startswith("a person is ")
        ]
        return bare[int(random.integers(len(bare)))] if bare else caption_variants(text, mirrored)[-1]

    def batch(self, seed: int, number: int, size: int, compose: float = 0.0, bucket: int = 4) -> MotionBatch:
        """Batch `number` of the endless series of a seed. `bucket` neighbours share their draws, sorted by length, to pad little."""
        key = (seed, number // bucket, size, compose, bucket)
        if self._bucket is None or self._bucket[0] != key:
            random = np.random.default_rng([seed, number // bucket, 7])
            items = [self.draw(random, compose) for _ in range(size * bucket)]
            items.sort(key=lambda item: len(item[0]))
            self._bucket = (key, items, random.permutation(bucket))
        _, items, order = self._bucket
        place = int(order[number % bucket])
        return pad(items[place * size : (place + 1) * size])

    def fixed(self, size: int, seed: int = 0) -> MotionBatch:
        """The same unmirrored crops every time, for validation: each clip from its start, with a fixed sentence."""
        random = np.random.default_rng(seed)
        order = random.permutation(len(self.clips))[:size]
        return pad([(self.clips[i].values[: self.frames], caption_variants(self.clips[i].texts[0])[0]) for i in order])


def pad(items: list[tuple[np.ndarray, str]]) -> MotionBatch:
    """Rows of one length, the longest, zero behind their end."""
    lengths = np.array([len(values) for values, _ in items])
    values = np.zeros((len(items), int(lengths.max()), items[0][0].shape[1]), np.float32)
    for row, (item, _) in zip(values, items, strict=True):
        row[: len(item)] = item
    return MotionBatch(values, lengths, [sentence for _, sentence in items])
