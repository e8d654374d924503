"""Colours with crisp edges: the mesh is cut along the border of each painted region."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Paint", "Region", "both", "bump", "either", "paint_mesh", "rgb", "slab"]

Region = Callable[[np.ndarray], np.ndarray]
Project = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Paint:
    """A colour for the part of a surface where `region` is positive.

    Args:
        color: sRGB as "#rrggbb".
        region: Maps points (M, 3) to about the depth inside the region [m], shape (M,).
    """

    color: str
    region: Region


def rgb(color: str) -> tuple[int, int, int]:
    """The three bytes of "#rrggbb"."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def slab(
    axis: int,
    low: float = -np.inf,
    high: float = np.inf,
    *,
    both_sides: bool = False,
    tilt: Sequence[float] = (0, 0, 0),
) -> Region:
    """Points between two values of a coordinate [m]; `both_sides` takes |coordinate|, `tilt` leans the planes by the
    others.
    """
    lean = np.asarray(tilt, float)

    def region(points: np.ndarray) -> np.ndarray:
        value = np.abs(points[:, axis]) if both_sides else points[:, axis]
        value = value + points @ lean
        return np.minimum(np.minimum(value - low, high - value), 10.0)

    return region


def bump(centre: Sequence[float] | np.ndarray, radii: float | Sequence[float], *, both_sides: bool = False) -> Region:
    """Points in an ellipsoid; `both_sides` also in its mirror image."""
    middle, size = np.asarray(centre, float), np.broadcast_to(np.asarray(radii, float), (3,))

    def region(points: np.ndarray) -> np.ndarray:
        at = np.abs(points) * [1, 0, 0] + points * [0, 1, 1] if both_sides else points
        return (1 - np.linalg.norm((at - middle) / size, axis=1)) * float(size.min())

    return region


def both(*regions: Region) -> Region:
    """Points in every region."""
    return lambda points: np.min([region(points) for region in regions], axis=0)


def either(*regions: Region) -> Region:
    """Points in any region."""
    return lambda points: np.max([region(points) for region in regions], axis=0)


def paint_mesh(
    vertices: np.ndarray, faces: np.ndarray, base: str, paints: Sequence[Paint], project: Project | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut a mesh along the borders of its paints and colour it; later paints cover earlier ones.

    Vertices on a border are doubled, one for each colour, like the seams of files from artists: the mesh is closed once
    welded.

    Args:
        vertices: Positions [m], shape (V, 3).
        faces: Triangles, shape (F, 3).
        base: Colour where no paint is.
        paints: The paints.
        project: Pulls points (M, 3) back onto the surface.

    Returns:
        Vertices (V', 3), faces (F', 3) and colours (V', 3) uint8.
    """
    for paint in paints:
        vertices, faces = _cut(vertices, faces, paint.region, project)
    palette = [base, *(paint.color for paint in paints)]
    centres = vertices[faces].mean(axis=1)
    color = np.zeros(len(faces), np.int64)
    for index, paint in enumerate(paints):
        color[paint.region(centres) > 0] = index + 1
    names = {c: i for i, c in enumerate(dict.fromkeys(palette))}
    color = np.array([names[c] for c in palette])[color]
    bytes_of = np.array([rgb(c) for c in names], np.uint8)
    pairs, faces = np.unique(faces * len(names) + color[:, None], return_inverse=True)
    return vertices[pairs // len(names)], faces.reshape(-1, 3), bytes_of[pairs % len(names)]


def _cut(
    vertices: np.ndarray, faces: np.ndarray, region: Region, project: Project | None
) -> tuple[np.ndarray, np.ndarray]:
    """Insert the border of a region into the mesh as edges."""
    value = region(vertices)
    sign = np.sign(value)
    crossed = (sign[faces].min(axis=1) < 0) & (sign[faces].max(axis=1) > 0)
    if not crossed.any():
        return vertices, faces
    vertices, zero = _snap(vertices, faces, crossed, region, value, project)
    value = np.where(zero, 0.0, region(vertices))
    value = np.where(~zero & (value == 0), 1e-9, value)
    sign = np.sign(value)
    crossed = (sign[faces].min(axis=1) < 0) & (sign[faces].max(axis=1) > 0)
    cut, keep = faces[crossed], faces[~crossed]
    edges = np.sort(np.concatenate([cut[:, [0, 1]], cut[:, [1, 2]], cut[:, [2, 0]]]), axis=1)
    edges = np.unique(edges[sign[edges[:, 0]] * sign[edges[:, 1]] < 0], axis=0)
    share = value[edges[:, 0]] / (value[edges[:, 0]] - value[edges[:, 1]])
    new = vertices[edges[:, 0]] + share[:, None] * (vertices[edges[:, 1]] - vertices[edges[:, 0]])
    index = {(int(a), int(b)): len(vertices) + i for i, (a, b) in enumerate(edges)}
    at = lambda a, b: index[(min(a, b), max(a, b))]  # noqa: E731
    out = []
    for face in cut.tolist():
        signs = [int(sign[v]) for v in face]
        # turn the face until its lone vertex, or its vertex on the border, is first
        first = (
            signs.index(0)
            if 0 in signs
            else next(i for i in range(3) if signs[i] != signs[i - 1] and signs[i] != signs[i - 2])
        )
        a, b, c = face[first], face[first - 2], face[first - 1]
        if 0 in signs:
            m = at(b, c)
            out += [(a, b, m), (a, m, c)]
        else:
            m, n = at(a, b), at(c, a)
            out += [(a, m, n), (m, b, c), (m, c, n)]
    return np.concatenate([vertices, new if project is None else project(new)]), np.concatenate(
        [keep, np.array(out, np.int64).reshape(-1, 3)]
    )


def _snap(vertices: np.ndarray, faces: np.ndarray, crossed: np.ndarray, region: Region, value: np.ndarray,
          project: Project | None) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Move the vertices that are nearly on the border onto it, so that the cut leaves no slivers."""
    ring = np.unique(faces[crossed])
    ends = np.concatenate([faces[crossed][:, [0, 1]], faces[crossed][:, [1, 2]], faces[crossed][:, [2, 0]]])
    length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    shortest = np.full(len(vertices), np.inf)
    np.minimum.at(shortest, ends.ravel(), np.repeat(length, 2))
    points = vertices[ring].copy()
    for _ in range(3):
        level = region(points)
        slope = np.stack(
            [(region(points + 1e-4 * axis) - region(points - 1e-4 * axis)) / 2e-4 for axis in np.eye(3)], axis=1
        )
        points = points - (level / np.maximum((slope * slope).sum(axis=1), 1e-2))[:, None] * slope
        if project is not None:
            points = project(points)
    moved = np.linalg.norm(points - vertices[ring], axis=1)
    good = (moved < 0.35 * shortest[ring]) & (np.abs(region(points)) < 0.03 * shortest[ring])
    out, zero = vertices.copy(), np.zeros(len(vertices), bool)
    out[ring[good]] = points[good]
    zero[ring[good]] = True
    return out, zero
