"""How the further legs of a body step: after one another, and not together with the leg whose part they play."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.limbs import further_limbs
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.geometry.easing import smooth_step
from bunraku.geometry.rotations import (
    axis_angle_from_matrix,
    matrix_from_quaternion,
    quaternion_from_matrix,
    quaternion_slerp,
)
from bunraku.handles.limbs import FAMILIES, SIDES, further_legged, limb_handles
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Gait"]

_HIPS = [HANDLE_NAMES.index(f"{side}_hip") for side in SIDES]


def _swings(motion: HandleMotion) -> np.ndarray:
    """How the left leg is turned forward against the right one in each frame [rad], shape (N,)."""
    left, right = (axis_angle_from_matrix(motion.rotations[:, hip].astype(np.float64))[:, 0] for hip in _HIPS)
    return np.asarray(left - right)


@dataclass(frozen=True)
class Gait(Stage):
    """Legs beyond those of a person step in turn.

    Args:
        shortest: Shortest cycle of steps [s].
        longest: Longest one [s].
        alike: Correlation of a swing with itself a cycle later, from which on it is one.
        slow: Cycles longer than this are those of a wave, in which one leg after the other lifts [s].
        faint: Swing of left against right in which nobody steps [rad].
        plain: Swing in which one does [rad].
    """

    name: ClassVar[str] = "gait"

    shortest: float = 0.25
    longest: float = 2.5
    alike: float = 0.5
    slow: float = 1.3
    faint: float = 0.05
    plain: float = 0.15

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return further_legged(anatomy.handles)

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return replace(fitting, rotations=self.stepping(fitting.source, anatomy.handles))

    def cycle(self, motion: HandleMotion) -> float:
        """Length of the cycle in which left and right legs take turns [s]; 0 where they do not.

        Args:
            motion: Of the reference body.
        """
        swings = _swings(motion)
        swings = swings - swings.mean()
        first, last = round(self.shortest * motion.fps), min(round(self.longest * motion.fps), (2 * len(swings)) // 3)
        if last <= first + 1 or float(np.abs(swings).max()) < self.faint:
            return 0.0
        alike = np.full(last + 1, -1.0)
        for lag in range(first, last + 1):
            one, other = swings[:-lag], swings[lag:]
            alike[lag] = (one @ other) / max(float(np.sqrt((one @ one) * (other @ other))), 1e-12)
        inside = np.arange(first + 1, last)
        peaks = inside[(alike[inside] >= alike[inside - 1]) & (alike[inside] >= alike[inside + 1])]
        peaks = peaks[alike[peaks] > self.alike]
        return float(peaks[0] / motion.fps) if len(peaks) else 0.0

    def phases(self, handles: Handles, cycle: float) -> dict[int, float]:
        """How far each handle of a further leg is behind the leg whose part it plays, in cycles.

        Legs of a side take turns from the hindmost forwards: each half a cycle after the one behind it, so that six
        legs stand on tripods and eight on two fours; in slow cycles they share the cycle evenly, as in a wave. Legs of
        both sides are as far behind as those whose parts they play, which take turns themselves.

        Args:
            handles: With `roles`.
            cycle: Length of the cycle [s].
        """
        out: dict[int, float] = {}
        played = handles.played
        for side in SIDES:
            own = [limb_handles(side, family) for family in FAMILIES]
            for family in own:
                plain = [handle for handle in family if played[handle] == handle and handles.weights[:, handle].any()]
                limbs = [limb for limb in further_limbs(handles) if int(played[limb[0]]) in family]
                group = sorted(
                    ([plain] if plain else []) + limbs, key=lambda limb: float(handles.positions[limb, 2].mean())
                )
                step = 1 / max(len(group), 1) if cycle > self.slow else 0.5
                base = group.index(plain) if plain else 0
                for number, limb in enumerate(group):
                    out |= {handle: ((number - base) * step) % 1.0 for handle in limb if limb is not plain}
        return out

    def stepping(self, motion: HandleMotion, handles: Handles) -> np.ndarray:
        """Rotations of a character's handles from those of the parts that they play, shape (N, K, 3, 3): further legs
        step in turn.

        Args:
            motion: Of the reference body.
            handles: The character's.
        """
        rotations = motion.rotations[:, handles.played].astype(np.float64)
        cycle = self.cycle(motion) if further_legged(handles) else 0.0
        if not cycle:
            return rotations
        count, frames = len(motion), np.arange(len(motion))
        amount = self._amount(_swings(motion), cycle * motion.fps)
        for handle, phase in self.phases(handles, cycle).items():
            shift = phase * cycle * motion.fps
            if shift:
                at = frames - shift
                at = np.where(at < 0, at + cycle * motion.fps, at)  # the first round steps as the next one does
                late = _at(rotations[:, handle], np.clip(at, 0, count - 1))
                rotations[:, handle] = _between(rotations[:, handle], late, amount)
        return rotations

    def _amount(self, swings: np.ndarray, cycle: float) -> np.ndarray:
        """How much the body steps in each frame, 0 to 1, shape (N,): what it does together, as a jump, it does
        together.
        """
        reach = max(round(cycle / 2), 1)
        padded = np.pad(swings - np.median(swings), reach, mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
        return np.asarray(smooth_step(np.ptp(windows, axis=1), self.faint, self.plain))


def _at(rotations: np.ndarray, times: np.ndarray) -> np.ndarray:
    low = np.floor(times).astype(int)
    high = np.minimum(low + 1, len(rotations) - 1)
    return _between(rotations[low], rotations[high], times - low)


def _between(start: np.ndarray, end: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) on the way from one to another."""
    first, last = np.asarray(quaternion_from_matrix(start)), np.asarray(quaternion_from_matrix(end))
    return np.asarray(matrix_from_quaternion(quaternion_slerp(first, last, share)))
