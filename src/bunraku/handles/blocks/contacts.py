"""Where rigid blocks touch, and about which point one turns on another."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from bunraku.core.character import Character
from bunraku.geometry.closest import least_distance
from bunraku.geometry.surface import surface_points
from bunraku.handles.blocks.find import Blocks

__all__ = ["BlockShapes", "away_from"]

SPACING = 0.008  # of the points spread over a block, over the height
POINTS = (200, 6000)  # of a block, at the least and at the most
NEAR = 0.02  # points are in contact that are so much farther apart than the nearest, over the height
REACH = 0.04  # a node stands at a joint that is so near to the boxes of both blocks, over the height
ALONG = 0.5  # a block that touches another along more of its length lies along it
ROUND = 1.25  # a block is long whose length is so many times its width


@dataclass(frozen=True, eq=False)
class BlockShapes:
    """The surfaces of blocks as points.

    Args:
        blocks: The blocks.
        points: Points spread over each block by area [m], a list of arrays (P, 3).
        areas: Surface of each block [m^2], shape (B,).
        height: Of the character [m].
    """

    blocks: Blocks
    points: list[np.ndarray]
    areas: np.ndarray
    height: float

    @classmethod
    def of(cls, character: Character, blocks: Blocks) -> BlockShapes:
        """Spread the points."""
        vertices, height = character.vertices.astype(np.float64), character.height
        owner, step = blocks.label[character.faces[:, 0]], SPACING * character.height
        points, areas = [], []
        for block in range(len(blocks.names)):
            faces = character.faces[owner == block]
            corners = vertices[faces]
            double = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            area = float(np.linalg.norm(double, axis=1).sum()) / 2
            spread = surface_points(vertices, faces, int(np.clip(area / step**2, *POINTS)))[0]
            points.append(np.concatenate([spread, vertices[np.unique(faces)]]))
            areas.append(area)
        return cls(blocks, points, np.array(areas), height)

    @cached_property
    def low(self) -> np.ndarray:
        """Lowest corner of each block's box [m], shape (B, 3)."""
        return np.array([some.min(axis=0) for some in self.points])

    @cached_property
    def high(self) -> np.ndarray:
        """Highest corner of each block's box [m], shape (B, 3)."""
        return np.array([some.max(axis=0) for some in self.points])

    @property
    def centers(self) -> np.ndarray:
        """Middle of each block's box [m], shape (B, 3)."""
        return 0.5 * (self.low + self.high)

    @cached_property
    def gaps(self) -> np.ndarray:
        """Least distance between points of two blocks over the height, shape (B, B)."""
        count, trees = len(self.points), [cKDTree(some) for some in self.points]
        out = np.zeros((count, count))
        for one in range(count):
            for other in range(one):
                out[one, other] = out[other, one] = least_distance(trees[one], self.points[other]) / self.height
        return out

    def pivot(self, own: list[int], other: list[int]) -> np.ndarray:
        """About which point blocks turn on other blocks [m], shape (3,).

        That is where the node of theirs that touches the others stands, if that is near both; else the middle of the
        contact. Of a long block that lies along the other, as an arm that hangs beside the trunk does, it is the upper
        end of the contact.
        """
        first = min(own, key=lambda block: float(self.gaps[block, other].min()))
        onto = min(other, key=lambda block: float(self.gaps[first, block]))
        origin, reach = self.blocks.origins[first], REACH * self.height
        low = np.maximum(self.low[first], self.low[onto]) - reach
        high = np.minimum(self.high[first], self.high[onto]) + reach
        shared = np.flatnonzero(np.abs(self.blocks.origins - origin).max(axis=1) < 1e-6 * self.height)
        if (origin >= low).all() and (origin <= high).all() and len(shared) == 1:
            return np.asarray(origin, np.float64)
        mine, theirs = self.points[first], self.points[onto]
        gap, near = cKDTree(theirs).query(mine)
        touching = gap <= gap.min() + NEAR * self.height
        contact = 0.5 * (mine[touching] + theirs[near[touching]])
        spread = mine - mine.mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov(spread.T))
        along = vectors[:, 2] * (1 if vectors[1, 2] >= 0 else -1)
        length = np.ptp(mine @ along)
        if values[2] > ROUND**2 * values[1] and np.ptp(contact @ along) > ALONG * length:
            width = float(np.sqrt(12 * values[1]))
            top = (mine @ along).max()
            upper = contact @ along > min(top, (contact @ along).max()) - width
            center = contact[upper].mean(axis=0)
            return np.asarray(center)
        return np.asarray(contact.mean(axis=0))


def away_from(points: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The direction in which a block leads away from its joint, unit, shape (3,): its longest axis where it is long, or
    that of its middle.

    Args:
        points: Spread over its surface [m], shape (P, 3).
        start: The joint [m], shape (3,).
    """
    middle = points.mean(axis=0)
    values, vectors = np.linalg.eigh(np.cov((points - middle).T))
    away = middle - start
    if values[2] > ROUND**2 * values[1]:
        away = vectors[:, 2] * (1 if vectors[:, 2] @ away >= 0 else -1)
    length = float(np.linalg.norm(away))
    return np.asarray(away / length) if length > 1e-9 else np.array([0.0, -1.0, 0.0])
