"""Pins: a hand or a foot that is at a position, and rotated as is requested, at a time.

A limb is bent so that its end is where it should be, by two-bone inverse kinematics as feet are held; what is out of
its reach the root goes the rest of the way, and feet stay where they were. The correction sets in before the pin and
fades after it, so a clip with pins is the clip as it was elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import Joints
from bunraku.anatomy.legs import Leg, carry
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Handles
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.core.request import MOMENT, PLACE, Constraint
from bunraku.errors import OptionError
from bunraku.retarget.stages.stage import with_feet_moved

PINNED = ("left_hand", "right_hand", "left_foot", "right_foot")
"""Parts that can be pinned; of further limbs of a kind the first."""
_PART_OF = {"wrist": "hand", "elbow": "hand", "fingers": "hand", "ankle": "foot", "knee": "foot", "foot": "foot"}
LEAD = 0.4
"""Seconds before and after a pin over which a limb goes there and back."""
ROOT_LEAD = 2 * LEAD
"""The same for the root where a limb does not reach."""
ROUNDS = 12
CLOSE = 5e-4
"""Error over the character's height at which a pin is met."""
MISSED = 10 * CLOSE
"""Error over the height from which on it is not."""


@dataclass(frozen=True)
class Pin(Constraint, kind="pin", several=True):
    """Where a hand or a foot is at a time.

    Raises:
        OptionError: There is no such part, or a number makes no sense.
    """

    part: str  # one of `PINNED`
    time: Annotated[float, MOMENT]  # seconds from the start of the clip
    # Where the wrist or ankle is [m], in the clip's world: +Y up.
    position: tuple[Annotated[float, PLACE], Annotated[float, PLACE], Annotated[float, PLACE]]
    # Turn of the hand or foot from the rest pose in the world, shape (3, 3); None leaves it as it is.
    rotation: np.ndarray | None = None
    hold: Annotated[float, MOMENT] = 0.0  # seconds for which it stays there

    def __post_init__(self) -> None:
        if self.part not in PINNED:
            raise OptionError(f"'{self.part}' cannot be pinned; there are {', '.join(PINNED)}")
        numbers = (self.time, self.hold, *self.position)
        if len(self.position) != 3 or not all(math.isfinite(number) for number in numbers):
            raise OptionError(f"the pin of {self.part} needs a time and three coordinates that are numbers")
        if self.time < 0 or self.hold < 0:
            raise OptionError(f"the pin of {self.part} cannot be before the start, nor be held for a negative time")
        if self.rotation is not None:
            turn = np.asarray(self.rotation, np.float64)
            if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) or np.linalg.det(turn) < 0:
                raise OptionError(f"the rotation of {self.part} must be a rotation matrix of three rows")
            object.__setattr__(self, "rotation", turn)

    def frames(self, count: int, fps: float) -> np.ndarray:
        """The frames in which it is held; OptionError where it is after the end of the clip."""
        first = round(self.time * fps)
        if first >= count:
            raise OptionError(f"the pin of {self.part} at {self.time:g} s is after the end at {count / fps:g} s")
        return np.arange(first, min(first + round(self.hold * fps), count - 1) + 1)


@dataclass(frozen=True, eq=False)
class LimbEnd:
    """The end of a limb that can be pinned: its part (`PINNED`), the handle that it moves with, and the wrist or ankle
    in the rest pose [m], shape (3,).
    """

    part: str
    handle: int
    point: np.ndarray
    limb: Leg


def limb_ends(anatomy: Anatomy) -> list[LimbEnd]:
    """The hands and feet of a character that can be pinned; none where it has no limbs."""
    out: dict[str, LimbEnd] = {}
    for limb in (*anatomy.legs, *anatomy.arms):
        side, _, name = HANDLE_NAMES[int(anatomy.handles.played[limb.end])].partition("_")
        part = f"{side}_{_PART_OF.get(name, '')}"
        if part in PINNED and part not in out:
            out[part] = LimbEnd(part, limb.end, limb.joints[2], limb)
    return [out[part] for part in PINNED if part in out]


def end_positions(motion: HandleMotion, handles: Handles, ends: Sequence[LimbEnd]) -> np.ndarray:
    """Where ends of limbs are [m], shape (N, L, 3), float64."""
    world = motion.transforms(handles.positions).astype(np.float64)
    positions = [world[:, end.handle, :, :3] @ end.point + world[:, end.handle, :, 3] for end in ends]
    return np.stack(positions, axis=1) if positions else np.zeros((len(motion), 0, 3))


def meet_pins(motion: HandleMotion, anatomy: Anatomy, pins: Sequence[Pin]) -> HandleMotion:
    """The motion of a character (N frames) with its pins met, at most one of a part at a time.

    Raises:
        OptionError: A part is not there, a pin is after the end, or pins of one time are too far apart for the body.
    """
    if not pins:
        return motion
    ends, character, handles, joints = limb_ends(anatomy), anatomy.mesh, anatomy.handles, anatomy.joints
    end_numbers = {end.part: number for number, end in enumerate(ends)}
    for pin in pins:
        if pin.part not in end_numbers:
            there = ", ".join(end_numbers) or "none"
            raise OptionError(f"{character.name} has no {pin.part.replace('_', ' ')} to pin; it has {there}")
    given, reach = motion, np.zeros(len(motion), bool)
    goals = np.full((len(motion), len(ends), 3), np.nan)
    for pin in pins:
        goals[pin.frames(len(motion), motion.fps), end_numbers[pin.part]] = pin.position
    pinned = ~np.isnan(goals[..., 0])
    limbs, height = [end.limb for end in ends], character.height
    feet = [number for number, end in enumerate(ends) if end.part.endswith("foot")]
    planted = end_positions(motion, handles, ends)

    def missing() -> np.ndarray:
        return np.where(pinned[..., None], goals - end_positions(motion, handles, ends), 0)

    for _ in range(ROUNDS):
        off = missing()
        if np.abs(off).max() <= CLOSE * height:
            break
        lead = LEAD * motion.fps
        shifts = np.stack([spread(pinned[:, n], off[:, n], lead) for n in range(len(ends))], axis=1)
        reach |= np.abs(shifts).max(axis=(1, 2)) > 0
        motion = with_feet_moved(motion, anatomy, limbs, shifts)
        off = missing()
        if np.abs(off).max() <= CLOSE * height:
            break
        frames = pinned.any(axis=1)  # what the limbs do not reach
        rest = off.sum(axis=1) / np.maximum(pinned.sum(axis=1), 1)[:, None]
        step = spread(frames, rest, ROOT_LEAD * motion.fps)
        reach |= np.abs(step).max(axis=1) > 0
        motion = replace(motion, root_translation=motion.root_translation + step)
        stay = np.zeros_like(shifts)
        for number in feet:  # the root moved, and feet without a pin stay where they were
            free = 1 - spread(pinned[:, number], np.ones((len(motion), 1)), LEAD * motion.fps)
            stay[:, number] = free * (planted - end_positions(motion, handles, ends))[:, number]
        motion = with_feet_moved(motion, anatomy, limbs, stay)
    worst = np.linalg.norm(missing(), axis=-1)
    if worst.max() > MISSED * height:
        frame, missed = (int(index) for index in np.unravel_index(int(worst.argmax()), worst.shape))
        raise OptionError(
            f"the pin of {ends[missed].part.replace('_', ' ')} at {frame / motion.fps:g} s is missed by "
            f"{worst.max():.2f} m: the pins of that time are too far apart for this body; move them together"
        )
    turned = [pin for pin in pins if pin.rotation is not None]
    for pin in turned:
        held = np.isin(np.arange(len(motion)), pin.frames(len(motion), motion.fps))
        reach |= np.abs(spread(held, np.ones((len(motion), 1)), LEAD * motion.fps))[:, 0] > 0
    met = _turned(motion, handles, joints, ends, turned)
    arrays = {}
    for name in HandleMotion.arrays:
        after, before = getattr(met, name), getattr(given, name)
        arrays[name] = np.where(reach.reshape(-1, *[1] * (after.ndim - 1)), after, before)
    return replace(met, **arrays)  # what no pin reaches stays bit for bit


def _turned(
    motion: HandleMotion, handles: Handles, joints: Joints, ends: list[LimbEnd], pins: list[Pin]
) -> HandleMotion:
    """The motion with hands and feet turned about their joints where pins say so."""
    if not pins:
        return motion
    world = motion.transforms(handles.positions).astype(np.float64)
    for end in ends:
        part_pins = [pin for pin in pins if pin.part == end.part]
        if not part_pins:
            continue
        if not end.limb.foot:
            raise OptionError(f"the {end.part.replace('_', ' ')} of this character has no handle that could rotate it")
        turns, pinned = np.zeros((len(motion), 3)), np.zeros(len(motion), bool)
        for pin in part_pins:
            frames = pin.frames(len(motion), motion.fps)
            back = np.swapaxes(world[frames, end.handle, :, :3], -1, -2)
            turns[frames] = axis_angle_from_matrix(np.asarray(pin.rotation) @ back)
            pinned[frames] = True
        turned = matrix_from_axis_angle(spread(pinned, turns, LEAD * motion.fps))
        pivot = world[:, end.handle, :, :3] @ end.point + world[:, end.handle, :, 3]
        for handle in end.limb.foot:
            carry(world, handle, joints, pivot, pivot, turned)
    return motion.with_transforms(world, handles.positions)


def spread(pinned: np.ndarray, values: np.ndarray, lead: float) -> np.ndarray:
    """A smooth curve (N, D) through values (N, D) in the frames that are `pinned` (N,), which comes from zero over
    `lead` frames before them and goes to it after. Frames that are nearer than twice that are joined.
    """
    out = np.zeros(values.shape)
    frames = np.flatnonzero(pinned)
    if not len(frames):
        return out
    count, time = len(values), np.arange(len(values))
    knots: list[tuple[float, np.ndarray]] = [(frames[0] - lead, np.zeros(values.shape[1]))]
    for index, frame in enumerate(frames):
        knots.append((float(frame), values[frame]))
        after = frames[index + 1] if index + 1 < len(frames) else count + 4 * lead
        if after - frame > 2 * lead:
            knots.append((frame + lead, np.zeros(values.shape[1])))
            knots.append((after - lead, np.zeros(values.shape[1])))
    for (start, low), (end, high) in zip(knots, knots[1:], strict=False):
        span = (time >= start) & (time <= end)
        out[span] = low + smooth_step(time[span], start, max(end, start + 1e-9))[:, None] * (high - low)
    out[frames] = values[frames]
    return out
