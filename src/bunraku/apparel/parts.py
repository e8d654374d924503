"""The separate pieces of a character's apparel: connected components of the surface that the mask leaves."""

from __future__ import annotations

import numpy as np

from bunraku.geometry.graph import clean_mesh, mesh_parts, unique_edges

__all__ = ["apparel_parts"]


def apparel_parts(vertices: np.ndarray, faces: np.ndarray, apparel: np.ndarray) -> np.ndarray:
    """Number of the apparel part of each vertex, -1 on the body, shape (V,), int32.

    Seams of the file do not part anything: vertices at the same position are one. Parts are numbered in the order of
    their first vertices.

    Args:
        vertices: Rest mesh [m], shape (V, 3).
        faces: Shape (F, 3).
        apparel: The mask, shape (V,), bool.

    Raises:
        CharacterError: The mesh is broken.
    """
    clean = clean_mesh(vertices, faces)
    count = len(clean.vertices)
    cloth = np.zeros(count, bool)
    cloth[clean.index[apparel]] = True
    edges = unique_edges(clean.faces, count)
    own = mesh_parts(edges[cloth[edges].all(axis=1)], count)[clean.index]
    out = np.full(len(vertices), -1, np.int32)
    _, first, number = np.unique(own[apparel], return_index=True, return_inverse=True)
    out[apparel] = np.argsort(np.argsort(first))[number.reshape(-1)]
    return out
