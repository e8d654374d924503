"""Soft shapes as signed distance fields, and clean triangles: marching cubes (Lorensen & Cline 1987) and thinning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

Vector = Sequence[float] | np.ndarray
_EMPTY = 10.0


@dataclass(frozen=True)
class Lump:
    """A tapered bar with round ends and an elliptic section; with both ends at one position, an ellipsoid.

    Args:
        start: First end of the axis [m], shape (3,).
        end: Second end of the axis [m], shape (3,).
        radii: Radius at the two ends [m].
        joint: The joint that moves it.
        stretch: Factors on the radius along the three axes of `turn`, shape (3,).
        turn: Axes of the stretch as columns, shape (3, 3).
        blend: Width over which it melts into what was there before [m].
        carve: Take the shape away in place of adding it.
    """

    start: np.ndarray
    end: np.ndarray
    radii: tuple[float, float]
    joint: str = ""
    stretch: np.ndarray | None = None
    turn: np.ndarray | None = None
    blend: float = 0.02
    carve: bool = False

    @property
    def reach(self) -> float:
        """Largest distance of its surface from its axis [m]."""
        return max(self.radii) * (1.0 if self.stretch is None else float(np.max(self.stretch)))

    def distance(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Signed distance to first order, negative inside [m]; the three coordinates broadcast against each other."""
        axis = self.end - self.start
        qx, qy, qz = x - self.start[0], y - self.start[1], z - self.start[2]
        length = float(axis @ axis)
        radius: np.ndarray | float = self.radii[0]
        if length > 0:
            along = np.clip((qx * axis[0] + qy * axis[1] + qz * axis[2]) / length, 0, 1)
            qx, qy, qz = qx - along * axis[0], qy - along * axis[1], qz - along * axis[2]
            if self.radii[0] != self.radii[1]:
                radius = self.radii[0] + along * (self.radii[1] - self.radii[0])
        if self.stretch is None:
            return np.sqrt(qx * qx + qy * qy + qz * qz) - radius
        if self.turn is not None:
            r = self.turn
            qx, qy, qz = (qx * r[0, i] + qy * r[1, i] + qz * r[2, i] for i in range(3))
        sx, sy, sz = (float(s) for s in self.stretch)
        qx, qy, qz = qx / sx, qy / sy, qz / sz
        whole = np.sqrt(qx * qx + qy * qy + qz * qz) + 1e-7
        slope = np.sqrt((qx / sx) ** 2 + (qy / sy) ** 2 + (qz / sz) ** 2) + 1e-7 / max(sx, sy, sz)
        return (whole - radius) * whole / slope


def bar(
    start: Vector, end: Vector, radius: float | tuple[float, float], joint: str = "", *, stretch: Vector | None = None,
    turn: np.ndarray | None = None, blend: float = 0.02, carve: bool = False,
) -> Lump:  # fmt: skip
    """A `Lump` from plain numbers."""
    both = (float(radius), float(radius)) if isinstance(radius, (int, float)) else (float(radius[0]), float(radius[1]))
    shape = None if stretch is None else np.asarray(stretch, float)
    return Lump(np.asarray(start, float), np.asarray(end, float), both, joint, shape, turn, blend, carve)


def ball(
    centre: Vector, radii: float | Vector, joint: str = "", *, turn: np.ndarray | None = None, blend: float = 0.02,
    carve: bool = False,
) -> Lump:  # fmt: skip
    """An ellipsoid with these radii [m]."""
    if isinstance(radii, (int, float)):
        return bar(centre, centre, radii, joint, blend=blend, carve=carve)
    return bar(centre, centre, 1.0, joint, stretch=radii, turn=turn, blend=blend, carve=carve)


def _melt(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """The smaller of two distances, rounded over a width."""
    if width <= 0:
        return np.minimum(a, b)
    h = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - h * h * (0.25 * width)


def distance_grid(lumps: Sequence[Lump], spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Lumps, joined or carved one after another, as one distance field on a regular grid.

    Args:
        lumps: The shapes.
        spacing: Distance of neighbouring samples [m].

    Returns:
        Position of the first sample [m], shape (3,), and the samples, negative inside, shape (X, Y, Z), float32.
    """
    solid = [lump for lump in lumps if not lump.carve]
    low = np.min([np.minimum(lump.start, lump.end) - lump.reach for lump in solid], axis=0) - 3 * spacing
    high = np.max([np.maximum(lump.start, lump.end) + lump.reach for lump in solid], axis=0) + 3 * spacing
    # the middle of the grid lies a little beside round numbers, so that no sample is exactly on a surface
    low += 1e-5
    count = np.ceil((high - low) / spacing).astype(int) + 1
    axes = [(low[i] + spacing * np.arange(count[i])).astype(np.float32) for i in range(3)]
    total = np.full(count, _EMPTY, np.float32)
    for lump in lumps:
        pad = lump.reach + lump.blend + 2 * spacing
        first = np.maximum(np.floor((np.minimum(lump.start, lump.end) - pad - low) / spacing).astype(int), 0)
        last = np.minimum(np.ceil((np.maximum(lump.start, lump.end) + pad - low) / spacing).astype(int) + 1, count)
        if (last <= first).any():
            continue
        box = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
        x, y, z = (axes[i][box[i]].reshape([-1 if j == i else 1 for j in range(3)]) for i in range(3))
        distance = lump.distance(x, y, z)
        part = total[box]
        total[box] = -_melt(-part, distance, lump.blend) if lump.carve else _melt(part, distance, lump.blend)
    return low, total


def marched(lumps: Sequence[Lump], spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """The surface of lumps by marching cubes: vertices (V, 3) and faces (F, 3).

    Args:
        lumps: The shapes, joined or carved one after another.
        spacing: Size of a cell, in their unit.
    """
    low, samples = distance_grid(lumps, spacing)
    samples = np.where(np.abs(samples) < 1e-3 * spacing, np.float32(1e-3 * spacing), samples)
    return grid_surface(samples, spacing, low)


_CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
"""The corners of a cube, in the order in which libigl takes them."""


def grid_surface(values: np.ndarray, spacing: float, low: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The surface where values on a grid are zero: vertices (V, 3) in the unit of the spacing, and faces (F, 3).

    Args:
        values: Negative inside, none of them zero, shape (X, Y, Z).
        spacing: Size of a cell.
        low: Where the first value is, shape (3,).
    """
    import igl

    inside = values < 0
    number = np.zeros(np.array(values.shape) - 1, np.int8)
    for dx, dy, dz in _CUBE:
        number += inside[dx : dx + number.shape[0], dy : dy + number.shape[1], dz : dz + number.shape[2]]
    cells = np.argwhere((number > 0) & (number < 8))
    corners = np.ravel_multi_index((cells[:, None] + _CUBE).reshape(-1, 3).T, values.shape)
    used, cubes = np.unique(corners, return_inverse=True)
    positions = np.stack(np.unravel_index(used, values.shape), axis=1) * spacing + low
    found = igl.marching_cubes(values.reshape(-1)[used].astype(float), positions, cubes.reshape(-1, 8), 0.0)
    return found[0], found[1].astype(np.int64)


_SHARE = 0.25
"""Of all edges the shortest that a round looks at, so that long ones wait until no short one is left."""


def thinned(positions: np.ndarray, faces: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Collapse edges to their middle, the short ones first, until no more than so many faces are left.

    An edge collapses where that keeps the surface a surface: its ends share no neighbours but those of its own faces
    (Dey et al. 1999, "Topology preserving edge contraction"). A border stays where it is but for its own edges.

    Args:
        positions: Vertices, in any number of dimensions in which lengths are taken, shape (V, D).
        faces: Of a surface in which an edge has one face or two, shape (F, 3).
        most: Faces.

    Returns:
        Positions (W, D) and faces, shape (G, 3), int64.
    """
    positions, faces = np.array(positions, float), np.asarray(faces, np.int64)
    while len(faces) > most:
        count = len(positions)
        ends, uses = _edges(faces)
        border = np.zeros(count, bool)
        border[ends[uses == 1]] = True
        length = np.square(positions[ends[:, 0]] - positions[ends[:, 1]]).sum(axis=1)
        links = sp.csr_matrix((np.ones(len(ends)), ends.T), shape=(count, count))
        links = links + links.T
        some = np.argsort(length, kind="stable")[: max(int(_SHARE * len(ends)), 100)]
        a, b = ends[some].T
        shared = np.asarray(links[a].multiply(links[b]).sum(axis=1)).ravel()
        degree = np.diff(links.indptr)
        # an inner edge between two border vertices would pinch the surface, and one of a tetrahedron would flatten it
        sound = (shared == uses[some]) & ((uses[some] == 1) | ~(border[a] & border[b]))
        sound &= np.maximum(degree[a], degree[b]) > uses[some] + 1
        chosen = some[sound]
        chosen = chosen[_apart(links, *ends[chosen].T)]
        if not len(chosen):
            break
        spare = len(faces) - most
        chosen = chosen[: max(int(np.searchsorted(np.cumsum(uses[chosen]), spare)), 1)]
        a, b = ends[chosen].T
        middle = 0.5 * (positions[a] + positions[b])
        for one, other in ((a, b), (b, a)):
            kept = border[one] & ~border[other]
            middle[kept] = positions[one[kept]]
        positions[a] = middle
        becomes = np.arange(count)
        becomes[b] = a
        faces = becomes[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        used, inverse = np.unique(faces, return_inverse=True)
        positions, faces = positions[used], inverse.reshape(-1, 3)
    return positions, faces


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges, smaller vertex first, shape (E, 2), and how many faces each has, shape (E,)."""
    count = int(faces.max()) + 1
    a, b = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    key, uses = np.unique(np.minimum(a, b) * count + np.maximum(a, b), return_counts=True)
    return np.stack([key // count, key % count], axis=1), uses


def _apart(links: sp.csr_matrix, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Which of some edges, given in order of preference, may collapse at once: no edge joins two of them, shape (E,).

    Those that come first among all that touch their ends or a neighbour of these.
    """
    rank = np.arange(len(a))
    first = np.full(links.shape[0], len(a))
    np.minimum.at(first, a, rank)
    np.minimum.at(first, b, rank)
    around = np.minimum(first, np.minimum.reduceat(np.append(first, len(a))[links.indices], links.indptr[:-1]))
    return np.asarray((rank == around[a]) & (rank == around[b]))


def neighbour_average(count: int, faces: np.ndarray) -> sp.csr_matrix:
    """The matrix that averages over the neighbours of each vertex, shape (V, V)."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    ends = np.concatenate([ends, ends[:, ::-1]])
    links = sp.csr_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    return sp.csr_matrix(sp.diags(1 / np.maximum(np.asarray(links.sum(axis=1)).ravel(), 1)) @ links)
