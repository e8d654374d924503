"""The body as points with normals, posed frame by frame: what apparel may not enter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.geometry.surface import vertex_normals
from bunraku.handles.inference.graph import farthest_points

__all__ = ["BodyPoints", "body_points", "nearest_index", "nearest_point"]

_ROWS = 64  # of distances that are looked at together: they stay in the cache


@dataclass(frozen=True, eq=False)
class BodyPoints:
    """Points spread over the body.

    Args:
        rest: Positions in the rest pose [m], shape (B, 3).
        normals: Outward, shape (B, 3).
        weights: Skinning weights for the 22 joints, shape (B, 22).
        joint: The joint that holds each most, shape (B,).
    """

    rest: np.ndarray
    normals: np.ndarray
    weights: np.ndarray
    joint: np.ndarray

    def posed(self, affine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and normals in a frame, shape (B, 3) each.

        Args:
            affine: Affine transforms of the joints, as `eq4_transforms` gives them, shape (22, 3, 4).
        """
        return self.placed(self.blends(affine)), np.einsum("bac,bc->ba", affine[self.joint, :, :3], self.normals)

    def blends(self, affine: np.ndarray) -> np.ndarray:
        """Affine transform of each point, shape (B, 3, 4); `affine` as above."""
        return (self.weights @ affine.reshape(len(affine), 12)).reshape(-1, 3, 4)

    def placed(self, blends: np.ndarray) -> np.ndarray:
        """Where these take the points [m], shape (B, 3)."""
        return np.asarray(np.einsum("bac,bc->ba", blends[..., :3], self.rest) + blends[..., 3])


def body_points(clothed: ClothedCharacter, most: int = 512) -> BodyPoints:
    """Points of a clothed character's body, evenly spread; none where all of it is apparel."""
    normals = vertex_normals(clothed.rest, clothed.faces)
    used = np.zeros(len(clothed.rest), bool)
    used[clothed.faces] = True
    rows = np.flatnonzero(used & (clothed.part < 0) & (np.linalg.norm(normals, axis=1) > 0.5))
    if len(rows):
        rows = rows[farthest_points(clothed.rest[rows].astype(np.float64), min(most, len(rows)))]
    weights = clothed.weights[rows].astype(np.float32)
    return BodyPoints(
        clothed.rest[rows].astype(np.float32), normals[rows].astype(np.float32), weights,
        weights.argmax(axis=1) if len(rows) else np.zeros(0, np.int64),
    )  # fmt: skip


def nearest_point(points: np.ndarray, positions: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The plane of the nearest body point: signed distance of each point from it, shape (M,), and its normal (M, 3);
    far away where there is no body.

    Args:
        points: [m], shape (M, 3).
        positions, normals: Of the posed body, shape (B, 3).
    """
    if not len(positions):
        return np.full(len(points), 10.0, np.float32), np.zeros_like(points)
    near = nearest_index(points, positions)
    return ((points - positions[near]) * normals[near]).sum(axis=-1), normals[near]


def nearest_index(points: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Number of the nearest of some places to each point, shapes (M, 3) and (B, 3) -> (M,)."""
    # one product: the square of a point's own length is the same for all
    table = np.empty((4, len(positions)), np.float32)
    np.multiply(positions.T, -2, out=table[:3])
    np.square(positions).sum(axis=1, out=table[3])
    ours = np.empty((len(points), 4), np.float32)
    ours[:, :3], ours[:, 3] = points, 1
    near = np.empty(len(points), np.int64)
    gaps = np.empty((min(_ROWS, len(points)), len(positions)), np.float32)
    for first in range(0, len(points), _ROWS):
        some = ours[first : first + _ROWS]
        np.matmul(some, table, out=gaps[: len(some)]).argmin(axis=1, out=near[first : first + _ROWS])
    return near
