"""What a body stands and moves with: the ground under it, the length of its strides, and its kind (a person, an animal,
...).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bunraku.anatomy.handles.limbs import FAMILIES, SIDES, limb_handles
from bunraku.anatomy.joints import Joints
from bunraku.anatomy.legs import NEAR, Leg
from bunraku.anatomy.rest_pose import upright
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.surface import part_extremes
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError

__all__ = ["BodyPlan", "Reach", "check_plans", "plan_of", "standing", "stride_scale"]


CHUNK = 500  # frames posed at once to find the lowest point: bounds memory
_LEGS = [i for i, name in enumerate(HANDLE_NAMES) if name.endswith(("hip", "knee", "ankle", "foot"))]
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
    legs = seen & (handles.weights[:, np.isin(handles.played, _LEGS)].sum(axis=1) > 0.5)
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
    """The extreme points of every part of a body, among which is the lowest one in any pose.

    Args:
        vertices: Rest positions [m], shape (n, 3).
        weights: Of the handles, shape (n, K).
    """

    vertices: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, vertices: np.ndarray, weights: np.ndarray) -> Reach:
        """That of a body, or of some of its vertices, shapes (V, 3) and (V, K)."""
        pick = part_extremes(vertices, weights)
        return cls(vertices[pick], weights[pick])

    def lowest(self, transforms: np.ndarray) -> np.ndarray:
        """Height of the lowest point in each frame [m], shape (N,), by the transforms of the handles (N, K, 3, 4)."""
        parts = [transforms[start : start + CHUNK] for start in range(0, len(transforms), CHUNK)]
        return np.concatenate([skin(self.vertices, self.weights, part)[..., 1].min(axis=1) for part in parts])


_HIND = [handle for side in SIDES for handle in limb_handles(side, FAMILIES[0])]
_ARMS = [HANDLE_NAMES.index(f"{side}_{part}") for side in SIDES for part in ("shoulder", "elbow")]
_WINGS = [HANDLE_NAMES.index(f"{side}_wing") for side in SIDES]
_CHEST = HANDLE_NAMES.index("spine3")
LONG = (3.5, 1.0)  # length over height, lying and with the head up, from which on a body is a snake and no fish
SPREAD = 0.15  # wings lie so far from the chest, over the height; a person's are the halves of the upper back
_TAIL = [HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")]


@dataclass(frozen=True)
class BodyPlan:
    """What a body stands and moves with.

    Args:
        hind: How many legs play those of a person.
        front: How many legs play the arms of a person.
        upright: Whether the head is over the hips.
        arms: Whether two arms are there, standing or not.
        wings: Whether two wings are there.
        tail: Whether a tail is there.
        long: Whether it is longer than fish are, for its height.
        further: How many legs it has beside these that stand without a knee of their own: of a spider's and a crab's.
    """

    hind: int
    front: int
    upright: bool
    arms: bool
    wings: bool
    tail: bool
    long: bool = False
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
        """Whether it moves through water as fish do."""
        return self._tailed and not self.slithers

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
        known = {
            "person": "an upright body with arms",
            "two legs": "a body on two legs",
            "four legs": "a body on four legs",
            "many legs": f"a body on {self.legs} legs",
            "no legs": "a body without legs",
        }
        more = [name for name, there in (("wings", self.wings), ("a tail", self.tail)) if there]
        return known[self.kind] + (f", with {' and '.join(more)}" if more else "")


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
    found = {leg.upper for leg in legs}
    stiff = [
        limb for limb in _limbs(handles, joints, further) if not found & set(limb) and _stands(character, handles, limb)
    ]
    hind = sum(int(handles.played[leg.upper]) in _HIND for leg in legs)
    own = joints.present & (handles.played == np.arange(len(handles.positions)))
    arms = _ARMS[::2] if handles.rigid else _ARMS  # an arm of one block has no elbow
    there = {name: bool(own[parts].all()) for name, parts in (("arms", arms), ("wings", _WINGS))}
    away = np.linalg.norm(handles.positions[_WINGS] - handles.positions[_CHEST], axis=1)
    there["wings"] &= bool((away > SPREAD * character.height).all())
    extent = np.ptp(character.vertices[character.surface], axis=0)
    return BodyPlan(
        hind=hind, front=len(legs) - hind, upright=stands, tail=bool(own[_TAIL].any()),
        arms=there["arms"], wings=there["wings"], long=bool(extent[2] > LONG[stands] * extent[1]), further=len(stiff),
    )  # fmt: skip


def _limbs(handles: Handles, joints: Joints, further: list[list[int]]) -> list[list[int]]:
    """The handles of each limb of a body that has more than people have; none of others."""
    if not further:
        return []
    own = joints.present & (handles.played == np.arange(len(handles.positions)))
    plain = ([part for part in limb_handles(side, family) if own[part]] for side in SIDES for family in FAMILIES)
    return [limb for limb in plain if limb] + further


def _stands(character: Character, handles: Handles, limb: list[int]) -> bool:
    """Whether a limb reaches the ground at rest."""
    held = character.surface & (handles.weights[:, limb].sum(axis=1) > 0.5)
    heights = character.vertices[:, 1]
    floor = float(heights[character.surface].min())
    return bool(held.any() and heights[held].min() < floor + NEAR * character.height)


def check_plans(source: BodyPlan, target: BodyPlan, name: str, flies: bool = False) -> None:
    """Refuse a motion that the limbs of a character cannot make.

    Args:
        source: Of the body that moves.
        target: Of the character.
        name: Of the character.
        flies: Whether the motion is carried by wings; then only these are needed.

    Raises:
        CharacterError: What carries the source is missing, or what carries the character would not be moved.
    """
    if flies:
        if not target.wings:
            raise CharacterError(
                f"{name}: the motion is flown, and no wings are found on this character; give it the motion of a body "
                "of its own kind, or look at `bunraku inspect` if it was set up wrongly"
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
