"""An example laid on a time line, for the sampler to start from.

While the noise is strong the sampler takes the example for what it would predict itself, so it goes on from the example
noised to a log signal-to-noise ratio of about -1.5 (as SDEdit does, Meng et al. 2022): what is done, when and how far
is the example's, and the rest is the network's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.diffusion.examples.joins import Joins
from bunraku.diffusion.examples.pack import ExamplePack
from bunraku.diffusion.examples.retrieve import Found
from bunraku.diffusion.features import FEATURE_SIZE, FeatureStatistics, mirror
from bunraku.diffusion.splicing import held, played
from bunraku.geometry.easing import smooth_step

__all__ = ["Guide", "fits_into", "laid", "laid_script"]

HURRY = 1.35
"""Factor by which an example that is done once is sped up at the most to fit in."""
_LEAD = 30
"""Frames that somebody stands before what is done once, at the most."""
_FADE = 10
"""Frames over which the sampler is left to itself where one sentence goes over into the next."""


@dataclass(frozen=True)
class Guide:
    """What the sampler starts from.

    Args:
        values: Network units, shape (N, 271).
        share: How far each frame is the example's, shape (N,).
    """

    values: np.ndarray
    share: np.ndarray


def fits_into(pack: ExamplePack, found: Found, frames: int) -> bool:
    """Whether an example is done within so many frames, or can be cut anywhere."""
    example = pack.examples[found.place]
    return example.loop is not None or example.frames <= HURRY * frames


def laid(
    pack: ExamplePack, found: Found, frames: int, statistics: FeatureStatistics, random: np.random.Generator
) -> np.ndarray:
    """An example made as long as is wanted, in network units, shape (frames, 271): what goes on is played on or cut,
    what is done once has rest around it or is done faster.

    Args:
        pack: That it is of.
        found: Which one.
        frames: Wanted.
        statistics: Units of the network.
        random: Draws when it begins.
    """
    features = pack.features(found.place)
    if found.mirrored:
        features = mirror(features)
    loop = pack.examples[found.place].loop
    if loop is None and len(features) > frames:
        features = hurried(features, frames)
    values = statistics.normalise(features).astype(np.float32)
    if loop is not None:
        values = played(values, loop, frames)
        start = int(random.integers(len(values) - frames + 1))
        return values[start : start + frames]
    if len(values) < frames and pack.standing:
        standing = [statistics.normalise(pack.features(index)).astype(np.float32) for index in pack.standing]
        values = Joins(standing).around(values, frames, False, random)
    still = statistics.normalise(np.zeros(FEATURE_SIZE, np.float32))[:3]
    room = frames - len(values)
    lead = min(int(room * random.uniform(0.15, 0.5)), _LEAD)
    values = held(values[::-1], lead, still)[::-1]
    return held(values, room - lead, still)


def hurried(features: np.ndarray, frames: int) -> np.ndarray:
    """The same motion in fewer frames, shape (frames, D)."""
    at = np.linspace(0, len(features) - 1, frames)
    low = np.minimum(at.astype(int), len(features) - 2)
    share = (at - low)[:, None].astype(np.float32)
    out = features[low] * (1 - share) + features[low + 1] * share
    out[:, :3] *= (len(features) - 1) / max(frames - 1, 1)
    return np.asarray(out, np.float32)


def laid_script(
    pack: ExamplePack,
    parts: Sequence[tuple[Found | None, int]],
    frames: int,
    statistics: FeatureStatistics,
    random: np.random.Generator,
) -> Guide:
    """The examples of sentences in a row; frames of a sentence without one are the sampler's own.

    Args:
        pack: That they are of.
        parts: For each sentence its example and its frames.
        frames: On the time line, at least those of the parts.
        statistics: Units of the network.
        random: Draws when each begins.
    """
    values, share = np.zeros((frames, FEATURE_SIZE), np.float32), np.zeros(frames, np.float32)
    start = 0
    for number, (found, length) in enumerate(parts):
        own = frames - start if number == len(parts) - 1 else length  # frames that make up for a short motion
        if found is not None:
            values[start : start + own] = laid(pack, found, own, statistics, random)
            edge = np.minimum(
                np.arange(own) + 1 if number else _FADE,
                np.arange(own)[::-1] + 1 if own == length and number < len(parts) - 1 else _FADE,
            )
            share[start : start + own] = smooth_step(np.minimum(edge / _FADE, 1.0))
        start += own
    return Guide(values, share)


@dataclass(frozen=True)
class Lead:
    """The examples that one candidate starts from.

    Args:
        pack: That they are of.
        found: One for each sentence of the script, None where none fits.
        seed: Of when each begins.
    """

    pack: ExamplePack
    found: tuple[Found | None, ...]
    seed: tuple[int, ...]

    def on(self, lengths: Sequence[int], frames: int, statistics: FeatureStatistics) -> Guide:
        """The guide of a time line of so many frames, of which the sentences have these."""
        parts = list(zip(self.found, lengths, strict=True))
        return laid_script(self.pack, parts, frames, statistics, np.random.default_rng(self.seed))
