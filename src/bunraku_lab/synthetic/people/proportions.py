"""Body shapes, proportions and rest poses of people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.body.layout import JOINT_COUNT
from bunraku_lab.synthetic.people.makehuman import limb_rotations, pose_points

__all__ = ["random_body", "random_kind", "random_proportions", "random_rest", "rest_linear"]

_TORSO, _NECK, _HEAD = (0, 3, 6, 9, 13, 14), (12,), (15,)
_LEGS, _ARMS, _HANDS, _FEET = (1, 2, 4, 5), (16, 17, 18, 19), (20, 21), (7, 8, 10, 11)
_MEASURES = ("head", "torso", "width", "leg", "leg girth", "arm", "arm girth", "hand", "foot")
"""What is measured of a person, over one of natural proportions."""
_STYLES: dict[str, tuple[tuple[float, float], ...]] = {
    "person": (),
    "chibi": (
        (1.6, 2.8), (0.65, 0.95), (0.8, 1.1), (0.45, 0.8), (0.9, 1.25), (0.6, 0.9), (0.85, 1.2), (0.8, 1.3), (0.9, 1.4)
    ),
    "toon": (
        (1.1, 1.7), (0.8, 1.1), (0.75, 1.2), (0.7, 1.1), (0.6, 1.2), (0.8, 1.15), (0.6, 1.2), (1, 1.7), (1, 1.6)
    ),
    "heroic": ((0.75, 0.95), (0.95, 1.1), (1.0, 1.25), (1.1, 1.4), (0.9, 1.15), (1.0, 1.2), (0.9, 1.3)),
    "stocky": (
        (0.95, 1.3), (0.85, 1.05), (1.2, 1.6), (0.55, 0.8), (1.1, 1.5), (0.7, 1.0), (1.1, 1.6), (1, 1.4), (1, 1.3)
    ),
}  # fmt: skip
"""Ranges of the measures, in their order, of people in games; those without a range are 1."""
_DRAWINGS: dict[str, tuple[tuple[float, float], ...]] = {
    "drawn": (
        (1.3, 1.6), (0.82, 0.94), (0.76, 0.9), (0.92, 1.06), (0.7, 0.88), (0.78, 0.88), (0.68, 0.84), (0.72, 0.86),
        (0.8, 0.95),
    ),
    "chibi": (
        (1.75, 2.4), (0.62, 0.8), (0.8, 0.98), (0.42, 0.62), (0.85, 1.1), (0.58, 0.76), (0.85, 1.1), (0.85, 1.15),
        (0.9, 1.2),
    ),
    "toon": (
        (1.2, 1.65), (0.8, 1.0), (0.85, 1.15), (0.7, 0.98), (0.75, 1.15), (0.78, 1.0), (0.75, 1.1), (1.0, 1.4),
        (1.0, 1.35),
    ),
    "tall": (
        (0.92, 1.1), (0.95, 1.08), (0.85, 1.05), (1.05, 1.25), (0.78, 0.98), (0.98, 1.12), (0.75, 0.95), (0.9, 1.05),
        (0.9, 1.05),
    ),
}  # fmt: skip
"""The same of the figures of drawings."""


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


def random_kind(rng: np.random.Generator) -> str:
    """Which way a figure of a drawing is drawn: "person" in natural proportions, "drawn", "chibi", "toon" or "tall"."""
    return str(rng.choice(["person", "drawn", "chibi", "toon", "tall"], p=[0.18, 0.38, 0.18, 0.16, 0.1]))


def random_proportions(rng: np.random.Generator, kind: str | None = None) -> np.ndarray:
    """How much each part is scaled along X, Y and Z in a T-pose, shape (22, 3).

    Args:
        rng: Random numbers.
        kind: Of a drawing (`random_kind`), symmetrical and with a thin neck; None draws among plain people and the ways
            in which games draw them, and varies each part a little.
    """
    if kind is not None:
        return _parts(_drawn(rng, _DRAWINGS.get(kind, ())), kind)
    style = str(rng.choice(list(_STYLES), p=[0.4, 0.18, 0.2, 0.12, 0.1]))
    measures = _drawn(rng, _STYLES[style])
    measures *= np.exp(rng.normal(0, 0.05, len(_MEASURES)))[[6, 4, 5, 0, 1, 2, 3, 7, 8]]  # as in the data of trainings
    out = _parts(measures)
    out[[9, 13, 14], 0] *= np.exp(rng.normal(0, 0.07))  # shoulders
    out[list(_HEAD)] = measures[0] * np.exp(rng.normal(0, 0.04, 3))
    return out


def _drawn(rng: np.random.Generator, ranges: Sequence[tuple[float, float]]) -> np.ndarray:
    """A number from each range, and 1 for the measures without one, shape (9,)."""
    found = [rng.uniform(*one) for one in ranges]
    return np.array(found + [1.0] * (len(_MEASURES) - len(found)))


def _parts(measures: np.ndarray, kind: str | None = None) -> np.ndarray:
    """The scales of the parts from those of `_MEASURES`, shape (22, 3)."""
    head, torso, width, leg, leg_girth, arm, arm_girth, hand, foot = measures.tolist()
    thin = 0.9 * width**0.5
    out = np.ones((JOINT_COUNT, 3))
    out[list(_TORSO)] = [width, torso, np.sqrt(width)]
    out[list(_NECK)] = [1.0, np.sqrt(torso), 1.0] if kind is None else [thin, torso, thin]
    out[list(_HEAD)] = head
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


def random_rest(rng: np.random.Generator, joints: np.ndarray) -> np.ndarray:
    """A random rest pose (T, A, arms down, between) and random proportions, as linear maps of the parts, shape (22, 3,
    3).
    """
    pose = rng.choice(4, p=[0.4, 0.3, 0.2, 0.1])
    arm = (rng.normal(0, 0.04), rng.normal(0.75, 0.12), rng.normal(1.25, 0.08), rng.uniform(-0.2, 1.3))[pose]
    elbow = float(rng.uniform(0, 0.5)) if rng.random() < 0.35 else 0.0
    leg = float(rng.uniform(0, 0.25)) if rng.random() < 0.5 else 0.0
    return rest_linear(joints, random_proportions(rng), float(arm), elbow, leg)
