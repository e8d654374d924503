"""Examples laid on a time line for the sampler to start from, and which candidate starts from which example."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bunraku.core.geometry.curves import smooth_step
from bunraku.generation.composition import (
    END,
    SHORTEST_LOOP,
    SLOWED,
    held,
    join_point,
    lively,
    on_one_leg,
    overlaid,
    played,
    rests,
    splice,
    unturned,
    warped,
)
from bunraku.generation.features import FEATURE_SIZE, FeatureStatistics, encode, feature_weights, mirror
from bunraku.generation.pack import FPS, ExamplePack
from bunraku.generation.retrieve import SHARED, Found, Retrieved, retrieve
from bunraku.generation.verifier import REST, SIDES, times_asked
from bunraku.gestures.catalogue import STANDING, at_part
from bunraku.gestures.interactions import interaction_gesture
from bunraku.gestures.limb_gesture import in_stance, limb_gesture
from bunraku.language.clauses import ENDING
from bunraku.language.interactions import says_more
from bunraku.language.lexicon import actions_of, done_once, goes_ahead, is_cyclic, stays_down
from bunraku.language.phrasing import tells_all, unseen_word
from bunraku.language.posing import AS_USUAL, Manner, Posing
from bunraku.language.sentence import Clause

if TYPE_CHECKING:
    from bunraku.gestures.pose import Gesture

_LENGTHS = 1.2, 12.0
"""Least and most seconds of a clip as long as its examples; chosen by eye."""
SINGLE = 0.25
"""Quantile of the lengths of examples at which a deed is taken to be done once; longer ones may be sets. Chosen by
eye.
"""
HURRY = 1.35
"""Largest factor by which an example that is done once is sped up to fill its time; chosen by eye."""
TEMPO = (0.93, 1.08)  # factors between which a loop is drawn longer: two seeds of one example differ; chosen by eye
# Chosen by eye on sheets of generated motion.
UPRIGHT = 0.9  # of the root's axis, in a person who stands
CROUCH = 0.12  # height [m] by which a person who stands is lower at most
AIRBORNE = 0.1  # height of the root over standing [m] from which on a body cannot stay
GOES = 1.0  # speed [m/s] of a person who walks on
EASE = 0.6  # share of a pose's change that is left from frame to frame where a motion comes to rest
NEAR = 1.0
"""Difference of two poses, in network units, up to which rest is joined to standing; a motion that stands in its midst
is joined whatever it is. The sampler repairs what is between.
"""
WEIGHTS = feature_weights()
BLEND = 10  # frames over which a motion blends into standing
AROUND = BLEND + 3  # frames at its end that this may change
_FADE = 10  # frames over which the sampler is free where one sentence blends into the next


@dataclass(frozen=True)
class Guide:
    """What the sampler starts from."""

    values: np.ndarray  # network units, shape (N, 271)
    share: np.ndarray  # how far each frame is the example's, shape (N,)
    made: np.ndarray  # whether it is followed to the end: a gesture, a user's own clip, what says the same, shape (N,)


def fits_into(pack: ExamplePack, found: Found, frames: int) -> bool:
    """Whether an example is done within so many frames, or can be cut anywhere."""
    return goes_on(pack, found) or pack.examples[found.number].frames * found.times <= HURRY * frames


def laid(
    pack: ExamplePack, found: Found, frames: int, statistics: FeatureStatistics, random: np.random.Generator,
    manner: Manner = AS_USUAL,
) -> Guide:  # fmt: skip
    """An example at the wanted length: a loop is repeated or cut, an action that is done once is done faster or slower,
    joined to standing, and done again if a body would rest for too long. Where it neither rests nor can be joined, the
    frames after it are the sampler's own. A gesture is performed anew, for so long.

    Args:
        pack: Of the example.
        found: The example.
        frames: Wanted.
        statistics: Units of the network.
        random: Draws when it begins, and all that varies in a gesture.
        manner: How it is done. In a closed loop a cycle is done a whole number of times, and an action that is done
            once is no example.
    """
    closed = manner.closed
    gesture = _gesture_of(pack, found)
    if gesture is not None and says_more(found.detail) and done_in_one(gesture):
        manner = replace(manner, count=manner.count or 1)  # the thing is then elsewhere
    stance = found.stance or manner.stance
    if gesture is not None and stance is not None and not isinstance(found.detail, Posing):
        gesture = in_stance(gesture, stance)
    if gesture is not None and not (closed and gesture.cycle is None):
        features = _performed(pack, gesture, frames, random, manner)
        if found.mirrored:
            features = mirror(features)
        every = np.ones(frames, np.float32)
        return Guide(statistics.normalise(features).astype(np.float32), every, every > 0)
    features = pack.features(found.number)
    if found.mirrored:
        features = mirror(features)
    if found.straight:
        features = unturned(features, FPS)
    if stance is not None and features[:, 3].mean() > -CROUCH:
        seated = _performed(pack, in_stance(STANDING, stance), len(features), random, AS_USUAL)
        features = overlaid(seated, features, ("upper body", "arms", "head"))
    example = pack.examples[found.number]
    if example.loop is None:
        span = lively(features, FPS)  # and its quiet end where there is time for it
        features = features[span.start : max(span.stop, span.start + frames)]
    # what the network may have seen as little of as the ranker, and what says the same, leads to the end
    made = np.full(frames, example.unranked or found.close)
    loop, times, period = _loop(pack, found), 1, frames
    if loop is None and manner.lasts and found.close:  # steps come round again, in a clip of a few as well
        loop = join_point(features, features, WEIGHTS, 1)[:2]
    if loop is None and not (closed or manner.lasts):
        most = min(2 * _FADE, frames // 2)
        shorter = int(random.integers(most + 1))  # of two seeds one is slower
        slowed = SLOWED - (SLOWED - TEMPO[1]) * shorter / max(most, 1)
        times = found.times
        if times == 1 and not manner.count:
            times = times_in(frames, features, slowed, pack.said[found.number].actions)
        if times > 1:  # the body rests after the last time as well, for about half as long
            length = len(features) * slowed
            rest = (frames - times * length - AROUND / 2) / (times - 0.5)
            period = int(length + rest if rest > AROUND else frames / times) + _FADE
        aim = frames - shorter if times == 1 else period
        features = warped(features, int(np.clip(aim, len(features) / HURRY, len(features) * slowed)))
    if closed:
        share = np.full(frames, loop is not None, np.float32)
        features = features[:1].repeat(frames, axis=0) if loop is None else circled(features, loop, frames)
        return Guide(statistics.normalise(features).astype(np.float32), share, made)
    if loop is None and len(features) > period:
        features = warped(features[: int(random.uniform(TEMPO[0], 1) * HURRY * period)], period)  # seeds differ
    if loop is not None:
        length = round(random.uniform(*TEMPO) * (len(features) - 1))
        loop = round(loop[0] * length / (len(features) - 1)), round(loop[1] * length / (len(features) - 1))
        features = warped(features, length + 1)
    values = statistics.normalise(features).astype(np.float32)
    if loop is not None:
        values = played(values, loop, frames)
        start = int(random.integers(len(values) - frames + 1))
        return Guide(values[start : start + frames], np.ones(frames, np.float32), made)
    # a person who walks on does not stand still after it; the sampler goes on
    goes = manner.lasts or _goes(features)
    actions = pack.said[found.number].actions
    rises = done_once(actions) and not any(map(stays_down, actions))  # a person who rolls is on the feet again
    stays = not goes and _stays(features[-END:], values[-END:], features[0, 3], statistics, rises, example.made)
    still = statistics.normalise(np.zeros(FEATURE_SIZE, np.float32))[:3]
    longer = values
    if not goes and len(values) + AROUND < period and pack.standing:
        eased = held(values, AROUND, still, EASE)
        longer = _stood(pack, eased, period, statistics, NEAR if stays else np.inf, example.made)
        longer = held(longer, period - len(longer), still, EASE)  # in its own pose where that is far from standing
    longer = repeated(longer, times)[:frames]
    room = frames - len(longer)
    share = np.ones(frames, np.float32)
    if not stays:
        share[frames - room :] = smooth_step(np.clip(1 - (np.arange(room) + 1) / _FADE, 0, 1))
    return Guide(held(longer, room, still, EASE), share, made)


def _stood(
    pack: ExamplePack, values: np.ndarray, frames: int, statistics: FeatureStatistics, near: float, made: bool
) -> np.ndarray:
    """A motion (N, D) in network units, followed by a person who stands in nearly the pose in which it ends, at most
    `frames` frames; the very array where the poses differ by more than `near`.
    """
    similar = [index for index in pack.standing if pack.examples[index].made == made] or pack.standing
    pieces = [statistics.normalise(pack.features(index)).astype(np.float32) for index in similar]
    joins = [join_point(values, piece, WEIGHTS, BLEND, (3, min(16, len(piece) // 2))) for piece in pieces]
    best = int(np.argmin([distance for *_, distance in joins]))
    i, j, distance = joins[best]
    if distance > near:
        return values
    piece, wanted = pieces[best], frames - i + j
    back, forth, _ = join_point(piece, piece, WEIGHTS)
    if len(piece) < wanted and back - forth >= END:
        piece = played(piece, (back, forth), wanted)
    return splice(values, piece, i, j, BLEND)[:frames]


def _gesture_of(pack: ExamplePack, found: Found) -> Gesture | None:
    """The gesture made by code that an example stands for; None for a captured one."""
    gesture = pack.gesture(found.number)
    if gesture is None or (found.detail is None and not found.part):
        return gesture
    if found.detail is None:
        return at_part(gesture, found.part)
    return limb_gesture(found.detail) if isinstance(found.detail, Posing) else interaction_gesture(found.detail)


def done_in_one(gesture: Gesture) -> bool:
    """Whether a gesture does not go on."""
    return gesture.cycle is None and gesture.repeat is None


def _performed(
    pack: ExamplePack, gesture: Gesture, frames: int, random: np.random.Generator, manner: Manner
) -> np.ndarray:
    """Features of a gesture by one of the people who stand, shape (N, 271)."""
    from bunraku.generation.features import body_handle_motion
    from bunraku.gestures.perform import performed

    return encode(body_handle_motion(performed(gesture, frames, pack.idles, random, manner, busy=pack.busy)))


def _goes(features: np.ndarray) -> bool:
    """Whether a body walks on at the end of a motion (N, D)."""
    return bool(np.linalg.norm(features[-END:, 1:3], axis=1).mean() > GOES)


def _stays(
    features: np.ndarray, values: np.ndarray, other: float, statistics: FeatureStatistics, rises: bool, made: bool
) -> bool:
    """Whether a body stays as it is at the end of a motion, by its last frames, shape (M, D), in both units, and the
    height of the root at its other end [m]; if not, as in the air, in a crouch, and on the ground where it `rises`
    again, it is joined to standing. A gesture `made` by code rests where it says so.
    """
    if made and rests(values, statistics):
        return True
    height = float(features[:, 3].max())
    crouches = height < -CROUCH and other < height + CROUCH and max(height, other) > -3 * CROUCH  # as before a jump
    if crouches or height > AIRBORNE or (rises and height < -3 * CROUCH):
        return False
    stands = height > -CROUCH and float(features[:, 8].min()) > UPRIGHT
    return (rests(values, statistics) and not (stands and on_one_leg(features))) or height < -3 * CROUCH


def goes_on(pack: ExamplePack, found: Found) -> bool:
    """Whether an example can be repeated."""
    loop = pack.examples[found.number].loop
    if loop is not None and loop[0] - loop[1] >= SHORTEST_LOOP:
        return True  # without a look at its frames, which takes 10 ms
    return _loop(pack, found) is not None


def _loop(pack: ExamplePack, found: Found) -> tuple[int, int] | None:
    """Frames (i, j) such that frame j after frame i continues the action: the whole example, where that is at least as
    smooth as its stored loop; None where it is done once, or they span half a movement.
    """
    loop = pack.examples[found.number].loop
    if loop is None or pack.examples[found.number].made:
        return loop  # a gesture's cycle is between two rests
    features = pack.features(found.number)
    all_frames = len(features) - 1, 0
    poses = features[:, 3:]
    if pose_distance(*poses[[*all_frames]]) <= pose_distance(*poses[[*loop]]):
        return all_frames
    return loop if loop[0] - loop[1] >= SHORTEST_LOOP else None


def pose_distance(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Squared distance of poses, shapes (..., 268) -> (...): features but for the root's velocities."""
    return np.asarray((WEIGHTS[3:] * (first - second) ** 2).sum(axis=-1))


def repeated(features: np.ndarray, times: int) -> np.ndarray:
    """A motion so many times in a row, each cross-faded into the next, shape (M, D)."""
    fade = min(_FADE, len(features) // 3)
    out = features
    for _ in range(times - 1):
        out = splice(out, features, len(out) - fade, 0, fade)
    return out


def times_in(frames: int, features: np.ndarray, slowed: float, actions: Collection[str]) -> int:
    """How often a motion (N, D) is done in so many frames: as often as it fits if the lexicon says that its actions go
    on; else as seldom as keeps a body that does it slowly from resting for longer than a motion may (`verifier.REST`).
    Once, if it ends in a run, or leads to the ground or a seat or up from there.
    """
    length = len(features)
    ends = features[[0, -1], 3]
    if _goes(features) or (ends.min() < -3 * CROUCH and np.ptp(ends) > CROUCH):
        return 1
    times = math.ceil(frames / (slowed * length + REST * FPS)) if done_once(actions) else round(frames / length)
    return max(min(times, int(HURRY * frames / length)), 1)


def circled(features: np.ndarray, loop: tuple[int, int], frames: int) -> np.ndarray:
    """The cycle of a loop (i, j) of a motion (N, D), repeated as fits best into so many frames, shape (frames, D)."""
    cycle = features[loop[1] : loop[0]]
    times = max(round(frames / len(cycle)), 1)
    return warped(np.concatenate([np.tile(cycle, (times, 1)), cycle[:1]]), frames + 1)[:-1]


def laid_script(
    pack: ExamplePack, parts: Sequence[tuple[Found | None, int]], frames: int, statistics: FeatureStatistics,
    random: np.random.Generator, manners: Sequence[Manner] = (),
) -> Guide:  # fmt: skip
    """The examples of sentences in a row, each with its frames and its manner, on a time line of at least as many
    frames; frames of a sentence without one are the sampler's own.
    """
    values, share = np.zeros((frames, FEATURE_SIZE), np.float32), np.zeros(frames, np.float32)
    made = np.zeros(frames, bool)
    start = 0
    for number, (found, length) in enumerate(parts):
        wanted = frames - start if number == len(parts) - 1 else length  # frames that make up for a short motion
        if found is not None:
            guide = laid(pack, found, wanted, statistics, random, manners[number] if manners else AS_USUAL)
            values[start : start + wanted] = guide.values
            before = np.arange(wanted) + 1 if number else np.full(wanted, _FADE)
            after = np.arange(wanted)[::-1] + 1 if number < len(parts) - 1 else np.full(wanted, _FADE)
            edge = smooth_step(np.minimum(np.minimum(before, after) / _FADE, 1.0))
            share[start : start + wanted] = guide.share * edge
            made[start : start + wanted] = guide.made
        start += wanted
    return Guide(values, share, made)


@dataclass(frozen=True)
class GuidanceExample:
    """The examples that one candidate starts from."""

    pack: ExamplePack  # of the examples
    found: tuple[Found | None, ...]  # one for each sentence of the script, None where none fits
    seed: tuple[int, ...]  # of when each begins
    manners: tuple[Manner, ...] = ()  # how each is done

    def on(self, lengths: Sequence[int], frames: int, statistics: FeatureStatistics, closed: bool = False) -> Guide:
        """The guide of a time line of so many frames, of which the sentences have these; `closed` for a loop."""
        random = np.random.default_rng(self.seed)
        if closed and self.found[0] is not None:
            manner = replace(self.manners[0] if self.manners else AS_USUAL, closed=True)
            return laid(self.pack, self.found[0], frames, statistics, random, manner)
        parts = list(zip(self.found, lengths, strict=True))
        return laid_script(self.pack, parts, frames, statistics, random, self.manners)


NEARER = 0.05
"""Scale of the numbers from a Gumbel distribution that are added to the examples' scores from the second deal on."""
NEAREST = 3
ALIKE = 1.0  # further distance of poses from the nearest up to which others may begin, too
LEFT = 0.35  # share of gestures that are done with the left hand where no side is said; chosen by eye
PACES = {"slow": 0.72, "fast": 1.35}  # tempo of a gesture by its adverb; chosen by eye


def dealt(scores: Sequence[float], seed: int) -> tuple[list[int], int]:
    """The order in which a seed takes examples, and how many of them are its own. They are dealt like cards, the
    nearest first, among `SHARED` seeds in a row, and for the next seeds in another order.
    """
    seeds = max(min(SHARED, len(scores)), 1)
    deal, own = divmod(seed, seeds)
    drawn = np.random.default_rng(deal).gumbel(size=len(scores)) if deal else np.zeros(len(scores))
    order = np.argsort(-(np.array(scores) + NEARER * drawn), kind="stable").tolist()
    hands = [order[start::seeds] for start in range(seeds)]
    return [index for hand in hands[own:] + hands[:own] for index in hand], len(hands[own])


class GuidanceExamples:
    """Examples for the clauses of a call, looked up once each.

    Args:
        pack: To choose from.
        clauses: Each clause by its text, with the ranker's unit vector of it as said of a person.
    """

    def __init__(self, pack: ExamplePack, clauses: Mapping[str, tuple[Clause, np.ndarray]]):
        self.pack = pack
        self._retrieved = {
            text: self._in_order(clause, retrieve(pack, clause, vector)) for text, (clause, vector) in clauses.items()
        }

    def retrieved(self, clause: Clause) -> Retrieved:
        """What fits a clause; nothing where it was not looked up."""
        return self._retrieved.get(clause.text, Retrieved([]))

    def shows(self, clause: Clause) -> bool:
        """Whether there is an example for a clause."""
        return bool(self.retrieved(clause).found)

    def _in_order(self, clause: Clause, shown: Retrieved) -> Retrieved:
        """What fits a clause, without examples whose sentences say its parts in another order."""

        def agrees(one: Found) -> bool:
            said = map(actions_of, self.pack.examples[one.number].texts)
            return any(tuple(filter(clause.actions.__contains__, row)) == clause.actions for row in said)

        return shown._replace(found=list(filter(agrees, shown.found))) if clause.parts else shown

    def parted(self, clause: Clause) -> tuple[Clause, ...]:
        """A clause in the parts that are done in a row, where no example shows it whole and one shows a part."""
        return clause.parts if any(map(self.shows, clause.parts)) and not self.shows(clause) else (clause,)

    def needed(self, script: Sequence[Clause]) -> list[Clause]:
        """A script without getting up from where a body is not: a person who bends down to pick something up stands
        again. The time of it goes to what comes before.
        """
        kept: list[Clause] = []
        for clause in script:
            pair = [nearest for part in (*kept[-1:], clause) for nearest in self.retrieved(part).found[:1]]
            if len(pair) == 2 and "gets up" in clause.cues and kept[-1].stance is None:
                last, first, end = (self._pose(pair[part], at)[0] for part, at in ((0, -1), (1, 0), (1, -1)))
                if abs(last - end) <= CROUCH and last - first > 3 * CROUCH:
                    whole = kept.pop()
                    clause = replace(whole.lasting(whole.seconds + clause.seconds), count=whole.count or 1)
            kept.append(clause)
        return kept

    def fitted(self, script: Sequence[Clause]) -> Sequence[Clause]:
        """A script of one clause for which no length was asked, as long as its examples are that do it once."""
        (clause, *others), found = script, self.retrieved(script[0]).found[:SHARED]
        if others or not clause.fits or not found:
            return script
        if done_once(clause.actions):
            script = [replace(clause, count=clause.count or 1)]
        gesture = _gesture_of(self.pack, found[0])
        if gesture is not None:
            if clause.count or not done_in_one(gesture):
                return script
            seconds = gesture.seconds
        else:
            found = [one for one in found if not self.pack.made[one.number]]
            if not done_once(clause.actions) or any(goes_on(self.pack, one) for one in found):
                return script
            spans = [lively(self.pack.features(one.number), FPS) for one in found]
            lengths = [(span.stop - span.start) * one.times for span, one in zip(spans, found, strict=True)]
            seconds = float(np.quantile(lengths, SINGLE)) / FPS
        return [script[0].lasting(float(np.clip(seconds + ENDING, *_LENGTHS)))]

    def unseen(self, clause: Clause) -> tuple[str, str]:
        """A word for a clause's only action that no caption and no example has, and that action; "" and "" for none."""
        found = self.retrieved(clause).found
        if len(clause.actions) != 1 or self.pack.made[[one.number for one in found]].any():
            return "", ""
        word = unseen_word(clause.person, clause.actions[0])
        if not word or any(tells_all((word,), example.texts) for example in self.pack.examples):
            return "", ""
        return word, clause.actions[0]

    def led_by(self, script: Sequence[tuple[Clause, int]]) -> bool:
        """Whether a clause requests what the ranker has never seen, a gesture made by code or a user's own clip: the
        network may not have learned it either. Or an example says the same, and shows it better than the network.
        """
        return any(
            self.pack.examples[found.number].unranked or found.close
            for clause, _ in script
            for found in self.retrieved(clause).found[:1]
        )

    def of(
        self, script: Sequence[tuple[Clause, int]], noise: tuple[int, int], number: int, others: int | None = None,
        meanwhile: bool = False,
    ) -> GuidanceExample | None:  # fmt: skip
        """The examples that a candidate starts from; None where no clause has one.

        Args:
            script: The clauses with their frames.
            noise: Seed and row of the motion's noise, for which the examples are `dealt`.
            number: The candidate's number among those that start from one.
            others: How many of other seeds' examples were taken before, where none that starts from one of its own did
                what was asked; None where these are its own.
            meanwhile: They are done while something else goes on: gestures then do not end before it.
        """
        seed = (noise[0] % 2**63, noise[1] % 2**63)
        chosen: list[Found | None] = []
        for clause, frames in script:
            offered = self.retrieved(clause).found
            fitting = [one for one in offered if fits_into(self.pack, one, frames)] or offered
            if chosen and chosen[-1] is not None:
                fitting = self._following(chosen[-1], fitting)
            order, own = dealt([example.score for example in fitting], sum(seed))
            first = number % max(own, 1) if others is None else (own + others + number) % max(len(order), 1)
            chosen.append(fitting[order[first]] if order else None)
        if not any(chosen):
            return None
        hands = np.random.default_rng((*seed, number, 1))
        sided = [self._sided(clause, one, hands) for (clause, _), one in zip(script, chosen, strict=True)]
        manners = [_manner(clause) for clause, _ in script]
        if meanwhile:
            made = [one is not None and bool(self.pack.made[one.number]) for one in chosen]
            manners = [replace(manner, lasts=manner.lasts or own) for manner, own in zip(manners, made, strict=True)]
        return GuidanceExample(self.pack, tuple(sided), (*seed, number), tuple(manners))

    def _sided(self, clause: Clause, found: Found | None, random: np.random.Generator) -> Found | None:
        """A gesture with either hand, where the clause names no side and people use either."""
        gesture = None if found is None else self.pack.gesture(found.number)
        if found is None or gesture is None or gesture.handed or any(cue.startswith(SIDES) for cue in clause.cues):
            return found
        return found._replace(mirrored=bool(random.random() < LEFT))

    def _following(self, last: Found, fitting: list[Found]) -> list[Found]:
        """The few that begin most as another ends: a person on a chair does not get up from the floor."""
        end = self._pose(last, -1)
        away = np.sqrt([float(pose_distance(self._pose(candidate, 0), end)) for candidate in fitting])
        order = np.argsort(away, kind="stable")[:NEAREST]
        return [fitting[index] for index in order[away[order] <= away.min(initial=np.inf) + ALIKE].tolist()]

    def _pose(self, found: Found, frame: int) -> np.ndarray:
        features = self.pack.features(found.number)[[frame]]
        return (mirror(features) if found.mirrored else features)[0, 3:]


def _manner(clause: Clause) -> Manner:
    """How a clause says that an action is done."""
    said = [pace for cue, pace in PACES.items() if cue in clause.cues]
    goes = "goes" in clause.traits or goes_ahead(clause.actions)
    lasts = goes and all(map(is_cyclic, clause.actions)) and clause.count is None and "halts" not in clause.traits
    return Manner(times_asked(clause), said[0] if len(said) == 1 else 1.0, lasts=lasts, stance=clause.stance)
