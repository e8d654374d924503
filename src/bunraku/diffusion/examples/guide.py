"""An example laid on a time line, for the sampler to start from.

While the noise is strong the sampler takes the example for what it would predict itself, so it goes on from the example
noised to a log signal-to-noise ratio of about -0.4 (as SDEdit does, Meng et al. 2022): what is done, when and how far
is the example's, and the rest is the network's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bunraku.diffusion.examples.joins import AROUND, Joins, on_one_leg
from bunraku.diffusion.examples.pack import ExamplePack
from bunraku.diffusion.examples.retrieve import Found
from bunraku.diffusion.features import FEATURE_SIZE, FeatureStatistics, encode, feature_weights, mirror
from bunraku.diffusion.splicing import END, held, played, rests
from bunraku.geometry.easing import smooth_step
from bunraku.gestures.limbs.composed import in_stance
from bunraku.gestures.limbs.gesture import limb_gesture
from bunraku.gestures.manner import AS_USUAL, Manner
from bunraku.gestures.parts import at_part
from bunraku.gestures.told import made_of
from bunraku.language.limbs.posing import Posing

if TYPE_CHECKING:
    from bunraku.gestures.pose import Gesture

__all__ = [
    "CROUCH", "Guide", "GuidanceExample", "circled",
    "fills", "fits_into", "goes_on", "hurried", "laid", "laid_script", "liveliest",
    "pose_distance",
]  # fmt: skip

HURRY = 1.35
"""Factor by which an example that is done once is sped up at the most to fit in."""
FILLED = 0.6
"""Share of the time that an example goes on for at least; shorter ones are taken where there are no others."""
UPRIGHT = 0.9
"""Of the root's axis, in who stands."""
_LEAD = 30
"""Frames that somebody stands before what is done once, at the most."""
CROUCH = 0.12
"""Height [m] by which somebody who stands is lower at the most."""
NEAR = 1.0
"""Difference of two poses, in network units, up to which what rests is joined to standing; what stands in mid-motion is
joined whatever it is. The sampler repairs what is between.
"""
AIRBORNE = 0.1
"""Height of the root over standing [m] from which on nobody stays."""
GOES = 1.0
"""Speed [m/s] of who goes on."""
EASE = 0.6
"""Share of a pose's change that is left from frame to frame where a motion comes to rest."""
SHORTEST_LOOP = 12
"""Frames under which what is played on is a part of a movement, half a punch."""
WEIGHTS = feature_weights()[3:]
"""Of what a pose is: all but the root's velocities."""
_FADE = 10
"""Frames over which the sampler is left to itself where one sentence goes over into the next."""


@dataclass(frozen=True)
class Guide:
    """What the sampler starts from.

    Args:
        values: Network units, shape (N, 271).
        share: How far each frame is the example's, shape (N,).
        made: Whether that is a gesture made by code or a clip of one's own, shape (N,).
    """

    values: np.ndarray
    share: np.ndarray
    made: np.ndarray


def fits_into(pack: ExamplePack, found: Found, frames: int) -> bool:
    """Whether an example is done within so many frames, or can be cut anywhere."""
    return goes_on(pack, found) or pack.examples[found.number].frames * found.times <= HURRY * frames


def fills(pack: ExamplePack, found: Found, frames: int) -> bool:
    """Whether an example goes on for most of so many frames."""
    return goes_on(pack, found) or pack.examples[found.number].frames * found.times >= FILLED * frames


def laid(
    pack: ExamplePack,
    found: Found,
    frames: int,
    statistics: FeatureStatistics,
    random: np.random.Generator,
    manner: Manner = AS_USUAL,
) -> Guide:
    """An example made as long as is wanted: what goes on is played on or cut, what is done once is joined to standing,
    or done faster. Where it neither rests nor can be joined, the frames before and after it are the sampler's own. A
    gesture is performed anew, for so long.

    Args:
        pack: That it is of.
        found: Which one.
        frames: Wanted.
        statistics: Units of the network.
        random: Draws when it begins, and all that differs in a gesture.
        manner: How it is done. In a loop what goes on is done a whole number of times, and what is done once is no
            example.
    """
    closed = manner.closed
    gesture = pack.gesture(found.number)
    if gesture is not None and found.told is not None:
        gesture = limb_gesture(found.told) if isinstance(found.told, Posing) else made_of(found.told)
    elif gesture is not None and found.part:
        gesture = at_part(gesture, found.part)
    if gesture is not None and manner.stance is not None and not isinstance(found.told, Posing):
        gesture = in_stance(gesture, manner.stance)
    if gesture is not None and not (closed and gesture.cycle is None):
        features = _performed(pack, gesture, frames, random, manner)
        if found.mirrored:
            features = mirror(features)
        every = np.ones(frames, np.float32)
        return Guide(statistics.normalise(features).astype(np.float32), every, every > 0)
    features = pack.features(found.number)
    if found.mirrored:
        features = mirror(features)
    example = pack.examples[found.number]
    made = np.full(frames, example.unranked)  # the network may have seen no more of it than the ranker
    if found.times > 1 and not closed:
        features = repeated(liveliest(features, int(HURRY * frames / found.times), statistics), found.times)
    loop = _loop(pack, found)
    if closed:
        share = np.full(frames, loop is not None, np.float32)
        features = features[:1].repeat(frames, axis=0) if loop is None else circled(features, loop, frames)
        return Guide(statistics.normalise(features).astype(np.float32), share, made)
    if loop is None and len(features) > frames:
        features = hurried(liveliest(features, int(HURRY * frames), statistics), frames)
    values = statistics.normalise(features).astype(np.float32)
    if loop is not None:
        values = played(values, loop, frames)
        start = int(random.integers(len(values) - frames + 1))
        return Guide(values[start : start + frames], np.ones(frames, np.float32), made)
    lead = min(int((frames - len(values)) * random.uniform(0.15, 0.5)), _LEAD)
    first = last = "free"  # who goes on does not stand still before or after; the sampler goes on with it
    if not manner.lasts:
        first = _end(features[:END], values[:END], features[-1, 3], statistics, example.made)
        last = _end(features[-END:], values[-END:], features[0, 3], statistics, example.made)
    still = statistics.normalise(np.zeros(FEATURE_SIZE, np.float32))[:3]
    led = longer = values
    if len(values) < frames and (first, last) != ("free", "free") and pack.standing:
        own = [index for index in pack.standing if pack.examples[index].made == example.made] or pack.standing
        standing = [statistics.normalise(pack.features(index)).astype(np.float32) for index in own]
        before, after = (Joins(standing, near=NEAR if end == "stays" else np.inf) for end in (first, last))
        if first != "free" and lead > AROUND:  # nothing of the motion itself is cross-faded
            eased = held(values[::-1], AROUND, still, EASE)[::-1]
            led = before.led(eased, lead - AROUND, random)
            led = values if led is eased else led
        longer = led
        if last != "free" and len(led) + AROUND < frames:
            eased = held(led, AROUND, still, EASE)
            longer = after.followed(eased, frames, False, random)[:frames]
    room = frames - len(longer)
    lead = min(lead, room) if led is values else 0
    share = np.ones(frames, np.float32)
    if first != "stays":
        share[:lead] = _rise(lead)
    if last != "stays":
        share[frames - (room - lead) :] = _rise(room - lead)[::-1]
    return Guide(held(held(longer[::-1], lead, still, EASE)[::-1], room - lead, still, EASE), share, made)


def _performed(
    pack: ExamplePack, gesture: Gesture, frames: int, random: np.random.Generator, manner: Manner
) -> np.ndarray:
    """What the denoiser sees of a gesture that is done by one of the people who stand, shape (N, 271)."""
    from bunraku.gestures.perform import performed
    from bunraku.retarget.body_motion import body_handle_motion

    return encode(body_handle_motion(performed(gesture, frames, pack.idles, random, manner, busy=pack.busy)))


def _end(
    features: np.ndarray, values: np.ndarray, other: float, statistics: FeatureStatistics, made: bool = False
) -> str:
    """What may be done where a motion ends, of its last frames, shape (M, D), in both units, and the height of the root
    at its other end [m]: it "stays"; it "moves" but stands, and can be joined to standing; or it is "free", left to the
    sampler, as in the air, in a crouch and in a run. A gesture that is `made` by code rests where it says so.
    """
    if made and rests(values, statistics):
        return "stays"
    height = float(features[:, 3].max())
    if _crouches(height, other) or height > AIRBORNE or np.linalg.norm(features[:, 1:3], axis=1).mean() > GOES:
        return "free"
    stands = height > -CROUCH and float(features[:, 8].min()) > UPRIGHT
    if (rests(values, statistics) and not (stands and on_one_leg(features))) or height < -3 * CROUCH:
        return "stays"
    return "moves" if stands else "free"


def goes_on(pack: ExamplePack, found: Found) -> bool:
    """Whether an example can be played on."""
    loop = pack.examples[found.number].loop
    if loop is not None and loop[0] - loop[1] >= SHORTEST_LOOP:
        return True  # without a look at its frames, which takes 10 ms
    return _loop(pack, found) is not None


def _loop(pack: ExamplePack, found: Found) -> tuple[int, int] | None:
    """Frames (i, j) such that playing on from j after i goes on with what is done: the whole example, where that is at
    least as smooth as the frames that were found for it; None where it is done once, or they span half a movement.
    """
    loop = pack.examples[found.number].loop
    if loop is None or pack.examples[found.number].made:
        return loop  # a gesture's cycle is between two rests
    features = pack.features(found.number)
    whole = len(features) - 1, 0
    poses = features[:, 3:]
    if pose_distance(*poses[[*whole]]) <= pose_distance(*poses[[*loop]]):
        return whole
    return loop if loop[0] - loop[1] >= SHORTEST_LOOP else None


def pose_distance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """How far poses are from others, squared, shapes (..., 268) -> (...): features but for the root's velocities."""
    return np.asarray((WEIGHTS * (one - other) ** 2).sum(axis=-1))


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


def repeated(features: np.ndarray, times: int) -> np.ndarray:
    """A motion so many times in a row, each cross-faded into the next, shape (M, D)."""
    fade = min(_FADE, len(features) // 3)
    share = smooth_step((np.arange(fade) + 1) / (fade + 1))[:, None].astype(np.float32)
    out = features
    for _ in range(times - 1):
        joined = out[len(out) - fade :] * (1 - share) + features[:fade] * share
        out = np.concatenate([out[: len(out) - fade], joined, features[fade:]])
    return out


def hurried(features: np.ndarray, frames: int) -> np.ndarray:
    """The same motion in fewer frames, shape (frames, D)."""
    at = np.linspace(0, len(features) - 1, frames)
    low = np.minimum(at.astype(int), len(features) - 2)
    share = (at - low)[:, None].astype(np.float32)
    out = features[low] * (1 - share) + features[low + 1] * share
    out[:, :3] *= (len(features) - 1) / max(frames - 1, 1)
    return np.asarray(out, np.float32)


def circled(features: np.ndarray, loop: tuple[int, int], frames: int) -> np.ndarray:
    """A cycle done as often as fits best into so many frames, a little faster or slower, shape (frames, D).

    Args:
        features: Motion that has it, shape (N, D).
        loop: Frames (i, j) such that frame j may follow where frame i would be.
        frames: Wanted.
    """
    cycle = features[loop[1] : loop[0]]
    times = max(round(frames / len(cycle)), 1)
    pace = times * len(cycle) / frames
    at = np.arange(frames) * pace % len(cycle)
    low = np.minimum(at.astype(int), len(cycle) - 1)
    share = (at - low)[:, None].astype(np.float32)
    out = cycle[low] * (1 - share) + cycle[(low + 1) % len(cycle)] * share
    out[:, :3] *= pace
    return np.asarray(out, np.float32)


def laid_script(
    pack: ExamplePack,
    parts: Sequence[tuple[Found | None, int]],
    frames: int,
    statistics: FeatureStatistics,
    random: np.random.Generator,
    manners: Sequence[Manner] = (),
) -> Guide:
    """The examples of sentences in a row; frames of a sentence without one are the sampler's own.

    Args:
        pack: That they are of.
        parts: For each sentence its example and its frames.
        frames: On the time line, at least those of the parts.
        statistics: Units of the network.
        random: Draws when each begins.
        manners: How each is done; as usual where there are none.
    """
    values, share = np.zeros((frames, FEATURE_SIZE), np.float32), np.zeros(frames, np.float32)
    made = np.zeros(frames, bool)
    start = 0
    for number, (found, length) in enumerate(parts):
        own = frames - start if number == len(parts) - 1 else length  # frames that make up for a short motion
        if found is not None:
            one = laid(pack, found, own, statistics, random, manners[number] if manners else AS_USUAL)
            values[start : start + own] = one.values
            before = np.arange(own) + 1 if number else np.full(own, _FADE)
            after = np.arange(own)[::-1] + 1 if number < len(parts) - 1 else np.full(own, _FADE)
            edge = smooth_step(np.minimum(np.minimum(before, after) / _FADE, 1.0))
            share[start : start + own] = one.share * edge
            made[start : start + own] = one.made
        start += own
    return Guide(values, share, made)


@dataclass(frozen=True)
class GuidanceExample:
    """The examples that one candidate starts from.

    Args:
        pack: That they are of.
        found: One for each sentence of the script, None where none fits.
        seed: Of when each begins.
        manners: How each is done.
    """

    pack: ExamplePack
    found: tuple[Found | None, ...]
    seed: tuple[int, ...]
    manners: tuple[Manner, ...] = ()

    def on(self, lengths: Sequence[int], frames: int, statistics: FeatureStatistics, closed: bool = False) -> Guide:
        """The guide of a time line of so many frames, of which the sentences have these; of a loop, which has one
        sentence, where it is `closed`.
        """
        random = np.random.default_rng(self.seed)
        if closed and self.found[0] is not None:
            manner = replace(self.manners[0] if self.manners else AS_USUAL, closed=True)
            return laid(self.pack, self.found[0], frames, statistics, random, manner)
        parts = list(zip(self.found, lengths, strict=True))
        return laid_script(self.pack, parts, frames, statistics, random, self.manners)
