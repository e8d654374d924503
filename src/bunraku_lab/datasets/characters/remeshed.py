"""Surfaces as scans and image-to-3D programs give them: one skin over what touches, blocks, and figures on plinths.

A surface here is points with normals, and nothing says which belong to one limb. Voxels make it: what touches itself
closer than a voxel is one piece from then on, as in files whose limbs are fused.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_closing, gaussian_filter, label

from bunraku_lab.synthetic.samples.isosurface import grid_surface

__all__ = ["blocky_surface", "filled_cells", "fused_mesh", "fused_surface", "on_plinth"]

_MARGIN = 3
_FILLED = 12
"""Least points for the square of a voxel: a shell with gaps is hollow."""
_SIX = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


def filled_cells(points: np.ndarray, area: float) -> int:
    """The most voxels along the largest extent at which points all over a surface leave no gap in its shell.

    Args:
        points: Spread evenly over it, shape (N, 3).
        area: Of the surface, in the square of their unit.
    """
    return int(np.sqrt(len(points) / (_FILLED * area)) * np.ptp(points, axis=0).max())


def fused_surface(
    points: np.ndarray, cells: int, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The skin of what points enclose, at a resolution of some voxels along the largest extent.

    Args:
        points: Points all over the surfaces of a character, any unit, shape (N, 3); far more than it has voxels.
        cells: Voxels along the largest extent.
        count: Points of the result at most, M.
        rng: Chooses them.

    Returns:
        Points, in the unit of those given, and unit normals, shape (M, 3) each.
    """
    solid, low, size = _solid(points, cells)
    soft = gaussian_filter(solid.astype(np.float64), 0.8)
    where = _chosen(np.argwhere(_outer(solid).any(axis=0)), count, rng)
    slope = np.stack([grid[tuple(where.T)] for grid in np.gradient(soft)], axis=1)
    steep = np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-6)
    step = np.clip((soft[tuple(where.T)][:, None] - 0.5) / steep, -0.7, 0.7)  # to where the skin is
    return (where + 0.5 - step * slope / steep) * size + low, -slope / steep


def fused_mesh(points: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """The same skin as triangles: vertices, in the unit of the points, shape (V, 3), and faces (F, 3); arguments as of
    `fused_surface`.
    """
    solid, low, size = _solid(points, cells)
    field = 0.5 - gaussian_filter(solid.astype(np.float64), 0.8)
    field = np.where(np.abs(field) < 1e-3, 1e-3, field)
    return grid_surface(field, size, low + 0.5 * size)


def blocky_surface(
    points: np.ndarray, cells: int, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The same as a figure of cubes: points on the outer faces of voxels; arguments as of `fused_surface`."""
    solid, low, size = _solid(points, cells)
    faces = np.argwhere(_outer(solid))
    faces = faces[rng.integers(len(faces), size=count)]
    normals = _SIX[faces[:, 0]].astype(np.float64)
    spread = np.where(normals == 0, rng.uniform(-0.5, 0.5, (count, 3)), 0.5 * normals)
    return (faces[:, 1:] + 0.5 + spread) * size + low, normals


def on_plinth(points: np.ndarray, area: float, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Points of a figure, +Y up, and of the surface of a box or a disc that it stands on, as dense as its own.

    Args:
        points: Spread evenly over the figure, shape (N, 3).
        area: Of its surface, in the square of their unit.
        rng: Of the plinth.

    Returns:
        Those points and further ones, shape (N + M, 3), and the area of both surfaces.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * max(float(np.ptp(points[:, 0])), float(np.ptp(points[:, 2]))) * rng.uniform(0.5, 1.2)
    tall = (high[1] - low[1]) * rng.uniform(0.04, 0.25)
    round_one = rng.random() < 0.5
    lid, wall = (np.pi * half**2, 2 * np.pi * half * tall) if round_one else (4 * half**2, 8 * half * tall)
    total = 2 * lid + wall
    count = int(np.clip(len(points) * total / area, 1, 4 * len(points)))
    on_lid = rng.random(count) < 2 * lid / total
    if round_one:
        angle, radius = rng.uniform(0, 2 * np.pi, count), np.sqrt(rng.uniform(0, 1, count))
        flat = np.stack([np.cos(angle), np.sin(angle)], axis=1) * np.where(on_lid, radius, 1)[:, None]
    else:
        flat = rng.uniform(-1, 1, (count, 2))
        edge = np.arange(count), rng.integers(2, size=count)
        flat[edge] = np.where(on_lid, flat[edge], np.sign(flat[edge]))
    down = np.where(on_lid, tall * rng.integers(2, size=count), rng.uniform(0, tall, count))
    across = flat * half + (low + high)[[0, 2]] / 2
    plinth = np.stack([across[:, 0], low[1] - down, across[:, 1]], axis=1)
    return np.concatenate([points, plinth]), area + total


def _solid(points: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Voxels that points touch or enclose, where the first one begins, and the size of one."""
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    size = max(float(extent.max()), 1e-12) / cells
    low = low - _MARGIN * size
    grid = np.zeros(np.ceil(extent / size).astype(int) + 1 + 2 * _MARGIN, bool)
    grid[tuple(((points - low) / size).astype(int).T)] = True
    outside = label(~binary_closing(grid))[0]  # the margin is outside
    return outside != outside[0, 0, 0], low, size


def _outer(solid: np.ndarray) -> np.ndarray:
    """Whether each voxel is solid and its neighbour in each of six directions is not, shape (6, *grid)."""
    return np.stack([solid & ~np.roll(solid, -step, axis=(0, 1, 2)) for step in _SIX])


def _chosen(rows: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    return rows if len(rows) <= count else rows[rng.choice(len(rows), count, replace=False)]
