"""Small loose parts (buttons, eyes, teeth, hair pins) move as a whole, with the surface that they sit on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.motion import line_up
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
TOUCHES = 0.012  # parts nearer than this touch, as a share of the character's extent
TINY = 0.008  # share of the surface under which a piece is no limb, however sure its handle is
_HEAD = [HANDLE_NAMES.index(name) for name in ("head", "head_top", "face")]
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
    on none, as the head of a robot does, takes the mean of its own where one handle clearly holds it, and the head's
    where head, hair and face hold it together; small ones follow what they touch (`_follow_contacts`). Rows are
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
    heads = own[:, _HEAD].sum(axis=1) if own.shape[1] == HANDLE_COUNT else np.zeros(count)
    hair = single & (own.max(axis=1) < CLEAR[1]) & (heads > CLEAR[0])  # it holds to the head, whatever shares it
    rows[hair] = np.eye(own.shape[1])[min(_HEAD[0], own.shape[1] - 1)]
    rows **= SHARP
    rows /= np.maximum(rows.sum(axis=1, keepdims=True), 1e-30)
    share_of_row = np.where(sits, 1.0, 0.0)
    clear = np.where(hair, heads, own.max(axis=1))
    share_of_row[single] = np.clip((clear[single] - CLEAR[0]) / (CLEAR[1] - CLEAR[0]), 0, 1)
    if stiff:
        _follow_contacts(mesh, weights, parts, sits, own, rows, share_of_row)
    member = label[mesh.surface.start]
    held = np.flatnonzero(share_of_row[member] > 0)
    member = member[held]
    full[held] += share_of_row[member, None].astype(np.float32) * (rows[member] - full[held])
    return full


def _follow_contacts(
    mesh: NetworkMesh,
    weights: np.ndarray,
    parts: LooseParts,
    sits: np.ndarray,
    own: np.ndarray,
    rows: np.ndarray,
    share: np.ndarray,
) -> None:
    """Let small pieces move with what they touch, one after another, in place: arrows with their quiver, a feather with
    its arrow.

    A piece whose handle is far from that of what it touches cannot be a limb that is jointed there: it would fly off.
    Unless it is large and clearly of one handle, it takes the row of what it touches, and what touches it follows in
    turn. Flecks that touch nothing, as image-to-3D programs leave them, stay with the nearest of the larger parts.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, shape (M, K).
        parts: Its loose parts.
        sits: Which of them sit on another already, shape (P,), bool.
        own: Mean weights of the parts that may move as a whole, shape (P, K); zero of others.
        rows: The row of each part, shape (P, K).
        share: How much of it each part takes, shape (P,).
    """
    label, points = parts.label, mesh.surface.vertices
    areas = np.bincount(label, mesh.surface.areas, len(parts.extent))
    waiting = ~sits & (own.sum(axis=1) > 0) & (areas < PIECE * areas.sum())
    fresh = ~waiting
    while waiting.any():
        # What touched a piece of an earlier round is settled with it, so only the last ones are asked.
        loose, settled = np.flatnonzero(waiting[label]), np.flatnonzero(fresh[label])
        if not len(settled):
            break
        gap, near = cKDTree(points[settled]).query(points[loose], distance_upper_bound=TOUCHES)
        touching = np.isfinite(gap)
        if not touching.any():
            break
        pieces, there = label[loose[touching]], settled[near[touching]]
        found = mesh.push_surface(weights, there)
        stiffened = share[label[there]][:, None]
        found = (1 - stiffened) * found + stiffened * rows[label[there]]
        fresh = np.isin(np.arange(len(waiting)), pieces)
        for piece in np.flatnonzero(fresh):
            row = found[pieces == piece].mean(axis=0)
            unsure = own[piece].max() < CLEAR[1] or areas[piece] < TINY * areas.sum()
            if unsure and not _jointed(int(own[piece].argmax()), int(row.argmax())):
                row = row**SHARP
                rows[piece], share[piece] = row / row.sum(), 1.0
        waiting &= ~fresh
    flecks = waiting & (areas < TINY * areas.sum())
    for piece in np.flatnonzero(flecks):  # it touches nothing, and is no limb: it stays with what it lies nearest to
        on = (label == piece) & (parts.host >= 0)
        if on.any():
            nearest = on & (parts.gap <= parts.gap[on].min() + _NEAR)
            row = mesh.push_surface(weights, parts.host[nearest]).mean(axis=0) ** SHARP
            rows[piece], share[piece] = row / row.sum(), 1.0
    for part in np.flatnonzero(sits):  # what sits on a piece that follows follows too
        on = parts.host[label == part]
        host = np.bincount(label[on[on >= 0]], minlength=len(sits)).argmax()
        rows[part] = (1 - share[host]) * rows[part] + share[host] * rows[host]


def _jointed(handle: int, other: int) -> bool:
    """Whether two handles are one, or at most two joints apart."""
    lines = line_up(handle, HANDLE_PARENTS), line_up(other, HANDLE_PARENTS)
    return sum(len(set(one) - set(both)) for one, both in (lines, lines[::-1])) <= 2
