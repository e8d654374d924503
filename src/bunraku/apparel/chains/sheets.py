"""Connected pieces of apparel, and how far along the surface each point is from where it is held.

All hair is one piece. A piece is held where the body holds it along its border: where it is one surface with the body,
or nearest to the surface of what carries it; a cape and a skirt are held all along their upper edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from bunraku.apparel.clothed import BESIDE, LAYER, LEGS, ClothedCharacter
from bunraku.apparel.fitting import kinds_of
from bunraku.apparel.nodes import NEIGHBOURS
from bunraku.apparel.parts import find_parts
from bunraku.core.body.layout import JOINT_NAMES, JOINT_PARENTS
from bunraku.core.geometry.axes import direction_bins
from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges

# All were chosen by eye.
BINS = 24  # directions about the pelvis in which the upper edge of a sheet is looked for
# Points of cloth are joined to so many of those on a grid that are near: both walls of a cloth with thickness, and a
# petticoat and its skirt, reach as far at the same position.
ACROSS = 16
UPPER = 0.35  # of the height of a piece of cloth: only its points above this hold it
HANGS = 0.5  # of two ends, the upper one holds though the other is nearer by as much of its height
_HEAD = JOINT_NAMES.index("head")


@dataclass(frozen=True, eq=False)
class Piece:
    """A connected piece."""

    kind: str  # one of `chain.KINDS`
    joint: int  # the joint that carries it
    rows: np.ndarray  # points of the surface (`clean_mesh`), shape (P,)
    points: np.ndarray  # their positions [m], shape (P, 3)
    gap: np.ndarray  # distance of each from the body [m], shape (P,)
    along: np.ndarray  # distance along the surface from where it is held [m], shape (P,)
    before: np.ndarray  # the point of `rows` that each is reached from, -1 where it is held, shape (P,)
    graph: csr_matrix  # lengths of the edges between points [m], (P, P)


def pieces_of(clothed: ClothedCharacter) -> tuple[list[Piece], np.ndarray]:
    """The pieces of a character's apparel, and the surface's point of each vertex, shape (V,)."""
    clean = clean_mesh(clothed.rest, clothed.faces)
    count = len(clean.vertices)
    points = clean.vertices * clean.scale + clean.center
    part, joint = np.full(count, -1, np.int64), np.zeros(count, np.int64)
    cloth = np.flatnonzero(clothed.part >= 0)
    part[clean.index[cloth]] = clothed.part[cloth]
    joint[clean.index] = clothed.weights.argmax(axis=1)
    joint[clean.index[cloth]] = clothed.weights[cloth].argmax(axis=1)
    kinds = clothed.kinds or kinds_of(clothed, find_parts(clothed.rest, clothed.faces).label)
    edges = unique_edges(clean.faces, count)
    apparel = (part[edges] >= 0).sum(axis=1)
    border = np.zeros(count, bool)
    border[edges[apparel == 1]] = True
    edges = edges[apparel == 2]
    groups, hair = list[tuple[str, int, np.ndarray]](), list[np.ndarray]()
    for number in range(int(part.max(initial=-1)) + 1):
        rows = np.flatnonzero(part == number)
        if len(rows) < 4:
            continue
        carrier = int(np.bincount(joint[rows]).argmax())
        if kinds[number] == "hair":
            hair.append(rows)
        else:
            groups.append((kinds[number], carrier, rows))
    if hair:
        groups.insert(0, ("hair", _HEAD, np.concatenate(hair)))
    body = points[part < 0]
    gap = np.zeros(count) if not len(body) else cKDTree(body).query(points)[0]
    pieces = []
    for group in groups:
        holders = points[(part < 0) & np.isin(joint, _holding(group[1]))]
        pieces.append(_piece(clothed, group, points, gap, holders, border, edges))
    return pieces, clean.index


def _holding(joint: int) -> list[int]:
    """Joints whose surface holds what a joint carries: those beside it, and the legs hold nothing."""
    beside = [JOINT_PARENTS[joint], *(child for child, parent in enumerate(JOINT_PARENTS) if parent == joint)]
    return [joint, *(other for other in beside if other >= 0 and other not in LEGS)]


def _piece(
    clothed: ClothedCharacter, group: tuple[str, int, np.ndarray], points: np.ndarray, gap: np.ndarray,
    holders: np.ndarray, border: np.ndarray, edges: np.ndarray,
) -> Piece:  # fmt: skip
    kind, joint, rows = group
    positions, count = points[rows], len(rows)
    index = np.full(len(points), -1)
    index[rows] = np.arange(count)
    pairs = index[edges]
    pairs = pairs[(pairs >= 0).all(axis=1)]
    # cards of hair and layers of cloth lie on one another without an edge
    pairs = np.concatenate([pairs, _near(positions, np.arange(count), NEIGHBOURS + 1, LAYER * clothed.scale)])
    if kind in ("skirt", "cape"):
        pairs = np.concatenate([pairs, _through(positions, clothed.scale)])
    seeds = _held(clothed, kind, positions, pairs, holders, border[rows])
    pairs = _bridged(positions, pairs, seeds)
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    lengths = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1) + 1e-9
    graph = coo_matrix((lengths, (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    graph = graph + graph.T
    far, before, _ = dijkstra(graph, indices=np.flatnonzero(seeds), min_only=True, return_predecessors=True)
    return Piece(kind, joint, rows, positions, gap[rows], far, np.where(before < 0, -1, before), graph)


def _held(
    clothed: ClothedCharacter, kind: str, points: np.ndarray, pairs: np.ndarray, holders: np.ndarray,
    border: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Points at which a piece is held, at least one, shape (P,), bool: where an edge joins it to the body, else at the
    nearest end of each of its components, as far as that is nearer to what carries it, points (H, 3), than to the rest
    of the piece.
    """
    low, high = float(points[:, 1].min()), float(points[:, 1].max())
    upper = points[:, 1] >= high - UPPER * (high - low)
    sheet = kind in ("skirt", "cape")
    held = border & upper if sheet else np.array(border)
    if sheet:
        held |= _upper_edge(clothed, points)
    label, size = mesh_parts(pairs, len(points)), clothed.scale
    gap = (cKDTree(holders).query(points)[0] if len(holders) else 0) + HANGS * (high - points[:, 1])
    least = np.full(int(label.max()) + 1, np.inf)
    np.minimum.at(least, label, gap)
    loose = ~np.isin(label, label[held])
    near = loose & (least <= BESIDE * size)[label]
    held |= near & (gap <= least[label] + LAYER * size)
    for number in np.unique(label[loose & ~near]):  # a tail far from the head hangs by itself, a tip on its lock
        rows = np.flatnonzero(label == number)
        other = cKDTree(points[held]).query(points[rows])[0].min() if held.any() else np.inf
        if least[number] <= other:
            held[rows[gap[rows] <= least[number] + LAYER * size]] = True
    return held if held.any() else upper


def _upper_edge(clothed: ClothedCharacter, points: np.ndarray) -> np.ndarray:
    """Points as high as a sheet is in their direction, in its upper half, shape (P,), bool."""
    middle = clothed.joints[0].astype(float)
    bins = direction_bins(np.arctan2(points[:, 0] - middle[0], points[:, 2] - middle[2]), BINS)
    top = np.full(BINS, -np.inf)
    np.maximum.at(top, bins, points[:, 1])
    low, high = float(points[:, 1].min()), float(points[:, 1].max())
    return (points[:, 1] > top[bins] - LAYER * clothed.scale) & (points[:, 1] > low + 0.5 * (high - low))


def _through(points: np.ndarray, size: float) -> np.ndarray:
    """Pairs of points that lie near each other on any layer, shape (E, 2)."""
    cells = np.floor(points / (LAYER * size)).astype(np.int64)
    chosen = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    return _near(points, chosen, ACROSS, (LAYER + BESIDE) * size)


def _near(points: np.ndarray, among: np.ndarray, count: int, reach: float) -> np.ndarray:
    """Pairs of each point with at most `count` of those in `among` that are nearer than `reach` [m], shape (E, 2)."""
    count = min(count, len(among))
    gap, near = (
        found.reshape(len(points), count)
        for found in cKDTree(points[among]).query(points, count, distance_upper_bound=reach)
    )
    row, column = np.nonzero(np.isfinite(gap))
    other = among[near[row, column]]
    return np.stack([row, other], axis=1)[row != other]


def _bridged(points: np.ndarray, pairs: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Pairs with one more from each component without a seed to the nearest point of one that has some."""
    label = mesh_parts(pairs, len(points))
    reached = np.zeros(int(label.max()) + 1, bool)
    reached[label[seeds]] = True
    more = [pairs]
    while not reached.all():
        inside, rest = np.flatnonzero(reached[label]), np.flatnonzero(~reached[label])
        gap, nearest = cKDTree(points[inside]).query(points[rest])
        order = np.argsort(gap, kind="stable")
        _, first = np.unique(label[rest[order]], return_index=True)
        # the nearest half at once: those behind them are nearer to these than to what is held
        first = first[np.argsort(gap[order[first]], kind="stable")][: max(1, (len(first) + 1) // 2)]
        chosen = order[first]
        more.append(np.stack([rest[chosen], inside[nearest[chosen]]], axis=1))
        reached[label[rest[chosen]]] = True
    return np.concatenate(more)
