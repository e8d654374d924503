"""Surfaces drawn directly: sheets, strands and domes, and closed balls, tubes, skirts, plates and boxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

__all__ = [
    "ball_mesh", "box_mesh", "curve_through", "cylinder_mesh", "nearest_shares", "patch", "plate_mesh", "ring_mesh",
    "sheet_faces", "sheet_mesh", "strand", "tube_mesh", "unit",
]  # fmt: skip


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


def _rings(rows: np.ndarray, closed: bool) -> Mesh:
    """A mesh of loops of points, shape (R, S, 3); `closed` joins the last to the first, otherwise both are capped."""
    count, size = rows.shape[:2]
    index = np.arange(count * size).reshape(count, size)
    low = index if closed else index[:-1]
    high = np.roll(index, -1, axis=0) if closed else index[1:]
    quads = np.stack([low, np.roll(low, -1, axis=1), np.roll(high, -1, axis=1), high], axis=-1).reshape(-1, 4)
    faces = [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    vertices = rows.reshape(-1, 3)
    if not closed:
        first, last = len(vertices), len(vertices) + 1
        vertices = np.concatenate([vertices, [rows[0].mean(axis=0), rows[-1].mean(axis=0)]])
        faces.append(np.stack([np.full(size, first), np.roll(index[0], -1), index[0]], axis=1))
        faces.append(np.stack([np.full(size, last), index[-1], np.roll(index[-1], -1)], axis=1))
    return _outward(vertices, np.concatenate(faces))


def _outward(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    a, b, c = (vertices[faces[:, i]] - vertices.mean(axis=0) for i in range(3))
    return (vertices, faces) if np.einsum("ij,ij->", a, np.cross(b, c)) > 0 else (vertices, faces[:, ::-1].copy())


def ball_mesh(
    centre: Sequence[float], radii: float | Sequence[float], level: int = 2, turn: np.ndarray | None = None
) -> Mesh:
    """An ellipsoid from an icosahedron split `level` times: 42, 162, 642 vertices for 1, 2, 3."""
    g = (1 + 5**0.5) / 2
    points = np.array([[s * a, t * b, 0] for a, b in ((1, g),) for s in (-1, 1) for t in (-1, 1)])
    points = np.concatenate([points, np.roll(points, 1, axis=1), np.roll(points, 2, axis=1)])
    near = np.linalg.norm(points[:, None] - points[None], axis=-1) < 2.1
    faces = np.array(
        [
            (i, j, k)
            for i in range(12)
            for j in range(i + 1, 12)
            for k in range(j + 1, 12)
            if near[i, j] and near[j, k] and near[i, k]
        ]
    )
    flip = np.einsum("ij,ij->i", points[faces[:, 0]], np.cross(points[faces[:, 1]], points[faces[:, 2]])) < 0
    faces[flip] = faces[flip][:, ::-1]
    for _ in range(level):
        ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        edges, which = np.unique(ends, axis=0, return_inverse=True)
        ab, bc, ca = (which.ravel() + len(points)).reshape(3, -1)
        a, b, c = faces.T
        points = np.concatenate([points, points[edges].mean(axis=1)])
        faces = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    points = points / np.linalg.norm(points, axis=1, keepdims=True) * np.broadcast_to(np.asarray(radii, float), (3,))
    return (points if turn is None else points @ turn.T) + np.asarray(centre, float), faces


def tube_mesh(points: np.ndarray, radii: Sequence[float] | np.ndarray | float, around: int = 8, *, flat: float = 1.0,
              up: Sequence[float] = (0, 1, 0)) -> Mesh:  # fmt: skip
    """A tube with round ends along a curve.

    Args:
        points: The curve [m], shape (P, 3).
        radii: Radius at each point [m].
        around: Vertices around the tube.
        flat: Factor on the radius across `up`.
        up: A direction that is never along the curve.
    """
    points = np.asarray(points, float)
    radius = np.broadcast_to(np.asarray(radii, float), (len(points),))
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    # two more rows at each end make it round
    ends = []
    for i, sign in ((0, -1), (len(points) - 1, 1)):
        for share in (0.55, 0.9):
            ends.append(
                (points[i] + sign * along[i] * radius[i] * share, radius[i] * np.sqrt(1 - share * share), along[i])
            )
    points = np.concatenate([[ends[1][0], ends[0][0]], points, [ends[2][0], ends[3][0]]])
    radius = np.concatenate([[ends[1][1], ends[0][1]], radius, [ends[2][1], ends[3][1]]])
    along = np.concatenate([[ends[1][2], ends[0][2]], along, [ends[2][2], ends[3][2]]])
    side = np.cross(np.broadcast_to(np.asarray(up, float), along.shape), along)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    high = np.cross(along, side)
    angle = 2 * np.pi * np.arange(around) / around
    across, upward = np.cos(angle)[:, None] * side[:, None], flat * np.sin(angle)[:, None] * high[:, None]
    rows = points[:, None] + radius[:, None, None] * (across + upward)
    return _rings(rows, closed=False)


def ring_mesh(centre: Sequence[float], radius: float | tuple[float, float], thickness: float | tuple[float, float],
around: int = 32,
              section: int = 8, turn: np.ndarray | None = None) -> Mesh:  # fmt: skip
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
    vertices, faces = _rings(rows, closed=True)
    return (vertices if turn is None else vertices @ turn.T) + np.asarray(centre, float), faces


def sheet_mesh(
    profile: np.ndarray, thickness: float, around: int,
    shape: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
) -> Mesh:  # fmt: skip
    """A thin closed shell that hangs around +Y, such as a skirt: an outer and an inner wall joined at waist and hem.

    Args:
        profile: Radius and height down the outer wall [m], shape (P, 2).
        thickness: Distance of the two walls [m].
        around: Vertices around.
        shape: Maps radius, angle (0 at +Z, pi/2 at +X) and share of the way down (0..1), each (P, around), to points
            (P, around, 3); the height of the profile is added to them.
    """
    profile = np.asarray(profile, float)
    angle = 2 * np.pi * np.arange(around) / around
    down = np.linspace(0, 1, len(profile))
    walls = []
    for inset in (0.0, thickness):
        r, a = np.broadcast_arrays(profile[:, :1] - inset, angle[None])
        points = shape(r, a, np.broadcast_to(down[:, None], r.shape))
        points[..., 1] += profile[:, 1:]
        walls.append(points)
    return _rings(np.concatenate([walls[0], walls[1][::-1]]), closed=True)


def plate_mesh(outline: np.ndarray, inner: Sequence[float], thickness: float, rings: int,
               bulge: Callable[[np.ndarray], np.ndarray] | None = None) -> Mesh:  # fmt: skip
    """A thin closed plate in the XY plane, such as a wing: its outline drawn in towards an inner point, front and back.

    Args:
        outline: Border loop, star-shaped about `inner` [m], shape (S, 2).
        inner: The inner point [m], shape (2,).
        thickness: Thickness in the middle along Z [m]; it thins to a third at the border.
        rings: Loops from the border to the inner point.
        bulge: Maps points (M, 3) of the flat plate to their final positions.
    """
    outline, middle = np.asarray(outline, float), np.asarray(inner, float)
    share = (1 - np.linspace(0, 1, rings + 1)[:-1])[:, None, None]
    flat = middle + share * (outline - middle)
    half = 0.5 * thickness * (1 - 0.67 * share[..., 0] ** 2) * np.ones(len(outline))
    front, back = np.concatenate([flat, half[..., None]], -1), np.concatenate([flat, -half[..., None]], -1)
    vertices, faces = _rings(np.concatenate([front[::-1], back]), closed=False)
    # the caps' middles get the full thickness
    vertices[-2:, 2] = [0.5 * thickness, -0.5 * thickness]
    vertices, faces = _outward(vertices, faces)
    return (vertices if bulge is None else bulge(vertices)), faces


def box_mesh(centre: Sequence[float], size: Sequence[float], bevel: float, cells: float, turn: np.ndarray | None = None,
             taper: float = 1.0) -> Mesh:  # fmt: skip
    """A box with bevelled edges, each flat face with its own vertices so that the edges stay hard.

    Args:
        centre: Its middle [m].
        size: Its edge lengths [m].
        bevel: Width of the bevel [m].
        cells: Longest edge of a grid cell on its faces [m].
        turn: Rotation matrix about the middle.
        taper: Factor on X and Z at the top.
    """
    half = 0.5 * np.asarray(size, float)
    flat = half - bevel
    vertices, faces, start = [], [], 0

    def patch(corners: np.ndarray, across: int, along: int) -> None:
        nonlocal start
        u, v = np.linspace(0, 1, across + 1)[:, None, None], np.linspace(0, 1, along + 1)[None, :, None]
        grid = (1 - u) * ((1 - v) * corners[0] + v * corners[3]) + u * ((1 - v) * corners[1] + v * corners[2])
        index = start + np.arange((across + 1) * (along + 1)).reshape(across + 1, along + 1)
        quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1).reshape(-1, 4)
        normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
        if normal @ corners.mean(axis=0) < 0:
            quads = quads[:, ::-1]
        vertices.append(grid.reshape(-1, 3))
        faces.extend([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        start += grid[..., 0].size

    count = np.maximum(np.ceil(2 * flat / cells).astype(int), 1)
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1, 1):
            corners = np.zeros((4, 3))
            corners[:, axis] = sign * half[axis]
            corners[:, b], corners[:, c] = flat[b] * np.array([-1, 1, 1, -1]), flat[c] * np.array([-1, -1, 1, 1])
            patch(corners, count[b], count[c])
        for s in (-1, 1):
            for t in (-1, 1):
                corners = np.zeros((4, 3))
                corners[:, axis] = flat[axis] * np.array([-1, 1, 1, -1])
                corners[:, b], corners[:, c] = (
                    s * np.array([half[b]] * 2 + [flat[b]] * 2),
                    t * np.array([flat[c]] * 2 + [half[c]] * 2),
                )
                patch(corners, count[axis], 1)
    points = np.concatenate(vertices)
    for signs in np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T:
        corner = signs * (flat + np.eye(3) * bevel)
        order = [0, 1, 2] if np.cross(corner[1] - corner[0], corner[2] - corner[0]) @ signs > 0 else [0, 2, 1]
        faces.append(np.array([order]) + len(points))
        points = np.concatenate([points, corner])
    if taper != 1.0:
        points = points * (1 + (taper - 1) * (0.5 + 0.5 * points[:, 1:2] / half[1]) * np.array([1, 0, 1]))
    return (points if turn is None else points @ turn.T) + np.asarray(centre, float), np.concatenate(faces)


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
