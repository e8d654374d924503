"""A character that never stops: motion is drawn in windows of two seconds, each from the last frames of the one before,
so that a new sentence or direction shows at once. What it looks at and reaches for is added to what is drawn.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bunraku.core.animation import AnimatedCharacter, Animation, RigAnimation
from bunraku.core.character import Character
from bunraku.core.geometry.rotations import matrix_y
from bunraku.core.motion import HandleMotion
from bunraku.core.request import checked
from bunraku.errors import OptionError
from bunraku.language.prompts import check_prompt
from bunraku.pipelines.aim import Aim, Point
from bunraku.pipelines.animator import Animator, Body
from bunraku.pipelines.requests import Constraints, Follow, Request, Sampling, is_cycle

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
        """The next poses as one animation, and the number of its first since the beginning.

        Args:
            frames: How many, at least 1.
            start: The number of the first, where those that were given from there on were not shown; OptionError where
                it was not given yet, or is no longer kept.
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
        """The last seconds that were shown, at most a minute, as an animation; OptionError where nothing was.

        Args:
            seconds: How many at most.
            stop: The number of the first pose that was not shown, of those that were given; None where all were.
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
