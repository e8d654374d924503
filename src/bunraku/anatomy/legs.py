"""What a body stands and moves with: its legs and arms, how a foot or a hand is moved by bending its limb, the ground
under it, the length of its strides, and its kind (a person, an animal, ...).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bunraku.anatomy.handles.limbs import ARMS, LEGS, SIDES
from bunraku.anatomy.joints import Joints
from bunraku.anatomy.rest_pose import upright
from bunraku.core.body.layout import CHEST, HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import rotation_between
from bunraku.core.geometry.surface import extreme_points, part_extremes
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError

# Chosen by eye on the characters of the archive.
NEAR = 0.15  # largest distance from the end of a leg of a lying body to the lowest point, over the height
SPLAYED = 0.5  # a spider's legs, which rest level, are as near as if it were so high over its extent
SHORTEST = 0.12  # least length of a leg, over the height; shorter ones are fins and stubs
SOLE = 0.25  # end of a leg that counts as its foot if it has no handle for one, over its length
OWN = 0.45  # least weight that the lower part of a leg has on some vertex; on a blob, parts blur
_PARTS = [*LEGS, *ARMS]
_LEGS = len(_PARTS) // 2


@dataclass(frozen=True, eq=False)
class Leg:
    """A limb that stands on the ground."""

    upper: int  # handle of its upper part
    lower: int  # handle of its lower part; the same where the leg is one rigid block
    # handles of its foot, from the ankle on; none where the lower part stands on the ground itself
    foot: tuple[int, ...]
    # Where it meets the body, its knee and its ankle, in the rest pose [m], shape (3, 3). The knee of one block is its
    # middle.
    joints: np.ndarray
    sole: np.ndarray  # vertices that tell where its foot is, shape (m,)
    foot_area: np.ndarray  # all vertices of its foot, shape (f,)
    length: float  # from where it meets the body to its sole, along its bones [m]

    def reach(self, joint: np.ndarray) -> float:
        """How far the sole is from one of its joints, along its bones [m]."""
        along = np.linalg.norm(np.diff(self.joints, axis=0), axis=1)
        return float(self.length - along[: int(np.linalg.norm(self.joints - joint, axis=1).argmin())].sum())

    @property
    def end(self) -> int:
        """The handle that the ankle moves with."""
        return self.foot[0] if self.foot else self.lower


def find_legs(character: Character, handles: Handles, joints: Joints, stands: bool, sure: bool = False) -> list[Leg]:
    """The limbs that a character stands on, none where it has fewer than two.

    An upright body stands on its two legs, any other on every limb that reaches the ground in the rest pose, those with
    the handles of arms included.

    Args:
        character: In its rest pose.
        handles: Its handles.
        joints: Where they meet.
        stands: Whether it is upright.
        sure: Whether the bones of a rig tell that its limbs are limbs, however little skin their lower parts hold.
    """
    out = []
    seen, heights = character.surface, character.vertices[:, 1]
    floor, height = float(heights[seen].min()), character.height
    near = NEAR * (
        height if handles.roles is None else max(height, SPLAYED * float(np.ptp(character.vertices[seen], 0).max()))
    )
    for number, parts in enumerate(_PARTS):
        if stands and number >= _LEGS:
            continue
        for chain in _chains(parts, handles.played, joints):
            leg = _leg(character, handles, joints, chain, sure)
            if leg is None or leg.length < SHORTEST * height:
                continue
            if stands or heights[leg.foot_area].min() < floor + near:
                out.append(leg)
    return out if len(out) > 1 else []


def find_arms(character: Character, handles: Handles, joints: Joints, legs: list[Leg]) -> list[Leg]:
    """The arms of a character that are not among its legs, in the words for legs: a shoulder, an elbow and a wrist. The
    hand is the foot; arms of one rigid block may have none.
    """
    leg_uppers = {leg.upper for leg in legs}
    limbs = (
        _leg(character, handles, joints, chain)
        for parts in _PARTS[_LEGS:]
        for chain in _chains(parts, handles.played, joints)
    )
    return [limb for limb in limbs if limb is not None and limb.upper not in leg_uppers]


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


def _leg(character: Character, handles: Handles, joints: Joints, chain: list[int], sure: bool = False) -> Leg | None:
    if len(chain) < 2 and not handles.rigid:
        return None
    single = len(chain) == 1
    upper, lower, *foot = chain * 2 if single else chain
    weight = handles.weights[:, foot or [lower]].sum(axis=1)
    members = np.flatnonzero(character.surface & (weight > 0.5))
    blurred = bool(foot) and len(members) < 3  # a foot that holds no vertex mainly
    if blurred:
        members = np.flatnonzero(character.surface & (handles.weights[:, [lower, *foot]].sum(axis=1) > 0.5))
    if len(members) < 3 or (not sure and float(handles.weights[:, lower].max()) < OWN):
        return None
    points = character.vertices[members].astype(np.float64)
    hip, knee = joints.positions[upper], joints.positions[lower]
    if blurred or not foot:
        far = np.linalg.norm(points - knee, axis=1)
        near_end = far > (1 - SOLE) * far.max()
        members, points = members[near_end], points[near_end]
    ankle = joints.positions[foot[0]] if foot else points.mean(axis=0)
    found = np.stack([hip, 0.5 * (hip + ankle) if single else knee, ankle])
    length = float(np.linalg.norm(np.diff(found, axis=0), axis=1).sum() + max(ankle[1] - points[:, 1].min(), 0))
    return Leg(upper, lower, tuple(foot), found, members[extreme_points(points)], members, length)


# Tried in a short run of the sample person and dog: 0.7 and 1.4 times STRAIGHT move them by up to 5 cm, 0.7 times SOFT
# by up to 1.4 cm.
STRAIGHT = 0.99  # largest stretch of a leg, over its length
SOFT = 0.94  # stretch from which on it slows down, so that knees do not snap
LEAST_SHIFT = 1e-9  # of an ankle [m]: less is far below what float32 keeps, and leaves legs bit for bit


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
    hip, knee, ankle = [
        world[:, handle, :, :3] @ joint + world[:, handle, :, 3]
        for handle, joint in zip((leg.upper, leg.lower, leg.end), leg.joints, strict=True)
    ]
    goal = ankle + shift
    if leg.lower == leg.upper:
        carry(world, leg.upper, joints, hip, hip, rotation_between(_unit(ankle - hip), _unit(goal - hip)))
        return
    thigh, shin = np.linalg.norm(knee - hip, axis=1), np.linalg.norm(ankle - knee, axis=1)
    before, wanted = np.linalg.norm(ankle - hip, axis=1), np.linalg.norm(goal - hip, axis=1)
    length = thigh + shin
    reach = before + _soft(wanted / length) * length - _soft(before / length) * length
    reach = np.clip(reach, np.abs(thigh - shin) + 1e-3 * length, np.maximum(before, STRAIGHT * length))
    line, toward = _unit(ankle - hip), _unit(goal - hip)
    goal = hip + toward * reach[:, None]
    swing = rotation_between(line, toward)
    aside = knee - hip - ((knee - hip) * line).sum(axis=1, keepdims=True) * line
    along = (thigh**2 - shin**2 + reach**2) / (2 * reach)
    out = np.sqrt(np.maximum(thigh**2 - along**2, 0))[:, None]
    more = out - np.linalg.norm(aside, axis=1, keepdims=True)
    aside = np.einsum("nij,nj->ni", swing, aside + more * _bend(aside, line, root))
    bent = hip + toward * along[:, None] + _unit(aside) * out
    for handle, pivot, target, before_turn, after_turn in (
        (leg.upper, hip, hip, knee - hip, bent - hip),
        (leg.lower, knee, bent, ankle - knee, goal - bent),
    ):
        swung = np.einsum("nij,nj->ni", swing, _unit(before_turn))
        carry(world, handle, joints, pivot, target, rotation_between(swung, _unit(after_turn)) @ swing)
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
    direction = np.einsum("nji,nj->ni", root, aside)
    size = np.linalg.norm(direction, axis=1)
    mean = direction.mean(axis=0)
    usual = mean / np.linalg.norm(mean) if np.linalg.norm(mean) > 0.3 * size.mean() else np.array([0, 0, 1.0])
    helps = np.einsum("nij,j->ni", root, usual)
    helps -= (helps * line).sum(axis=1, keepdims=True) * line
    return _unit(aside + 0.3 * size.mean() * np.exp(-((size / max(0.5 * size.mean(), 1e-9)) ** 2))[:, None] * helps)


CHUNK = 500  # frames posed at once to find the lowest point: bounds memory
_LEG_HANDLES = [i for i, name in enumerate(HANDLE_NAMES) if name.endswith(("hip", "knee", "ankle", "foot"))]
_HANGING = [
    i
    for i, name in enumerate(HANDLE_NAMES)
    if name.endswith(("shoulder", "elbow", "wrist", "fingers", "wing", "tail", "tail_tip"))
]


def standing(character: Character, handles: Handles) -> np.ndarray:
    """Vertices that may stand on the ground, shape (V,), bool: the surface, but of an upright body on legs not what may
    hang lower than the feet, such as a weapon in a hand, long arms or a tail.

    Args:
        character: In the reference body's stance (`stance_of`), so that one that sits has its legs below it.
        handles: Its handles there.
    """
    seen, heights = character.surface, character.vertices[:, 1]
    legs = seen & (handles.weights[:, np.isin(handles.played, _LEG_HANDLES)].sum(axis=1) > 0.5)
    if not upright(handles) or not legs.any() or heights[legs].min() - heights[seen].min() > 0.2 * character.height:
        return seen
    return seen & (handles.weights[:, np.isin(handles.played, _HANGING)].sum(axis=1) < 0.5)


def stride_scale(character: Character, handles: Handles, stands: np.ndarray) -> float:
    """How long the character's strides are over the reference body's: the height of the root handle over the floor, as
    a ratio.

    Args:
        character: In the reference body's stance.
        handles: Its handles there.
        stands: What may stand on the ground, shape (V,).
    """
    over_floor = float(handles.positions[0, 1]) - float(character.vertices[stands, 1].min())
    return max(over_floor, 0.02 * character.height) / float(reference_body().handles.positions[0, 1])


class Reach(NamedTuple):
    """The extreme points of every part of a body, among which is the lowest one in any pose."""

    vertices: np.ndarray  # rest positions [m], shape (n, 3)
    weights: np.ndarray  # of the handles, shape (n, K)

    @classmethod
    def of(cls, vertices: np.ndarray, weights: np.ndarray) -> Reach:
        """That of a body, or of some of its vertices, shapes (V, 3) and (V, K)."""
        pick = part_extremes(vertices, weights)
        return cls(vertices[pick], weights[pick])

    def lowest(self, transforms: np.ndarray) -> np.ndarray:
        """Height of the lowest point in each frame [m], shape (N,), by the transforms of the handles (N, K, 3, 4)."""
        parts = [transforms[start : start + CHUNK] for start in range(0, len(transforms), CHUNK)]
        return np.concatenate([skin(self.vertices, self.weights, part)[..., 1].min(axis=1) for part in parts])


_HIND = [*LEGS[0], *LEGS[1]]
_ARMS = [HANDLE_NAMES.index(f"{side}_{part}") for side in SIDES for part in ("shoulder", "elbow")]
_WINGS = [HANDLE_NAMES.index(f"{side}_wing") for side in SIDES]

# Chosen by eye on the snakes, fish and winged bodies of tools/make_creature_sheets.py.
LONG = (3.5, 1.0)  # length over height, lying and with the head up, from which on a body is a snake and not a fish
SPREAD = 0.15  # least distance of wings from the chest, over the height; a person's are the halves of the upper back
_TAIL = [HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")]


@dataclass(frozen=True)
class BodyPlan:
    """What a body stands and moves with."""

    hind: int  # how many legs play those of a person
    front: int  # how many legs play the arms of a person
    upright: bool  # whether the head is over the hips
    arms: bool  # whether two arms are there, standing or not
    wings: bool  # whether two wings are there
    tail: bool  # whether a tail is there
    long: bool = False  # whether it is longer than fish are, for its height
    # how many legs it has beside these that stand without a knee of their own: of a spider's and a crab's
    further: int = 0

    @property
    def legs(self) -> int:
        """How many legs it stands on."""
        return self.hind + self.front + self.further

    @property
    def slithers(self) -> bool:
        """Whether it moves over the ground as snakes do; what is as long and has fins at its sides is a ray."""
        return self._tailed and self.long and not self.arms

    @property
    def swims(self) -> bool:
        """Whether it moves through water as fish do: what stands upright is a figurine."""
        return self._tailed and not self.slithers and not self.upright

    @property
    def _tailed(self) -> bool:
        """Whether it has a tail and neither legs nor wings; an upright body with arms wears a gown."""
        return self.tail and not self.legs and not self.wings and not (self.upright and self.arms)

    @property
    def kind(self) -> str:
        """ "person", "two legs", "four legs", "many legs" or "no legs"."""
        if self.legs > 4:
            return "many legs"
        if self.legs > 2 and not self.upright:
            return "four legs"
        if self.upright and self.arms:
            return "person"
        return "two legs" if self.legs else "no legs"

    @property
    def words(self) -> str:
        """The same in words."""
        standing = {"no legs": "a body without legs", "many legs": f"a body on {self.legs} legs"}
        standing |= {"person": "an upright body with arms"}
        more = [name for name, there in (("wings", self.wings), ("a tail", self.tail)) if there]
        return standing.get(self.kind, f"a body on {self.kind}") + (f", with {' and '.join(more)}" if more else "")


def plan_of(
    character: Character, handles: Handles, joints: Joints, legs: list[Leg], further: list[list[int]], stands: bool
) -> BodyPlan:
    """The plan of a body in the pose that it stands in.

    Args:
        character: In its rest pose, facing +Z.
        handles: Its handles, K = 30 with the reference body's meaning.
        joints: Where they meet.
        legs: The limbs that it stands on.
        further: The handles of each limb beyond those of a person.
        stands: Whether it is upright.
    """
    uppers = {leg.upper for leg in legs}
    others = [limb for limb in _all_limbs(handles, joints, further) if not uppers & set(limb)]
    stiff = [limb for limb in others if _on_ground(character, handles, limb)]
    hind = sum(int(handles.played[leg.upper]) in _HIND for leg in legs)
    itself = joints.present & (handles.played == np.arange(len(handles.positions)))
    arms = _ARMS[::2] if handles.rigid else _ARMS  # an arm of one block has no elbow
    there = {name: bool(itself[parts].all()) for name, parts in (("arms", arms), ("wings", _WINGS))}
    away = np.linalg.norm(handles.positions[_WINGS] - handles.positions[CHEST], axis=1)
    there["wings"] &= bool((away > SPREAD * character.height).all())
    extent = np.ptp(character.vertices[character.surface], axis=0)
    return BodyPlan(
        hind=hind, front=len(legs) - hind, upright=stands, tail=bool(itself[_TAIL].any()),
        arms=there["arms"], wings=there["wings"], long=bool(extent[2] > LONG[stands] * extent[1]), further=len(stiff),
    )  # fmt: skip


def _all_limbs(handles: Handles, joints: Joints, further: list[list[int]]) -> list[list[int]]:
    """The handles of each limb of a body that has more than people have; none of others."""
    if not further:
        return []
    itself = joints.present & (handles.played == np.arange(len(handles.positions)))
    plain = ([part for part in limb if itself[part]] for limb in (LEGS[0], ARMS[0], LEGS[1], ARMS[1]))
    return [limb for limb in plain if limb] + further


def _on_ground(character: Character, handles: Handles, limb: list[int]) -> bool:
    """Whether a limb reaches the ground at rest."""
    held = character.surface & (handles.weights[:, limb].sum(axis=1) > 0.5)
    heights = character.vertices[:, 1]
    floor = float(heights[character.surface].min())
    return bool(held.any() and heights[held].min() < floor + NEAR * character.height)


def check_plans(source: BodyPlan, target: BodyPlan, name: str, flies: bool = False) -> None:
    """Refuse a motion that the limbs of a character cannot make. CharacterError if what carries the source is missing,
    or what carries the character would not be moved.

    Args:
        source: Of the body that moves.
        target: Of the character.
        name: Of the character.
        flies: Whether the motion is carried by wings; then only these are needed.
    """
    if flies:
        if not target.wings:
            raise CharacterError(
                f"{name}: the motion is a flight, and no wings are found on this character; give it the motion of a "
                "body of its own kind, or look at `bunraku inspect` if it was set up wrongly"
            )
        return
    has, needs = target.kind, source.kind
    if needs in ("four legs", "many legs") and has not in ("four legs", "many legs"):
        seen = "no legs" if has == "no legs" else "two legs, and no front legs that reach the ground"
        raise CharacterError(
            f"{name}: the motion is of {source.words}, and {seen} are found on this character; give it the motion of "
            "a body of its own kind, or look at `bunraku inspect` if it was set up wrongly"
        )
    if needs == "no legs" and has != "no legs":
        raise CharacterError(
            f"{name}: the motion is of {source.words}, and nothing in it moves the {max(target.legs, 2)} legs that "
            "this character stands on; give it the motion of a body with legs"
        )
