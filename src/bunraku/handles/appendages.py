"""What stands out from a head: ears, horns, stalks, antennae, a trunk; each gets a handle of its own.

The 30 handles know one part for all that stands on a head. Here it is told apart by the shape alone: as hills of the
distance from the body, along the surface. A hill begins at its tip and goes down until it meets another one (the merge
tree of that distance), and as far down as it is slender and free of the head it is an appendage. What it is called,
and what a predictor takes it for, is not asked.

A ball whose cap reaches over the angle t has a slenderness, length squared over area / (2 pi), of t^2 / (1 - cos t): 2
for a flat patch, 2.5 for a half, 4.9 for all of it. A cylinder of length L and radius r has L / r, a cone twice that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.geometry.simplify import NetworkMesh
from bunraku.handles.limbs import edge_lengths

__all__ = ["Appendage", "appendage_shares", "find_appendages", "with_appendages"]

SLENDER = 4.0  # least slenderness: that of three quarters of a ball, which no lump on a head is
LONG = 0.05  # least length, over the character's extent; the grid's cells are about a third of that
PART = 0.45  # of the head's surface at the most; more is the head itself
FREE = 0.5  # least distance of its tip from the rest of the head, over its length: the inside of a mouth is nearer
ROOT = 0.3  # share of the length, from the root, over which it blends with the head
SPARE = 2e-3  # share of the surface under which a handle is spare
_HEAD = [HANDLE_NAMES.index(name) for name in ("head", "head_top", "face")]
_TOP = HANDLE_NAMES.index("head_top")
_SPARE_FIRST = [
    HANDLE_NAMES.index(name)
    for name in ("face", "left_fingers", "right_fingers", "left_foot", "right_foot", "tail_tip", "tail", "left_wing",
                 "right_wing")
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Appendage:
    """A part that stands out from a head.

    Args:
        members: Its vertices, shape (m,).
        root: How far from the body its root is, along the mesh.
        tip: How far its tip is.
    """

    members: np.ndarray
    root: float
    tip: float

    @property
    def length(self) -> float:
        """From its root to its tip, along the mesh."""
        return self.tip - self.root


def find_appendages(mesh: NetworkMesh, weights: np.ndarray, graph: csr_matrix | None = None) -> list[Appendage]:
    """The appendages of a head, the longest first; none of a body that is all head.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, rows sum to 1, shape (M, 30).
        graph: Lengths of its edges (`handles.limbs.edge_lengths`).
    """
    head = weights[:, _HEAD].sum(axis=1) > 0.5
    if not head.any() or head.all():
        return []
    graph = edge_lengths(mesh) if graph is None else graph
    distance = dijkstra(graph, indices=np.flatnonzero(~head), min_only=True)
    found = sorted(_hills(mesh, graph, distance, head & np.isfinite(distance)), key=lambda one: -one.length)
    rest = head.copy()
    for one in found:
        rest[one.members] = False
    return [one for one in found if _free(mesh, rest, one)]


@dataclass
class _Hill:
    """What is over some level about one tip; `best` is the most of it that is slender."""

    tip: float
    area: float
    members: list[int]
    best: Appendage | None = None
    over: bool = False


def _hills(mesh: NetworkMesh, graph: csr_matrix, distance: np.ndarray, inside: np.ndarray) -> Iterator[Appendage]:
    """Slender hills of a distance. Where two that are slender meet, what is below both is of neither; a hill that is
    slender nowhere yet goes on in the one that it meets.
    """
    most = PART * float(mesh.areas[inside].sum())
    hills: dict[int, _Hill] = {}
    merged: dict[int, int] = {}  # a label of each vertex that was passed, and the label that it has become

    def current(label: int) -> int:
        while merged[label] != label:
            label = merged[label]
        return label

    order = np.flatnonzero(inside)
    for vertex in order[np.argsort(-distance[order], kind="stable")].tolist():
        level = float(distance[vertex])
        near = graph.indices[graph.indptr[vertex] : graph.indptr[vertex + 1]].tolist()
        met = sorted({current(one) for one in near if one in merged}, key=lambda one: (-hills[one].tip, one))
        slender = [hills[one] for one in met if hills[one].best is not None or hills[one].over]
        hill = slender[0] if slender else hills[met[0]] if met else _Hill(level, 0.0, [])
        if len(slender) > 1:
            for one in slender:
                if one.best is not None:
                    yield one.best
            hill = _Hill(hill.tip, hill.area, hill.members, over=True)
        others = [hills[one] for one in met if hills[one].members is not hill.members]
        hill.area += sum(one.area for one in others) + float(mesh.areas[vertex])
        hill.members.extend(member for one in others for member in one.members)
        hill.members.append(vertex)
        label = met[0] if met else vertex
        merged[vertex], hills[label] = label, hill
        for other in met[1:]:
            merged[other] = label
        length = hill.tip - level
        if not hill.over and hill.area < most and length > LONG and 2 * np.pi * length**2 > SLENDER * hill.area:
            hill.best = Appendage(np.array(hill.members), level, hill.tip)
    for label in {current(one) for one in merged}:
        best = hills[label].best
        if best is not None:
            yield best


def _free(mesh: NetworkMesh, rest: np.ndarray, one: Appendage) -> bool:
    """Whether a hill stands off the rest of the head: the inside of a mouth and a mane on a neck do not."""
    if not rest.any():
        return False
    away = cKDTree(mesh.vertices[rest]).query(mesh.vertices[one.members])[0]
    return float(away.max()) > FREE * one.length


def appendage_shares(mesh: NetworkMesh, found: list[Appendage], distance: np.ndarray) -> np.ndarray:
    """How much each vertex is of each appendage, from 0 at its root to 1, shape (M, A)."""
    out = np.zeros((len(mesh.vertices), len(found)))
    for number, one in enumerate(found):
        way = np.clip((distance[one.members] - one.root) / (ROOT * one.length), 0, 1)
        out[one.members, number] = way * way * (3 - 2 * way)
    return out


def with_appendages(
    mesh: NetworkMesh, weights: np.ndarray, full: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Weights in which each appendage of the head has a handle of its own: a spare one, which plays the head's top.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, rows sum to 1, shape (M, 30).
        full: Of the vertices of `mesh.clean`, shape (W, 30).

    Returns:
        Both, and the handle whose part each handle plays, shape (30,); None where there is no appendage, or no handle
        for one.
    """
    graph = edge_lengths(mesh)
    spare = [handle for handle in _SPARE_FIRST if mesh.areas @ weights[:, handle] < SPARE * mesh.areas.sum()]
    found = find_appendages(mesh, weights, graph)[: len(spare)]
    if not found:
        return weights, full, None
    # Twins are nearly equally long, so their order by length would hang on the tessellation.
    found.sort(key=lambda one: -float(mesh.vertices[one.members, 0].mean()))
    head = weights[:, _HEAD].sum(axis=1) > 0.5
    distance = dijkstra(graph, indices=np.flatnonzero(~head), min_only=True)
    shares = appendage_shares(mesh, found, distance)
    roles = np.arange(HANDLE_COUNT)
    roles[spare[: len(found)]] = _TOP
    taken = spare[: len(found)]
    return _moved(weights, shares, taken), _moved(full, mesh.push_clean(shares), taken), roles


def _moved(weights: np.ndarray, shares: np.ndarray, taken: list[int]) -> np.ndarray:
    """Weights of which the head's share goes to the handles of its appendages; what these held before goes to the
    head.
    """
    out = np.array(weights, np.float64)
    out[:, _HEAD[0]] += out[:, taken].sum(axis=1)
    out[:, taken] = 0
    head = [handle for handle in _HEAD if handle not in taken]
    held = out[:, head]
    shares = np.clip(shares, 0, 1)
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), 1)
    out[:, taken] = shares * held.sum(axis=1, keepdims=True)
    out[:, head] = held * (1 - shares.sum(axis=1, keepdims=True))
    return (out / out.sum(axis=1, keepdims=True)).astype(np.float32)
