"""The legs and arms of a body, and how a foot or a hand is moved by bending its limb, a chain of two bones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.anatomy.handles.limbs import FAMILIES, SIDES, limb_handles
from bunraku.anatomy.joints import Joints
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.geometry.surface import extreme_points

__all__ = ["Leg", "NEAR", "carry", "find_arms", "find_legs", "move_feet"]


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


def find_legs(character: Character, handles: Handles, joints: Joints, stands: bool) -> list[Leg]:
    """The limbs that a character stands on, none where it has fewer than two.

    An upright body stands on its two legs, any other on every limb that reaches the ground in the rest pose, those with
    the handles of arms included.

    Args:
        character: In its rest pose.
        handles: Its handles.
        joints: Where they meet.
        stands: Whether it is upright.
    """
    out = []
    seen, heights = character.surface, character.vertices[:, 1]
    floor, height = float(heights[seen].min()), character.height
    for number, parts in enumerate(_PARTS):
        if stands and number >= _LEGS:
            continue
        for chain in _chains(parts, handles.played, joints):
            leg = _leg(character, handles, joints, chain)
            if leg is None or leg.length < SHORTEST * height:
                continue
            if stands or heights[leg.foot_area].min() < floor + NEAR * height:
                out.append(leg)
    return out if len(out) > 1 else []


def find_arms(character: Character, handles: Handles, joints: Joints, legs: list[Leg]) -> list[Leg]:
    """The arms of a character that are not among its legs, in the words for legs: a shoulder, an elbow and a wrist. The
    hand is the foot; arms of one rigid block may have none.
    """
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


STRAIGHT = 0.99  # how far a leg is stretched at the most, over its length
SOFT = 0.94  # from where on stretching slows down, so that knees do not snap
LEAST_SHIFT = 1e-9  # of an ankle [m]: legs whose feet move less are left bit for bit


def move_feet(
    world: np.ndarray,
    root: np.ndarray,
    joints: Joints,
    legs: list[Leg],
    shifts: np.ndarray,
    slopes: np.ndarray | None = None,
) -> None:
    """Move feet by bending their legs, in place; feet keep their slope unless slopes are given.

    A leg is a chain of two bones: its knee stays in the plane in which it was bent. It is never stretched beyond its
    length, so a foot may stop short of where it should be. A leg of one rigid block points to where its foot should be.

    Args:
        world: Transforms of the handles, shape (N, K, 3, 4), float64.
        root: Rotations of the root, shape (N, 3, 3): what a knee usually does in its frame says how a straight leg
            bends.
        joints: Where the handles meet.
        legs: The legs whose feet are moved, L.
        shifts: How far each ankle moves [m], shape (N, L, 3).
        slopes: How each foot turns about its ankle, in the world, shape (N, L, 3, 3); None for not at all.
    """
    for number, leg in enumerate(legs):
        if np.abs(shifts[:, number]).max() > LEAST_SHIFT:
            slope = np.tile(np.eye(3), (len(world), 1, 1)) if slopes is None else slopes[:, number]
            _move_foot(world, root, leg, joints, shifts[:, number], slope)


def _move_foot(
    world: np.ndarray, root: np.ndarray, leg: Leg, joints: Joints, shift: np.ndarray, slope: np.ndarray
) -> None:
    """Bend one leg, in place."""
    hip, knee, ankle = (
        world[:, handle, :, :3] @ joint + world[:, handle, :, 3]
        for handle, joint in zip((leg.upper, leg.lower, leg.end), leg.joints, strict=True)
    )
    goal = ankle + shift
    if leg.lower == leg.upper:
        carry(world, leg.upper, joints, hip, hip, _between(_unit(ankle - hip), _unit(goal - hip)))
        return
    thigh, shin = np.linalg.norm(knee - hip, axis=1), np.linalg.norm(ankle - knee, axis=1)
    before, wanted = np.linalg.norm(ankle - hip, axis=1), np.linalg.norm(goal - hip, axis=1)
    length = thigh + shin
    reach = before + _soft(wanted / length) * length - _soft(before / length) * length
    reach = np.clip(reach, np.abs(thigh - shin) + 1e-3 * length, np.maximum(before, STRAIGHT * length))
    line, toward = _unit(ankle - hip), _unit(goal - hip)
    goal = hip + toward * reach[:, None]
    swing = _between(line, toward)
    aside = knee - hip - ((knee - hip) * line).sum(axis=1, keepdims=True) * line
    along = (thigh**2 - shin**2 + reach**2) / (2 * reach)
    out = np.sqrt(np.maximum(thigh**2 - along**2, 0))[:, None]
    more = out - np.linalg.norm(aside, axis=1, keepdims=True)
    bent = (
        hip
        + toward * along[:, None]
        + _unit(np.einsum("nij,nj->ni", swing, aside + more * _bend(aside, line, root))) * out
    )
    for handle, pivot, target, before_turn, after_turn in (
        (leg.upper, hip, hip, knee - hip, bent - hip),
        (leg.lower, knee, bent, ankle - knee, goal - bent),
    ):
        swung = np.einsum("nij,nj->ni", swing, _unit(before_turn))
        carry(world, handle, joints, pivot, target, _between(swung, _unit(after_turn)) @ swing)
    for handle in leg.foot:
        carry(world, handle, joints, ankle, goal, slope)


def carry(
    world: np.ndarray, handle: int, joints: Joints, pivot: np.ndarray, target: np.ndarray, turned: np.ndarray
) -> None:
    """Turn a handle, and absent ones that go along with it, about a pivot that moves to a target."""
    along = [handle, *(int(other) for other in np.flatnonzero((joints.parents == handle) & ~joints.present))]
    for each in along:
        world[:, each, :, 3] = np.einsum("nij,nj->ni", turned, world[:, each, :, 3] - pivot) + target
        world[:, each, :, :3] = turned @ world[:, each, :, :3]


def _soft(share: np.ndarray) -> np.ndarray:
    """A stretch that slows down from SOFT on and ends at STRAIGHT."""
    room = STRAIGHT - SOFT
    return np.where(share > SOFT, STRAIGHT - room * np.exp(-(np.maximum(share, SOFT) - SOFT) / room), share)


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-12))


def _bend(aside: np.ndarray, line: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Where the knee points, square to the line from hip to ankle, shape (N, 3); where it is straight, as in the clip's
    bent frames.

    Args:
        aside: From the line to the knee [m], shape (N, 3).
        line: From hip to ankle, shape (N, 3).
        root: Rotations of the root, shape (N, 3, 3): what a knee does in its frame is usual for it.
    """
    own = np.einsum("nji,nj->ni", root, aside)
    size = np.linalg.norm(own, axis=1)
    mean = own.mean(axis=0)
    usual = mean / np.linalg.norm(mean) if np.linalg.norm(mean) > 0.3 * size.mean() else np.array([0, 0, 1.0])
    helps = np.einsum("nij,j->ni", root, usual)
    helps -= (helps * line).sum(axis=1, keepdims=True) * line
    return _unit(aside + 0.3 * size.mean() * np.exp(-((size / max(0.5 * size.mean(), 1e-9)) ** 2))[:, None] * helps)


def _between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, (start * end).sum(axis=1))
    return np.asarray(matrix_from_axis_angle(axis / np.maximum(sine, 1e-12)[:, None] * angle[:, None]))
