"""Small loose parts (buttons, eyes, teeth, hair pins) move as a whole, with the surface that they sit on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from bunraku.geometry.simplify import NetworkMesh

__all__ = ["LooseParts", "find_loose_parts", "seat_parts"]

SMALL = 0.13  # largest extent of a part that can sit on another, as a share of the character's
PIECE = 0.03  # share of the surface from which a part is no longer small, however short: the shoulder plates of a robot
REACH = 0.025  # a point nearer than this to a larger part lies on it, as a share of the character's extent
COVER = 0.8  # share of its surface with which a part must lie on the larger one to sit there
STIFF = 0.35  # largest extent of a part that sits nowhere and yet moves as a whole
CLEAR = (
    0.6,
    0.8,
    # share of such a part that one handle must hold, from which and from which on wholly; others reach over a joint,
    # as a
    # sleeve does
)
# power of a part's row: blends of handles that turn apart would shear the part, and rigs mostly bind it to one bone
SHARP = 3
_NEAR = 0.01  # how sharply the nearest points of the larger part are preferred


@dataclass(frozen=True, eq=False)
class LooseParts:
    """The loose parts of a mesh.

    Args:
        label: Part of each point of the mesh's surface (`NetworkMesh.surface`), shape (S,).
        extent: Largest extent of each part, as a share of the character's, shape (P,).
        cover: Share of its surface with which each small part lies on the larger ones; 0 of those that are not small,
            shape (P,).
        gap: Distance of each point of a small part to the larger parts, infinite elsewhere, shape (S,).
        host: The point of a larger part nearest to each point of a small part, -1 elsewhere, shape (S,).
    """

    label: np.ndarray
    extent: np.ndarray
    cover: np.ndarray
    gap: np.ndarray
    host: np.ndarray


def find_loose_parts(mesh: NetworkMesh) -> LooseParts:
    """The loose parts of the surface that a network mesh stands for, and how the small ones lie on the large."""
    points, label = mesh.surface.vertices, mesh.surface.parts
    count = int(label.max()) + 1
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(count))
    extent = (np.maximum.reduceat(points[order], starts) - np.minimum.reduceat(points[order], starts)).max(axis=1)
    areas = mesh.surface.areas
    small = (extent < SMALL) & (np.bincount(label, areas, count) < PIECE * areas.sum())
    gap, host = np.full(len(points), np.inf), np.full(len(points), -1)
    if small.any() and not small.all():
        inside, outside = np.flatnonzero(small[label]), np.flatnonzero(~small[label])
        gap[inside], near = cKDTree(points[outside]).query(points[inside])
        host[inside] = outside[near]
    cover = np.bincount(label, areas * (gap < REACH), count) / np.bincount(label, areas, count)
    return LooseParts(label, extent, cover, gap, host)


def seat_parts(mesh: NetworkMesh, weights: np.ndarray, stiff: bool = True) -> np.ndarray:
    """Weights where each small loose part has one row for all of it.

    A part that lies on a larger one takes the mean of that one's weights at the points nearest to it. A part that lies
    on none, as the head of a robot does, takes the mean of its own where one handle clearly holds it. Either row is
    sharpened.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, rows sum to 1, shape (M, K).
        stiff: Whether parts that lie on no other may move as a whole; not where they are legs, as those of insects
            often are.

    Returns:
        Weights of the vertices of `mesh.clean`, shape (W, K), float32.
    """
    full = mesh.push_clean(weights)
    if not mesh.surface.parts.any():
        return full
    parts = find_loose_parts(mesh)
    label, areas, count = parts.label, mesh.surface.areas, len(parts.extent)

    def means(where: np.ndarray, share: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Mean of values (S', K) at some points over each part, shape (P, K); zero of parts without such points."""
        total = np.maximum(np.bincount(label[where], share, count), 1e-30)
        columns = [np.bincount(label[where], share * column, count) / total for column in values.T]
        return np.stack(columns, axis=1).astype(np.float32)

    sits = parts.cover >= COVER
    on = np.flatnonzero(sits[label])
    nearest = np.full(count, np.inf)
    np.minimum.at(nearest, label[on], parts.gap[on])
    share = areas[on] * np.exp(-0.5 * ((parts.gap[on] - nearest[label[on]]) / _NEAR) ** 2)
    hosts, inverse = np.unique(parts.host[on], return_inverse=True)
    rows = means(on, share, mesh.push_surface(weights, hosts)[inverse.reshape(-1)])

    single = ~sits & (parts.extent < STIFF) & stiff
    alone = np.flatnonzero(single[label])
    own = means(alone, areas[alone], mesh.push_surface(weights, alone))
    rows[single] = own[single]
    rows **= SHARP
    rows /= np.maximum(rows.sum(axis=1, keepdims=True), 1e-30)
    share_of_row = np.where(sits, 1.0, 0.0)
    share_of_row[single] = np.clip((own[single].max(axis=1) - CLEAR[0]) / (CLEAR[1] - CLEAR[0]), 0, 1)
    member = label[mesh.surface.start]
    amount = share_of_row[member, None].astype(np.float32)
    full += amount * (rows[member] - full)
    return full
