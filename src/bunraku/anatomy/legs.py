"""The legs that a character stands on: their joints and their feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.anatomy.joints import Joints
from bunraku.anatomy.rest_pose import upright
from bunraku.core.character import Character, Handles
from bunraku.core.skinning import skin
from bunraku.geometry.extremes import extreme_points
from bunraku.handles.limbs import FAMILIES, SIDES, limb_handles

__all__ = ["NEAR", "Leg", "find_arms", "find_legs", "find_stumps", "foot_points"]

NEAR = 0.15  # a limb of a lying body is a leg if it ends so near to the lowest point, over the height
SHORTEST = 0.12  # least length of a leg, over the height; shorter ones are fins and stubs
SOLE = 0.25  # part of a leg, from its end, that counts as its foot where it has no handle for one
OWN = 0.45  # the lower part of a leg has a vertex of which it holds so much at the least; on a blob, parts blur
_PARTS = [limb_handles(side, family) for family in FAMILIES for side in SIDES]
_LEGS = len(_PARTS) // 2


@dataclass(frozen=True, eq=False)
class Leg:
    """A limb that stands on the ground.

    Args:
        upper: Handle of its upper part.
        lower: Handle of its lower part; the same where the leg is one rigid block.
        foot: Handles of its foot, from the ankle on; none where the lower part stands on the ground itself.
        joints: Where it meets the body, its knee and its ankle, in the rest pose [m], shape (3, 3). The knee of one
            block is its middle.
        sole: Vertices that tell where its foot is, shape (m,).
        foot_area: All vertices of its foot, shape (f,).
        length: From where it meets the body to its sole, along its bones [m].
    """

    upper: int
    lower: int
    foot: tuple[int, ...]
    joints: np.ndarray
    sole: np.ndarray
    foot_area: np.ndarray
    length: float

    def reach(self, joint: np.ndarray) -> float:
        """How far the sole is from one of its joints, along its bones [m]."""
        along = np.linalg.norm(np.diff(self.joints, axis=0), axis=1)
        return float(self.length - along[: int(np.linalg.norm(self.joints - joint, axis=1).argmin())].sum())

    @property
    def end(self) -> int:
        """The handle that the ankle moves with."""
        return self.foot[0] if self.foot else self.lower


def find_legs(character: Character, handles: Handles, joints: Joints) -> list[Leg]:
    """The limbs that a character stands on: two legs of who is upright; of others every limb, and that may be an arm of
    the reference body, that reaches the ground in the rest pose. None of who has no legs.

    Args:
        character: In its rest pose.
        handles: Its handles.
        joints: Where they meet.
    """
    out = []
    played, stands = handles.played, upright(handles)
    seen, heights = character.surface, character.vertices[:, 1]
    floor, height = float(heights[seen].min()), character.height
    for number, parts in enumerate(_PARTS):
        if stands and number >= _LEGS:
            continue
        for chain in _chains(parts, played, joints):
            leg = _leg(character, handles, joints, chain)
            if leg is None or leg.length < SHORTEST * height:
                continue
            if stands or heights[leg.foot_area].min() < floor + NEAR * height:
                out.append(leg)
    return out if len(out) > 1 else []


def find_arms(character: Character, handles: Handles, joints: Joints, legs: list[Leg]) -> list[Leg]:
    """The arms of a character that are not among its legs, in the words for legs: a shoulder, an elbow and a wrist with
    a hand.
    """
    return [arm for arm in _arms(character, handles, joints, legs) if arm.foot]


def find_stumps(character: Character, handles: Handles, joints: Joints, legs: list[Leg]) -> list[Leg]:
    """The arms of a character that are not among its legs and have no hand of their own, such as those of one rigid
    block: they end in what may be a fist.
    """
    return [arm for arm in _arms(character, handles, joints, legs) if not arm.foot]


def _arms(character: Character, handles: Handles, joints: Joints, legs: list[Leg]) -> list[Leg]:
    known = {leg.upper for leg in legs}
    limbs = (
        _leg(character, handles, joints, chain)
        for parts in _PARTS[_LEGS:]
        for chain in _chains(parts, handles.played, joints)
    )
    return [limb for limb in limbs if limb is not None and limb.upper not in known]


def _chains(parts: list[int], played: np.ndarray, joints: Joints) -> list[list[int]]:
    """The limbs whose handles play some parts, each as its handles from the body outwards."""
    members = [int(handle) for handle in np.flatnonzero(np.isin(played, parts) & joints.present)]
    above = joints.parents[members].tolist()
    ends = [handle for handle in members if handle not in above]
    out = []
    for end in ends:
        chain = [end]
        while int(joints.parents[chain[0]]) in members:
            chain.insert(0, int(joints.parents[chain[0]]))
        out.append(chain)
    return out


def _leg(character: Character, handles: Handles, joints: Joints, chain: list[int]) -> Leg | None:
    if len(chain) < 2 and not handles.rigid:
        return None
    single = len(chain) == 1
    upper, lower, *foot = chain * 2 if single else chain
    weight = handles.weights[:, foot or [lower]].sum(axis=1)
    own = np.flatnonzero(character.surface & (weight > 0.5))
    blurred = bool(foot) and len(own) < 3  # a foot that holds no vertex mainly
    if blurred:
        own = np.flatnonzero(character.surface & (handles.weights[:, [lower, *foot]].sum(axis=1) > 0.5))
    if len(own) < 3 or float(handles.weights[:, lower].max()) < OWN:
        return None
    points = character.vertices[own].astype(np.float64)
    hip, knee = joints.positions[upper], joints.positions[lower]
    if blurred or not foot:
        far = np.linalg.norm(points - knee, axis=1)
        near_end = far > (1 - SOLE) * far.max()
        own, points = own[near_end], points[near_end]
    ankle = joints.positions[foot[0]] if foot else points.mean(axis=0)
    found = np.stack([hip, 0.5 * (hip + ankle) if single else knee, ankle])
    length = float(np.linalg.norm(np.diff(found, axis=0), axis=1).sum() + max(ankle[1] - points[:, 1].min(), 0))
    return Leg(upper, lower, tuple(foot), found, own[extreme_points(points)], own, length)


def foot_points(leg: Leg, character: Character, handles: Handles, transforms: np.ndarray) -> np.ndarray:
    """Where the sole of a leg is in each frame [m], shape (N, m, 3), by the transforms of the handles (N, K, 3, 4)."""
    return skin(character.vertices[leg.sole], handles.weights[leg.sole], transforms).astype(np.float64)
