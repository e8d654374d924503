"""Limbs that share their handles, told apart: the pieces of a region of the network mesh that go out from the body side
by side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Handles
from bunraku.core.geometry.graph import mesh_parts
from bunraku.core.geometry.simplify import NetworkMesh

__all__ = [
    "FAMILIES",
    "LIMB_HANDLES",
    "SIDES",
    "Limb",
    "edge_lengths",
    "find_limbs",
    "has_extra_legs",
    "limb_handles",
    "stands",
]

FAMILIES: tuple[tuple[str, ...], ...] = (("hip", "knee", "ankle", "foot"), ("shoulder", "elbow", "wrist", "fingers"))
"""Parts of a limb, from the body outwards; a limb is found by all but the first."""

SIDES = ("left", "right")
AREA = 0.15  # least surface of a further limb, over the largest one's
REACH = 0.45  # how far out a further limb reaches at the least, over the farthest one
LEAST = 0.008  # least surface of a limb, over the character's; the spikes of a puffer fish are smaller
SLENDER = 3.0  # least length of a limb over its radius, if it were a cylinder
OVERLAP = 0.5  # share of the way outwards that two limbs go side by side; a boot and a shin follow one another
APART = 0.15  # least mean distance of two limbs, over the shorter one's length; a sleeve and its arm are nearer
FREE = 0.35  # least share of the way from the body to its tip on which a limb is on its own; fingers are so for less
TOUCH = 0.75  # loose parts nearer than this are one limb, in cells
GROUND = 0.2  # a limb whose tip is so near to the lowest point, over the height, is a leg


@dataclass(frozen=True, eq=False)
class Limb:
    """One limb of those that share their handles.

    Args:
        members: Vertices of its lower parts, shape (m,).
        start: Distance from the body, along the mesh, at which it is on its own.
        end: Distance of its tip.
        area: Of its members.
    """

    members: np.ndarray
    start: float
    end: float
    area: float


def limb_handles(side: str, family: tuple[str, ...]) -> list[int]:
    """Handles of the parts of a limb, from the body outwards."""
    return [HANDLE_NAMES.index(f"{side}_{part}") for part in family]


LIMB_HANDLES = [column for side in SIDES for family in FAMILIES for column in limb_handles(side, family)]


def has_extra_legs(handles: Handles) -> bool:
    """Whether some handles play parts of further limbs; what stands on a head is no limb. One limb of such a body in
    place of all of them (`anatomy.limbs.LimbView`), which has roles that are all its own, is a part of it.
    """
    played = handles.played
    beside = played[played != np.arange(len(played))]
    return handles.roles is not None and bool(not len(beside) or np.isin(beside, LIMB_HANDLES).any())


def edge_lengths(mesh: NetworkMesh) -> csr_matrix:
    """Lengths of the edges, bridges between loose parts included, shape (M, M)."""
    first, second = mesh.edges.T
    length = np.maximum(np.linalg.norm(mesh.vertices[first] - mesh.vertices[second], axis=1), 1e-6).astype(np.float64)
    count = len(mesh.vertices)
    return csr_matrix(
        (np.tile(length, 2), (np.concatenate([first, second]), np.concatenate([second, first]))), shape=(count, count)
    )


def find_limbs(
    mesh: NetworkMesh, weights: np.ndarray, graph: csr_matrix
) -> dict[tuple[tuple[str, ...], str], tuple[list[Limb], list[Limb]]]:
    """For each family and side, the limbs that share those handles, raised ones first and then from the back, and stubs
    beside them; fewer than two limbs where it is one or none.

    Candidates are the connected pieces of the region that the handles hold, or, where those hang together at the body,
    of what the lower parts hold. One counts as a limb of its own if it is about as large as the largest, goes out side
    by side with the others and apart from them, and meets the body by itself: weapons, shields and boots meet it
    through the limb that bears them. What does all that but reaches less far, as the fangs of a spider, is a stub.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, shape (M, K).
        graph: Lengths of its edges (`edge_lengths`).
    """
    body = weights[:, LIMB_HANDLES].sum(axis=1) < 0.5
    keys = [(family, side) for family in FAMILIES for side in SIDES]
    if not body.any():
        return {key: ([], []) for key in keys}
    distance, before, _ = dijkstra(graph, indices=np.flatnonzero(body), min_only=True, return_predecessors=True)
    out = {}
    for family, side in keys:
        columns = limb_handles(side, family)
        regions = [weights[:, some].sum(axis=1) > 0.5 for some in (columns, columns[1:])]
        whole, lower = (_limbs(mesh, region, distance, before) if region.any() else ([], []) for region in regions)
        limbs, stubs = max(whole, lower, key=lambda found: (len(found[0]), len(found[1])))
        out[family, side] = (
            sorted(limbs, key=lambda limb: (stands(mesh, limb), float(mesh.vertices[limb.members, 2].mean()))),
            stubs,
        )
    return out


def _limbs(
    mesh: NetworkMesh, region: np.ndarray, distance: np.ndarray, before: np.ndarray
) -> tuple[list[Limb], list[Limb]]:
    """Pieces of a region that are limbs, largest first, and those that are stubs.

    Args:
        mesh: The network mesh.
        region: Its vertices, shape (M,), bool.
        distance: Of each vertex from the body, shape (M,).
        before: The vertex before each on the way from the body, negative on the body, shape (M,).
    """
    label = np.where(region, mesh_parts(_joined(mesh, region), len(region)), -1)
    areas = np.bincount(label[region], mesh.areas[region])
    large = np.flatnonzero(areas > max(AREA * areas.max(), LEAST * mesh.areas.sum()))
    found: list[Limb] = []
    for piece in large[np.argsort(-areas[large], kind="stable")]:
        members = np.flatnonzero(label == piece)
        nearest = int(members[distance[members].argmin()])
        if not _borne(nearest, before, label, set(large.tolist()) - {int(piece)}):
            found.append(Limb(members, float(distance[nearest]), float(distance[members].max()), float(areas[piece])))
    farthest = max((limb.end for limb in found), default=0.0)
    kept: list[Limb] = []
    stubs: list[Limb] = []
    for limb in found:
        alone = limb.end - limb.start
        if alone < FREE * limb.end or alone**2 < SLENDER * limb.area / (2 * np.pi):
            continue
        if limb.end < REACH * farthest:
            stubs.append(limb)
        elif all(_parallel(limb, other) and _apart(mesh, limb, other) for other in kept):
            kept.append(limb)
    return kept, [stub for stub in stubs if all(_apart(mesh, stub, limb) for limb in kept)]


def _joined(mesh: NetworkMesh, region: np.ndarray) -> np.ndarray:
    """Edges within a region, and pairs of its vertices on different loose parts that touch, shape (E, 2)."""
    own = mesh.edges[mesh.components[mesh.edges[:, 0]] == mesh.components[mesh.edges[:, 1]]]
    where = np.flatnonzero(region)
    near = where[cKDTree(mesh.vertices[where]).query_pairs(TOUCH * mesh.cell, output_type="ndarray")]
    near = near[mesh.components[near[:, 0]] != mesh.components[near[:, 1]]]
    return np.concatenate([own[region[own].all(axis=1)], near])


def _borne(vertex: int, before: np.ndarray, label: np.ndarray, others: set[int]) -> bool:
    """Whether the way from a vertex to the body leads over another piece."""
    while vertex >= 0:
        if int(label[vertex]) in others:
            return True
        vertex = int(before[vertex])
    return False


def _parallel(one: Limb, other: Limb) -> bool:
    shared = min(one.end, other.end) - max(one.start, other.start)
    return shared >= OVERLAP * min(one.end - one.start, other.end - other.start)


def _apart(mesh: NetworkMesh, one: Limb, other: Limb) -> bool:
    points = [mesh.vertices[limb.members] for limb in (one, other)]
    gaps = [float(np.average(cKDTree(far).query(own)[0], weights=mesh.areas[limb.members])) for own, far, limb in
            ((points[0], points[1], one), (points[1], points[0], other))]  # fmt: skip
    return min(gaps) >= APART * min(one.end - one.start, other.end - other.start)


def stands(mesh: NetworkMesh, limb: Limb) -> bool:
    """Whether a limb reaches the ground."""
    heights = mesh.vertices[:, 1]
    return bool(heights[limb.members].min() - heights.min() < GROUND * np.ptp(heights))
