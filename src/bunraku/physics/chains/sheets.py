"""Pieces of apparel cut out of a mesh: the surface of one part, how far along it each point is from where the part is
held, how far round it is, and what kind of apparel it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.nodes import surface_distances
from bunraku.body.layout import JOINT_NAMES, JOINT_PARENTS
from bunraku.geometry.graph import clean_mesh, unique_edges

__all__ = ["Piece", "pieces_of"]

STEP = 0.045
"""Of the size [m]: bins of distance in which a piece is looked at for where it branches."""
SPECK = 0.02  # of a piece's points: a branch with fewer is none
ROUND = 0.65  # of the directions about the body: a piece that covers so many is a skirt
BROAD = 0.3  # of them: a piece on the trunk that covers so many is a cape
BINS = 24
GAP = 4  # bins: an opening at least so wide makes a sheet open
_HEAD = tuple(JOINT_NAMES.index(name) for name in ("head", "neck"))
_HIPS = tuple(JOINT_NAMES.index(name) for name in ("pelvis", "spine1", "left_hip", "right_hip"))
_ARMS = tuple(JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right")
              for part in ("shoulder", "elbow", "wrist"))  # fmt: skip


@dataclass(frozen=True, eq=False)
class Piece:
    """A stretch of a part without branches.

    Args:
        kind: One of `chain.KINDS`.
        joint: The joint that carries the part.
        rows: Points of the surface (`clean_mesh`), shape (P,).
        points: Where they are [m], shape (P, 3).
        along: Distance from where the part is held [m], shape (P,).
        angle: About the axis that it lies around, from the start of the sheet [rad], shape (P,).
        span: Of the angles; 2 pi where the sheet is closed [rad].
        start: Distance at which it begins [m].
        above: The piece that it branches off from, -1 for the body.
    """

    kind: str
    joint: int
    rows: np.ndarray
    points: np.ndarray
    along: np.ndarray
    angle: np.ndarray
    span: float
    start: float
    above: int

    @property
    def closed(self) -> bool:
        """Whether it goes all the way round."""
        return self.span > 2 * np.pi - 1e-6


def pieces_of(clothed: ClothedCharacter) -> tuple[list[Piece], np.ndarray]:
    """The pieces of a character's apparel, each after the one that it branches off from, and the surface's point of
    each vertex, shape (V,).

    Args:
        clothed: The character; its parts hang whole on one joint each.
    """
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
    edges = edges[(part[edges[:, 0]] == part[edges[:, 1]]) & (part[edges[:, 0]] >= 0)]
    out: list[Piece] = []
    for number in range(int(part.max(initial=-1)) + 1):
        rows = np.flatnonzero(part == number)
        if len(rows) < 4:
            continue
        carrier = int(np.bincount(joint[rows]).argmax())
        own = edges[part[edges[:, 0]] == number]
        _cut(out, clothed, carrier, rows, points, along, own)
    return out, clean.index


def _cut(
    out: list[Piece], clothed: ClothedCharacter, joint: int, rows: np.ndarray, points: np.ndarray, along: np.ndarray,
    edges: np.ndarray,
) -> None:  # fmt: skip
    """Add the pieces of a part: one of a sheet, and of what hangs in strands one for each stretch between branches."""
    angle, radius = _around(clothed, joint, points[rows])
    kind = _kind(clothed, joint, points[rows], angle, radius, along[rows])
    if kind in ("skirt", "cape", "sleeve"):
        turned, span = _opened(angle)
        out.append(Piece(kind, joint, rows, points[rows], along[rows], turned, span, float(along[rows].min()), -1))
        return
    step = STEP * clothed.scale
    level = np.floor(along / step).astype(np.int64)
    same = edges[level[edges[:, 0]] == level[edges[:, 1]]]
    index = np.full(len(points), -1)
    index[rows] = np.arange(len(rows))
    pairs = index[same]
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(rows), len(rows)))
    own_level = level[rows]
    # loose locks that are one part have no edges between them, and a level may be crossed by one edge alone
    label = connected_components(graph, directed=False)[1]
    sizes = np.bincount(label)
    across = index[edges[level[edges[:, 0]] != level[edges[:, 1]]]]
    least = max(3, SPECK * len(rows))
    order = sorted(range(len(sizes)), key=lambda one: (own_level[label == one][0], -sizes[one]))
    stretch: dict[int, int] = {}  # of a component, its number in `members`
    members: list[list[int]] = []
    above: list[int] = []
    for one in order:
        touching = across[(label[across] == one).any(axis=1)]
        others = np.unique(label[touching])
        lower = [int(other) for other in others
                 if other in stretch and own_level[label == other][0] < own_level[label == one][0]]  # fmt: skip
        if not lower:
            if sizes[one] >= least or own_level[label == one][0] == 0 or not members:
                stretch[one] = len(members)
                members.append([one])
                above.append(-1)
            else:
                stretch[one] = _nearest(rows, points, label, one, members)
                members[stretch[one]].append(one)
            continue
        parent = max(lower, key=lambda other: sizes[other])
        place = stretch[parent]
        siblings = [other for other in stretch if stretch[other] == place
                    and own_level[label == other][0] >= own_level[label == one][0]]  # fmt: skip
        if sizes[one] < least or not siblings:
            stretch[one] = place
            members[place].append(one)
        else:
            stretch[one] = len(members)
            members.append([one])
            above.append(place)
    base = len(out)
    for number, some in enumerate(members):
        mine = np.isin(label, some)
        turned, span = _opened(angle[mine])
        own = rows[mine]
        out.append(
            Piece(kind, joint, own, points[own], along[own], turned, span, float(along[own].min()),
                  -1 if above[number] < 0 else base + above[number])
        )  # fmt: skip


def _nearest(rows: np.ndarray, points: np.ndarray, label: np.ndarray, one: int, members: list[list[int]]) -> int:
    """The stretch that lies nearest to a component."""
    middle = points[rows[label == one]].mean(axis=0)
    gaps = [float(np.linalg.norm(points[rows[np.isin(label, some)]] - middle, axis=1).min()) for some in members]
    return int(np.argmin(gaps))


def _around(clothed: ClothedCharacter, joint: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle of points about the axis of what carries them, 0 in front, and how far they are from it [m]."""
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
    x, z = away @ side, away @ front
    return np.arctan2(x, z), np.hypot(x, z)


def _kind(
    clothed: ClothedCharacter, joint: int, points: np.ndarray, angle: np.ndarray, radius: np.ndarray, along: np.ndarray
) -> str:
    """What a part is, by what carries it and how far it goes round that."""
    length = float(along.max())
    bins = np.bincount(((angle + np.pi) / (2 * np.pi) * BINS).astype(np.int64) % BINS, minlength=BINS)
    cover = float((bins > 0).mean())
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
        return "skirt" if cover > BROAD and thin < 0.35 else "tail" if thin >= 0.35 or width < 0.1 else "ribbon"
    if joint in (JOINT_NAMES.index("spine2"), JOINT_NAMES.index("spine3"), *(
            JOINT_NAMES.index(f"{side}_collar") for side in ("left", "right"))):  # fmt: skip
        return "cape" if cover > BROAD and length > 0.15 * clothed.scale else "ribbon"
    return "ribbon"


def _thickness(points: np.ndarray) -> float:
    """How thick points are over how wide, across their longest axis, from 0 (a sheet) to 1 (a rod)."""
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov((points - points.mean(axis=0)).T)), 0))
    return float(values[0] / max(values[1], 1e-9))


def _opened(angle: np.ndarray) -> tuple[np.ndarray, float]:
    """Angles from where the sheet begins, and their span: from the widest opening on, or all the way round."""
    bins = np.bincount(((angle + np.pi) / (2 * np.pi) * BINS).astype(np.int64) % BINS, minlength=BINS) > 0
    best, where, run = 0, 0, 0
    for number in range(2 * BINS):
        run = 0 if bins[number % BINS] else run + 1
        if best < run <= BINS:
            best, where = run, number
    if best < GAP:
        return (angle + np.pi) % (2 * np.pi), 2 * np.pi
    begin = -np.pi + 2 * np.pi * ((where + 1) % BINS) / BINS
    turned = (angle - begin) % (2 * np.pi)
    low, high = float(turned.min()), float(turned.max())
    return turned - low, max(high - low, 1e-6)
