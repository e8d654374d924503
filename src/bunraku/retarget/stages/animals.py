"""Stages for animals: further legs step after one another, and heads stay above the ground."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.handles.limbs import ARMS, FAMILIES, SIDES, limb_handles
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Handles
from bunraku.core.geometry.curves import gaussian, running_least, smooth_step
from bunraku.core.geometry.rotations import (
    axis_angle_from_matrix,
    facing_and_tilt,
    matrix_from_axis_angle,
    matrix_slerp,
)
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages.stage import Fitting, Stage

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


_TRUNK = [HANDLE_NAMES.index(name) for name in ("spine1", "spine2", "spine3", "neck", "head", "head_top", "face")]


@dataclass(frozen=True)
class Front(Stage, name="front", needs=("ground",)):
    """Heads of bodies that lie along their spine are kept above the ground."""

    sink: float = 0.01  # a head may be so far under the ground, over the height
    # How far the tops of front legs come down as the trunk tilts at the most, over their length: what crouches before a
    # jump on short legs would lie on its chest. By eye on a bear and a lion.
    stoop: float = 0.3
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
        rest would sink into the ground, or its chest come down too far.
        """
        held, character = anatomy.front, anatomy.mesh
        if not len(held):
            return motion, rotations
        floor = float(character.vertices[character.surface, 1].min()) - self.sink * character.height
        reach = anatomy.reach_of(held)
        fore = [leg for leg in anatomy.legs if int(anatomy.handles.played[leg.upper]) in (*ARMS[0], *ARMS[1])]

        def sinks(world: np.ndarray) -> np.ndarray:
            return reach.lowest(world) < floor

        def stoops(world: np.ndarray) -> np.ndarray:
            tops = [world[:, leg.upper, 1, :3] @ leg.joints[0] + world[:, leg.upper, 1, 3] for leg in fore]
            drops = [leg.joints[0][1] - top for leg, top in zip(fore, tops, strict=True)]
            return np.asarray(np.max(drops, axis=0) > self.stoop * max(leg.length for leg in fore))

        if fore:
            motion, rotations = self._less(motion, rotations, anatomy, _TRUNK[:3], stoops)
        return self._less(motion, rotations, anatomy, _TRUNK, sinks)

    def _less(
        self, motion: HandleMotion, rotations: np.ndarray, anatomy: Anatomy, parts: list[int],
        low: Callable[[np.ndarray], np.ndarray],
    ) -> tuple[HandleMotion, np.ndarray]:  # fmt: skip
        """The same with less tilt of the root and less bending of some parts where the posed body is too low."""
        facing, turned = facing_and_tilt(motion.root_rotation, motion.fps)
        tilt, bends = (axis_angle_from_matrix(turns.astype(np.float64)) for turns in (turned, rotations[:, parts]))

        def bent(share: np.ndarray) -> tuple[HandleMotion, np.ndarray]:
            some = rotations.copy()
            some[:, parts] = matrix_from_axis_angle(share[:, None, None] * bends)
            return replace(motion, root_rotation=facing @ matrix_from_axis_angle(share[:, None] * tilt)), some

        def sinks(moved: HandleMotion, some: np.ndarray) -> np.ndarray:
            turned, translations = anatomy.attached(some.astype(np.float64))
            still = np.zeros_like(motion.root_translation)
            posed = replace(moved, rotations=turned, translations=translations, root_translation=still)
            return np.asarray(low(posed.transforms(anatomy.handles.positions)))

        sunk = sinks(motion, rotations)
        if not sunk.any():
            return motion, rotations
        share = np.where(sunk, 0.0, 1.0)
        for step in self.steps:
            clear = ~sinks(*bent(np.full(len(motion), step)))
            share = np.where(sunk & clear, np.maximum(share, step), share)
        share = running_least(share, 2 * max(round(2 * self.soft * motion.fps), 1) + 1)
        return bent(gaussian(share, self.soft * motion.fps))
