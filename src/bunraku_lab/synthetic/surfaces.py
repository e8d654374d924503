"""Surfaces drawn directly: sheets, strands and domes, rings and cylinders."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length 1, along the last axis; zeros stay zeros."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def sheet_faces(rows: int, columns: int, wrap: bool = False) -> np.ndarray:
    """Triangles of a grid of points, row by row, shape (F, 3); `wrap` joins the last column with the first.

    Rows that go down and columns that go from +Z to +X about a vertical axis give faces that look outwards.
    """
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(columns if wrap else columns - 1), indexing="ij")
    a, b = row * columns + column, row * columns + (column + 1) % columns
    quads = np.stack([a, a + columns, b + columns, b], axis=-1).reshape(-1, 4)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def nearest_shares(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where points are on a mesh: the triangle nearest to each and the shares of its corners.

    Args:
        points: [m], shape (P, 3).
        vertices: [m], shape (V, 3).
        faces: Shape (F, 3).

    Returns:
        Corners (P, 3), vertices of the mesh, and their shares (P, 3), from 0 to 1; they sum to 1 but for rounding.
    """
    import igl

    vertices = np.asarray(vertices, np.float64)
    _, triangle, nearest = igl.point_mesh_squared_distance(points, vertices, faces)
    corners = faces[triangle]
    shares = igl.barycentric_coordinates(
        nearest, *(np.ascontiguousarray(vertices[corners[:, corner]]) for corner in range(3))
    )
    return corners, np.clip(np.nan_to_num(shares, nan=1 / 3), 0, 1)


def curve_through(points: np.ndarray, count: int) -> np.ndarray:
    """So many points along a smooth curve through some, evenly spaced, shape (count, 3)."""
    from scipy.interpolate import CubicSpline

    points = np.asarray(points, float)
    knots = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    if len(points) < 3:
        fine = np.linspace(0, 1, 65)[:, None] * (points[-1] - points[0]) + points[0]
    else:
        fine = CubicSpline(knots, points)(np.linspace(0, knots[-1], 129))
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
    at = np.linspace(0, length[-1], count)
    return np.stack([np.interp(at, length, fine[:, axis]) for axis in range(3)], axis=1)


def strand(
    curve: np.ndarray, outward: np.ndarray, width: np.ndarray | float, thick: np.ndarray | float, sides: int = 8
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A closed tube of elliptic section along a curve: hair, tails, ears, ribbons.

    Args:
        curve: Points of its middle, shape (N, 3).
        outward: Which way its flat side looks, shape (3,) or (N, 3).
        width: Half its width at each point [m].
        thick: Half its thickness at each point [m].
        sides: Points of the section.

    Returns:
        Points (V, 3), faces (F, 3), and for each vertex its place on the curve from 0 to N - 1, shape (V,).
    """
    count = len(curve)
    along = unit(np.gradient(curve, axis=0))
    outward = np.broadcast_to(outward, curve.shape)
    side = unit(np.cross(along, outward))
    out = np.cross(side, along)
    angle = np.arange(sides) * 2 * np.pi / sides
    wide, deep = np.broadcast_to(width, count)[:, None, None], np.broadcast_to(thick, count)[:, None, None]
    rings = (
        curve[:, None] + wide * np.cos(angle)[:, None] * side[:, None] + deep * np.sin(angle)[:, None] * out[:, None]
    )
    points = np.concatenate([rings.reshape(-1, 3), curve[:1], curve[-1:]])
    first, last, ring = count * sides, count * sides + 1, np.arange(sides)
    cap = np.stack([np.full(sides, first), ring, np.roll(ring, -1)], axis=1)
    end = np.stack([np.full(sides, last), np.roll(ring, -1) + (count - 1) * sides, ring + (count - 1) * sides], axis=1)
    faces = np.concatenate([sheet_faces(count, sides, wrap=True), cap, end])
    index = np.concatenate([np.repeat(np.arange(count), sides), [0, count - 1]]).astype(float)
    return points, _outwards(points, faces), index


def _outwards(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (points[faces[:, corner]] - points.mean(axis=0) for corner in range(3))
    return faces if np.einsum("ij,ij->", a, np.cross(b, c)) > 0 else faces[:, ::-1]


def patch(
    rings: int, around: int, half: tuple[float, float], *, squareness: float = 2.0
) -> tuple[np.ndarray, np.ndarray]:
    """A disc in the plane with its faces, as eyes are made of: points (V, 2), the middle first, and faces (F, 3).

    Args:
        rings: Circles about the middle.
        around: Points on each.
        half: Half width and height [m].
        squareness: 2 is an ellipse, more has corners.
    """
    angle = np.arange(around) * 2 * np.pi / around
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    circle = circle / (np.abs(circle) ** squareness).sum(axis=1, keepdims=True) ** (1 / squareness)
    points = np.concatenate([np.zeros((1, 2)), *(circle * (ring + 1) / rings for ring in range(rings))]) * half
    one, ring = np.arange(around), 1 + np.arange(around)
    faces = [np.stack([np.zeros(around, int), ring, 1 + (one + 1) % around], axis=1)]
    for step in range(rings - 1):
        a, b = 1 + step * around + one, 1 + step * around + (one + 1) % around
        faces += [np.stack([a, a + around, b + around], axis=1), np.stack([a, b + around, b], axis=1)]
    return points, np.concatenate(faces)


Mesh = tuple[np.ndarray, np.ndarray]


def _outward(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    a, b, c = (vertices[faces[:, i]] - vertices.mean(axis=0) for i in range(3))
    return (vertices, faces) if np.einsum("ij,ij->", a, np.cross(b, c)) > 0 else (vertices, faces[:, ::-1].copy())


def ring_mesh(
    centre: np.ndarray | Sequence[float], radius: float | tuple[float, float], thickness: float | tuple[float, float],
    around: int = 32, section: int = 8, turn: np.ndarray | None = None,
) -> Mesh:  # fmt: skip
    """A torus about +Y (before `turn`) with radii along X and Z, its section thick across and high along Y [m]."""
    rx, rz = (radius, radius) if isinstance(radius, (int, float)) else radius
    across, high = (thickness, thickness) if isinstance(thickness, (int, float)) else thickness
    a, b = 2 * np.pi * np.arange(around) / around, 2 * np.pi * np.arange(section) / section
    away = np.stack([np.cos(a), 0 * a, np.sin(a)], axis=1)
    rows = (
        (away * [rx, 0, rz])[:, None]
        + across * np.cos(b)[None, :, None] * away[:, None]
        + high * np.sin(b)[None, :, None] * np.array([0, 1.0, 0])
    )
    index = np.arange(around * section).reshape(around, section)
    above = np.roll(index, -1, axis=0)
    quads = np.stack([index, np.roll(index, -1, axis=1), np.roll(above, -1, axis=1), above], axis=-1).reshape(-1, 4)
    vertices, faces = _outward(rows.reshape(-1, 3), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))
    return (vertices if turn is None else vertices @ turn.T) + np.asarray(centre, float), faces


def cylinder_mesh(start: Sequence[float], end: Sequence[float], radii: tuple[float, float], around: int = 16,
rows: int = 2,
                  bevel: float = 0.0) -> Mesh:  # fmt: skip
    """A cylinder or cone with flat ends of their own vertices; `bevel` rounds the ends off [m]."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    along = (b - a) / np.linalg.norm(b - a)
    side = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    side /= np.linalg.norm(side)
    angle = 2 * np.pi * np.arange(around) / around
    circle = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(along, side)

    def row(share: float, shift: float, inset: float) -> np.ndarray:
        return a + share * (b - a) + shift * along + (radii[0] + share * (radii[1] - radii[0]) - inset) * circle

    bands = [[row(s, bevel * (1 - 2 * s), 0.0) for s in np.linspace(0, 1, rows + 1)]]
    if bevel:
        bands = [[row(0, 0, bevel), bands[0][0]], bands[0], [bands[0][-1], row(1, 0, bevel)]]
    vertices, faces, start_at = [], [], 0
    for band in bands:
        index = start_at + np.arange(len(band) * around).reshape(len(band), around)
        low, high = index[:-1], index[1:]
        quads = np.stack([low, np.roll(low, -1, 1), np.roll(high, -1, 1), high], -1).reshape(-1, 4)
        vertices += band
        faces += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
        start_at += index.size
    for loop, sign in ((bands[0][0], -1), (bands[-1][-1], 1)):
        ring = start_at + np.arange(around)
        vertices += [loop, loop.mean(axis=0)[None]]
        order = np.stack([np.full(around, start_at + around), ring, np.roll(ring, -1)], axis=1)
        faces.append(order if sign > 0 else order[:, ::-1])
        start_at += around + 1
    return np.concatenate(vertices), np.concatenate(faces)
