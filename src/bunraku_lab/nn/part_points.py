"""A mesh as points with neighbours: what the part network sees, whatever the mesh's resolution and loose parts.

The first `CENTRES` points cover the surface evenly, and the first `TOKENS` of those cover it coarsely. Points gather
from their neighbours on the way up, and answers come back down by interpolation (PointNet++, Qi et al. 2017).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges

POINTS, CENTRES, TOKENS = 4096, 1024, 256
GATHERED, BESIDE = 12, 8
"""Points that a centre gathers from the level below, and centres beside it that it looks at."""
LOCAL = 24
"""Points whose spread says how flat the surface is here and whether another side is near."""
THICK = 0.1
"""Over the largest extent: another side farther off is not looked for."""
SMALL_PARTS = 0.3
"""Points of a loose part go with its area to the power of one less this, so that small parts get some."""
SHAPE = 6
FEATURES = 3 + 3 + 4 + 7 + SHAPE


@dataclass(frozen=True, eq=False)
class Surface:
    """Points on a mesh.

    Args:
        points: In units of the largest extent, from the middle of the bounding box, shape (S, 3).
        normals: Shape (S, 3).
        colors: sRGB from 0 to 1, shape (S, 3), or None.
        part: Loose part of each, shape (S,).
        shape: Local shape (`_local_shape`), shape (S, SHAPE).
    """

    points: np.ndarray
    normals: np.ndarray
    colors: np.ndarray | None
    part: np.ndarray
    shape: np.ndarray


@dataclass(frozen=True, eq=False)
class PartPoints:
    """A mesh as the part network sees it.

    Args:
        surface: Its points.
        vertex: The vertex of the mesh nearest to each point within its face, shape (S,).
        gather: For each centre, points near it, shape (CENTRES, GATHERED).
        beside: For each centre, centres near it, shape (CENTRES, BESIDE).
        gather_up: For each token, centres near it, shape (TOKENS, GATHERED).
        down: For each centre, the nearest tokens, shape (CENTRES, 3), and their shares.
        down_shares: As said.
        fine: For each point, the nearest centres, shape (POINTS, 3), and their shares.
        fine_shares: As said.
    """

    surface: Surface
    vertex: np.ndarray
    gather: np.ndarray
    beside: np.ndarray
    gather_up: np.ndarray
    down: np.ndarray
    down_shares: np.ndarray
    fine: np.ndarray
    fine_shares: np.ndarray


def loose_parts(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Number of the loose part that each face is of, shape (F,), by a mesh whose seams are closed.

    Raises:
        CharacterError: The mesh is broken.
    """
    clean = clean_mesh(vertices, faces)
    piece = mesh_parts(unique_edges(clean.faces, len(clean.vertices)), len(clean.vertices))
    return np.asarray(piece[clean.index[np.asarray(faces)[:, 0]]], np.int64)


def part_points(
    vertices: np.ndarray, faces: np.ndarray, own: np.ndarray, colors: np.ndarray | None = None, seed: int = 0
) -> PartPoints:
    """Sample a mesh by area.

    Args:
        vertices: Rest mesh [m], +Y up, shape (V, 3).
        faces: Shape (F, 3).
        own: Loose part of each face (`loose_parts`), shape (F,).
        colors: sRGB from 0 to 1 of each vertex, shape (V, 3), or None.
        seed: Of what is taken.
    """
    rng = np.random.default_rng(seed)
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    whole = np.bincount(own, area)
    chance = area * np.maximum(whole, 1e-12 * whole.sum())[own] ** -SMALL_PARTS
    chosen = np.searchsorted(np.cumsum(chance), rng.random(POINTS) * chance.sum()).clip(0, len(faces) - 1)
    r, s = np.sqrt(rng.random(POINTS)), rng.random(POINTS)
    shares = np.stack([1 - r, r * (1 - s), r * s], axis=1)
    points = np.einsum("pc,pcx->px", shares, vertices[faces[chosen]])
    normals = cross[chosen] / np.maximum(area[chosen], 1e-30)[:, None]
    used = vertices[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    points = (points - 0.5 * (low + high)) / max(float((high - low).max()), 1e-12)
    order = _spread_order(points, CENTRES, int(rng.integers(POINTS)))
    points, normals, chosen, shares = points[order], normals[order], chosen[order], shares[order]
    tint = None if colors is None else np.einsum("pc,pcx->px", shares, np.asarray(colors, np.float64)[faces[chosen]])
    tree, centres = cKDTree(points), cKDTree(points[:CENTRES])
    near = tree.query(points, LOCAL)[1]
    fine, fine_shares = _nearest(centres, points)
    down, down_shares = _nearest(cKDTree(points[:TOKENS]), points[:CENTRES])
    return PartPoints(
        Surface(points, normals, tint, own[chosen], _local_shape(points, normals, near)),
        faces[chosen, shares.argmax(axis=1)],
        near[:CENTRES, :GATHERED],
        centres.query(points[:CENTRES], BESIDE)[1],
        centres.query(points[:TOKENS], GATHERED)[1],
        down,
        down_shares,
        fine,
        fine_shares,
    )


def point_features(surface: Surface) -> np.ndarray:
    """Input of the network, shape (S, FEATURES), float32: position, normal, colour and whether there is one, extent of
    the loose part, its share of the points, the position within it, and the local shape.
    """
    points, part = surface.points, surface.part
    order = np.argsort(part, kind="stable")
    _, starts, count = np.unique(part[order], return_index=True, return_counts=True)
    back = np.unique(part, return_inverse=True)[1]
    low, high = (step.reduceat(points[order], starts, axis=0)[back] for step in (np.minimum, np.maximum))
    color = np.zeros((len(points), 4))
    if surface.colors is not None:
        color[:, :3], color[:, 3] = 2 * surface.colors - 1, 1
    share = np.log10(count[back] / len(points))[:, None]
    return np.concatenate(
        [3 * points, surface.normals, color, 2 * (high - low), share, 2 * (points - low), surface.shape], axis=1
    ).astype(np.float32)


def _spread_order(points: np.ndarray, count: int, first: int) -> np.ndarray:
    """An order of points whose first `count` are each the farthest from those before it, shape (S,)."""
    x = np.ascontiguousarray(points.T, np.float32)
    chosen, gap, last = np.empty(count, np.int64), np.full(x.shape[1], np.inf, np.float32), first
    for number in range(count):
        chosen[number] = last
        away = x - x[:, last, None]
        np.minimum(gap, np.einsum("xp,xp->p", away, away), out=gap)
        last = int(gap.argmax())
    rest = np.ones(len(points), bool)
    rest[chosen] = False
    return np.concatenate([chosen, np.flatnonzero(rest)])


def _nearest(tree: cKDTree, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The three nearest points of a tree and their shares, by one over the distance, shape (P, 3) each."""
    gap, found = tree.query(points, 3)
    weight = 1 / (gap + 1e-3)
    return found, weight / weight.sum(axis=1, keepdims=True)


def _local_shape(points: np.ndarray, normals: np.ndarray, near: np.ndarray) -> np.ndarray:
    """How points lie about each: as a line, a plane or all around; how alike their normals are; whether they lie before
    or behind it; how near another side of the surface is. Shape (S, SHAPE).
    """
    away = points[near] - points[:, None]
    spread = np.einsum("pkx,pky->pxy", away, away)
    high = np.maximum(np.linalg.eigvalsh(spread)[:, ::-1], 1e-12)
    flat = np.stack([1 - high[:, 1] / high[:, 0], (high[:, 1] - high[:, 2]) / high[:, 0]], axis=1)
    other = np.einsum("pkx,px->pk", normals[near], normals)
    ahead = np.einsum("pkx,px->pk", away, normals)
    size = np.sqrt(high[:, 0] / near.shape[1])
    length = np.linalg.norm(away, axis=2)
    side = np.where(other < -0.3, length, THICK).min(axis=1).clip(max=THICK) / THICK
    return np.stack(
        [flat[:, 0], flat[:, 1], other.mean(axis=1), ahead.mean(axis=1) / size, side, 10 * size.clip(max=0.1)], axis=1
    )
