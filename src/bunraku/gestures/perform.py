"""A gesture performed: legs, trunk and head of a captured person who stands, and variation drawn from a seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_y
from bunraku.core.motion import SkeletalMotion
from bunraku.gestures.play import AT, FPS, SIDES, SPINE, HandTrack, Standing, Tracks, captured, mirrored, posed, swaying
from bunraku.gestures.pose import HANGING, Gesture, Key, Pose, moved
from bunraku.language.posing import AS_USUAL, Manner

FOLLOWS = np.array([(23.8, -4.5, -37.3), (18.4, -2.6, -29.2), (-6.4, 3.2, 10.1), (-1.6, 5.3, 46.1)])
"""How far pelvis and trunk turn to the left, the trunk leans to the side and the head turns to the left: degrees for
each metre by which the left hand is farther out, up and ahead; the right one's are the contrary. Of 131 captured
stretches (16 minutes) they explain, each left out when it was fitted, 22, 46, 13 and 22 % of the variance.
"""
MOST = 22.0
"""How far each goes at the most [degrees]."""


def accompanied(tracks: Tracks, share: np.ndarray, free: dict[str, np.ndarray]) -> Tracks:
    """Key poses in which pelvis, trunk and head go with the hands.

    Args:
        tracks: L key poses.
        share: How far, in each, shape (L,).
        free: By side, whether a hand touches nothing of the body, shape (L,): it stays where it is while the chest that
            carries it turns.
    """
    angles = np.zeros((len(FOLLOWS), len(share)))
    for side, sign in SIDES:
        away = np.where(tracks.hands[side].rests[:, None], 0, tracks.hands[side].palm - HANGING.palm)
        angles += sign * (FOLLOWS @ away.T)
    turn, left, aside, look = share * np.clip(angles, -MOST, MOST)
    none = np.zeros(len(share))
    lean = np.stack([none, left, aside], axis=1)
    back = -np.radians(turn + left)
    hands = {}
    for side, sign in SIDES:
        hand = tracks.hands[side]
        hands[side] = _turned(hand, np.where(free[side] & (hand.on == 1), sign * back, 0))
    head = np.stack([none, look, none], axis=1)
    return replace(tracks, lean=tracks.lean + lean, head=tracks.head + head, turn=tracks.turn + turn, hands=hands)


def _turned(hand: HandTrack, angle: np.ndarray) -> HandTrack:
    """A hand about the vertical through the trunk, by an angle towards its own side [rad], shape (L,)."""
    about = matrix_y(np.where(hand.rests, 0, angle))
    palm = (about @ hand.palm[..., None])[..., 0]
    return replace(hand, palm=palm, ways=hand.ways @ np.swapaxes(about, -1, -2))


@dataclass(frozen=True)
class Variation:
    """How far two performances of one gesture differ; all was chosen by eye."""

    tempo: float = 1.28  # largest factor of the tempo, either way
    heavy: float = 1.1  # the same of what steps, jumps or falls, whose time gravity keeps
    size: float = 1.22  # largest factor of the size of the movement, either way
    touching: float = 1.08  # the same of hands that touch the body
    each: float = 0.12  # how far each time differs in size from the one before, either way
    timing: float = 0.1  # how far each time differs in length, either way
    reach: float = 0.045  # standard deviation of where hands are that touch nothing [m]
    elbows: float = 0.2  # the same of to where elbows are bent, over a direction
    bearing: float = 4.0  # the same of how trunk and head are held [degrees]
    # least and largest factor of how far pelvis, trunk and head go with the hands
    follows: tuple[float, float] = (0.5, 1.2)
    leaning: float = 0.03  # the same as `reach` of how far the pelvis of a standing body is over one foot [m]
    stride: float = 1.2  # largest factor of the length and the width of steps, either way
    sinks: float = 0.05  # how much lower a stepping body goes at the most [m]
    holds: tuple[float, float] = (0.6, 1.8)  # least and largest factor of how long a pose is held
    pauses: float = 0.2  # share of the times after which there is a pause
    pause: tuple[float, float] = (0.15, 0.6)  # its shortest and longest [s]
    before: float = 0.6  # longest wait before it [s]
    after: float = 1.2  # the same after it, from which on a gesture is made again
    hurry: float = 1.35  # factor by which it is sped up at the most to fit in


VARIED = Variation()

# Chosen by eye on sheets of gestures.
TOUCH = 0.17
"""Distance of two palms, or of a palm from the middle of the trunk, with which they touch something [m]."""
_TRUNK = np.array([0.0, 1.25, 0.0])
_RISES = 0.03
SHIFTS, MOST_SHIFTED = (0.1, 0.24), 2.5
"""How far the pelvis goes to and fro during a gesture at the least, drawn from these [m], as that of the middle half of
captured people who make one; and how many times as far as in standing at the most.
"""
TURNS = (10.0, 24.0)
"""The same of how far it turns to and fro [degrees], and up to as many times as far."""
DIPS, OUT = (0.005, 0.02), 0.7
"""How far it goes down at most with hands that go out, drawn from these [m], and how far they go out for all of it."""
STRAIGHT = 0.996
"""From hip to ankle of a leg that stands, over its length: the knee is bent by ten degrees, as those of the people who
were captured standing are.
"""
BOBS = 0.7
"""Share of their going up and down that those who stoop lose as they are straightened; chosen by eye."""
WITH_BUSY = 0.85
"""Share of gestures of the hands that are made by a person who was captured with busy hands, whose legs and trunk are
livelier: beside them a shaken head is not seen.
"""
LIES = 20.0
"""Tilt of the pelvis from which on the body lies [degrees]."""


def performed(
    gesture: Gesture,
    frames: int,
    idles: Sequence[SkeletalMotion],
    random: np.random.Generator,
    manner: Manner = AS_USUAL,
    variation: Variation = VARIED,
    fps: float = FPS,
    busy: Sequence[SkeletalMotion] = (),
) -> SkeletalMotion:
    """A gesture done in this many frames by a person who stands before and after it.

    Args:
        gesture: What is done.
        frames: How many.
        idles: Captured standing people, one of which is drawn; none for one made by code.
        random: Draws all that differs.
        manner: What is said of it.
        variation: How far performances differ.
        fps: Frames a second [1/s].
        busy: Captured standing people with busy hands, whose legs, trunk and head most gestures take; idle hands are
            always those of `idles`.
    """
    heavy = gesture.steps or any(pose.hips[1] > _RISES for _, pose in gesture.keys)
    most = variation.heavy if heavy else variation.tempo
    tempo = manner.pace * most ** random.uniform(-1, 1)
    span = frames / fps
    keys, times, sizes = _scheduled(gesture, span, tempo, random, manner, variation)
    tracks = _varied(Tracks.of(keys), gesture, sizes, random, variation)
    moments = np.arange(frames) / fps
    standing = _standing(idles, frames, random, manner.closed, moments)
    with_hands = any(not tracks.hands[side].rests.all() for side, _ in SIDES)
    if idles and busy and random.random() < WITH_BUSY and with_hands:
        standing = replace(_standing(busy, frames, random, manner.closed, moments), hands=standing.hands)
    elif not with_hands:
        standing = _level(standing)
    generator = random.spawn(1)[0]
    if gesture.steps:
        standing = replace(standing, feet={side: None for side, _ in SIDES})
    else:
        standing, tracks = _upright(_turning(standing, generator)), _dipping(tracks, generator)
    return posed(tracks, times, moments, standing, fps)


def _level(standing: Standing) -> Standing:
    """A person who looks straight ahead on average: in one who looks at the ground, nothing is left of a look up."""
    world = standing.rotations[:, 0]
    for joint in SPINE:
        world = world @ standing.rotations[:, AT[joint]]
    down = np.degrees(np.arcsin(np.clip(-world[:, 1, 2], -1, 1))).mean()
    return replace(standing, head=standing.head - [down, 0, 0])


def _turning(standing: Standing, random: np.random.Generator) -> Standing:
    """A person whose pelvis turns to and fro at least as far as that of people who use their hands."""
    pelvis = standing.rotations[:, 0]
    angle = np.unwrap(np.arctan2(pelvis[:, 0, 2], pelvis[:, 2, 2]))
    reach = np.degrees(np.ptp(angle))
    more = np.clip(random.uniform(*TURNS) / max(float(reach), 1e-3), 1, MOST_SHIFTED) - 1
    rotations = standing.rotations.copy()
    rotations[:, 0] = matrix_y(more * (angle - angle.mean())) @ pelvis
    return replace(standing, rotations=rotations)


def _upright(standing: Standing) -> Standing:
    """A person whose knees are nearly straight where they are straightest, and whose trunk does not lean ahead on
    average, looking where it did: people who were captured as they talk stand with knees bent by 30 degrees.
    """
    rest = reference_body().joints.astype(float)
    pelvis, lifts = standing.rotations[:, 0], []
    for side, foot in standing.feet.items():
        if foot is not None:
            hip, knee, ankle = (AT[f"{side}_{name}"] for name in ("hip", "knee", "ankle"))
            away = rest[0] + standing.hips + pelvis @ (rest[hip] - rest[0]) - foot.ankle
            length = STRAIGHT * np.linalg.norm(np.diff(rest[[hip, knee, ankle]], axis=0), axis=1).sum()
            lifts.append(np.sqrt(np.maximum(length**2 - (away[:, [0, 2]] ** 2).sum(axis=1), 0)) - away[:, 1])
    lift = np.min(lifts, axis=0) if lifts else np.zeros(len(pelvis))
    lift = np.maximum(lift.min() + BOBS * (lift - lift.min()), 0)
    world, above = pelvis, np.zeros((len(pelvis), 3))
    for below, joint in zip(("pelvis", *SPINE), SPINE[:4], strict=False):
        above = above + world @ (rest[AT[joint]] - rest[AT[below]])
        world = world @ standing.rotations[:, AT[joint]]
    own = rest[AT["neck"]] - rest[AT["pelvis"]]
    ahead = np.degrees(np.arctan2(above[:, 2], above[:, 1]) - np.arctan2(own[2], own[1])).mean()
    back = np.array([max(float(ahead), 0.0), 0, 0])
    return replace(
        standing, hips=standing.hips + lift[:, None] * [0, 1, 0], lean=standing.lean - back, head=standing.head + back
    )  # fmt: skip


def _dipping(tracks: Tracks, random: np.random.Generator) -> Tracks:
    """Key poses in which the knees of a standing body give way a little where a hand goes out."""
    stands = np.minimum(*[tracks.feet[side].rests for side, _ in SIDES])
    away = [
        np.where(hand.rests | (hand.on == 3), 0, np.linalg.norm(hand.palm - HANGING.palm, axis=1))
        for hand in tracks.hands.values()
    ]
    dip = random.uniform(*DIPS) * stands * np.clip(np.max(away, axis=0) / OUT, 0, 1)
    return replace(tracks, hips=tracks.hips - dip[:, None] * [0, 1, 0])


def _standing(
    idles: Sequence[SkeletalMotion], frames: int, random: np.random.Generator, closed: bool, moments: np.ndarray
) -> Standing:
    """One of those who stand, for this many frames: to and fro where the clip is shorter."""
    if not idles:
        return swaying(int(random.integers(2**31)), moments)
    ways = np.array([_range(idle.root_translation) for idle in idles])
    idle = idles[int(random.choice(len(idles), p=ways / ways.sum()))]
    if random.random() < 0.5:
        idle = mirrored(idle)
    last = len(idle) - 1
    at: np.ndarray
    if closed:
        reach = min(frames / 2, last)
        first = random.uniform(0, last - reach)
        at = np.asarray(first + 0.5 * reach * (1 - np.cos(2 * np.pi * np.arange(frames) / frames)))
    else:
        at = (random.uniform(0, 2 * last) + np.arange(frames)) % (2 * last)
        at = np.where(at > last, 2 * last - at, at)
    standing = captured(idle, at)
    middle = standing.hips.mean(axis=0)
    shift = np.clip(random.uniform(*SHIFTS) / _range(standing.hips), 1, MOST_SHIFTED)
    return replace(standing, hips=middle + np.array([shift, 1, shift]) * (standing.hips - middle))


def _range(positions: np.ndarray) -> float:
    """How far a body (N, 3) comes over the ground [m]."""
    return max(float(np.linalg.norm(np.ptp(positions[:, [0, 2]], axis=0))), 1e-3)


def _scheduled(
    gesture: Gesture, span: float, tempo: float, random: np.random.Generator, manner: Manner, variation: Variation
) -> tuple[list[Key], np.ndarray, np.ndarray]:
    """Keys of this many seconds, when each is reached, and the size of the movement there."""
    parts, endless = _times_of(gesture, span, tempo, random, manner, variation)
    poses = [pose for part, *_ in parts for _, pose in part]
    times = np.array([start + moment / factor for part, start, factor, _ in parts for moment, _ in part])
    sizes = np.array([size for part, *_, size in parts for _ in part])
    at, length = times - times[0], times[-1] - times[0]
    slack = span - length
    if manner.closed:
        return list(zip(at.tolist(), poses, strict=True)), at * span / max(length, 1e-6), sizes
    before = 0.0
    if slack > 0 and not (endless and poses[0] != Pose()):
        before = min(slack * random.uniform(0.1, 0.6), random.uniform(0, variation.before))
    if slack < 0 and not endless:
        at = at * span / length
    return list(zip(at.tolist(), poses, strict=True)), at + before, sizes


_Part = tuple[Sequence[Key], float, float, float]
"""Keys, when they begin [s], how much faster they are, and their size."""


def _times_of(
    gesture: Gesture, span: float, tempo: float, random: np.random.Generator, manner: Manner, variation: Variation
) -> tuple[list[_Part], bool]:
    """The parts of a gesture in a row, and whether the last may be cut off."""
    keys, repeat = gesture.keys, gesture.repeat

    def size() -> float:
        return 1 + variation.each * random.uniform(-1, 1)

    if repeat is None and gesture.cycle is not None and not manner.count:
        return _cycles(gesture, span, tempo, random, manner), True
    if repeat is None:
        if gesture.onward is None and not manner.count:
            keys = _prolonged(keys, tempo * (span - variation.after) - keys[-1][0])
        again = min(
            span / (gesture.seconds / tempo + variation.after), variation.hurry * tempo * span / gesture.seconds - 1
        )
        count = manner.count or max(math.ceil(again), 1)
        count = count if gesture.counted else 1
        tempo = max(tempo, min(count * gesture.seconds / span, variation.hurry * tempo))
        parts: list[_Part] = []
        start = 0.0
        for number in range(count):
            timed = keys if gesture.steps else _held(keys, random, variation)
            onward = [number * shift for shift in gesture.onward or (0, 0, 0)]
            parts.append(([(time, moved(pose, onward)) for time, pose in timed], start, tempo, size()))
            start += timed[-1][0] / tempo + random.uniform(*variation.pause)
        return parts, False
    head, stop = [key for key in keys if key[0] < repeat.start - 1e-6], repeat.stop
    ends = keys[-1][0] > stop + 1e-6  # a crawl does not stop in the middle
    tail = [key for key in keys if ends and key[0] > stop - 1e-6]
    once = [key for key in keys if repeat.start - 1e-6 <= key[0] < repeat.start + repeat.period - 1e-6]
    if manner.closed:
        count = max(round(span * tempo / repeat.period), 1)
        head, tail = [], [(stop, moved(once[0][1], [repeat.times * shift for shift in repeat.drift]))]
    around = sum(part[-1][0] - part[0][0] for part in (head + once[:1], tail) if len(part) > 1)
    finishes = bool(tail) and (bool(manner.count) or (not manner.lasts and random.random() < 0.6))
    pauses = variation.pauses if head and not manner.closed else 0.0
    if not manner.closed:
        room = span - (around if finishes else 0) / tempo - (random.uniform(0, variation.after) if finishes else 0)
        exact = room * tempo / repeat.period
        count = manner.count or max(int(exact), 1)
        idle = finishes and not manner.count and (exact - count) * repeat.period > variation.after * tempo
        if idle and count + 1 < variation.hurry * exact:
            count, tempo = count + 1, tempo * (count + 1) / exact
    if manner.count:
        tempo = max(tempo, min((around + count * repeat.period) / span, variation.hurry * tempo))
    endless = not manner.count and not finishes
    if endless:
        count += 2
    parts = [(head, 0.0, tempo, 1.0)] if head else []
    start = (once[0][0] - head[0][0]) / tempo if head else 0.0
    for number in range(count):
        drift = [number * shift for shift in repeat.drift]
        factor = tempo if manner.closed or gesture.steps else tempo * (1 + variation.timing * random.uniform(-1, 1))
        part = [(time - once[0][0], moved(pose, drift)) for time, pose in once]
        parts.append((part, start, factor, 1.0 if manner.closed else size()))
        start += repeat.period / factor
        if random.random() < pauses:
            held = random.uniform(*variation.pause)
            if manner.count or start + held + around / tempo < span:
                there = moved(once[0][1], [(number + 1) * shift for shift in repeat.drift])
                parts.append(([(0.0, there)], start, 1.0, 1.0))
                start += held
    drift = [(count - repeat.times) * shift for shift in repeat.drift]
    if tail:
        parts.append(([(time - tail[0][0], moved(pose, drift)) for time, pose in tail], start, tempo, 1.0))
    elif count:
        parts.append(([(0.0, moved(once[0][1], [count * shift for shift in repeat.drift]))], start, tempo, 1.0))
    return parts, endless


def _prolonged(keys: Sequence[Key], more: float) -> tuple[Key, ...]:
    """Keys whose longest pose, but for the first, is held for `more` seconds longer, as the crouch of a landing."""
    start, best, last = 1, 0.0, len(keys)
    for index in range(2, len(keys)):
        if keys[index][1] != keys[start][1]:
            start = index
        elif keys[index][0] - keys[start][0] > best:
            best, last = keys[index][0] - keys[start][0], index
    return tuple([(moment + max(more, 0) * (index >= last), pose) for index, (moment, pose) in enumerate(keys)])


def _held(keys: Sequence[Key], random: np.random.Generator, variation: Variation) -> list[Key]:
    """Keys whose poses are held for another time."""
    held_keys, late = [keys[0]], 0.0
    for before, after in zip(keys, keys[1:], strict=False):
        if before[1] == after[1]:
            late += (after[0] - before[0]) * (random.uniform(*variation.holds) - 1)
        held_keys.append((after[0] + late, after[1]))
    return held_keys


def _cycles(gesture: Gesture, span: float, tempo: float, random: np.random.Generator, manner: Manner) -> list[_Part]:
    """What goes on and whose times are not known, played on for so long."""
    assert gesture.cycle is not None
    start, stop = gesture.cycle
    head = [key for key in gesture.keys if key[0] < start - 1e-6]
    once = [key for key in gesture.keys if start - 1e-6 <= key[0] < stop - 1e-6]
    period = stop - start
    if manner.closed:
        laps = max(round(span * tempo / period), 1)
        tempo = laps * period / span
        head = []
    else:
        laps = int(np.ceil(span * tempo / period)) + 1
        if head and not gesture.begins and random.random() < 0.4:
            head = []
    first = head[0][0] if head else start
    parts: list[_Part] = [([(time - first, pose) for time, pose in head], 0.0, tempo, 1.0)] if head else []
    begin = (start - first) / tempo
    for lap in range(laps):
        parts.append(([(time - start, pose) for time, pose in once], begin + lap * period / tempo, tempo, 1.0))
    parts.append(([(0.0, once[0][1])], begin + laps * period / tempo, tempo, 1.0))
    return parts


def _varied(
    tracks: Tracks, gesture: Gesture, sizes: np.ndarray, random: np.random.Generator, variation: Variation
) -> Tracks:
    """Key poses of another size and with hands elsewhere; hands that touch something still touch it, and what stands
    on the ground, or on hands, stays.
    """
    size = variation.size ** random.uniform(-1, 1) * sizes
    shift = random.normal(0, variation.reach, (3, 3)).clip(-2 * variation.reach, 2 * variation.reach)
    left, right = tracks.hands["left"], tracks.hands["right"]
    together = _together(left, right)
    hands, free = {}, {side: np.zeros(len(sizes), bool) for side, _ in SIDES}
    for number, (side, _) in enumerate(SIDES):
        hand = tracks.hands[side]
        rests = hand.rests
        on_body = (hand.on == 0) | (hand.on == 3) | (np.linalg.norm((hand.palm - _TRUNK)[:, [0, 2]], axis=1) < TOUCH)
        touches = (together | on_body) & ~rests
        if rests.all() or (hand.on == 3).any():
            hands[side] = hand
            continue
        palm = hand.palm.copy()
        anchor = (
            palm[touches].mean(axis=0) if touches.any() and not touches[~rests].all() else palm[~rests].mean(axis=0)
        )
        factor = (
            size if not touches[~rests].all() else 1 + (size - 1) * np.log(variation.touching) / np.log(variation.size)
        )
        palm[~rests] = (anchor + factor[:, None] * (palm - anchor))[~rests]
        if touches[~rests].all() and not (together & ~rests).any():
            moved_by = np.zeros(3)
        elif (together & ~rests).any():
            moved_by = 1.4 * shift[2] * [0, 1, 1]
        else:
            moved_by = shift[number] * (0 if on_body[~rests].any() else 1)
        palm[~rests] += moved_by
        ways = hand.ways.copy()
        if not touches.any():
            ways[~rests, 2] += random.normal(0, variation.elbows, 3)
        hands[side] = replace(hand, palm=palm, ways=ways)
        free[side] = ~touches
    if gesture.steps:
        return _strode(replace(tracks, hands=hands), random, variation)
    placed = np.any(
        [tracks.hands[side].on == 3 for side, _ in SIDES], axis=0
    )  # a body that bends less does not get there
    body = np.where(placed, np.maximum(size, 1), size)[:, None]
    hips = tracks.hips
    if all(tracks.feet[side].rests.all() for side, _ in SIDES):
        deeper = np.clip(variation.size ** random.uniform(-0.6, 0.4), 0.85, 1.1)
        hips = hips * np.where(placed, max(deeper, 1), deeper)[:, None]
    upright = np.clip(1 - np.abs(tracks.tilt) / LIES, 0, 1)[:, None]
    lean = tracks.lean * body + upright * random.normal(0, variation.bearing, 3).clip(*_within(variation.bearing))
    head = tracks.head * body + upright * random.normal(0, variation.bearing, 3).clip(*_within(variation.bearing))
    over = float(random.normal(0, variation.leaning))
    stands = np.minimum(*[tracks.feet[side].rests for side, _ in SIDES])
    hips = hips + stands[:, None] * upright * [np.clip(over, *_within(variation.leaning)), -abs(over) / 6, 0]
    varied = replace(tracks, lean=lean, head=head, shrug=tracks.shrug * size, hips=hips, hands=hands)
    return accompanied(varied, random.uniform(*variation.follows) * stands * upright[:, 0], free)


def _within(deviation: float) -> tuple[float, float]:
    """Bounds of what is drawn: twice a deviation to both sides."""
    return -2 * deviation, 2 * deviation


def _strode(tracks: Tracks, random: np.random.Generator, variation: Variation) -> Tracks:
    """Key poses of steps that are longer or shorter, wider or narrower, with trunk and head held otherwise."""
    if np.abs(tracks.tilt).max() > LIES or any((tracks.hands[side].on == 3).any() for side, _ in SIDES):
        return tracks
    longer, wider = variation.stride ** random.uniform(-1, 1, 2)
    scale = np.array([wider, 1, longer])
    lower = np.array([0, variation.sinks * random.uniform(0, 1), 0])
    lean, head = (random.normal(0, variation.bearing, 3) for _ in range(2))
    feet = {side: replace(foot, ankle=foot.ankle * scale) for side, foot in tracks.feet.items()}
    hips = tracks.hips * [1, 1, longer] - lower
    return replace(tracks, lean=tracks.lean + lean, head=tracks.head + head, hips=hips, feet=feet)


def _together(left: HandTrack, right: HandTrack) -> np.ndarray:
    """Whether the palms touch each other, in each key, shape (L,)."""
    away = left.palm - right.palm * [-1, 1, 1]
    return np.asarray((np.linalg.norm(away, axis=1) < TOUCH) & ~left.rests & ~right.rests)
