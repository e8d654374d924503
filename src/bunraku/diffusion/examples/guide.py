"""An example laid on a time line, for the sampler to start from.

While the noise is strong the sampler takes the example for what it would predict itself, so it goes on from the example
noised to a log signal-to-noise ratio of about -0.4 (as SDEdit does, Meng et al. 2022): what is done, when and how far
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
from bunraku.diffusion.splicing import END, held, played, rests
from bunraku.geometry.easing import smooth_step

__all__ = ["Guide", "Lead", "fills", "fits_into", "hurried", "laid", "laid_script", "liveliest"]

HURRY = 1.35
"""Factor by which an example that is done once is sped up at the most to fit in."""
FILLED = 0.6
"""Share of the time that an example goes on for at least; shorter ones are taken where there are no others."""
_LEAD = 30
"""Frames that somebody stands before what is done once, at the most."""
CROUCH = 0.12
"""Height [m] by which somebody who stands is lower at the most."""
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


def fills(pack: ExamplePack, found: Found, frames: int) -> bool:
    """Whether an example goes on for most of so many frames."""
    example = pack.examples[found.place]
    return example.loop is not None or example.frames >= FILLED * frames


def laid(
    pack: ExamplePack, found: Found, frames: int, statistics: FeatureStatistics, random: np.random.Generator
) -> Guide:
    """An example made as long as is wanted: what goes on is played on or cut, what is done once is joined to standing,
    or done faster. Where it neither rests nor can be joined, the frames before and after it are the sampler's own.

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
        features = hurried(liveliest(features, int(HURRY * frames), statistics), frames)
    values = statistics.normalise(features).astype(np.float32)
    if loop is not None:
        values = played(values, loop, frames)
        start = int(random.integers(len(values) - frames + 1))
        return Guide(values[start : start + frames], np.ones(frames, np.float32))
    if len(values) < frames and pack.standing:
        standing = [statistics.normalise(pack.features(index)).astype(np.float32) for index in pack.standing]
        values = Joins(standing).around(values, frames, False, random)
    still = statistics.normalise(np.zeros(FEATURE_SIZE, np.float32))[:3]
    room = frames - len(values)
    lead = min(int(room * random.uniform(0.15, 0.5)), _LEAD)
    share = np.ones(frames, np.float32)
    first, last = (float(statistics.restore(values[[place]])[0, 3]) for place in (0, -1))
    if not rests(values[:END], statistics) or _crouches(first, last):
        share[:lead] = _rise(lead)
    if not rests(values[-END:], statistics) or _crouches(last, first):
        share[frames - (room - lead) :] = _rise(room - lead)[::-1]
    values = held(values[::-1], lead, still)[::-1]
    return Guide(held(values, room - lead, still), share)


def _crouches(here: float, there: float) -> bool:
    """Whether nobody stays at this height of the root over standing [m], whose motion has this one at its other end:
    the crouch before a jump, and not the seat that somebody gets up from, nor the floor on which somebody lies on.
    """
    return here < -CROUCH and there < here + CROUCH and max(here, there) > -3 * CROUCH


def _rise(frames: int) -> np.ndarray:
    """Shares of frames before something that is held: none, and a rise at the end."""
    return smooth_step(np.clip(1 - (frames - np.arange(frames)) / _FADE, 0, 1)).astype(np.float32)


def liveliest(features: np.ndarray, frames: int, statistics: FeatureStatistics) -> np.ndarray:
    """The part of a motion with the most movement, of at most so many frames, shape (M, D)."""
    if len(features) <= frames:
        return features
    pose = statistics.normalise(features)[:, 3:]
    step = np.diff(pose, axis=0, prepend=pose[:1])
    moved = np.concatenate([[0.0], np.cumsum((step**2).sum(axis=1))])
    start = int((moved[frames:] - moved[:-frames]).argmax())
    return features[start : start + frames]


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
            one = laid(pack, found, own, statistics, random)
            values[start : start + own] = one.values
            before = np.arange(own) + 1 if number else np.full(own, _FADE)
            after = np.arange(own)[::-1] + 1 if number < len(parts) - 1 else np.full(own, _FADE)
            edge = smooth_step(np.minimum(np.minimum(before, after) / _FADE, 1.0))
            share[start : start + own] = one.share * edge
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
