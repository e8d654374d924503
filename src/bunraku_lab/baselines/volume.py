"""The inside of a mesh on a grid: how deep each point lies, and whether a straight line stays inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

__all__ = ["Volume", "surface_samples", "volume_of"]


@dataclass(frozen=True, eq=False)
class Volume:
    """Signed distances to the surface at the points of a grid, above 0 inside.

    Args:
        depth: Shape (X, Y, Z).
        low: Position of the first grid point, shape (3,).
        step: Distance of grid points.
    """

    depth: np.ndarray
    low: np.ndarray
    step: float

    def at(self, points: np.ndarray) -> np.ndarray:
        """Depth at points, trilinear, shape [..., 3] -> [...]."""
        positions = ((np.asarray(points) - self.low) / self.step).reshape(-1, 3).T
        out: np.ndarray = map_coordinates(self.depth, positions, order=1, mode="nearest")
        return out.reshape(np.asarray(points).shape[:-1])

    def shallowest(self, start: np.ndarray, end: np.ndarray, samples: int = 8) -> np.ndarray:
        """Least depth along straight lines, ends left out, shapes [..., 3] x 2 -> [...]."""
        least = np.full(np.broadcast_shapes(start.shape, end.shape)[:-1], np.inf)
        for share in (np.arange(samples) + 1) / (samples + 1):
            least = np.minimum(least, self.at(start + share * (end - start)))
        return least

    def points(self) -> np.ndarray:
        """Positions of the grid points, shape (X, Y, Z, 3)."""
        axes = [low + self.step * np.arange(count) for low, count in zip(self.low, self.depth.shape, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def surface_samples(vertices: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """Points spread over a surface by area, always the same ones, shape (about count, 3)."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    ends = np.cumsum(area)
    face = np.searchsorted(ends, (np.arange(count) + 0.5) / count * ends[-1]).clip(max=len(faces) - 1)
    u, v = np.random.default_rng(0).random((2, count, 1))
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    return np.asarray(a[face] + u * (b - a)[face] + v * (c - a)[face])


def volume_of(vertices: np.ndarray, faces: np.ndarray, cells: int = 56) -> Volume:
    """The volume of a mesh; loose parts that overlap count as one, and holes are closed by their winding numbers.

    Args:
        vertices: Positions, shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        cells: Grid cells along the largest extent.
    """
    import igl

    low, high = vertices.min(axis=0), vertices.max(axis=0)
    step = float((high - low).max()) / cells
    low = low - 2 * step
    shape = np.ceil((high - low) / step).astype(int) + 3
    grid = Volume(np.zeros(shape), low, step)
    points = grid.points().reshape(-1, 3)
    soup = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int64)
    winding = np.asarray(igl.fast_winding_number(*soup, points)).reshape(-1)
    near = np.concatenate([surface_samples(vertices, faces, 30_000), vertices])
    distance, _ = cKDTree(near).query(points)
    return Volume(np.where(winding > 0.5, distance, -distance).reshape(shape), low, step)
