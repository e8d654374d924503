"""Clean triangles from a distance field: marching cubes, thinning to a size, and relaxing on the surface."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from bunraku_lab.synthetic.samples.fields import Field
from bunraku_lab.synthetic.samples.isosurface import grid_surface
from bunraku_lab.synthetic.samples.thinning import thinned

__all__ = ["field_mesh", "marched", "mirror_mesh", "neighbour_average"]


def field_mesh(
    field: Field, count: int, *, half: bool = False, crease: float = 0.03, steps: int = 6
) -> tuple[np.ndarray, np.ndarray]:
    """The zero surface of a field as a closed mesh of about `count` well-shaped triangles' vertices.

    Args:
        field: The shape.
        count: How many vertices to aim at.
        half: Build the half x >= 0 and mirror it, for an exactly symmetric mesh; the field must be symmetric.
        crease: How much finer the mesh is where it bends: the edge length that a turn of the normal by one radian
            counts as [m].
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
    """Put a vertex on each inner edge that joins two border vertices: the mirror image would have the same edge
    again.
    """
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
