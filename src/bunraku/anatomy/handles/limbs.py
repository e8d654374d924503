"""Limbs beyond a person's: limbs that share their handles, new handles for the legs of insects and spiders, and for
ears, horns and trunks that stand out from a head.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.body.reference import handle_positions
from bunraku.core.character import Handles
from bunraku.core.geometry.graph import mesh_parts
from bunraku.core.geometry.simplify import NetworkMesh

FAMILIES: tuple[tuple[str, ...], ...] = (("hip", "knee", "ankle", "foot"), ("shoulder", "elbow", "wrist", "fingers"))
"""Parts of a limb, from the body outwards; a limb is found by all but the first."""

# Chosen by eye on the characters of the archive.
SIDES = ("left", "right")
AREA = 0.15  # least surface of a further limb, over the largest one's
REACH = 0.45  # least reach of a further limb, over the farthest one
LEAST = 0.008  # least surface of a limb, over the character's; the spikes of a puffer fish are smaller
SLENDER = 3.0  # least length of a limb over its radius, if it were a cylinder
OVERLAP = 0.5  # least common part of two limbs on the way outwards; a boot and a shin follow one another
APART = 0.15  # least mean distance of two limbs, over the shorter one's length; a sleeve and its arm are nearer
FREE = 0.35  # least share of the way to its tip on which a limb is alone; for fingers it is less
TOUCH = 0.75  # loose parts nearer than this are one limb, in cells
GROUND = 0.2  # largest distance from the tip of a leg to the lowest point, over the height


@dataclass(frozen=True, eq=False)
class Limb:
    """A limb of those that share their handles."""

    members: np.ndarray  # vertices of its lower parts, shape (m,)
    start: float  # distance from the body, along the mesh, at which it is on its own
    end: float  # distance of its tip
    area: float  # of its members


def limb_handles(side: str, family: tuple[str, ...]) -> list[int]:
    """Handles of the parts of a limb, from the body outwards."""
    return [HANDLE_NAMES.index(f"{side}_{part}") for part in family]


LEGS, ARMS = ([limb_handles(side, family) for side in SIDES] for family in FAMILIES)
"""Handles of the legs and of the arms, of each of `SIDES`."""
LIMB_HANDLES = [*LEGS[0], *ARMS[0], *LEGS[1], *ARMS[1]]


def has_extra_legs(handles: Handles) -> bool:
    """Whether some handles play parts of further limbs; what stands on a head is not a limb. One limb of such a body in
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
        regions = [weights[:, handles].sum(axis=1) > 0.5 for handles in (columns, columns[1:])]
        upper, lower = (_limbs(mesh, region, distance, before) if region.any() else ([], []) for region in regions)
        limbs, stubs = max(upper, lower, key=lambda found: (len(found[0]), len(found[1])))
        limbs.sort(key=lambda limb: (stands(mesh, limb), float(mesh.vertices[limb.members, 2].mean())))
        out[family, side] = limbs, stubs
    return out


def _limbs(
    mesh: NetworkMesh, region: np.ndarray, distance: np.ndarray, before: np.ndarray
) -> tuple[list[Limb], list[Limb]]:
    """Pieces of a region (M,) that are limbs, largest first, and those that are stubs; `before` is the vertex before
    each on the way from the body, negative on the body.
    """
    label = np.where(region, mesh_parts(_joined(mesh, region), len(region)), -1)
    areas = np.bincount(label[region], mesh.areas[region])
    large = np.flatnonzero(areas > max(AREA * areas.max(), LEAST * mesh.areas.sum()))
    limbs: list[Limb] = []
    for piece in large[np.argsort(-areas[large], kind="stable")]:
        members = np.flatnonzero(label == piece)
        nearest = int(members[distance[members].argmin()])
        if not _borne(nearest, before, label, set(large.tolist()) - {int(piece)}):
            limbs.append(Limb(members, float(distance[nearest]), float(distance[members].max()), float(areas[piece])))
    farthest = max((limb.end for limb in limbs), default=0.0)
    kept: list[Limb] = []
    stubs: list[Limb] = []
    for limb in limbs:
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
    inner = mesh.edges[mesh.components[mesh.edges[:, 0]] == mesh.components[mesh.edges[:, 1]]]
    where = np.flatnonzero(region)
    near = where[cKDTree(mesh.vertices[where]).query_pairs(TOUCH * mesh.cell, output_type="ndarray")]
    near = near[mesh.components[near[:, 0]] != mesh.components[near[:, 1]]]
    return np.concatenate([inner[region[inner].all(axis=1)], near])


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
    gaps = [float(np.average(cKDTree(far).query(near)[0], weights=mesh.areas[limb.members])) for near, far, limb in
            ((points[0], points[1], one), (points[1], points[0], other))]  # fmt: skip
    return min(gaps) >= APART * min(one.end - one.start, other.end - other.start)


def stands(mesh: NetworkMesh, limb: Limb) -> bool:
    """Whether a limb reaches the ground."""
    heights = mesh.vertices[:, 1]
    return bool(heights[limb.members].min() - heights.min() < GROUND * np.ptp(heights))


# Chosen by eye on the characters of the archive.
BLEND = 1.5  # how softly limbs meet, in cells
SPARE = 2e-3  # share of the surface below which a handle is spare: it would follow its parent
HELD = 3e-3  # share of the surface from which a part of a further limb gets a handle
TALL = 0.55  # least height of a person's head over the feet, over the extent; the head is also over the hips
_SPARE_FIRST = (
    "left_wing", "right_wing", "head_top", "face", "left_fingers", "right_fingers", "left_foot", "right_foot",
    "tail_tip", "tail",
    "left_collar", "right_collar", "spine1", "spine2", "spine3", "left_wrist", "right_wrist", "left_ankle",
    "right_ankle", "left_elbow",
    "right_elbow", "left_knee", "right_knee", "left_shoulder", "right_shoulder", "left_hip", "right_hip", "neck",
)  # fmt: skip


def _person(mesh: NetworkMesh, weights: np.ndarray) -> bool:
    """Whether a character stands upright and tall on its legs; further limbs are then clothes and weapons."""
    positions = handle_positions(mesh.vertices, weights, mesh.areas)
    names = ("pelvis", "head", "left_ankle", "right_ankle")
    pelvis, head, *feet = (positions[HANDLE_NAMES.index(name)] for name in names)
    return bool(head[1] - pelvis[1] > 2 * abs(head[2] - pelvis[2]) and head[1] - max(foot[1] for foot in feet) > TALL)


@dataclass(eq=False)
class _Split:
    """Limbs that share their handles."""

    columns: list[int]  # the handles
    legs: list[int]  # those of the leg of that side
    parts: np.ndarray  # what each of the handles weighs, shape (M, P)
    members: np.ndarray  # how much each vertex is of each limb, shape (M, L)
    stands: list[bool]  # which limbs stand on the ground
    side: int  # 0 for left, 1 for right
    # Further limbs of that side in families before this one. What the predictor calls the first leg of a crab, or its
    # last arm, is the same limb and should get the same handles.
    before: int

    def slot(self, limb: int, part: int) -> int:
        """The index of a part of a further limb among all that may need a handle."""
        return self.side + len(SIDES) * ((self.before + limb - 1) * len(self.columns) + part)

    def roles(self, limb: int) -> list[int]:
        """The handles whose parts a limb's handles play: a leg's where it stands on the ground."""
        return self.legs if self.stands[limb] else self.columns

    def masses(self, areas: np.ndarray) -> list[np.ndarray]:
        """Shares of the surface of the parts of each limb, shape (P,) each."""
        return [areas @ (self.parts * member[:, None]) for member in self.members.T]

    def owners(self, areas: np.ndarray, most: int, mirrored: _Split) -> list[list[int]]:
        """For each further limb, the part whose new handle each of its parts takes; at most this many handles a limb.

        Where both sides have as many limbs they are dealt with alike.
        """
        out, masses = [], self.masses(areas)
        if self.members.shape == mirrored.members.shape:
            masses = [0.5 * (plain + other) for plain, other in zip(masses, mirrored.masses(areas), strict=True)]
        for mass in masses[1:]:
            held = [number for number in range(len(mass)) if mass[number] >= HELD][:most] or [int(mass.argmax())]
            out.append([max((n for n in held if n <= number), default=held[0]) for number in range(len(mass))])
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
            on_ground = [stands(mesh, limb) for limb in limbs]
            splits[-1].append(_Split(columns, legs, out[:, columns], members, on_ground, number, before[number]))
            before[number] += len(limbs) - 1
    roles = np.arange(HANDLE_COUNT)
    dealt = _fitted(splits, areas, len(spare))
    for split, _ in dealt:
        out[:, split.columns] = split.parts * split.members[:, :1]
    further = [(split, limb, owner) for split, owners in dealt for limb, owner in enumerate(owners, 1)]
    queries = [(split, limb, part, owner) for split, limb, owner in further for part in sorted(set(owner))]
    wanted = [split.slot(limb, _canonical_part(part, owner)) for split, limb, part, owner in queries]
    fresh = _slots_of(wanted, len(SIDES) * max(before) * len(FAMILIES[0]), spare)
    for (split, limb, part, owner), handle in zip(queries, fresh, strict=True):
        roles[handle] = split.roles(limb)[_canonical_part(part, owner)]
        moved = [number for number, holder in enumerate(owner) if holder == part]
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
    """The part that a part's handle plays: the one nearest to the body plays the first, if that has no handle."""
    return 0 if part == owner[0] else part


def _slots_of(queries: list[int], slots: int, spare: list[int]) -> list[int]:
    """A spare handle for each slot that is asked for, so that a part more or less does not move the others.

    A slot has its own position in `_SPARE_FIRST`. Where the character uses that one itself, the slot has the next that
    no slot owns, and keeps it whether it is asked for or not, as long as there are enough.
    """
    handles = [HANDLE_NAMES.index(_SPARE_FIRST[slot]) if slot < len(_SPARE_FIRST) else -1 for slot in range(slots)]
    free = [handle for handle in spare if handle not in handles]
    index = [handle if handle in spare else free.pop(0) if free else -1 for handle in handles]
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


# Chosen by eye on heads of the archive; FREE_HILL with the files of benchmarks/foreign_files.md in view.
SLENDER_HILL = 4.0  # least slenderness: that of three quarters of a ball, which no lump on a head is
LONG = 0.05  # least length, over the character's extent; the grid's cells are about a third of that
PART = 0.45  # largest share of the head's surface; more is the head itself
FREE_HILL = 0.5  # least distance of its tip from the rest of the head, over its length: the inside of a mouth is nearer
ROOT = 0.3  # share of the length, from the root, over which it blends with the head
_HEAD = [HANDLE_NAMES.index(name) for name in ("head", "head_top", "face")]
_TOP = HANDLE_NAMES.index("head_top")
_SPARE_HANDLES = [
    HANDLE_NAMES.index(name)
    for name in ("face", "left_fingers", "right_fingers", "left_foot", "right_foot", "tail_tip", "tail", "left_wing",
                 "right_wing")
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Appendage:
    """A part that stands out from a head."""

    members: np.ndarray  # its vertices, shape (m,)
    root: float  # how far from the body its root is, along the mesh
    tip: float  # how far its tip is

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
    appendages = sorted(_hills(mesh, graph, distance, head & np.isfinite(distance)), key=lambda one: -one.length)
    rest = head.copy()
    for one in appendages:
        rest[one.members] = False
    return [one for one in appendages if _stands_off(mesh, rest, one)]


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
            for lower in others:
                hill.members += lower.members
        else:
            hill = hills[met[0]] if met else _Hill(level, 0.0, [])
        hill.area += area
        hill.members.append(vertex)
        label = met[0] if met else vertex
        merged[vertex], hills[label] = label, hill
        for other in met[1:]:
            merged[other] = label
        length = hill.tip - level
        if not hill.over and hill.area < most and length > LONG and 2 * np.pi * length**2 > SLENDER_HILL * hill.area:
            hill.best = Appendage(np.array(hill.members), level, hill.tip)
    for label, above in merged.items():
        best = hills[label].best if label == above else None
        if best is not None:
            yield best


def _stands_off(mesh: NetworkMesh, rest: np.ndarray, one: Appendage) -> bool:
    """Whether a hill stands off the rest of the head: the inside of a mouth and a mane on a neck do not."""
    if not rest.any():
        return False
    away = cKDTree(mesh.vertices[rest]).query(mesh.vertices[one.members])[0]
    return float(away.max()) > FREE_HILL * one.length


def appendage_shares(mesh: NetworkMesh, found: list[Appendage], distance: np.ndarray) -> np.ndarray:
    """How much each vertex is of each appendage, from 0 at its root to 1, shape (M, A)."""
    out = np.zeros((len(mesh.vertices), len(found)))
    for number, appendage in enumerate(found):
        way = np.clip((distance[appendage.members] - appendage.root) / (ROOT * appendage.length), 0, 1)
        out[appendage.members, number] = way * way * (3 - 2 * way)
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
    spare = [handle for handle in _SPARE_HANDLES if mesh.areas @ weights[:, handle] < SPARE * mesh.areas.sum()]
    appendages = find_appendages(mesh, weights, graph)[: len(spare)]
    if not appendages:
        return weights, full, None
    # Twins are nearly equally long, so their order by length would hang on the tessellation.
    appendages.sort(key=lambda one: -float(mesh.vertices[one.members, 0].mean()))
    head = weights[:, _HEAD].sum(axis=1) > 0.5
    distance = dijkstra(graph, indices=np.flatnonzero(~head), min_only=True)
    shares = appendage_shares(mesh, appendages, distance)
    roles = np.arange(HANDLE_COUNT)
    roles[spare[: len(appendages)]] = _TOP
    taken = spare[: len(appendages)]
    return _moved(weights, shares, taken), _moved(full, mesh.push_clean(shares), taken), roles


def _moved(weights: np.ndarray, shares: np.ndarray, taken: list[int]) -> np.ndarray:
    """Weights of which the head's share goes to the handles of its appendages; what these held goes to the head."""
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
