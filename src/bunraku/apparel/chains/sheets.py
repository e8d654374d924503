"""Connected pieces of apparel: how far along the surface each point is from where it is held, and the kind of apparel.

All hair is one piece, held by the skull; a cape and a skirt are held along the whole of their upper edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.nodes import surface_distances
from bunraku.core.body.layout import JOINT_NAMES, JOINT_PARENTS, sided
from bunraku.core.geometry.axes import covered, direction_bins
from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges

# Lengths over the size [m]. All were chosen by eye.
ROUND = 0.65  # share of the directions about the body that a skirt covers
BROAD = 0.3  # the same of a cape
BINS = 24
# Points are joined to so many that are as near: cards of hair and layers of cloth lie on one another without an edge.
NEAR, CLOSE = 6, 0.02
# Points of cloth are joined to so many of those on a grid that are nearer than the wall: both walls of a cloth with
# thickness, and a petticoat and its skirt, reach as far at the same position.
WALL, GRID, ACROSS = 0.06, 0.02, 16
SKULL = 1.3  # half axes of the skull within which hair above its lower quarter is held
BALD = 0.75  # least half axes of a skull that hair hides, over half its height
FAR = 0.04  # what lies farther than this from the held points of its piece is held by itself
UPPER = 0.35  # of the height of a piece of cloth: only its points above this hold it
EDGE = 0.02  # how far down from its upper edge cloth is held
_HEAD = tuple(JOINT_NAMES.index(name) for name in ("head", "neck"))
_HIPS = tuple(JOINT_NAMES.index(name) for name in ("pelvis", "spine1", "left_hip", "right_hip"))
_CHEST = (JOINT_NAMES.index("spine2"), JOINT_NAMES.index("spine3"), *sided("collar"))
_ARMS = sided("shoulder", "elbow", "wrist")


@dataclass(frozen=True, eq=False)
class Piece:
    """A connected piece."""

    kind: str  # one of `chain.KINDS`
    joint: int  # the joint that carries it
    rows: np.ndarray  # points of the surface (`clean_mesh`), shape (P,)
    points: np.ndarray  # their positions [m], shape (P, 3)
    along: np.ndarray  # distance along the surface from where it is held [m], shape (P,)
    before: np.ndarray  # the point of `rows` that each is reached from, -1 where it is held, shape (P,)
    graph: csr_matrix  # lengths of the edges between points [m], (P, P)


def pieces_of(clothed: ClothedCharacter) -> tuple[list[Piece], np.ndarray]:
    """The pieces of a character's apparel, and the surface's point of each vertex, shape (V,)."""
    clean = clean_mesh(clothed.rest, clothed.faces)
    count = len(clean.vertices)
    points = clean.vertices * clean.scale + clean.center
    part = np.full(count, -1, np.int64)
    along, joint = np.zeros(count), np.zeros(count, np.int64)
    cloth = np.flatnonzero(clothed.part >= 0)
    part[clean.index[cloth]] = clothed.part[cloth]
    along[clean.index[cloth]] = surface_distances(clothed)[cloth]
    joint[clean.index[cloth]] = clothed.weights[cloth].argmax(axis=1)
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
        kind = _kind(clothed, carrier, points[rows], along[rows])
        if kind == "hair":
            hair.append(rows)
        else:
            groups.append((kind, carrier, rows))
    if hair:
        groups.insert(0, ("hair", _HEAD[0], np.concatenate(hair)))
    pieces = [_piece(clothed, kind, carrier, rows, points, along, border, edges) for kind, carrier, rows in groups]
    return pieces, clean.index


def _piece(
    clothed: ClothedCharacter, kind: str, joint: int, rows: np.ndarray, points: np.ndarray, along: np.ndarray,
    border: np.ndarray, edges: np.ndarray,
) -> Piece:  # fmt: skip
    positions, count = points[rows], len(rows)
    index = np.full(len(points), -1)
    index[rows] = np.arange(count)
    pairs = index[edges]
    pairs = pairs[(pairs >= 0).all(axis=1)]
    pairs = np.concatenate([pairs, _near(positions, np.arange(count), NEAR + 1, CLOSE * clothed.scale)])
    if kind in ("skirt", "cape"):
        pairs = np.concatenate([pairs, _through(positions, clothed.scale)])
    seeds = _held(clothed, kind, positions, along[rows])
    seeds |= _apart(positions, pairs, seeds, border[rows], clothed.scale)
    pairs = _bridged(positions, pairs, seeds)
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    lengths = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1) + 1e-9
    graph = coo_matrix((lengths, (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    graph = graph + graph.T
    far, before, _ = dijkstra(graph, indices=np.flatnonzero(seeds), min_only=True, return_predecessors=True)
    return Piece(kind, joint, rows, positions, far, np.where(before < 0, -1, before), graph)


def _held(clothed: ClothedCharacter, kind: str, points: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Points at which a piece is held, at least one, shape (P,), bool."""
    touches = along <= along.min() + 1e-9
    low, high = float(points[:, 1].min()), float(points[:, 1].max())
    if kind == "hair":
        centre, axes = _skull(clothed)
        away = (points - centre) / axes
        held = (np.linalg.norm(away, axis=1) < SKULL) & (away[:, 1] > -0.25)
        return held if held.any() else touches
    if kind in ("skirt", "cape"):
        upper = points[:, 1] >= high - UPPER * (high - low)
        held = (touches & upper) | _upper_edge(clothed, points)
        return held if held.any() else upper
    return touches


def _upper_edge(clothed: ClothedCharacter, points: np.ndarray) -> np.ndarray:
    """Points as high as a sheet is in their direction, in its upper half, shape (P,), bool."""
    middle = clothed.joints[0].astype(float)
    bins = direction_bins(np.arctan2(points[:, 0] - middle[0], points[:, 2] - middle[2]), BINS)
    top = np.full(BINS, -np.inf)
    np.maximum.at(top, bins, points[:, 1])
    low, high = float(points[:, 1].min()), float(points[:, 1].max())
    return (points[:, 1] > top[bins] - EDGE * clothed.scale) & (points[:, 1] > low + 0.5 * (high - low))


def _skull(clothed: ClothedCharacter) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half axes of the skull [m], (3,) each, by the bare surface of the head; never very narrow."""
    head = clothed.joints[_HEAD[0]].astype(float)
    held = clothed.weights[:, _HEAD[0]] > 0.5
    held &= clothed.rest[:, 1] > head[1]
    bare = clothed.rest[held & (clothed.part < 0)]
    every = clothed.rest[held]
    top = float(np.percentile(every[:, 1], 99)) if len(every) else head[1] + 0.2 * clothed.scale
    if len(bare) >= 20 and bare[:, 1].max() > head[1] + 0.6 * (top - head[1]):
        top = float(np.percentile(bare[:, 1], 99))
    half = 0.5 * max(top - head[1], 0.06 * clothed.scale)
    centre = np.array([head[0], head[1] + half, head[2]])
    axes = np.full(3, half)
    if len(bare) >= 20:
        low, high = np.percentile(bare, [2, 98], axis=0)
        for axis in (0, 2):
            axes[axis] = np.clip(0.5 * (high[axis] - low[axis]), BALD * half, 1.3 * half)
        centre[0] = 0.5 * (low[0] + high[0])
        # a face alone says where the skull begins, and not how far back it goes
        centre[2] = max(0.5 * (low[2] + high[2]), high[2] - 1.1 * axes[2]) if high[2] > head[2] else head[2]
        centre[2] = min(centre[2], high[2] - 0.8 * axes[2])
    return centre, axes


def _through(points: np.ndarray, size: float) -> np.ndarray:
    """Pairs of points that lie near each other on any layer, shape (E, 2)."""
    cells = np.floor(points / (GRID * size)).astype(np.int64)
    chosen = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    return _near(points, chosen, ACROSS, WALL * size)


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


def _apart(points: np.ndarray, pairs: np.ndarray, seeds: np.ndarray, border: np.ndarray, size: float) -> np.ndarray:
    """Points that hold components apart from all that is held, (P,), bool: where they are one surface with the body,
    or, far from all that is held, at their nearest end: a tail hangs from the head and not from a hip that it touches.
    """
    label = mesh_parts(pairs, len(points))
    out = np.zeros(len(points), bool)
    loose = ~np.isin(label, label[seeds])
    gap = cKDTree(points[seeds]).query(points)[0]
    for number in np.unique(label[loose]):
        rows = np.flatnonzero(label == number)
        if border[rows].any():
            out[rows] = border[rows]
        elif gap[rows].min() > FAR * size:
            out[rows] = gap[rows] <= gap[rows].min() + EDGE * size
    return out


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


def _around(clothed: ClothedCharacter, joint: int, points: np.ndarray) -> np.ndarray:
    """Angle of points about the axis of their carrier, 0 in front."""
    start = clothed.joints[joint].astype(float)
    axis = np.array([0.0, 1, 0])
    if joint in _ARMS:
        below = [child for child, parent in enumerate(JOINT_PARENTS) if parent == joint]
        axis = clothed.joints[below[0]] - start if below else start - clothed.joints[JOINT_PARENTS[joint]]
        axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
    front = np.array([0.0, 0, 1]) - axis[2] * axis
    front /= max(float(np.linalg.norm(front)), 1e-9)
    side = np.cross(axis, front)
    away = points - start
    return np.asarray(np.arctan2(away @ side, away @ front))


def _kind(clothed: ClothedCharacter, joint: int, points: np.ndarray, along: np.ndarray) -> str:
    """The kind of a part, by its carrier and how far it goes round that."""
    length = float(along.max())
    angle = _around(clothed, joint, points)
    cover = covered(angle, BINS)
    spread = np.ptp(points, axis=0)
    width = float(np.hypot(spread[0], spread[2]))
    if joint in _HEAD:
        top = clothed.rest[:, 1].max() - 0.5 * (clothed.rest[:, 1].max() - clothed.joints[_HEAD[0]][1])
        far = along > 0.5 * length
        stands = bool(far.any()) and points[:, 1].max() > top and points[far, 1].mean() > points[~far, 1].mean()
        return "ear" if stands and length < 0.2 * clothed.scale else "hair"
    if joint in _ARMS:
        return "sleeve" if cover > BROAD else "ribbon"
    if joint in _HIPS:
        if cover >= ROUND:
            return "skirt"
        thin = _thickness(points)
        if cover > BROAD and thin < 0.35:
            return "skirt"
        begins = points[along <= np.percentile(along, 20)].mean(axis=0) - clothed.joints[_HIPS[0]]
        behind = begins[2] < 0 and abs(begins[0]) < -begins[2]
        return "tail" if behind and (thin >= 0.35 or width < 0.1) else "ribbon"
    if joint in _CHEST:
        return "cape" if cover > BROAD and length > 0.15 * clothed.scale else "ribbon"
    return "ribbon"


def _thickness(points: np.ndarray) -> float:
    """Thickness over width of points, across their longest axis, from 0 (a sheet) to 1 (a rod)."""
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov((points - points.mean(axis=0)).T)), 0))
    return float(values[0] / max(values[1], 1e-9))
