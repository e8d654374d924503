"""How a character stands over the floor: what of it may stand there, how long its strides are, how low it is."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from bunraku.anatomy.rest_pose import upright
from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.geometry.extremes import part_extremes

__all__ = ["Reach", "lowest", "reference_reach", "standing", "stride_scale"]

CHUNK = 500  # frames posed at once to find the lowest point: bounds memory
_LEGS = [i for i, name in enumerate(HANDLE_NAMES) if name.endswith(("hip", "knee", "ankle", "foot"))]
_HANGING = [
    i
    for i, name in enumerate(HANDLE_NAMES)
    if name.endswith(("shoulder", "elbow", "wrist", "fingers", "wing", "tail", "tail_tip"))
]


def standing(character: Character, handles: Handles) -> np.ndarray:
    """Vertices that may stand on the ground, shape (V,), bool: the surface, but of who stands on legs not what may hang
    lower than the feet, such as a weapon in a hand, long arms or a tail.

    Args:
        character: In the reference body's stance (`stance_of`): who sits has its legs below it all the same.
        handles: Its handles.
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

    def lowest(self, motion: HandleMotion, positions: np.ndarray) -> np.ndarray:
        """Height of the lowest point in each frame [m], shape (N,); handles are at `positions` [m], shape (K, 3)."""
        transforms = motion.transforms(positions)
        parts = [transforms[start : start + CHUNK] for start in range(0, len(transforms), CHUNK)]
        return np.concatenate([skin(self.vertices, self.weights, part)[..., 1].min(axis=1) for part in parts])


def lowest(vertices: np.ndarray, weights: np.ndarray, motion: HandleMotion, positions: np.ndarray) -> np.ndarray:
    """Height of the lowest vertex in each frame [m], shape (N,), from the extreme points of every part.

    Args:
        vertices: Rest positions [m], shape (V, 3).
        weights: Of the handles, shape (V, K).
        motion: Of the handles.
        positions: Of the handles [m], shape (K, 3).
    """
    return Reach.of(vertices, weights).lowest(motion, positions)


@lru_cache(maxsize=2)
def reference_reach(arms: bool = True) -> Reach:
    """That of the reference body, or of all that it may stand on, which is not its arms."""
    body = reference_body()
    some = slice(None) if arms else standing(body.character(), body.handles)
    return Reach.of(body.vertices[some], body.handle_weights[some])
