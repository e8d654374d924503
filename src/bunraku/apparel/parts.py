"""The separate pieces of a character's apparel: connected components of the surface that the mask leaves."""

from __future__ import annotations

import numpy as np

from bunraku.geometry.graph import clean_mesh, mesh_parts, unique_edges

__all__ = ["apparel_parts", "whole_pieces"]

MOSTLY = 0.4
"""Of a loose piece's points: a piece of which so many are apparel is apparel."""
LARGE = 0.3  # of all points: a piece with more may be the body itself


def whole_pieces(vertices: np.ndarray, faces: np.ndarray, apparel: np.ndarray) -> np.ndarray:
    """Number of the loose piece of the mesh of each vertex where much of that is apparel, -1 elsewhere, shape (V,): a
    lock of hair whose upper half is not marked hangs on the head all the same, whatever arm lies beside it.

    Args:
        vertices: Rest mesh [m], shape (V, 3).
        faces: Shape (F, 3).
        apparel: The mask, shape (V,), bool.

    Raises:
        CharacterError: The mesh is broken.
    """
    index, edges, cloth = _welded(vertices, faces, apparel)
    count = len(cloth)
    piece = mesh_parts(edges, count)
    sizes = np.bincount(piece)
    share = np.bincount(piece, cloth) / np.maximum(sizes, 1)
    whole = (share >= MOSTLY) & (sizes < LARGE * count)
    own = piece[index]
    return np.asarray(np.where(whole[own], own, -1))


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
    index, edges, cloth = _welded(vertices, faces, apparel)
    own = mesh_parts(edges[cloth[edges].all(axis=1)], len(cloth))[index]
    out = np.full(len(vertices), -1, np.int32)
    _, first, number = np.unique(own[apparel], return_index=True, return_inverse=True)
    out[apparel] = np.argsort(np.argsort(first))[number.reshape(-1)]
    return out


def _welded(vertices: np.ndarray, faces: np.ndarray, apparel: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The point of each vertex (V,), where vertices at one position are one; the edges between points (E, 2); and
    which points are apparel, shape (P,).
    """
    clean = clean_mesh(vertices, faces)
    cloth = np.zeros(len(clean.vertices), bool)
    cloth[clean.index[apparel]] = True
    return clean.index, unique_edges(clean.faces, len(cloth)), cloth
