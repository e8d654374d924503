"""The same humanoid in other rest poses."""

from __future__ import annotations

import numpy as np

from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.geometry.rotations import rotation_between
from bunraku.core.skinning import skin
from bunraku_lab.datasets.characters.training_character import TrainingCharacter, forward_kinematics

REST_POSES = ("T", "A", "arms down", "sitting")
_ARM_DROP = {
    "T": 0.0,
    "A": 45.0,
    "arms down": 80.0,
    "sitting": 45.0,
    "crouching": 60.0,
}  # below the horizontal [degrees]
_LEG_DIRECTIONS = {
    "sitting": ((0.0, 0, 1), (0.0, -1, 0)),
    "crouching": ((0.0, -0.3, 0.95), (0.0, -0.8, -0.6)),
}  # thighs and shins that do not stand, which define the poses
_CHAINS = (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))


def limb_directions(pose: str) -> dict[str, np.ndarray]:
    """Where the upper arms, forearms, thighs and shins of a pose point, by the handle of their bones, shape (3,) each.

    Args:
        pose: One of `REST_POSES` or "crouching". Arms are in the frontal plane: level (T), 45 degrees below (A and
            sitting), 60 (crouching) or 80 (arms down). Legs hang straight down, but the thighs of one who sits or
            crouches point forward.
    """
    drop = np.radians(_ARM_DROP[pose])
    out = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        out[f"{side}_shoulder"] = out[f"{side}_elbow"] = np.array([sign * np.cos(drop), -np.sin(drop), 0])
        out[f"{side}_hip"], out[f"{side}_knee"] = (
            np.array(leg) for leg in _LEG_DIRECTIONS.get(pose, ((0.0, -1, 0), (0.0, -1, 0)))
        )
    return out


def _first(truth: TrainingCharacter, handle: str, mass: np.ndarray, under: int = -1) -> int:
    """The joint at which a limb's part begins: the heaviest whose parent is of another part, or -1."""
    index = HANDLE_NAMES.index(handle)
    found = [
        j
        for j in np.flatnonzero(truth.handles == index)
        if truth.parents[j] < 0 or truth.handles[truth.parents[j]] != index
    ]
    if under >= 0:
        found = [j for j in found if under in _above(truth.parents, int(j))]
    return int(max(found, key=lambda j: (mass[j], -j))) if found else -1


def _above(parents: np.ndarray, joint: int) -> list[int]:
    out: list[int] = []
    joint = int(parents[joint])
    while joint >= 0 and joint not in out:
        out.append(joint)
        joint = int(parents[joint])
    return out


def posed_limbs(truth: TrainingCharacter, pose: str) -> np.ndarray:
    """Vertices of a humanoid whose limbs point where `limb_directions` says [m], shape (V, 3), float32.

    Each joint takes the smallest turn that does it; hands and feet follow. The legs keep their stance where the pose
    stands: only their lean forward and back is taken away.

    Args:
        truth: The rig on the character's vertices.
        pose: One of `REST_POSES` or "crouching".
    """
    directions = limb_directions(pose)
    mass = truth.weights.sum(axis=0)
    rotations = np.tile(np.eye(3), (len(truth.joints), 1, 1))
    for chain in _CHAINS:
        for side in ("left", "right"):
            begin = [_first(truth, f"{side}_{chain[0]}", mass)]
            for part in chain[1:]:
                begin.append(_first(truth, f"{side}_{part}", mass, begin[-1]) if begin[-1] >= 0 else -1)
            for joint, child, part in zip(begin, begin[1:], chain, strict=False):
                if joint < 0 or child < 0:
                    break
                bone = truth.joints[child] - truth.joints[joint]
                if np.linalg.norm(bone) < 1e-6 * truth.height:
                    break
                target = directions[f"{side}_{part}"]
                if chain[0] == "hip" and pose not in _LEG_DIRECTIONS:
                    target = np.array([bone[0], bone[1], 0.0]) if bone[1] < -abs(bone[0]) else target
                world = np.eye(3)
                for above in reversed(_above(truth.parents, joint)):
                    world = world @ rotations[above]
                rotations[joint] = world.T @ rotation_between(world @ bone, target) @ world
    transforms = forward_kinematics(truth.joints, truth.parents, rotations)
    return np.ascontiguousarray(skin(truth.vertices, truth.weights, transforms[None])[0])
