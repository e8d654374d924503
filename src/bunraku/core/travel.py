"""How a motion moves over the ground: along a drawn path, one motion after another, in loops, and on the spot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bunraku.core.geometry.curves import STRIDE, MonotoneCurve, gaussian, smooth_step
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, matrix_y
from bunraku.core.motion import HandleMotion
from bunraku.core.request import Constraint
from bunraku.errors import OptionError

MOST = 200
"""Points of a path."""
DENSE = 64
"""Samples that stand for the curve between two points."""
LONGEST = 500.0
"""Length of a path [m]."""
PATH_SWAY = 0.3
"""What a root does faster than this is kept as its own sway; the rest follows the path [s]."""
ASIDE = 0.05
"""How far the root may sway off the path, over the height of the root handle."""


_WAY = "a path says where the character goes, so it goes with none of {1}, {2} and {3}"


@dataclass(frozen=True)
class GroundPath(Constraint, kind="path", alone=(("loop", "after", "in_place"), _WAY)):
    """Points on the ground that a root passes. OptionError if there are fewer than two, times do not
    rise, or numbers make no sense.
    """

    points: tuple[tuple[float, float], ...]  # x and z of each [m], at least two that differ
    # When it passes each [s], rising from 0; None passes all at an even speed with a soft start and end.
    times: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        points = np.asarray(self.points, float)
        shaped = points.ndim == 2 and points.shape[1:] == (2,) and 2 <= len(points) <= MOST
        if not shaped or not np.isfinite(points).all():
            raise OptionError(f"a path has 2 to {MOST} points, each with x and z in metres, such as 0,0 1,2 3,2")
        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        if not 1e-6 < length <= LONGEST:
            raise OptionError(f"a path is longer than nothing and at most {LONGEST:g} m, not {length:g} m")
        if self.times is not None:
            times = np.asarray(self.times, float)
            if len(times) != len(points) or times[0] != 0 or not (np.diff([*times, np.inf]) > 0).all():
                raise OptionError("the times of a path rise from 0, one for each of its points")

    def moved(self, scale: float) -> GroundPath:
        """The same path in another unit."""
        return GroundPath(tuple((x * scale, z * scale) for x, z in self.points), self.times)

    def positions(self, frames: int, fps: float) -> np.ndarray:
        """Position of the root in each frame [m], shape (N, 2). OptionError if the path's last time is after the end of
        the clip.
        """
        points = np.asarray(self.points, float)
        seconds = max((frames - 1) / fps, 1e-9)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        keep = np.concatenate([[True], steps > 1e-9])
        if self.times is not None:
            if self.times[-1] > seconds + 1 / fps:
                end = f"{self.times[-1]:g} s"
                raise OptionError(f"the path ends at {end}, after the end of the clip, {frames / fps:g} s")
            knots = np.asarray(self.times)
            now = np.minimum(np.arange(frames) / fps, knots[-1])
            return MonotoneCurve(knots, points)(now)
        points = points[keep]
        along = np.concatenate([[0.0], np.cumsum(steps[steps > 1e-9])])
        curve = MonotoneCurve(along, points)(np.linspace(0, along[-1], DENSE * len(points)))
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
        soft = min(0.4, seconds / 4)  # s to set off and to arrive
        time = np.arange(frames) / fps
        speed = np.clip(np.minimum(time, seconds - time) / soft, 0, 1)
        velocity = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) * length[-1]
        velocity /= max(float(speed.sum()) - 0.5 * float(speed[0] + speed[-1]), 1e-9)
        return np.column_stack([np.interp(velocity, length, column) for column in curve.T])

    def headings(self, frames: int, fps: float, backwards: bool = False) -> np.ndarray:
        """Heading of a character that follows the path, forwards or backwards, in each frame [rad], shape (N,); 0 is
        +Z, positive angles go towards +X.
        """
        positions = self.positions(frames, fps)
        velocity = np.gradient(positions, axis=0) if frames > 1 else np.zeros_like(positions)
        speed = np.linalg.norm(velocity, axis=1)
        moves = np.flatnonzero(speed > 1e-3 * max(float(speed.max()), 1e-12))
        angle = np.unwrap(np.arctan2(velocity[moves, 0], velocity[moves, 1]))
        headings = np.interp(np.arange(frames), moves, angle)
        return np.asarray(gaussian(headings, 0.15 * fps) + (math.pi if backwards else 0.0))


def bent_to_path(
    motion: HandleMotion, path: GroundPath, start: Sequence[float] = (0.0, 0.0), size: float = 1.0
) -> HandleMotion:
    """The motion of a character with its root on a path in its metres, but for its sway, which the height of its root
    handle [m] bounds. `start` is the path's point that the root of a character at the origin stands on [m].
    """
    want = path.positions(len(motion), motion.fps) + np.asarray(start, float)
    root = motion.root_translation.astype(float)
    off = root[:, [0, 2]] - want
    sway = off - gaussian(off, PATH_SWAY * motion.fps)
    far = np.linalg.norm(sway, axis=1, keepdims=True) / (ASIDE * size)
    sway *= np.tanh(far) / np.maximum(far, 1e-9)
    root[:, [0, 2]] = want + sway
    return replace(motion, root_translation=root)


def _yaw(first: np.ndarray, last: np.ndarray) -> float:
    """The rotation about +Y [rad] that comes closest to taking one rotation to another."""
    between = last.astype(float) @ first.astype(float).T
    return math.atan2(between[0, 2] - between[2, 0], between[0, 0] + between[2, 2])


def moved(motion: HandleMotion, angle: float, position: np.ndarray) -> HandleMotion:
    """The motion rotated about +Y by an angle [rad] (+Z towards +X), then moved by a position [m], shape (3,)."""
    turn = matrix_y(np.array([angle]))[0]
    path = motion.root_translation @ turn.T + position
    return replace(motion, root_translation=path, root_rotation=turn @ motion.root_rotation)


def placed_at(motion: HandleMotion, frame: int, like: HandleMotion, there: int) -> HandleMotion:
    """The motion moved over the ground and rotated about +Y so that its root in one frame stands and faces as that of
    another motion does in a frame of its own.
    """
    turned = moved(motion, _yaw(motion.root_rotation[frame], like.root_rotation[there]), np.zeros(3))
    displacement = like.root_translation[there].astype(float) - turned.root_translation[frame]
    displacement[1] = 0
    return moved(turned, 0.0, displacement)


def repeated(motion: HandleMotion, before: int, after: int) -> HandleMotion:
    """A loop with frames of other rounds `before` its first and `after` its last frame; each round goes on where the
    one before ended. The last of the loop's N + 1 frames is the first of the next round.
    """
    last = len(motion) - 1
    if last < 1:
        return motion
    indices = np.arange(-before, last + after + 1)
    rounds, frames = np.divmod(indices, last)
    step = matrix_y(np.array([_yaw(motion.root_rotation[0], motion.root_rotation[-1])]))[0]
    displacement = motion.root_translation[-1].astype(float) - step @ motion.root_translation[0]
    positions, turns = {0: np.zeros(3)}, {0: np.eye(3)}
    for index in range(1, max(int(rounds.max()), 0) + 1):
        turns[index], positions[index] = step @ turns[index - 1], step @ positions[index - 1] + displacement
    for index in range(-1, min(int(rounds.min()), 0) - 1, -1):
        turns[index], positions[index] = step.T @ turns[index + 1], step.T @ (positions[index + 1] - displacement)
    turned, moves = (np.stack([each[index] for index in rounds.tolist()]) for each in (turns, positions))
    once = motion.take(frames)
    path = np.einsum("nij,nj->ni", turned, once.root_translation) + moves
    return replace(once, root_translation=path, root_rotation=turned @ once.root_rotation)


def closed_loop(motion: HandleMotion, like: HandleMotion, fade: int = 8) -> HandleMotion:
    """A nearly closed loop of N + 1 frames, closed: its last pose becomes its first, moved as a round of the loop moves
    that it was made from; where that neither turns nor travels, neither does the result. The difference fades in over
    the last frames.
    """
    turns = abs(_yaw(like.root_rotation[0], like.root_rotation[-1])) > 1e-4
    travels = bool(np.abs(like.root_translation[-1] - like.root_translation[0])[[0, 2]].max() > 1e-4)
    angle = _yaw(motion.root_rotation[0], motion.root_rotation[-1]) if turns else 0.0
    goal_rotation = matrix_y(np.array([angle]))[0] @ motion.root_rotation[0]
    goal = motion.root_translation[-1 if travels else 0].astype(float)
    goal[1] = motion.root_translation[0, 1]
    count = len(motion)
    share = smooth_step(np.arange(count), count - 1 - min(fade, count - 1), count - 1)
    path, all_along = motion.root_translation.astype(float), np.arange(count) / (count - 1)
    off = goal - path[-1]
    path[:, [0, 2]] += all_along[:, None] * off[[0, 2]]
    path[:, 1] += share * off[1]

    def turned(rotations: np.ndarray, there: np.ndarray) -> np.ndarray:
        out = _faded(rotations, there, rotations[-1], share).astype(np.float32)
        out[-1] = there
        return out

    off = motion.translations[0] - motion.translations[-1]
    translations = motion.translations + (share[:, None, None] * off).astype(np.float32)
    translations[-1] = motion.translations[0]
    rotations, root = turned(motion.rotations, motion.rotations[0]), turned(motion.root_rotation, goal_rotation)
    return replace(motion, translations=translations, rotations=rotations, root_translation=path, root_rotation=root)


def in_place(motion: HandleMotion, loop: bool = False) -> HandleMotion:
    """The motion without its travel over the ground, with the swaying of its root. With `loop` the last frame is the
    first of the next round, and stays so.
    """
    if len(motion) < 3:
        return motion
    margin = round(4 * STRIDE * motion.fps)  # what the root does faster than this stays
    path = motion.root_translation.astype(float)
    if loop:
        longer = repeated(motion, margin, margin).root_translation.astype(float)
    else:
        longer = np.pad(path, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    displacement = gaussian(longer, STRIDE * motion.fps)[margin : margin + len(path)]
    out = path - displacement
    out[:, [0, 2]] += path[0, [0, 2]] - out[0, [0, 2]]
    out[:, 1] = path[:, 1]
    return replace(motion, root_translation=out)


FADE = 8
"""Frames over which a difference at the edge of a span fades out."""


def follow(motion: HandleMotion, before: HandleMotion) -> HandleMotion:
    """A motion that nearly continues another, moved and bent so that its first frame equals the other's last, bit for
    bit.
    """
    still = before.take(np.full(len(motion), len(before) - 1))
    none = np.zeros(motion.translations.shape[1], bool)
    return put_back(placed_at(motion, 0, before, len(before) - 1), still, none, 1, len(motion))


def put_back(
    made: HandleMotion, original: HandleMotion, handles: np.ndarray, first: int, after: int, fade: int = FADE
) -> HandleMotion:
    """The generated motion with what is kept of the original of as many frames, bit for bit: all frames before `first`
    and from `after` on, and in all frames some handles, (K,), bool, of which handle 0 stands for the root's path.

    A difference to the next kept frame fades out over some frames at the edges of the span, and one of the root's
    position on the ground over the whole span, so that no foot slides for it. A fade of 0 leaves differences as they
    are.
    """
    count = len(original)
    arrays = {name: np.array(getattr(made, name)) for name in HandleMotion.arrays}
    edges = [(first - 1, 1)] * (first > 0) + [(after, -1)] * (after < count)
    for edge, displacement in edges if fade else ():
        frames = edge + displacement * np.arange(1, min(fade, after - first) + 1)
        share = _fade(len(frames))
        for name, array in arrays.items():
            there = getattr(original, name)[edge].astype(float)
            if name.endswith(("translation", "translations")):
                off = there - array[edge]
                if name.startswith("root"):
                    wide = _fade(after - first) if len(edges) == 2 else np.ones(after - first)
                    all_along = edge + displacement * np.arange(1, after - first + 1)
                    array[all_along] += (wide[:, None] * off * [1, 0, 1]).astype(np.float32)
                    off = off * [0, 1, 0]
                array[frames] += (share.reshape(-1, *[1] * there.ndim) * off).astype(np.float32)
            else:
                array[frames] = _faded(array[frames], there, array[edge], share)
    kept = np.ones(count, bool)
    kept[first:after] = False
    for name, array in arrays.items():
        array[kept] = getattr(original, name)[kept]
        if not name.startswith("root"):
            array[:, handles] = getattr(original, name)[:, handles]
        elif handles[0]:
            array[:] = getattr(original, name)
    return replace(made.with_arrays(arrays), fps=original.fps)


def put_back_runs(
    made: HandleMotion, original: HandleMotion, handles: np.ndarray, runs: Sequence[tuple[int, int]], fade: int = FADE
) -> HandleMotion:
    """`put_back` of several spans, each its first frame and the one after its last, in order; other frames are kept."""
    unbroken = original
    for first, after in runs:
        piece = put_back(made, original, handles, first, after, fade)
        arrays = {name: np.array(getattr(unbroken, name)) for name in HandleMotion.arrays}
        for name, array in arrays.items():
            array[first:after] = getattr(piece, name)[first:after]
        unbroken = replace(made.with_arrays(arrays), fps=original.fps)
    return unbroken


def _faded(rotations: np.ndarray, there: np.ndarray, here: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Rotations of frames, each turned by a share (N,) of what takes some (..., 3, 3) from `here` to `there`."""
    off = axis_angle_from_matrix(there.astype(float) @ np.swapaxes(here, -1, -2).astype(float))
    return matrix_from_axis_angle(share.reshape(-1, *[1] * off.ndim) * off) @ rotations.astype(float)


def _fade(length: int) -> np.ndarray:
    """From nearly 1 smoothly to nearly 0, shape (length,)."""
    return smooth_step(1 - np.arange(1, length + 1) / (length + 1))
