"""Body shapes, proportions and rest poses of dressed characters."""

from __future__ import annotations

import numpy as np

from bunraku.body.layout import JOINT_COUNT
from bunraku_lab.synthetic.makehuman import limb_rotations, pose_points

__all__ = ["random_body", "random_figure", "random_proportions", "rest_linear"]

_TORSO, _NECK, _HEAD = (0, 3, 6, 9, 13, 14), (12,), (15,)
_LEGS, _ARMS, _HANDS, _FEET = (1, 2, 4, 5), (16, 17, 18, 19), (20, 21), (7, 8, 10, 11)


def random_body(rng: np.random.Generator) -> dict[str, float]:
    """Parameters of `MakeHumanBody.shape`: people of every age and build, grown-ups more often than children."""
    low, high = ((0.0, 0.2), (0.2, 0.45), (0.45, 0.8), (0.8, 1.0))[rng.choice(4, p=[0.05, 0.2, 0.55, 0.2])]
    african, asian, caucasian = rng.dirichlet([0.6, 0.6, 0.6])
    return {
        "gender": float(rng.beta(0.5, 0.5)), "age": float(rng.uniform(low, high)), "muscle": float(rng.beta(1.2, 1.2)),
        "weight": float(rng.beta(1.2, 1.2)), "height": float(rng.random()), "proportions": float(rng.random()),
        "cupsize": float(rng.beta(1.5, 1.5)),
        "firmness": float(rng.random()), "african": float(african), "asian": float(asian),
        "caucasian": float(caucasian),
    }  # fmt: skip


def random_proportions(rng: np.random.Generator) -> np.ndarray:
    """How much each part is scaled along X, Y and Z in a T-pose, shape (22, 3): plain people, and the ways in which
    games draw them.
    """
    between = rng.uniform
    style = rng.choice(["person", "chibi", "toon", "heroic", "stocky"], p=[0.4, 0.18, 0.2, 0.12, 0.1])
    leg = leg_girth = arm = arm_girth = torso = width = head = hand = foot = 1.0
    if style == "chibi":
        head, torso, width = between(1.6, 2.8), between(0.65, 0.95), between(0.8, 1.1)
        leg, leg_girth, arm, arm_girth = between(0.45, 0.8), between(0.9, 1.25), between(0.6, 0.9), between(0.85, 1.2)
        hand, foot = between(0.8, 1.3), between(0.9, 1.4)
    elif style == "toon":
        head, torso, width = between(1.1, 1.7), between(0.8, 1.1), between(0.75, 1.2)
        leg, leg_girth, arm, arm_girth = between(0.7, 1.1), between(0.6, 1.2), between(0.8, 1.15), between(0.6, 1.2)
        hand, foot = between(1, 1.7), between(1, 1.6)
    elif style == "heroic":
        head, torso, width = between(0.75, 0.95), between(0.95, 1.1), between(1.0, 1.25)
        leg, leg_girth, arm, arm_girth = between(1.1, 1.4), between(0.9, 1.15), between(1.0, 1.2), between(0.9, 1.3)
    elif style == "stocky":
        head, torso, width = between(0.95, 1.3), between(0.85, 1.05), between(1.2, 1.6)
        leg, leg_girth, arm, arm_girth = between(0.55, 0.8), between(1.1, 1.5), between(0.7, 1.0), between(1.1, 1.6)
        hand, foot = between(1, 1.4), between(1, 1.3)
    leg, leg_girth, arm, arm_girth, torso, width, head, hand, foot = np.array(
        [leg, leg_girth, arm, arm_girth, torso, width, head, hand, foot]
    ) * np.exp(rng.normal(0, 0.05, 9))
    out = np.ones((JOINT_COUNT, 3))
    out[list(_TORSO)] = [width, torso, np.sqrt(width)]
    out[[9, 13, 14], 0] *= np.exp(rng.normal(0, 0.07))  # shoulders
    out[list(_NECK)] = [1.0, np.sqrt(torso), 1.0]
    out[list(_HEAD)] = head * np.exp(rng.normal(0, 0.04, 3))
    out[list(_LEGS)] = [leg_girth, leg, leg_girth]
    out[list(_ARMS)] = [arm, arm_girth, arm_girth]
    out[list(_HANDS)], out[list(_FEET)] = hand, foot
    return out


def rest_linear(joints: np.ndarray, proportions: np.ndarray, arm: float, elbow: float, leg: float) -> np.ndarray:
    """Linear maps of the parts from the body's own pose to a rest pose with other proportions, shape (22, 3, 3).

    Args:
        joints: Positions in the body's own pose, shape (22, 3).
        proportions: From `random_proportions`.
        arm, elbow, leg: As for `limb_rotations` [rad].
    """
    straight = limb_rotations(joints)
    scaled = proportions[:, :, None] * straight
    t_joints = pose_points(np.zeros((0, 3)), joints, np.zeros((0, JOINT_COUNT)), scaled)[1]
    return np.asarray(limb_rotations(t_joints, arm, elbow, leg) @ scaled)


def random_figure(rng: np.random.Generator, joints: np.ndarray) -> np.ndarray:
    """A random rest pose (T, A, arms down, between) and random proportions, as linear maps of the parts, shape (22, 3,
    3).
    """
    pose = rng.choice(4, p=[0.4, 0.3, 0.2, 0.1])
    arm = (rng.normal(0, 0.04), rng.normal(0.75, 0.12), rng.normal(1.25, 0.08), rng.uniform(-0.2, 1.3))[pose]
    elbow = float(rng.uniform(0, 0.5)) if rng.random() < 0.35 else 0.0
    leg = float(rng.uniform(0, 0.25)) if rng.random() < 0.5 else 0.0
    return rest_linear(joints, random_proportions(rng), float(arm), elbow, leg)
