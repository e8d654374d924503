"""Stages for animals: further legs step after one another, left and right swing alike, legs stand under the trunk, and
heads stay above the ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.handles.limbs import ARMS, FAMILIES, SIDES, limb_handles
from bunraku.anatomy.legs import Leg
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Handles
from bunraku.core.geometry.curves import gaussian, running_least, smooth_step
from bunraku.core.geometry.rotations import (
    axis_angle_from_matrix,
    facing_and_tilt,
    matrix_from_axis_angle,
    matrix_slerp,
    nearest_rotation,
)
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages.stage import Fitting, Stage, sole_points, with_feet_moved

_HIPS = [HANDLE_NAMES.index(f"{side}_hip") for side in SIDES]


def _swings(motion: HandleMotion) -> np.ndarray:
    """How the left leg is turned forward against the right one in each frame [rad], shape (N,)."""
    left, right = (axis_angle_from_matrix(motion.rotations[:, hip].astype(np.float64))[:, 0] for hip in _HIPS)
    return np.asarray(left - right)


def _alike_later(curve: np.ndarray, first: int, last: int) -> np.ndarray:
    """Correlation of a curve (N,) with itself `first` to `last` frames later, shape (last + 1,); -1 before `first`."""
    alike = np.full(last + 1, -1.0)
    for lag in range(first, last + 1):
        earlier, later = curve[:-lag], curve[lag:]
        alike[lag] = (earlier @ later) / max(float(np.sqrt((earlier @ earlier) * (later @ later))), 1e-12)
    return alike


@dataclass(frozen=True)
class Gait(Stage, name="gait"):
    """Legs beyond those of a person step in turn."""

    shortest: float = 0.25  # shortest cycle of steps [s]
    longest: float = 2.5  # longest one [s]
    alike: float = 0.5  # correlation of a swing with itself a cycle later, from which on it is one
    slow: float = 1.3  # cycles longer than this are those of a wave, in which one leg after the other lifts [s]
    faint: float = 0.05  # swing of left against right up to which a body takes no steps [rad]
    plain: float = 0.15  # swing from which on it does [rad]

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return anatomy.has_extra_legs

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return replace(fitting, rotations=self.stepping(fitting.source, anatomy.handles, anatomy.extra_limbs))

    def cycle(self, motion: HandleMotion) -> float:
        """Length of the cycle in which left and right legs take turns [s]; 0 where they do not."""
        swings = _swings(motion)
        swings = swings - swings.mean()
        first, last = round(self.shortest * motion.fps), min(round(self.longest * motion.fps), (2 * len(swings)) // 3)
        if last <= first + 1 or float(np.abs(swings).max()) < self.faint:
            return 0.0
        alike = _alike_later(swings, first, last)
        inside = np.arange(first + 1, last)
        peaks = inside[(alike[inside] >= alike[inside - 1]) & (alike[inside] >= alike[inside + 1])]
        peaks = peaks[alike[peaks] > self.alike]
        return float(peaks[0] / motion.fps) if len(peaks) else 0.0

    def phases(self, handles: Handles, further: list[list[int]], cycle: float) -> dict[int, float]:
        """How far each handle of a further leg is behind the leg whose part it plays, in cycles of `cycle` seconds.

        Legs of a side take turns from the hindmost forwards: each half a cycle after the one behind it, so that six
        legs stand on tripods and eight on two fours; in slow cycles they share the cycle evenly, as in a wave. Legs of
        both sides are as far behind as those whose parts they play, which take turns themselves.
        """
        out: dict[int, float] = {}
        played = handles.played
        for side in SIDES:
            own = [limb_handles(side, family) for family in FAMILIES]
            for family in own:
                plain = [handle for handle in family if played[handle] == handle and handles.weights[:, handle].any()]
                limbs = [limb for limb in further if int(played[limb[0]]) in family]
                group = sorted(
                    ([plain] if plain else []) + limbs, key=lambda limb: float(handles.positions[limb, 2].mean())
                )
                step = 1 / max(len(group), 1) if cycle > self.slow else 0.5
                base = group.index(plain) if plain else 0
                for number, limb in enumerate(group):
                    out |= {handle: ((number - base) * step) % 1.0 for handle in limb if limb is not plain}
        return out

    def stepping(self, motion: HandleMotion, handles: Handles, further: list[list[int]]) -> np.ndarray:
        """Rotations of a character's handles from those of the parts of the reference body that they play, shape (N, K,
        3, 3): the limbs of `further`, each a list of handles, step in turn.
        """
        rotations = motion.rotations[:, handles.played].astype(np.float64)
        cycle = self.cycle(motion) if further else 0.0
        if not cycle:
            return rotations
        count, frames = len(motion), np.arange(len(motion))
        amount = self._amount(_swings(motion), cycle * motion.fps)
        for handle, phase in self.phases(handles, further, cycle).items():
            shift = phase * cycle * motion.fps
            if shift:
                at = frames - shift
                at = np.where(at < 0, at + cycle * motion.fps, at)  # the first round steps as the next one does
                at, turns = np.clip(at, 0, count - 1), rotations[:, handle]
                low = np.floor(at).astype(int)
                late = matrix_slerp(turns[low], turns[np.minimum(low + 1, count - 1)], at - low)
                rotations[:, handle] = matrix_slerp(turns, late, amount)
        return rotations

    def _amount(self, swings: np.ndarray, cycle: float) -> np.ndarray:
        """How much the body steps in each frame, 0 to 1, shape (N,): what it does together, as a jump, it does
        together.
        """
        reach = max(round(cycle / 2), 1)
        padded = np.pad(swings - np.median(swings), reach, mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
        return np.asarray(smooth_step(np.ptp(windows, axis=1), self.faint, self.plain))


def pairs_of(legs: list[Leg]) -> list[tuple[Leg, Leg]]:
    """Legs of the left and of the right side of a body that faces +Z that meet it side by side, the foremost first."""
    left, found = sorted((leg for leg in legs if leg.joints[0][0] > 0), key=lambda leg: -leg.joints[0][2]), []
    right = [leg for leg in legs if leg.joints[0][0] <= 0]
    for one in left:
        if right:
            other = min(right, key=lambda leg: abs(leg.joints[0][2] - one.joints[0][2]))
            right = [leg for leg in right if leg is not other]
            found.append((one, other))
    return found


@dataclass(frozen=True)
class Swings(Stage, name="swings"):
    """Left and right legs of a body on four legs swing alike."""

    shortest: float = 0.25  # shortest cycle of steps [s]
    longest: float = 2.5  # longest one [s]
    alike: float = 0.4  # correlation of a leg's angle with itself a cycle later, from which on it goes to and fro
    turns: float = 0.5  # correlation of both legs, negative, from which on they take turns, whatever their pace
    crossings: int = 4  # how often one then passes the other at the least: once is a step, and no walk
    least: float = 0.1  # angle through which both legs swing at the least [rad]
    unlike: float = 3.0  # factor between both beyond which they do different things, as in a blow with a paw
    percent: float = 5.0  # share of the frames beyond the swing's ends, on each side
    most: float = 1.8  # factor by which a swing is made larger or smaller at the most
    # No leg that goes to and fro swings farther, or is farther back or ahead [rad], than the 48 of twelve animals of
    # 0 A.D. that run.
    widest: float = float(np.radians(90))
    back: float = float(np.radians(-55))
    ahead: float = float(np.radians(47))
    rounds: int = 4  # the factors are found in turns, since a leg's angle is no linear function of its parts'

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return fitting.source.own_kind and bool(anatomy.plan.front) and not anatomy.has_extra_legs

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        rotations, fps = fitting.rotations.copy(), fitting.source.fps
        # a trunk that rocks with the steps adds to the swing of one leg what it takes from the other's
        _, rocks = facing_and_tilt(fitting.root_rotation, fps)
        for pair in pairs_of(anatomy.legs):
            self._paired(rotations, pair, anatomy, rocks, fps)
        return replace(fitting, rotations=rotations)

    def _paired(
        self, rotations: np.ndarray, pair: tuple[Leg, Leg], anatomy: Anatomy, rocks: np.ndarray, fps: float
    ) -> None:
        """Make both legs of a pair swing alike, in place."""
        angles = [self.angle(rotations, leg, anatomy, rocks) for leg in pair]
        swings = [self.swing(angle) for angle in angles]
        ratio = max(swings) / max(min(swings), 1e-9)
        if min(swings) < self.least or ratio > self.unlike or not self._goes_on(angles, fps):
            return
        swing = min(float(np.sqrt(swings[0] * swings[1])), self.widest)
        ends = self.back + swing / 2, self.ahead - swing / 2
        middle = float(np.clip(np.mean([one.mean() for one in angles]), *ends))
        for leg, swing_of_leg in zip(pair, swings, strict=True):
            factor, turned = 1.0, rotations
            for _ in range(self.rounds):
                factor = float(np.clip(factor * swing / max(swing_of_leg, 1e-9), 1 / self.most, self.most))
                turned = self._scaled(rotations, leg, factor)
                swing_of_leg = self.swing(self.angle(turned, leg, anatomy, rocks))
            shift = middle - float(self.angle(turned, leg, anatomy, rocks).mean())
            about = matrix_from_axis_angle(np.array([-shift, 0.0, 0.0]))
            for handle in _handles(leg):
                rotations[:, handle] = about @ turned[:, handle]

    def angle(self, rotations: np.ndarray, leg: Leg, anatomy: Anatomy, rocks: np.ndarray) -> np.ndarray:
        """How far forward a leg points along the heading [rad], shape (N,); `rocks` (N, 3, 3) are the root's rotations
        from the heading.
        """
        hip, knee, ankle = leg.joints.astype(np.float64)
        sole = anatomy.mesh.vertices[leg.sole].mean(axis=0) - ankle
        way = rotations[:, leg.upper] @ (knee - hip) + rotations[:, leg.lower] @ (ankle - knee)
        way = (rocks @ (way + rotations[:, leg.end] @ sole)[..., None])[..., 0]
        return np.unwrap(np.arctan2(way[:, 2], -way[:, 1]))

    def swing(self, angle: np.ndarray) -> float:
        """Through how much of an angle a leg swings [rad]."""
        return float(np.ptp(np.percentile(angle, [self.percent, 100 - self.percent])))

    def _scaled(self, rotations: np.ndarray, leg: Leg, factor: float) -> np.ndarray:
        """Rotations with a larger or smaller swing of a leg about the axis from side to side, each of its parts about
        its own mean.
        """
        out = rotations.copy()
        for handle in _handles(leg):
            turns = rotations[:, handle]
            mean = nearest_rotation(turns.mean(axis=0))
            turn = np.asarray(axis_angle_from_matrix(turns @ mean.T))
            turn[:, 0] *= factor
            out[:, handle] = matrix_from_axis_angle(turn) @ mean
        return out

    def _goes_on(self, angles: list[np.ndarray], fps: float) -> bool:
        """Whether both legs go to and fro: with one cycle, or at any pace, one ahead while the other is behind."""
        away = [angle - angle.mean() for angle in angles]
        apart, size = away[0] - away[1], float(np.sqrt((away[0] @ away[0]) * (away[1] @ away[1])))
        if away[0] @ away[1] < -self.turns * size and np.count_nonzero(np.diff(np.sign(apart))) >= self.crossings:
            return True
        count = len(angles[0])
        first, last = round(self.shortest * fps), min(round(self.longest * fps), (2 * count) // 3)
        if last <= first + 1:
            return False
        both = np.minimum(*(_alike_later(angle, first, last) for angle in away))
        return bool(both.max() > self.alike)


def _handles(leg: Leg) -> list[int]:
    """The handles of a leg's parts, each once."""
    return list(dict.fromkeys((leg.upper, leg.lower, *leg.foot)))


_FRONT = [*ARMS[0], *ARMS[1]]


def _ends(handles: Handles, legs: list[Leg]) -> tuple[list[int], list[int]]:
    """The legs of the rear and of the front of a body on four legs, by their numbers; empty of others."""
    front = [number for number, leg in enumerate(legs) if int(handles.played[leg.upper]) in _FRONT]
    rear = [number for number in range(len(legs)) if number not in front]
    return (rear, front) if len(front) == len(rear) == 2 else ([], [])


@dataclass(frozen=True)
class Support(Stage, name="support"):
    """Legs stay under the trunk of a body on four legs."""

    lifted: float = 0.1  # a leg whose foot is higher, over its length, carries nothing
    long: float = 0.6  # legs that are lifted for longer leave the trunk without support [s]
    # An end of the trunk that is so much higher than at rest is meant to be up [rad].
    reared: float = float(np.radians(20))
    soft: float = 0.12  # how softly legs are put down [s]

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return len(anatomy.legs) == 4

    def unsupported(self, motion: HandleMotion, anatomy: Anatomy) -> np.ndarray:
        """In which frames the rear and the front of a trunk have nothing under them, though the other end stands, shape
        (N, 2), bool.
        """
        legs, floor = anatomy.legs, anatomy.floor
        world = motion.transforms(anatomy.handles.positions)
        ends = _ends(anatomy.handles, legs)
        out = np.zeros((len(motion), 2), bool)
        if not ends[0]:
            return out
        high, tops, rest = [], [], []
        for end in ends:
            pair = [legs[number] for number in end]
            lows = [(sole_points(leg, anatomy, world)[..., 1].min(axis=1) - floor) / leg.length for leg in pair]
            high.append(np.min(lows, axis=0) > self.lifted)
            tops.append(np.mean([_joint(world, leg.upper, leg.joints[0]) for leg in pair], axis=0))
            rest.append(np.mean([leg.joints[0] for leg in pair], axis=0))
        rise = _slope(tops[1] - tops[0]) - _slope((rest[1] - rest[0])[None])  # of the front over the rear
        for side, rises in ((0, -rise), (1, rise)):
            out[:, side] = self._lasting(high[side] & ~high[1 - side] & (rises < self.reared), motion.fps)
        return out

    def changed(self, motion: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """The motion with legs put down below the end of the trunk that has nothing under it; unchanged where the body
        does not stand on four.
        """
        handles, legs = anatomy.handles, anatomy.legs
        wanting = self.unsupported(motion, anatomy)
        if not wanting.any():
            return motion
        world = motion.transforms(handles.positions).astype(np.float64)
        ahead, _ = facing_and_tilt(motion.root_rotation, motion.fps)
        shifts = np.zeros((len(motion), len(legs), 3))
        slopes = np.tile(np.eye(3), (len(motion), len(legs), 1, 1))
        for end, numbers in enumerate(_ends(handles, legs)):
            amount = gaussian(wanting[:, end].astype(float), self.soft * motion.fps)[:, None]
            if not wanting[:, end].any():
                continue
            for number in numbers:
                leg = legs[number]
                top = _joint(world, leg.upper, leg.joints[0])
                ankle = _joint(world, leg.end, leg.joints[2])
                goal = top + np.einsum("nij,j->ni", ahead, leg.joints[2] - leg.joints[0])
                goal[:, 1] = leg.joints[2][1]  # as high over the ground as at rest
                shifts[:, number] = amount * (goal - ankle)
                level = axis_angle_from_matrix(ahead @ np.swapaxes(world[:, leg.end, :, :3], -1, -2))
                slopes[:, number] = matrix_from_axis_angle(amount * np.asarray(level))
        return with_feet_moved(motion, anatomy, legs, shifts, slopes)

    def _lasting(self, held: np.ndarray, fps: float) -> np.ndarray:
        """Runs of frames that last longer than `long`, shape (N,), bool."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(int)))
        out = np.zeros(len(held), bool)
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            out[start:end] = end - start > self.long * fps
        return out


def _joint(world: np.ndarray, handle: int, position: np.ndarray) -> np.ndarray:
    return np.asarray(world[:, handle, :, :3] @ position + world[:, handle, :, 3], np.float64)


def _slope(direction: np.ndarray) -> np.ndarray:
    """How far directions (N, 3) lead up [rad], shape (N,)."""
    return np.asarray(np.arctan2(direction[:, 1], np.hypot(direction[:, 0], direction[:, 2])))


_TRUNK = [HANDLE_NAMES.index(name) for name in ("spine1", "spine2", "spine3", "neck", "head", "head_top", "face")]


@dataclass(frozen=True)
class Front(Stage, name="front", needs=("ground",)):
    """Heads of bodies that lie along their spine are kept above the ground."""

    sink: float = 0.01  # a head may be so far under the ground, over the height
    steps: tuple[float, ...] = (0.75, 0.5, 0.25)  # shares of the bending that are tried, before none
    soft: float = 0.15  # how softly bending is taken out [s]

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return fitting.source.own_kind and bool(anatomy.legs) and not anatomy.upright

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        source, rotations = self.raised(fitting.source, fitting.rotations, anatomy)
        return replace(
            fitting, source=source, rotations=rotations, root_rotation=source.root_rotation,
            root_translation=anatomy.path(source.root_translation, source.root_rotation),
        )  # fmt: skip

    def raised(self, motion: HandleMotion, rotations: np.ndarray, anatomy: Anatomy) -> tuple[HandleMotion, np.ndarray]:
        """A motion with less tilt of the root, and local rotations of the character's handles (N, K, 3, 3), in the
        root's frame, with less bending of the trunk, in frames in which the head of a body that stands as high as at
        rest would sink into the ground.
        """
        held = anatomy.front
        if not len(held):
            return motion, rotations
        character = anatomy.mesh
        floor = float(character.vertices[character.surface, 1].min()) - self.sink * character.height
        reach = anatomy.reach_of(held)
        facing, turned = facing_and_tilt(motion.root_rotation, motion.fps)
        tilt = axis_angle_from_matrix(turned)
        bends = np.asarray(axis_angle_from_matrix(rotations[:, _TRUNK].astype(np.float64)))

        def bent(share: np.ndarray) -> tuple[HandleMotion, np.ndarray]:
            some = rotations.copy()
            some[:, _TRUNK] = matrix_from_axis_angle(share[:, None, None] * bends)
            return replace(motion, root_rotation=facing @ matrix_from_axis_angle(share[:, None] * tilt)), some

        def sinks(moved: HandleMotion, some: np.ndarray) -> np.ndarray:
            turned, translations = anatomy.attached(some.astype(np.float64))
            still = np.zeros_like(motion.root_translation)
            posed = replace(moved, rotations=turned, translations=translations, root_translation=still)
            return reach.lowest(posed.transforms(anatomy.handles.positions)) < floor

        low = sinks(motion, rotations)
        if not low.any():
            return motion, rotations
        share = np.where(low, 0.0, 1.0)
        for step in self.steps:
            clear = ~sinks(*bent(np.full(len(motion), step)))
            share = np.where(low & clear, np.maximum(share, step), share)
        share = running_least(share, 2 * max(round(2 * self.soft * motion.fps), 1) + 1)
        return bent(gaussian(share, self.soft * motion.fps))
