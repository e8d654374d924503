"""Handles beyond a person's: further legs of insects and spiders, and ears, horns and trunks that stand out from a
head.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from bunraku.anatomy.handles.limbs import (
    FAMILIES,
    LIMB_HANDLES,
    SIDES,
    Limb,
    edge_lengths,
    find_limbs,
    limb_handles,
    stands,
)
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.body.reference import handle_positions
from bunraku.core.geometry.simplify import NetworkMesh

__all__ = ["Appendage", "appendage_shares", "find_appendages", "split_limbs", "with_appendages"]


BLEND = 1.5  # how softly limbs meet, in cells
SPARE = 2e-3  # share of the surface under which a handle is spare; it would follow its parent
HELD = 3e-3  # share of the surface from which a part of a further limb gets a handle
TALL = 0.55  # a character whose head is over its hips and so far above its feet, over its extent, is a person
_SPARE_FIRST = (
    "left_wing", "right_wing", "head_top", "face", "left_fingers", "right_fingers", "left_foot", "right_foot",
    "tail_tip", "tail",
    "left_collar", "right_collar", "spine1", "spine2", "spine3", "left_wrist", "right_wrist", "left_ankle",
    "right_ankle", "left_elbow",
    "right_elbow", "left_knee", "right_knee", "left_shoulder", "right_shoulder", "left_hip", "right_hip", "neck",
)  # fmt: skip


def _person(mesh: NetworkMesh, weights: np.ndarray) -> bool:
    """Whether a character stands upright and tall on its legs; what looks like further limbs are its clothes and
    weapons.
    """
    positions = handle_positions(mesh.vertices, weights, mesh.areas)
    pelvis, head, *feet = (
        positions[HANDLE_NAMES.index(name)] for name in ("pelvis", "head", "left_ankle", "right_ankle")
    )
    return bool(head[1] - pelvis[1] > 2 * abs(head[2] - pelvis[2]) and head[1] - max(foot[1] for foot in feet) > TALL)


@dataclass(eq=False)
class _Split:
    """Limbs that share their handles.

    Args:
        columns: The handles.
        legs: Those of the leg of that side.
        parts: What each of the handles weighs, shape (M, P).
        members: How much each vertex is of each limb, shape (M, L).
        stands: Which limbs stand on the ground.
        side: 0 for left, 1 for right.
        before: Further limbs of that side in families before this one. What the predictor calls the first leg of a
            crab, or its last arm, is the same limb and should get the same handles.
    """

    columns: list[int]
    legs: list[int]
    parts: np.ndarray
    members: np.ndarray
    stands: list[bool]
    side: int
    before: int

    def slot(self, limb: int, part: int) -> int:
        """The place of a part of a further limb among all that may need a handle."""
        return self.side + len(SIDES) * ((self.before + limb - 1) * len(self.columns) + part)

    def roles(self, limb: int) -> list[int]:
        """The handles whose parts a limb's handles play: a leg's where it stands on the ground."""
        return self.legs if self.stands[limb] else self.columns

    def masses(self, areas: np.ndarray) -> list[np.ndarray]:
        """Shares of the surface of the parts of each limb, shape (P,) each."""
        return [areas @ (self.parts * member[:, None]) for member in self.members.T]

    def owners(self, areas: np.ndarray, most: int, mirrored: _Split) -> list[list[int]]:
        """For each further limb, the part whose new handle each of its parts takes; at most so many handles a limb.

        Where both sides have as many limbs they are dealt with alike.
        """
        out, masses = [], self.masses(areas)
        if self.members.shape == mirrored.members.shape:
            masses = [0.5 * (one + other) for one, other in zip(masses, mirrored.masses(areas), strict=True)]
        for mass in masses[1:]:
            own = [number for number in range(len(mass)) if mass[number] >= HELD][:most] or [int(mass.argmax())]
            out.append([max((some for some in own if some <= number), default=own[0]) for number in range(len(mass))])
        return out


def split_limbs(mesh: NetworkMesh, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Weights in which every further limb of a side has handles of its own.

    What spare handles held goes to their parents. Where there are too few of them, the parts of further limbs are
    joined from the far end, and then the hindmost limbs with those before them. Only characters with further limbs on
    both sides are split.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, rows sum to 1, shape (M, 30).

    Returns:
        Weights of the same shape, and the handle whose part each handle plays, shape (30,); None where nothing was
        split.
    """
    if _person(mesh, weights):
        return weights, None
    graph = edge_lengths(mesh)
    found = find_limbs(mesh, weights, graph)
    if any(all(len(found[family, side][0]) < 2 for family in FAMILIES) for side in SIDES):
        return weights, None
    areas = mesh.areas / mesh.areas.sum(dtype=np.float64)
    spare = [handle for handle in map(HANDLE_NAMES.index, _SPARE_FIRST) if areas @ weights[:, handle] < SPARE]
    out = _without(weights, spare)
    splits: list[list[_Split]] = []
    before = [0] * len(SIDES)
    for family in FAMILIES:
        splits.append([])
        for number, side in enumerate(SIDES):
            limbs, stubs = found[family, side]
            if len(limbs) < 2:
                continue
            columns = limb_handles(side, family)
            members = _membership(mesh, graph, limbs + stubs)
            for index, stub in enumerate(stubs, len(limbs)):
                held = out[:, columns] * members[:, index : index + 1]
                out[:, columns] -= held
                out[:, _body_handle(mesh, out, stub)] += held.sum(axis=1)
            members = members[:, : len(limbs)] / members[:, : len(limbs)].sum(axis=1, keepdims=True)
            legs = limb_handles(side, FAMILIES[0])
            splits[-1].append(
                _Split(
                    columns,
                    legs,
                    out[:, columns],
                    members,
                    [stands(mesh, limb) for limb in limbs],
                    number,
                    before[number],
                )
            )
            before[number] += len(limbs) - 1
    roles = np.arange(HANDLE_COUNT)
    dealt = _fitted(splits, areas, len(spare))
    for split, _ in dealt:
        out[:, split.columns] = split.parts * split.members[:, :1]
    queries = [
        (split, limb, part, owner)
        for split, owners in dealt
        for limb, owner in enumerate(owners, 1)
        for part in sorted(set(owner))
    ]
    fresh = _slots_of(
        [split.slot(limb, _canonical_part(part, owner)) for split, limb, part, owner in queries],
        len(SIDES) * max(before) * len(FAMILIES[0]),
        spare,
    )
    for (split, limb, part, owner), handle in zip(queries, fresh, strict=True):
        roles[handle] = split.roles(limb)[_canonical_part(part, owner)]
        moved = [number for number, own in enumerate(owner) if own == part]
        out[:, handle] += split.parts[:, moved].sum(axis=1) * split.members[:, limb]
    if (roles == np.arange(HANDLE_COUNT)).all():
        return weights, None
    for side in SIDES:
        arm, (limbs, _) = np.array(limb_handles(side, FAMILIES[1])), found[FAMILIES[1], side]
        if limbs and stands(mesh, limbs[0]):
            kept = roles[arm] == arm
            roles[arm[kept]] = np.array(limb_handles(side, FAMILIES[0]))[kept]
    return (out / out.sum(axis=1, keepdims=True)).astype(np.float32), roles


def _fitted(splits: list[list[_Split]], areas: np.ndarray, room: int) -> list[tuple[_Split, list[list[int]]]]:
    """Every split with the owners of its parts (`_Split.owners`), as many handles as there is room for; both sides of a
    family alike.
    """
    most = [len(family) for family in FAMILIES]
    while True:
        dealt = [
            (split, split.owners(areas, most[number], family[-1 - side]))
            for number, family in enumerate(splits)
            for side, split in enumerate(family)
        ]
        if sum(len(set(owner)) for _, owners in dealt for owner in owners) <= room:
            return dealt
        if max(most) > 1:
            most[int(np.argmax(most[::-1])) * -1 - 1] -= 1
            continue
        longest = max(split.members.shape[1] for split, _ in dealt)
        for split, _ in dealt:
            if split.members.shape[1] == longest:
                split.members = np.column_stack([split.members[:, :-2], split.members[:, -2:].sum(axis=1)])


def _canonical_part(part: int, owner: list[int]) -> int:
    """The part that the handle of a part plays: the one nearest to the body plays the first, where that has no handle
    of its own.
    """
    return 0 if part == owner[0] else part


def _slots_of(queries: list[int], slots: int, spare: list[int]) -> list[int]:
    """A spare handle for each slot that is asked for, so that a part more or less does not move the others.

    A slot has its own place in `_SPARE_FIRST`. Where the character uses that one itself, the slot has the next that no
    slot owns, and keeps it whether it is asked for or not, as long as there are enough.
    """
    own = [HANDLE_NAMES.index(_SPARE_FIRST[slot]) if slot < len(_SPARE_FIRST) else -1 for slot in range(slots)]
    free = [handle for handle in spare if handle not in own]
    index = [handle if handle in spare else free.pop(0) if free else -1 for handle in own]
    left = [handle for handle in spare if handle not in [index[slot] for slot in queries]]
    return [index[slot] if index[slot] >= 0 else left.pop(0) for slot in queries]


def _without(weights: np.ndarray, spare: list[int]) -> np.ndarray:
    """The weights with what spare handles hold given to their nearest ancestors that are not spare."""
    out = np.array(weights, np.float64)
    for handle in spare:
        above = HANDLE_PARENTS[handle]
        while above in spare:
            above = HANDLE_PARENTS[above]
        out[:, above] += out[:, handle]
        out[:, handle] = 0
    return out


def _body_handle(mesh: NetworkMesh, weights: np.ndarray, stub: Limb) -> int:
    """The handle of the body that is nearest to a stub: that of the head for fangs and feelers."""
    positions = handle_positions(mesh.vertices, weights, mesh.areas)
    away = np.linalg.norm(positions - mesh.vertices[stub.members].mean(axis=0), axis=1)
    away[mesh.areas @ weights < SPARE * mesh.areas.sum()] = np.inf
    away[LIMB_HANDLES] = np.inf
    return int(away.argmin())


def _membership(mesh: NetworkMesh, graph: csr_matrix, limbs: list[Limb]) -> np.ndarray:
    """How much each vertex belongs to each limb, by the way along the mesh, shape (M, L), rows sum to 1."""
    gaps = np.stack([dijkstra(graph, indices=limb.members, min_only=True) for limb in limbs], axis=1)
    closeness = np.exp((gaps.min(axis=1, keepdims=True) - gaps) / (BLEND * mesh.cell))
    return np.asarray(closeness / closeness.sum(axis=1, keepdims=True))


SLENDER = 4.0  # least slenderness: that of three quarters of a ball, which no lump on a head is
LONG = 0.05  # least length, over the character's extent; the grid's cells are about a third of that
PART = 0.45  # of the head's surface at the most; more is the head itself
FREE = 0.5  # least distance of its tip from the rest of the head, over its length: the inside of a mouth is nearer
ROOT = 0.3  # share of the length, from the root, over which it blends with the head
SPARE_SHARE = 2e-3  # share of the surface under which a handle is spare
_HEAD = [HANDLE_NAMES.index(name) for name in ("head", "head_top", "face")]
_TOP = HANDLE_NAMES.index("head_top")
_SPARE_HANDLES = [
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

    order = np.flatnonzero(inside)
    for vertex in order[np.argsort(-distance[order], kind="stable")].tolist():
        level = float(distance[vertex])
        near = graph.indices[graph.indptr[vertex] : graph.indptr[vertex + 1]].tolist()
        labels = set()
        for other in near:
            if other in merged:
                while merged[other] != other:
                    other = merged[other]
                labels.add(other)
        met, area = list(labels), float(mesh.areas[vertex])
        if len(met) > 1:
            met.sort(key=lambda label: (-hills[label].tip, label))
            slender = [hills[label] for label in met if hills[label].best is not None or hills[label].over]
            hill = slender[0] if slender else hills[met[0]]
            if len(slender) > 1:
                yield from [one.best for one in slender if one.best is not None]
                hill = _Hill(hill.tip, hill.area, hill.members, over=True)
            others = [hills[label] for label in met if hills[label].members is not hill.members]
            area = sum(one.area for one in others) + area
            hill.members.extend(member for one in others for member in one.members)
        else:
            hill = hills[met[0]] if met else _Hill(level, 0.0, [])
        hill.area += area
        hill.members.append(vertex)
        label = met[0] if met else vertex
        merged[vertex], hills[label] = label, hill
        for other in met[1:]:
            merged[other] = label
        length = hill.tip - level
        if not hill.over and hill.area < most and length > LONG and 2 * np.pi * length**2 > SLENDER * hill.area:
            hill.best = Appendage(np.array(hill.members), level, hill.tip)
    for label, above in merged.items():
        best = hills[label].best if label == above else None
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
    spare = [handle for handle in _SPARE_HANDLES if mesh.areas @ weights[:, handle] < SPARE_SHARE * mesh.areas.sum()]
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
