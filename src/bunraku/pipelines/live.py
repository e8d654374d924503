"""A character that never stops: motion is drawn in windows of two seconds, each from the last frames of the one before,
so that a new sentence or direction shows at once. What it looks at and reaches for is added to what is drawn.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.legs import Leg
from bunraku.core.animation import AnimatedCharacter, Animation, RigAnimation
from bunraku.core.body.layout import HANDLE_INDEX
from bunraku.core.character import Character
from bunraku.core.geometry.rotations import matrix_from_axis_angle, matrix_y
from bunraku.core.motion import HandleMotion
from bunraku.core.request import checked
from bunraku.errors import OptionError
from bunraku.language.prompts import check_prompt
from bunraku.pipelines.animator import Animator, Body
from bunraku.pipelines.requests import Constraints, Follow, Request, Sampling, is_cycle
from bunraku.retarget.stages.stage import with_feet_moved

WINDOW = 2.0
"""Seconds that are drawn at once: the shortest in which the network takes a step with each foot."""
LEAD = 0.25
"""Seconds of what was drawn before that are still shown after something new is said, so that it can be drawn meanwhile.
Measured on the sample person: a window takes 0.2 s of one core.
"""
PAST = 40
"""Frames that the next window is made to follow; the network reads the last 20 of them."""
KEPT = 60.0
"""Seconds of what was shown that are kept, chosen by eye."""
TURN = math.radians(120)
"""Fastest rotation towards a direction [rad/s], chosen by eye: a person turns about in one and a half seconds."""


HEAD = tuple(HANDLE_INDEX[name] for name in ("neck", "head", "head_top", "face"))

# Angles [rad] and paces, chosen by eye on the sample person.
ASIDE, NOD = math.radians(75), math.radians(45)  # how far a head turns aside from where the body faces, and nods
BEHIND = math.radians(135)  # aside from which on a point is not looked at, nor reached for
EASE = 0.22  # share of what is missing that comes each frame
FASTEST = math.radians(10)  # turn of the head in a frame
FARTHEST = 0.97  # reach of a hand over the length of its arm

Point = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Aim:
    """How the body of a character looks and reaches."""

    anatomy: Anatomy

    @property
    def still(self) -> np.ndarray:
        """The state of a frame in which nothing is looked at or reached for, shape (2 + 4 L,) for L arms: how far the
        head is turned aside and down [rad], then for each arm the share that it reaches, 0 to 1, and where to [m].
        """
        return np.zeros(2 + 4 * len(self.anatomy.arms))

    def states(self, motion: HandleMotion, before: np.ndarray, look: Point | None, reach: Point | None) -> np.ndarray:
        """The states of the frames of a motion, shape (N, S), each from the one before it."""
        world = motion.transforms(self.anatomy.handles.positions).astype(np.float64)
        facing = motion.root_rotation.astype(np.float64)
        wanted = self._turns(world, facing, look)
        chosen = self._arms(world, facing, reach)
        out = np.empty((len(motion), len(before)))
        for frame in range(len(motion)):
            state = before.copy()
            state[:2] += np.clip(EASE * (wanted[frame] - state[:2]), -FASTEST, FASTEST)
            for arm, share in enumerate(state[2:].reshape(-1, 4)):
                asked = chosen[frame] == arm
                if asked:
                    share[1:] += (EASE if share[0] > EASE else 1.0) * (np.asarray(reach) - share[1:])
                share[0] += EASE * (float(asked) - share[0])
            out[frame] = before = np.where(np.abs(state) < 1e-4, 0.0, state)
        return out

    def applied(self, motion: HandleMotion, states: np.ndarray) -> HandleMotion:
        """The motion with its head and its arms as the states of its frames say."""
        if not states.any():
            return motion
        anatomy = self.anatomy
        if states[:, 2:].any():
            world = motion.transforms(anatomy.handles.positions).astype(np.float64)
            shares = states[:, 2:].reshape(len(states), -1, 4)
            shifts = np.stack([
                shares[:, number, :1] * (_within(world, arm, shares[:, number, 1:]) - _end(world, arm))
                for number, arm in enumerate(anatomy.arms)
            ], axis=1)  # fmt: skip
            motion = with_feet_moved(motion, anatomy, anatomy.arms, shifts)
        if states[:, :2].any() and self._pivots:
            world = motion.transforms(anatomy.handles.positions).astype(np.float64)
            turns = states[:, :2] / len(self._pivots)
            for pivot, members in self._pivots:  # the neck takes half of it, where there is one
                own = world[:, pivot, :, :3]
                turned = own @ _turn(turns) @ own.transpose(0, 2, 1)
                at = own @ anatomy.joints.positions[pivot] + world[:, pivot, :, 3]
                group = world[:, members]
                group[..., 3] = np.einsum("nij,nkj->nki", turned, group[..., 3] - at[:, None]) + at[:, None]
                group[..., :3] = turned[:, None] @ group[..., :3]
                world[:, members] = group
            motion = motion.with_transforms(world, anatomy.handles.positions)
        return motion

    @property
    def _pivots(self) -> list[tuple[int, list[int]]]:
        """The handles about whose joints the head turns, the lowest first, and those that go with each."""
        joints, played = self.anatomy.joints, self.anatomy.handles.played
        members = [int(each) for each in np.flatnonzero(np.isin(played, HEAD))]
        there = [each for each in members if joints.present[each] and int(played[each]) in HEAD[:2]]
        ordered = sorted(there, key=lambda each: HEAD.index(int(played[each])))
        return [
            (each, [one for one in members if HEAD.index(int(played[one])) >= HEAD.index(int(played[each]))])
            for each in ordered
        ]  # fmt: skip

    def _turns(self, world: np.ndarray, facing: np.ndarray, look: Point | None) -> np.ndarray:
        """How far the head of each frame would turn aside and down [rad], shape (N, 2)."""
        if look is None or not self._pivots:
            return np.zeros((len(world), 2))
        pivot = self._pivots[-1][0]
        own = world[:, pivot, :, :3]
        toward = np.asarray(look) - (own @ self.anatomy.joints.positions[pivot] + world[:, pivot, :, 3])
        x, y, z = np.einsum("nji,nj->ni", own, toward).T
        there = _aside(facing, own[:, :, 2])  # it may look aside by itself
        aside = np.clip(np.arctan2(x, z), -ASIDE - there, ASIDE - there)
        turns = np.stack([aside, np.clip(np.arctan2(-y, np.hypot(x, z)), -NOD, NOD)], axis=1)
        return np.where(np.abs(_aside(facing, toward))[:, None] < BEHIND, turns, 0)

    def _arms(self, world: np.ndarray, facing: np.ndarray, reach: Point | None) -> np.ndarray:
        """Which arm of each frame reaches, the nearest; -1 for none."""
        arms = self.anatomy.arms
        if reach is None or not arms:
            return np.full(len(world), -1)
        middle = (len(world) - 1) // 2  # one arm for all, so that no frame changes it
        away = [np.linalg.norm(np.asarray(reach) - _shoulder(world, arm)[middle]) for arm in arms]
        toward = np.asarray(reach) - np.mean([_shoulder(world, arm) for arm in arms], axis=0)
        return np.where(np.abs(_aside(facing, toward)) < BEHIND, int(np.argmin(away)), -1)


def _shoulder(world: np.ndarray, arm: Leg) -> np.ndarray:
    return np.asarray(world[:, arm.upper, :, :3] @ arm.joints[0] + world[:, arm.upper, :, 3])


def _end(world: np.ndarray, arm: Leg) -> np.ndarray:
    return np.asarray(world[:, arm.end, :, :3] @ arm.joints[2] + world[:, arm.end, :, 3])


def _within(world: np.ndarray, arm: Leg, goals: np.ndarray) -> np.ndarray:
    """Goals of a hand, drawn near to where its arm reaches [m], shape (N, 3)."""
    shoulder = _shoulder(world, arm)
    length = FARTHEST * np.linalg.norm(np.diff(arm.joints, axis=0), axis=1).sum()
    away = goals - shoulder
    far = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    return np.asarray(shoulder + away * np.minimum(1, length / far))


def _aside(facing: np.ndarray, toward: np.ndarray) -> np.ndarray:
    """How far directions are aside from where a body faces, over the ground [rad]."""
    x, _, z = np.einsum("nji,nj->ni", facing, toward).T
    return np.asarray(np.arctan2(x, z))


def _turn(turns: np.ndarray) -> np.ndarray:
    """Rotations of turns aside and down, shape (N, 3, 3)."""
    aside, down = np.zeros((len(turns), 3)), np.zeros((len(turns), 3))
    aside[:, 1], down[:, 0] = turns[:, 0], turns[:, 1]
    return np.asarray(matrix_from_axis_angle(aside) @ matrix_from_axis_angle(down))


@checked
def live(
    character: Character | str | Path, sentence: str = "stands still", *, idle: str = "stands still", seed: int = 0,
    steps: int | None = None, ahead: bool = False,
) -> Live:  # fmt: skip
    """Start a character that does what it is told, from now on.

    Args:
        character: Any mesh, +Y up and facing +Z, or its file.
        sentence: What it does first.
        idle: What it does after a sentence that does not go on by itself, as jumping does not and walking does.
        seed: The same seed, sentences and directions at the same frames give the same poses, unless `ahead`.
        steps: Sampling steps; None takes the default.
        ahead: Draw in a thread, so that no pose waits while there is a processor for it.

    Raises:
        OptionError: A sentence is refused.
        CharacterError, FormatError: The character cannot be read or moved.
    """
    from bunraku.pipelines.animate import opened

    return Live(opened(character), sentence, idle=idle, seed=seed, steps=steps, ahead=ahead)


class Live(Iterator[AnimatedCharacter]):
    """An iterator of poses, each an animation of one frame; see `live`. It ends when it is closed."""

    def __init__(
        self, character: Character | Body, sentence: str = "stands still", *, idle: str = "stands still",
        seed: int = 0, steps: int | None = None, ahead: bool = False, lead: float = LEAD,
    ):  # fmt: skip
        self._animator = Animator.shipped()
        self._sampling = Sampling(WINDOW, seed, steps, None, 1)
        self._idle = self._request(idle)
        self._now = self._request(sentence)
        self._body = character if isinstance(character, Body) else self._animator.body(character, self._now)
        self.direction: tuple[float, float] | None = None
        """Where it faces and travels, x and z; None where sentences decide."""
        self._look: Point | None = None
        self._reach: Point | None = None
        self._aim = Aim(self._body.anatomy)
        self._aims = self._aim.still[None][:0]
        """The states of `_aim` of the frames of `_shown` that were given."""
        self._shown: AnimatedCharacter | None = None
        """What was drawn, of which `_next` is the frame that is given next; older frames are dropped."""
        self._next = self._said = self._dropped = 0
        self._cut: int | None = None
        """The first frame that is to be drawn anew, since something was said."""
        self._lead, self._ahead, self._took = lead, ahead, 0.0
        self._changed = threading.Condition()
        self._drawing = threading.Lock()
        self._closed = False
        if ahead:
            threading.Thread(target=self._draw_ahead, name="live", daemon=True).start()

    @property
    def fps(self) -> float:
        """Poses a second [1/s]."""
        return 20.0 if self._shown is None else self._shown.fps

    def say(self, sentence: str) -> None:
        """Do this next; OptionError, with what is done unchanged, where the sentence is refused."""
        self._change(self._request(sentence), self.direction)

    def go(self, direction: Sequence[float] | None) -> None:
        """Face and travel in a direction on the ground, x and z; None lets sentences decide. OptionError else."""
        given = None
        if direction is not None:
            try:
                x, z = given = float(direction[0]), float(direction[1])
            except (TypeError, ValueError, LookupError):
                x = z = math.nan
            if not 0 < math.hypot(x, z) < math.inf or len(direction) != 2:
                raise OptionError("a direction is x and z on the ground, two numbers that are not both zero")
        self._change(self._now, given)

    def look(self, point: Sequence[float] | None) -> None:
        """Turn the head to a point in the world [m], whatever is done, where it is not behind; None looks ahead again.
        OptionError for other values. A character that its own skeleton moves does not.
        """
        self._look = _point(point)

    def reach(self, point: Sequence[float] | None) -> None:
        """Likewise, hold the nearest hand to a point, or as near as the arm reaches."""
        self._reach = _point(point)

    def window(self, frames: int, start: int | None = None) -> tuple[int, AnimatedCharacter]:
        """The next poses, at least one, as one animation, and the number of its first since the beginning. It goes on
        from `start` where poses that were given from there on were not shown; OptionError where that was not given yet,
        or is no longer kept.
        """
        with self._changed:
            if start is not None:
                if not 0 <= start - self._dropped <= self._next:
                    raise OptionError(f"pose {start} was not given, or is forgotten; go on from the latest")
                self._next = start - self._dropped
                if self._cut is not None:
                    self._cut = self._next + math.ceil(self._lead * self.fps)
        while self._left() < frames:
            self._draw(frames)
        with self._changed:
            return self._next + self._dropped, self._give(frames)

    def played(self, seconds: float = KEPT, stop: int | None = None) -> AnimatedCharacter:
        """The last seconds that were shown, at most a minute, as an animation; OptionError where nothing was. `stop` is
        the number of the first pose that was given and not shown; None where all were.
        """
        with self._changed:
            end = self._next if stop is None else min(stop - self._dropped, self._next)
            if self._shown is None or end < 1:
                raise OptionError("nothing was shown yet; take a pose first")
            span = slice(max(0, end - round(seconds * self.fps)), end)
            return self._aimed(self._shown.take(span), self._aims[span])

    def _give(self, frames: int) -> AnimatedCharacter:
        """The next poses, looking and reaching; their frames are drawn."""
        assert self._shown is not None
        first, self._next = self._next, self._next + frames
        given = self._shown.take(slice(first, self._next))
        before = self._aims[first - 1] if first else self._aim.still
        states = np.tile(self._aim.still, (frames, 1))
        if isinstance(given, Animation) and (before.any() or self._look or self._reach):
            states = self._aim.states(given.motion, before, self._look, self._reach)
        self._aims = np.concatenate([self._aims[:first], states])
        return self._aimed(given, states)

    def _aimed(self, given: AnimatedCharacter, states: np.ndarray) -> AnimatedCharacter:
        if not isinstance(given, Animation):
            return given
        return replace(given, motion=self._aim.applied(given.motion, states))

    def close(self) -> None:
        """End it: the iterator stops."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __next__(self) -> AnimatedCharacter:
        if self._left() < 1 and not self._closed:
            self._draw(1)
        with self._changed:
            if self._closed:
                raise StopIteration
            self._changed.notify_all()
            return self._give(1)

    def _request(self, sentence: str) -> Request:
        check_prompt(sentence)
        return Request(sentence, self._sampling).with_parsed()

    def _change(self, request: Request, direction: tuple[float, float] | None) -> None:
        with self._changed:
            self._said += request is not self._now
            self._now, self.direction = request, direction
            lead = max(self._lead, 1.5 * self._took) if self._ahead else self._lead
            self._cut = self._next + math.ceil(lead * self.fps)
            self._changed.notify_all()

    def _left(self) -> int:
        """Frames that are drawn and may be shown."""
        with self._changed:
            drawn = 0 if self._shown is None else len(self._shown.motion)
            return (drawn if self._cut is None else min(drawn, self._cut)) - self._next

    def _draw_ahead(self) -> None:
        while not self._closed:
            self._draw(math.ceil(WINDOW / 2 * self.fps))
            with self._changed:
                self._changed.wait(0.02)

    def _draw(self, least: int) -> None:
        """Draw the next window behind the frames that stay, unless something was drawn and nothing said meanwhile."""
        with self._drawing:
            start = time.perf_counter()
            with self._changed:
                past, said, direction, cut = self._shown, self._now, self.direction, self._cut
                if cut is None and self._left() >= least:
                    return
                past = None if cut == 0 else past
            constraints = Constraints()
            if past is not None:
                past = past.take(slice(None, cut))
                constraints = Constraints((Follow(past.take(slice(-PAST, None))),))
            request = replace(said.with_seed(self._sampling.seed + self._said), constraints=constraints)
            made: AnimatedCharacter = self._animator.steered(
                self._body, request, lambda motion: _steered(motion, direction)
            )
            with self._changed:
                if past is not None:
                    made = _joined(past, made)
                over = max(0, self._next - round(KEPT * made.fps))
                self._shown = made.take(slice(over, None)) if over else made
                self._next -= over
                self._dropped += over
                self._aims = self._aims[over:]
                if self._cut == cut and self._now is said:  # nothing was said meanwhile
                    self._cut = None
                    if not is_cycle(said.parsed):
                        self._now, self._said = self._idle, self._said + 1
                elif self._cut is not None:
                    self._cut -= over
                self._took = time.perf_counter() - start
                self._changed.notify_all()


def _point(point: Sequence[float] | None) -> Point | None:
    """A point in the world; OptionError for what is none."""
    if point is None:
        return None
    try:
        x, y, z = (float(each) for each in point)
    except (TypeError, ValueError):
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        raise OptionError("a point is x, y and z in the world, three numbers")
    return x, y, z


def _steered(motion: HandleMotion, direction: tuple[float, float] | None) -> HandleMotion:
    """A motion of the reference body that turns towards x and z on its way; its first frame stays."""
    if direction is None:
        return motion
    heading = math.atan2(*direction)
    faces = motion.root_rotation[:, :, 2].astype(float)
    missing = heading - np.arctan2(faces[:, 0], faces[:, 2])
    missing = (missing + math.pi) % (2 * math.pi) - math.pi
    angles = np.zeros(len(motion))
    step = TURN / motion.fps
    for frame in range(1, len(motion)):  # at a bounded rate, and softly where little is missing
        toward = (missing[frame] - angles[frame - 1] + math.pi) % (2 * math.pi) - math.pi
        angles[frame] = angles[frame - 1] + float(np.clip(0.25 * toward, -step, step))
    turns = matrix_y(angles)
    path = motion.root_translation.astype(float)
    moved = np.einsum("nij,nj->ni", turns[1:], np.diff(path, axis=0))
    path = np.concatenate([path[:1], path[:1] + np.cumsum(moved, axis=0)])
    return replace(motion, root_translation=path, root_rotation=turns @ motion.root_rotation)


def _joined(first: AnimatedCharacter, then: AnimatedCharacter) -> AnimatedCharacter:
    """An animation and one that follows it, whose first frame is the last of the first."""
    then = then.take(slice(1, None))
    assert first.reference is not None and then.reference is not None
    reference = HandleMotion.joined([first.reference, then.reference])
    if isinstance(first, Animation):
        return replace(first, motion=HandleMotion.joined([first.motion, then.motion]), reference=reference)
    assert isinstance(first, RigAnimation) and isinstance(then, RigAnimation)
    return replace(
        first, rotations=np.concatenate([first.rotations, then.rotations]),
        translations=np.concatenate([first.translations, then.translations]), reference=reference,
    )  # fmt: skip
