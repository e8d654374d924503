"""Soft shapes as signed distance fields, and clean triangles: marching cubes (Lorensen & Cline 1987) and thinning."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise, product

import numpy as np
import scipy.sparse as sp

__all__ = [
    "Field", "Lump", "ball", "bar", "field_mesh", "grid_surface", "limb", "marched", "marching_cubes", "mirror_mesh",
    "mirrored", "neighbour_average", "thinned",
]  # fmt: skip

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


def limb(points: Sequence[Vector], radii: Sequence[float], joints: Sequence[str] | str, *, blend: float = 0.02,
inner: float = 0.006,
         stretch: Vector | None = None, bends: int = 1) -> list[Lump]:  # fmt: skip
    """Bars from point to point; the first melts into the body by `blend`, the others into each other by `inner` [m].

    Args:
        points: The joints of the limb [m], length P.
        radii: Radius at each point [m], length P.
        joints: Joint of each of the P - 1 bars, or one for all.
        blend: See above.
        inner: See above.
        stretch: See `Lump`.
        bends: Split each bar into this many along a smooth curve through the points.
    """
    names = [joints] * (len(points) - 1) if isinstance(joints, str) else joints
    knots = np.column_stack([np.asarray(points, float), np.asarray(radii, float)])
    slopes = np.gradient(knots, axis=0)
    out: list[Lump] = []
    for i, name in enumerate(names):
        t = np.linspace(0, 1, bends + 1)[:, None]
        between = 3 * t**2 - 2 * t**3
        row = knots[i] + t * (knots[i + 1] - knots[i])
        if bends > 1:
            row = (
                (1 - between) * knots[i]
                + between * knots[i + 1]
                + t * (1 - t) * ((1 - t) * slopes[i] - t * slopes[i + 1])
            )
        for low, high in pairwise(row):
            out.append(bar(low[:3], high[:3], (low[3], high[3]), name, stretch=stretch, blend=inner if out else blend))
    return out


def mirrored(lumps: Iterable[Lump]) -> list[Lump]:
    """The lumps and their images across x = 0, each left one before its right one; Left... becomes Right...."""
    flip = np.diag([-1.0, 1.0, 1.0])
    out = []
    for lump in lumps:
        turn = None if lump.turn is None else flip @ lump.turn
        out += [
            lump,
            replace(
                lump, start=flip @ lump.start, end=flip @ lump.end, turn=turn, joint=lump.joint.replace("Left", "Right")
            ),
        ]
    return out


def _melt(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """The smaller of two distances, rounded over a width."""
    if width <= 0:
        return np.minimum(a, b)
    h = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - h * h * (0.25 * width)


class Field:
    """Lumps joined in order into one distance field.

    Args:
        lumps: The shapes, joined or carved one after another.
        floor: Height below which nothing exists [m], for flat soles; None for no floor.
    """

    def __init__(self, lumps: Sequence[Lump], floor: float | None = None):
        self.lumps = tuple(lumps)
        self.floor = floor

    def _join(self, total: np.ndarray, lump: Lump, distance: np.ndarray) -> np.ndarray:
        return -_melt(-total, distance, lump.blend) if lump.carve else _melt(total, distance, lump.blend)

    def values(self, points: np.ndarray) -> np.ndarray:
        """Signed distance, negative inside [m], shape (M,), at points [m], shape (M, 3)."""
        x, y, z = np.ascontiguousarray(points.T)
        total = np.full(len(points), _EMPTY)
        for lump in self.lumps:
            total = self._join(total, lump, lump.distance(x, y, z))
        return total if self.floor is None else -_melt(-total, y - self.floor, 0.012)

    def gradient(self, points: np.ndarray, step: float = 5e-4) -> np.ndarray:
        """Gradient of the distance by central differences, shape (M, 3): the outward direction, about unit length."""
        moved = np.concatenate([points + sign * step * axis for axis in np.eye(3) for sign in (1, -1)])
        values = self.values(moved).reshape(3, 2, len(points))
        return (values[:, 0] - values[:, 1]).T / (2 * step)

    def distances(self, points: np.ndarray, joints: Sequence[str]) -> np.ndarray:
        """Distance to the nearest lump of each joint [m], shape (M, J)."""
        x, y, z = np.ascontiguousarray(points.T)
        out = np.full((len(points), len(joints)), _EMPTY)
        where = {name: i for i, name in enumerate(joints)}
        for lump in self.lumps:
            if lump.joint in where and not lump.carve:
                column = where[lump.joint]
                out[:, column] = np.minimum(out[:, column], lump.distance(x, y, z))
        return out

    def grid(self, spacing: float, half: bool) -> tuple[np.ndarray, np.ndarray]:
        """The field sampled on a regular grid.

        Args:
            spacing: Distance of neighbouring samples [m].
            half: Only x >= 0, with the first samples exactly on x = 0.

        Returns:
            Position of the first sample [m], shape (3,), and the samples, shape (X, Y, Z), float32.
        """
        solid = [lump for lump in self.lumps if not lump.carve]
        low = np.min([np.minimum(lump.start, lump.end) - lump.reach for lump in solid], axis=0) - 3 * spacing
        high = np.max([np.maximum(lump.start, lump.end) + lump.reach for lump in solid], axis=0) + 3 * spacing
        # the middle of the grid lies a little beside round numbers, so that no sample is exactly on a surface
        low += 1e-5
        if half:
            low[0] = 0.0
        count = np.ceil((high - low) / spacing).astype(int) + 1
        axes = [(low[i] + spacing * np.arange(count[i])).astype(np.float32) for i in range(3)]
        total = np.full(count, _EMPTY, np.float32)
        for lump in self.lumps:
            pad = lump.reach + lump.blend + 2 * spacing
            first = np.maximum(np.floor((np.minimum(lump.start, lump.end) - pad - low) / spacing).astype(int), 0)
            last = np.minimum(np.ceil((np.maximum(lump.start, lump.end) + pad - low) / spacing).astype(int) + 1, count)
            if (last <= first).any():
                continue
            box = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
            x, y, z = (axes[i][box[i]].reshape([-1 if j == i else 1 for j in range(3)]) for i in range(3))
            total[box] = self._join(total[box], lump, lump.distance(x, y, z))
        if self.floor is not None:
            total = -_melt(-total, (axes[1] - np.float32(self.floor))[None, :, None], 0.012)
        return low, total


CUBE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]])
"""The corners of a cube, in the order in which `marching_cubes` takes them: bit a of a number is along axis a."""
_EDGES = [(corner, corner | 1 << axis) for axis in range(3) for corner in range(8) if not corner >> axis & 1]


def marching_cubes(values: np.ndarray, points: np.ndarray, cubes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the surface where values that are linear along the edges of cubes are 0.

    Where two corners that lie across a side of a cube are inside and the two others are not, the inside ones are taken
    apart; both cubes of that side do so, hence no crack.

    Args:
        values: Below 0 inside, never 0, shape (P,).
        points: Where they are taken, shape (P, 3).
        cubes: Eight points each, in the order of `CUBE`, shape (C, 8).

    Returns:
        Vertices, shape (V, 3), and faces, shape (F, 3), int64, that look to where values are above 0.
    """
    count, triangles = _cases()
    case = ((values[cubes] < 0) << np.arange(8)).sum(axis=1)
    number = count[case]
    owner = np.repeat(np.arange(len(cubes)), number)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number)
    ends = cubes[owner[:, None, None], np.array(_EDGES)[triangles[case[owner], place]]]
    key = ends.min(axis=-1) * len(points) + ends.max(axis=-1)
    unique, faces = np.unique(key, return_inverse=True)
    a, b = unique // len(points), unique % len(points)
    share = (values[a] / (values[a] - values[b]))[:, None]
    return points[a] + share * (points[b] - points[a]), faces.reshape(-1, 3).astype(np.int64)


def grid_surface(values: np.ndarray, spacing: float, low: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The surface where values on a grid are zero: vertices (V, 3) in the unit of the spacing, and faces (F, 3).

    Args:
        values: Negative inside, none of them zero, shape (X, Y, Z).
        spacing: Size of a cell.
        low: Where the first value is, shape (3,).
    """
    inside = values < 0
    number = np.zeros(np.array(values.shape) - 1, np.int8)
    for dx, dy, dz in CUBE:
        number += inside[dx : dx + number.shape[0], dy : dy + number.shape[1], dz : dz + number.shape[2]]
    cells = np.argwhere((number > 0) & (number < 8))
    corners = np.ravel_multi_index((cells[:, None] + CUBE).reshape(-1, 3).T, values.shape)
    used, cubes = np.unique(corners, return_inverse=True)
    positions = np.stack(np.unravel_index(used, values.shape), axis=1) * spacing + low
    return marching_cubes(values.reshape(-1)[used].astype(float), positions, cubes.reshape(-1, 8))


@cache
def _cases() -> tuple[np.ndarray, np.ndarray]:
    """For each set of inside corners the number of triangles, (256,), and their corners' edges, (256, T, 3)."""
    fans = [[triangle for loop in _loops(case) for triangle in _fan(loop)] for case in range(256)]
    count = np.array([len(fan) for fan in fans])
    out = np.zeros((256, count.max(), 3), np.int64)
    for case, fan in enumerate(fans):
        out[case, : len(fan)] = np.array(fan).reshape(-1, 3)
    return count, out


def _fan(loop: list[int]) -> list[tuple[int, int, int]]:
    """Triangles of a closed line, around a corner of which no diagonal lies in a side of the cube."""
    for start in range(len(loop)):
        turned = loop[start:] + loop[:start]
        if not any(_beside(turned[0], other) for other in turned[2:-1]):
            break
    return [(turned[0], turned[i + 1], turned[i]) for i in range(1, len(turned) - 1)]


def _beside(edge: int, other: int) -> bool:
    """Whether two edges belong to a common side of the cube."""
    corners = CUBE[list(_EDGES[edge] + _EDGES[other])]
    return bool((corners == corners[0]).all(axis=0).any())


def _loops(case: int) -> list[list[int]]:
    """The closed lines in which the surface crosses the sides of a cube, as numbers of edges.

    Each crossed edge belongs to two sides, and going around both as seen from outside, one leaves the inside there on
    one side and enters it on the other, so a line from the one to the other goes on at its end on the next side.
    """
    number = {edge: i for i, edge in enumerate(_EDGES)} | {edge[::-1]: i for i, edge in enumerate(_EDGES)}
    follows: dict[int, int] = {}
    for axis, side in product(range(3), range(2)):
        u, v = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        round_ = [base | side << axis for base in ((0, u, u | v, v) if side else (0, v, u | v, u))]
        steps = [(a, b) for a, b in zip(round_, round_[1:] + round_[:1], strict=True) if (case >> a ^ case >> b) & 1]
        entered = [not case >> a & 1 for a, _ in steps]
        for i, step in enumerate(steps):
            if not entered[i]:
                follows[number[step]] = number[steps[i - 1]]
    loops = []
    while follows:
        loop = [next(iter(follows))]
        while (after := follows.pop(loop[-1])) != loop[0]:
            loop.append(after)
        loops.append(loop)
    return loops


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


def field_mesh(
    field: Field, count: int, *, half: bool = False, crease: float = 0.03, steps: int = 6
) -> tuple[np.ndarray, np.ndarray]:
    """The zero surface of a field as a closed mesh of about `count` well-shaped triangles' vertices.

    Args:
        field: The shape.
        count: How many vertices to aim at.
        half: Build the half x >= 0 and mirror it, for an exactly symmetric mesh; the field must be symmetric.
        crease: Edge length that a bend of the normal by one radian counts as [m]: the mesh is finer there.
        steps: Rounds of relaxation.

    Returns:
        Vertices [m], shape (V, 3), float64, and faces, shape (F, 3), int64, wound outward.
    """
    share = 0.5 if half else 1.0
    rough = marched(field, 0.03, half)
    corners = rough[0][rough[1]]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    thinnest = min(
        max(lump.radii) * (1 if lump.stretch is None else float(np.min(lump.stretch)))
        for lump in field.lumps
        if not lump.carve
    )
    spacing = min(float(np.sqrt(1.5 * area / (3.5 * count * share))), max(0.7 * thinnest, 0.006))
    vertices, faces = marched(field, spacing, half)
    # thinning in position and normal together spends the triangles where the surface bends
    lifted = np.hstack([vertices, crease * _unit(field.gradient(vertices))])
    lifted, faces = thinned(lifted, faces, max(int(2 * count * share), 60))
    vertices = np.ascontiguousarray(lifted[:, :3])
    if half:
        vertices, faces = _split_chords(vertices, faces)
    vertices = _relax(vertices, faces, field, steps, half)
    return mirror_mesh(vertices, faces) if half else (vertices, faces)


def marched(field: Field, spacing: float, half: bool) -> tuple[np.ndarray, np.ndarray]:
    """Marching cubes on the cells that the surface of a field crosses: vertices (V, 3) and faces (F, 3).

    Args:
        field: Distances.
        spacing: Size of a cell, in the field's unit.
        half: Only the side x >= 0 (see `Field.grid`).
    """
    low, samples = field.grid(spacing, half)
    samples = np.where(np.abs(samples) < 1e-3 * spacing, np.float32(1e-3 * spacing), samples)
    return grid_surface(samples, spacing, low)


def neighbour_average(count: int, faces: np.ndarray) -> sp.csr_matrix:
    """The matrix that averages over the neighbours of each vertex, shape (V, V)."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    ends = np.concatenate([ends, ends[:, ::-1]])
    links = sp.csr_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    return sp.csr_matrix(sp.diags(1 / np.maximum(np.asarray(links.sum(axis=1)).ravel(), 1)) @ links)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)


def _border(count: int, faces: np.ndarray) -> np.ndarray:
    """Which vertices lie on an edge of only one face, shape (V,)."""
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, uses = np.unique(ends, axis=0, return_counts=True)
    out = np.zeros(count, bool)
    out[unique[uses == 1]] = True
    return out


def _split_chords(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Put a vertex on each inner edge that joins two border vertices, so that no edge equals its mirror image."""
    border = _border(len(vertices), faces)
    while True:
        ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        unique, uses = np.unique(ends, axis=0, return_counts=True)
        chords = unique[(uses == 2) & border[unique].all(axis=1)]
        if not len(chords):
            return vertices, faces
        a, b = chords[0]
        beside = (faces == a).any(axis=1) & (faces == b).any(axis=1)
        first, second = faces[beside].copy(), faces[beside].copy()
        first[first == a] = second[second == b] = len(vertices)
        faces = np.concatenate([faces[~beside], first, second])
        vertices = np.concatenate([vertices, [0.5 * (vertices[a] + vertices[b]) + [1e-3, 0, 0]]])
        border = np.append(border, False)


def _relax(vertices: np.ndarray, faces: np.ndarray, field: Field, steps: int, half: bool) -> np.ndarray:
    """Even the triangles out along the surface and pull every vertex back onto it."""
    average = neighbour_average(len(vertices), faces)
    seam = _border(len(vertices), faces) if half else np.zeros(len(vertices), bool)
    out = vertices.copy()
    out[seam, 0] = 0
    normals = _unit(field.gradient(out))
    for _ in range(steps):
        shift = 0.5 * (average @ out - out)
        shift -= (shift * normals).sum(axis=1, keepdims=True) * normals
        out = out + shift
        out[seam, 0] = 0
        slope = field.gradient(out)
        size = np.maximum((slope * slope).sum(axis=1), 0.05)
        out = out - (np.clip(field.values(out), -0.02, 0.02) / size)[:, None] * slope
        out[seam, 0] = 0
        normals = _unit(slope)
    if half:
        out[~seam, 0] = np.maximum(out[~seam, 0], 1e-4)
    return out


def mirror_mesh(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A half mesh with its image across x = 0, joined along the vertices that lie exactly on x = 0."""
    middle = vertices[:, 0] == 0
    image = np.arange(len(vertices))
    image[~middle] = len(vertices) + np.arange(int((~middle).sum()))
    both = np.concatenate([vertices, vertices[~middle] * [-1, 1, 1]])
    return both, np.concatenate([faces, image[faces][:, ::-1]])
