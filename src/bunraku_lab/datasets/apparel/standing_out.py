"""Hems that stay up where a raised leg has left them: coat flaps that stand out like a shelf.

The chains of bodies that a simulation hangs on a pelvis can come to rest on one another. Such clips teach a network
what no cloth does.
"""

from __future__ import annotations

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.body.layout import JOINT_NAMES

__all__ = ["standing_out"]

HIPS = [JOINT_NAMES.index("left_hip"), JOINT_NAMES.index("right_hip")]
CALM = np.radians(25)
"""Angle between thighs and pelvis under which a leg is not raised [rad]."""
SETTLED = 15
"""Frames for which legs are calm before a hem that is still up stands out."""
UPRIGHT = 0.95
UP = 0.06
"""How much higher than at rest a hem is, over the character's size."""
STILL = 0.15
"""Speed under which it hangs there [m/s]."""
SOME = 0.03
"""Share of what hangs from the pelvis that must stand out for a frame to count."""


def standing_out(
    clothed: ClothedCharacter, transforms: np.ndarray, loose: np.ndarray, offsets: np.ndarray, fps: float = 30.0
) -> float:
    """Share of the frames with calm legs in which apparel that hangs from the pelvis stands out; 0 where there is none.

    Args:
        clothed: The character.
        transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
        loose: Vertices that leave their joints, shape (M,).
        offsets: By how much [m], shape (N, M, 3).
        fps: Frames a second.
    """
    hung = (
        clothed.apparel[loose] & (clothed.weights[loose].argmax(axis=1) == 0)
        & (clothed.rest[loose, 1] < clothed.joints[0, 1])
    )  # fmt: skip
    turn = np.asarray(transforms[:, 0, :, :3], np.float32)
    thighs = np.einsum("nba,njbc->njac", turn, transforms[:, HIPS, :, :3])
    angle = np.arccos(np.clip((np.trace(thighs, axis1=2, axis2=3) - 1) / 2, -1, 1)).max(axis=1)
    calm = (angle < CALM) & (turn[:, 1, 1] > UPRIGHT)
    settled = np.convolve(calm, np.ones(SETTLED + 1), "full")[: len(calm)] > SETTLED
    if not hung.any() or not settled.any():
        return 0.0
    away = np.einsum("nba,nmb->nma", turn, offsets[:, hung].astype(np.float32))
    speed = np.linalg.norm(np.gradient(away, axis=0), axis=2) * fps
    up = (away[..., 1] > UP * clothed.scale) & (speed < STILL)
    return float((up[settled].mean(axis=1) > SOME).mean())
