"""What a joint of MMD lets its bodies do, as joints of MuJoCo.

Bullet, which MMD uses, reads the angles of its six-degrees-of-freedom joint from the transpose of the rotation of B in
A: A turns in B by Rx(a) Ry(b) Rz(c), so B turns in A by Rz(-c) Ry(-b) Rx(-a). Three hinges in that order are that
joint, with its own limits about each axis, which a ball joint of MuJoCo does not have. An axis without room gets no
hinge. A joint whose middle axis may turn by 80 degrees or more would lock, and becomes a ball.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.core.mmd_model import MMD_METRE
from bunraku.physics.forest import STIFF, TIGHT, Link

__all__ = ["Freedom", "freedoms"]

GIMBAL = np.radians(80.0)
SLACK = 0.1  # how far a body may go along an axis that its file frees altogether [m]
_ANGLE_UNIT = MMD_METRE**2  # torques of MMD are mass times its unit squared over seconds squared


@dataclass(frozen=True)
class Freedom:
    """One joint of MuJoCo.

    Args:
        kind: "slide", "hinge" or "ball".
        axis: In the axes of the world at rest, shape (3,).
        lower, upper: Limits [m or rad]; both infinite where there are none.
        stiffness: Of its spring [kg/s^2 or N m/rad].
    """

    kind: str
    axis: np.ndarray
    lower: float
    upper: float
    stiffness: float

    @property
    def limited(self) -> bool:
        """Whether it has limits."""
        return bool(np.isfinite(self.lower) or np.isfinite(self.upper))


def freedoms(link: Link) -> list[Freedom]:
    """How a body may move against what it hangs on, the outermost joint first."""
    joint = link.joint
    if joint is None:
        return [Freedom("ball", np.array([0.0, 0, 1]), -np.inf, np.inf, 0.0)]
    out = []
    low, high = _range(joint.lower, joint.upper, not link.turned)
    for axis in range(3):
        if high[axis] - low[axis] > TIGHT:
            start, end = (low[axis], high[axis]) if np.isfinite(low[axis]) else (-SLACK, SLACK)
            out.append(
                Freedom("slide", joint.rotation[:, axis], float(start), float(end), max(float(joint.spring[axis]), 0.0))
            )
    low, high = _range(joint.angle_lower, joint.angle_upper, link.turned)
    stiffness = np.maximum(joint.angle_spring, 0) * _ANGLE_UNIT
    for other, turned in link.more:
        more_low, more_high = _range(other.angle_lower, other.angle_upper, turned)
        both_low, both_high = np.maximum(low, more_low), np.minimum(high, more_high)
        good = both_low <= both_high
        low, high = np.where(good, both_low, low), np.where(good, both_high, high)
        stiffness = stiffness + np.maximum(other.angle_spring, 0) * _ANGLE_UNIT
    open_axes = high - low > STIFF
    if max(-low[1], high[1]) > GIMBAL and open_axes.all():
        widest = float(max(-low.min(), high.max()))
        widest = widest if widest < np.pi else np.inf
        return [
            *out,
            Freedom(
                "ball", np.array([0.0, 0, 1]), 0.0 if np.isfinite(widest) else -np.inf, widest, float(stiffness.mean())
            ),
        ]
    for axis in (0, 1, 2) if link.turned else (2, 1, 0):
        if open_axes[axis]:
            out.append(
                Freedom("hinge", joint.rotation[:, axis], float(low[axis]), float(high[axis]), float(stiffness[axis]))
            )
    return out


def _range(lower: np.ndarray, upper: np.ndarray, straight: bool) -> tuple[np.ndarray, np.ndarray]:
    """Limits in the joint's own sense or turned round; infinite where the file's range is empty, and past half a turn
    of angles.
    """
    low, high = (lower, upper) if straight else (-upper, -lower)
    free = lower > upper
    return np.where(free, -np.inf, low), np.where(free, np.inf, high)
