"""How the joints of a rig hold its dynamic bodies: their limits and springs against bending."""

from __future__ import annotations

import numpy as np

from bunraku.apparel.clothed import FREE
from bunraku.core.mmd_model import MMD_METRE
from bunraku.physics.apparel_rig import ApparelRig
from bunraku.physics.forest import apparel_forest

__all__ = ["NEWTON_METRE", "bending_limits", "body_springs"]

NEWTON_METRE = MMD_METRE**2
"""A spring of 1 in a file [N m / rad]: MMD's forces are in kg unit / s^2."""


def body_springs(rig: ApparelRig) -> np.ndarray:
    """Spring against swinging of the joint that holds each body, in the file's numbers, shape (B,)."""
    out = np.zeros(len(rig.bodies))
    for joint in rig.joints:
        for held in joint.bodies:  # the joint that holds a body is the stiffest: ties to neighbours have no springs
            out[held] = max(out[held], float(np.mean(np.abs(joint.angle_spring)[[0, 2]])))
    return out


def bending_limits(rig: ApparelRig, parents: np.ndarray) -> np.ndarray:
    """How far each dynamic body may bend against what it hangs on, by the limits of its joint about the axes across its
    length [rad], shape (B,); pi where it hangs freely, and of bodies that follow their bones.

    Args:
        rig: The bodies and joints.
        parents: Parent of each bone, shape (J,).
    """
    out = np.full(len(rig.bodies), FREE)
    whole = tuple(joint for joint in rig.joints if min(joint.bodies) >= 0 and max(joint.bodies) < len(rig.bodies))
    for link in apparel_forest(rig.bodies, whole, parents).links:
        joint = link.joint
        if joint is None:
            continue
        far = np.maximum(np.abs(joint.angle_lower), np.abs(joint.angle_upper))
        half = np.where(joint.angle_lower > joint.angle_upper, FREE, np.minimum(far, FREE))
        along = rig.bodies[link.body].position - joint.position
        length = float(np.linalg.norm(along))
        across = 1 - np.square(joint.rotation.T @ along / length) if length > 1e-6 else np.ones(3)
        out[link.body] = np.sqrt(float((np.square(half) * across).sum() / across.sum()))
    return out
