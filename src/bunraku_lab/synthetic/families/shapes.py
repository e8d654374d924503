"""Meshes of the parts of code-made characters: lumps as rounded blocks, lumps melted into one skin, and sheets."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from bunraku.geometry.surface import vertex_normals
from bunraku_lab.synthetic.samples.fields import Field, Lump
from bunraku_lab.synthetic.samples.meshing import marched
from bunraku_lab.synthetic.surfaces import sheet_faces, unit

__all__ = ["Mesh", "block_mesh", "melted_mesh", "sheet_mesh", "thinned"]

Mesh = tuple[np.ndarray, np.ndarray]


@lru_cache(maxsize=64)
def _cube(around: int, rows: int) -> Mesh:
    """The surface of the cube [-1, 1]^3 as a grid with `rows` cells along Y and `around` along X and Z."""
    vertices, faces, start = [], [], 0
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        steps = [np.linspace(-1, 1, (rows if i == 1 else around) + 1) for i in (b, c)]
        for sign in (-1, 1):
            grid = np.zeros((len(steps[0]), len(steps[1]), 3))
            grid[..., axis], grid[..., b], grid[..., c] = sign, steps[0][:, None], steps[1][None]
            index = start + np.arange(grid[..., 0].size).reshape(grid.shape[:2])
            quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1).reshape(-1, 4)[
                :, ::sign
            ]
            vertices.append(grid.reshape(-1, 3))
            faces += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
            start += index.size
    points, where = np.unique(np.round(np.concatenate(vertices), 6), axis=0, return_inverse=True)
    return points, where.reshape(-1)[np.concatenate(faces)]


def block_mesh(lump: Lump, exponent: float = 2.0, cells: int = 4, cap: float = 1.0) -> Mesh:
    """One lump as a closed mesh of its own.

    Args:
        lump: The lump.
        exponent: Roundness of its section: 2 is an ellipse, 20 a box with sharp edges.
        cells: Cells of the grid across each side.
        cap: How far the ends reach past the axis, over the radius.
    """
    axis = lump.end - lump.start
    length = float(np.linalg.norm(axis))
    turn = np.eye(3) if lump.turn is None else lump.turn
    stretch = np.ones(3) if lump.stretch is None else lump.stretch
    if length < 1e-9:
        points, faces = _cube(cells, cells)
        unit = points / (np.abs(points) ** exponent).sum(axis=1, keepdims=True) ** (1 / exponent)
        size = lump.radii[0] * stretch * (0.9 if exponent > 4 else 1.0)
        return lump.start + (unit * size) @ turn.T, faces
    along = axis / length
    side = np.eye(3)[0] if abs(along[0]) < 0.8 else np.eye(3)[2]
    side = side - (side @ along) * along
    side /= np.linalg.norm(side)
    frame = np.stack([side, along, np.cross(side, along)], axis=1)
    bent = (turn * stretch) @ turn.T
    across = np.array([np.linalg.norm(bent @ frame[:, 0]), 1.0, np.linalg.norm(bent @ frame[:, 2])])
    first, last = (radius * cap * float(np.linalg.norm(bent @ along)) for radius in lump.radii)
    points, faces = _cube(
        cells,
        max(cells, min(3 * cells, round(cells * (length + first + last) / (2.5 * max(lump.radii) * across.max())))),
    )
    position = -first + 0.5 * (points[:, 1] + 1) * (length + first + last)
    share = np.clip(position / length, 0, 1)
    radius = lump.radii[0] + share * (lump.radii[1] - lump.radii[0])
    past = np.where(
        position < 0,
        position / max(first, 1e-9),
        np.where(position > length, (position - length) / max(last, 1e-9), 0.0),
    )
    unit = np.stack([points[:, 0], past, points[:, 2]], axis=1)
    unit /= np.maximum((np.abs(unit) ** exponent).sum(axis=1, keepdims=True) ** (1 / exponent), 1e-9)
    end = np.where(past < 0, first, last)
    local = np.stack(
        [unit[:, 0] * radius * across[0], share * length + unit[:, 1] * end, unit[:, 2] * radius * across[2]], axis=1
    )
    return lump.start + local @ frame.T, faces


def melted_mesh(lumps: Sequence[Lump], count: int) -> Mesh:
    """The skin around lumps melted into each other, by marching cubes, with about `count` vertices."""
    field = Field(lumps)
    solid = [lump for lump in lumps if not lump.carve]
    area = 0.0
    for lump in solid:
        mean, length = float(np.mean(lump.radii)), float(np.linalg.norm(lump.end - lump.start))
        size = mean * (np.ones(3) if lump.stretch is None else lump.stretch)
        area += (
            4.2 * float(np.prod(size) ** (1 / 3) * size.max()) * 3 + 6.3 * mean * float(np.median(size) / mean) * length
        )
    thinnest = min(max(lump.radii) * (1.0 if lump.stretch is None else float(np.min(lump.stretch))) for lump in solid)
    spacing = float(np.sqrt(0.9 * area / count))
    spacing = min(spacing, max(0.8 * thinnest, 0.45 * spacing))
    return marched(field, spacing, half=False)


def thinned(mesh: Mesh, faces: int) -> Mesh:
    """The mesh with at most this many faces, for the look of low-polygon models."""
    import fast_simplification

    if len(mesh[1]) <= faces:
        return mesh
    points, triangles = fast_simplification.simplify(
        mesh[0].astype(np.float32), mesh[1].astype(np.int32), 1 - faces / len(mesh[1])
    )
    return np.asarray(points, float), np.asarray(triangles, np.int64)


def sheet_mesh(grid: np.ndarray, thickness: float = 0.0, wrap: bool = False) -> Mesh:
    """A sheet through a grid of points, such as a skirt, a cape, a wing or a fin.

    Args:
        grid: Points, shape (R, S, 3).
        thickness: Distance of its two sides [m]; 0 gives one open layer.
        wrap: The last column joins the first.
    """
    rows, columns = grid.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    if wrap:
        index = np.concatenate([index, index[:, :1]], axis=1)
    faces = sheet_faces(rows, columns, wrap)
    points = grid.reshape(-1, 3)
    if thickness <= 0:
        return points, faces
    normal = unit(vertex_normals(points, faces, unit=False))  # where the sheet ends in a point it has no thickness
    count = len(points)
    rim = [index[0], index[-1][::-1]] + ([] if wrap else [index[::-1, 0], index[:, -1]])
    walls = [faces, faces[:, ::-1] + count]
    for line in rim:
        a, b = line[:-1], line[1:]
        walls += [np.stack([a, b, b + count], 1), np.stack([a, b + count, a + count], 1)]
    return np.concatenate([points + 0.5 * thickness * normal, points - 0.5 * thickness * normal]), np.concatenate(walls)
