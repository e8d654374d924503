"""Polygons whose corners have UVs and normals of their own, as triangles of vertices that have one each.

The first corner of a vertex keeps its place, each further one that differs is appended, so the vertices of the file
come first and in their order.
"""

from __future__ import annotations

import numpy as np

__all__ = ["fans", "split_corners"]


def split_corners(corners: np.ndarray, vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places of different corners among the vertices of a document.

    Args:
        corners: Different corners, their vertex in column 0, shape (C, columns).
        vertices: How many vertices the file has, V.

    Returns:
        Document vertex of each corner (C,), file vertex of each document vertex (U,), and the corner that each document
        vertex shows, -1 for none (U,).
    """
    unique, first = np.unique(corners[:, 0], return_index=True)
    slots = np.full(len(corners), -1, np.int64)
    slots[first] = unique
    extra = np.flatnonzero(slots < 0)
    slots[extra] = vertices + np.arange(len(extra))
    index = np.concatenate([np.arange(vertices), corners[extra, 0]])
    corner_of = np.full(vertices + len(extra), -1, np.int64)
    corner_of[slots] = np.arange(len(corners))
    return slots, index, corner_of


def fans(corners: np.ndarray, sizes: np.ndarray, materials: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of polygons and the material of each: corner 0 with each further edge.

    Args:
        corners: The vertex of each corner, polygon after polygon, shape (sum of sizes,).
        sizes: Corners of each polygon, shape (F,).
        materials: Material of each polygon, shape (F,).
    """
    counts = np.maximum(sizes - 2, 0)
    face = np.repeat(np.arange(len(sizes)), counts)
    starts = (np.cumsum(sizes) - sizes)[face]
    step = np.arange(len(face)) - (np.cumsum(counts) - counts)[face]
    return np.stack([corners[starts], corners[starts + step + 1], corners[starts + step + 2]], axis=1).reshape(
        -1, 3
    ), materials[face]
