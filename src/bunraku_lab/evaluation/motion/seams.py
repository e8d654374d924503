"""How smoothly a long motion runs where its windows, or its prompts, meet.

Two rates are measured between neighbouring frames, each the mean over the 30 handles, in the world:

- displacement: how far the handles go from one frame to the next, |p(n + 1) - p(n)| [m]
- jump: how much that step changes, |p(n + 2) - 2 p(n + 1) + p(n)| [m]; a motion that goes fast but steadily has none

For both, the ratio is the largest value within 10 frames of a seam over the median of the whole clip. A real motion has
ratios well above 1 too (a leap is faster than the median), so the same ratio away from all seams is given beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.body.reference import reference_body
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import posed_points

__all__ = ["SeamReport", "posed_positions", "measure_seams"]

NEAR = 10  # frames


@dataclass(frozen=True)
class SeamReport:
    """Largest over median, see the module.

    Args:
        displacement: Of the step between frames, near seams.
        displacement_elsewhere: The same away from seams.
        jump: Of the change of the step, near seams.
        jump_elsewhere: The same away from seams.
    """

    displacement: float
    displacement_elsewhere: float
    jump: float
    jump_elsewhere: float


def posed_positions(motion: HandleMotion, positions: np.ndarray | None = None) -> np.ndarray:
    """World positions of the handles [m], shape (N, K, 3); of the reference body's unless rest positions (K, 3) are
    given.
    """
    rest = np.asarray(reference_body().handles.positions if positions is None else positions, float)
    transforms = motion.transforms(rest).astype(float)
    return np.asarray(posed_points(transforms, rest))


def measure_seams(motion: HandleMotion, seams: Sequence[int], positions: np.ndarray | None = None) -> SeamReport:
    """Measure the seams of a motion.

    Args:
        motion: N frames, at least 3.
        seams: Frames at which another window or prompt takes over.
        positions: Rest positions of the handles [m], shape (K, 3); the reference body's by default.
    """
    posed = posed_positions(motion, positions)
    found: list[float] = []
    for order in (1, 2):
        rate = np.linalg.norm(np.diff(posed, n=order, axis=0), axis=-1).mean(axis=1)
        near = np.zeros(len(rate), bool)
        for seam in seams:
            near[max(seam - NEAR, 0) : seam + NEAR] = True
        middle = max(float(np.median(rate)), 1e-9)
        found += [float(rate[part].max(initial=0)) / middle for part in (near, ~near)]
    return SeamReport(*found)
