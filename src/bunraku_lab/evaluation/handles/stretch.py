"""How far handles stretch a mesh when its character walks."""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.geometry.graph import unique_edges

__all__ = ["FAR", "STRETCHED", "edge_error", "edge_stretch", "stretch_of"]

STRETCHED, FAR = 2.0, 4.0
"""Lengths, over those at rest, from which on an edge is stretched, and torn."""
STRIDE = 3  # frames from one that is measured to the next
SHORT = 1e-3  # edges shorter than this share of the height are not seen, whatever they do
CHUNK = 16  # frames posed at once: bounds memory
MOST = 20_000  # edges that an error is the mean of


def edge_stretch(rest: np.ndarray, posed: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """The largest length of each edge over all poses, over its length at rest, shape (E,).

    Args:
        rest: Vertices [m], shape (V, 3).
        posed: The same in each pose [m], shape (N, V, 3).
        edges: Pairs of vertices, shape (E, 2).
    """
    first, second = edges.T
    length = np.maximum(np.linalg.norm(rest[first] - rest[second], axis=1), 1e-12)
    return np.asarray(np.linalg.norm(posed[:, first] - posed[:, second], axis=-1).max(axis=0) / length)


def stretch_of(character: Character, handles: Handles, motion: HandleMotion) -> dict[str, float]:
    """How far the edges of a character are stretched in a motion of its handles.

    Returns:
        `stretched_edges`: the share of the edges that are ever longer than `STRETCHED` times their length;
        `most_stretched`: the largest such ratio.
    """
    edges = unique_edges(character.faces, len(character.vertices))
    rest = character.vertices.astype(np.float64)
    lengths = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    edges = edges[lengths > SHORT * character.height]
    transforms = motion.transforms(handles.positions)[::STRIDE]
    most = np.ones(len(edges))
    for start in range(0, len(transforms), CHUNK):
        posed = skin(character.vertices, handles.weights, transforms[start : start + CHUNK])
        most = np.maximum(most, edge_stretch(rest, posed, edges))
    return {
        "stretched_edges": float((most > STRETCHED).mean()) if len(most) else 0.0,
        "most_stretched": float(most.max(initial=1.0)),
    }


def edge_error(character: Character, handles: Handles, motion: HandleMotion) -> float:
    """How far edges are from their length at rest, of that length: the mean of |l / l_rest - 1| over edges and frames.

    Edges shorter than 0.1 % of the height are not looked at, and of more than 20,000 as many, evenly chosen.
    """
    edges = unique_edges(character.faces, len(character.vertices))
    rest = character.vertices.astype(np.float64)
    lengths = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    edges = edges[lengths > SHORT * character.height]
    if not len(edges):
        return 0.0
    edges = edges[np.unique(np.linspace(0, len(edges) - 1, min(len(edges), MOST)).astype(int))]
    used, index = np.unique(edges, return_inverse=True)
    first, second = index.reshape(-1, 2).T
    length = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    transforms = motion.transforms(handles.positions)[::STRIDE]
    vertices, weights, total = character.vertices[used], handles.weights[used], 0.0
    for start in range(0, len(transforms), CHUNK):
        posed = skin(vertices, weights, transforms[start : start + CHUNK])
        changed = np.linalg.norm(posed[:, first] - posed[:, second], axis=-1) / length - 1
        total += float(np.abs(changed).mean(axis=1).sum())
    return total / len(transforms)
