"""More limbs than two arms and two legs: spiders, crabs and insects.

The handles know one leg and one arm a side, so the predictor gives all the legs of a side the same ones, and they would move as
one rigid group about their common middle. Where the region of a limb is several limbs, each of the others gets handles of its
own: spare ones, that nothing else of the character uses. They play the part of the limb's handles (`Handles.roles`). What the
predictor takes for the arms of such a character and yet stands on the ground plays the part of a leg.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from bunraku.bodies.layout import HANDLE_COUNT, HANDLE_NAMES, HANDLE_PARENTS
from bunraku.bodies.reference import handle_positions
from bunraku.geometry.graph import mesh_parts
from bunraku.geometry.simplify import NetworkMesh

__all__ = ["FAMILIES", "Limb", "find_limbs", "split_limbs"]

FAMILIES: tuple[tuple[str, ...], ...] = (("hip", "knee", "ankle", "foot"), ("shoulder", "elbow", "wrist", "fingers"))
"""Parts of a limb, from the body outwards; a limb is found by all but the first."""

AREA = 0.15  # least surface of a further limb, over the largest one's
REACH = 0.45  # how far out a further limb reaches at the least, over the farthest one
LEAST = 0.008  # least surface of a limb, over the character's; the spikes of a puffer fish are smaller
SLENDER = 3.0  # least length of a limb over its radius, if it were a cylinder
OVERLAP = 0.5  # share of the way outwards that two limbs go side by side; a boot and a shin follow one another
APART = 0.15  # least mean distance of two limbs, over the shorter one's length; a sleeve and its arm are nearer
FREE = 0.35  # least share of the way from the body to its tip on which a limb is on its own; fingers are so for less
TOUCH = 0.75  # loose parts nearer than this are one limb, in cells
BLEND = 1.5  # how softly limbs meet, in cells
SPARE = 2e-3  # share of the surface under which a handle is spare; it would follow its parent
HELD = 3e-3  # share of the surface from which a part of a further limb gets a handle
GROUND = 0.2  # a limb whose tip is so near to the lowest point, over the height, is a leg
TALL = 0.55  # a character whose head is over its hips and so far above its feet, over its extent, is a person
_SIDES = ("left", "right")
_SPARE_FIRST = (
    "left_wing", "right_wing", "head_top", "face", "left_fingers", "right_fingers", "left_foot", "right_foot", "tail_tip", "tail",
    "left_collar", "right_collar", "spine1", "spine2", "spine3", "left_wrist", "right_wrist", "left_ankle", "right_ankle", "left_elbow",
    "right_elbow", "left_knee", "right_knee", "left_shoulder", "right_shoulder", "left_hip", "right_hip", "neck",
)  # fmt: skip


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


def _person(mesh: NetworkMesh, weights: np.ndarray) -> bool:
    """Whether a character stands upright and tall on its legs; what looks like further limbs are its clothes and weapons."""
    places = handle_positions(mesh.vertices, weights, mesh.areas)
    pelvis, head, *feet = (places[HANDLE_NAMES.index(name)] for name in ("pelvis", "head", "left_ankle", "right_ankle"))
    return bool(head[1] - pelvis[1] > 2 * abs(head[2] - pelvis[2]) and head[1] - max(foot[1] for foot in feet) > TALL)


def _columns(side: str, family: tuple[str, ...]) -> list[int]:
    return [HANDLE_NAMES.index(f"{side}_{part}") for part in family]


_ALL = [column for side in _SIDES for family in FAMILIES for column in _columns(side, family)]


def _graph(mesh: NetworkMesh) -> csr_matrix:
    """Lengths of the edges, bridges between loose parts included, shape (M, M)."""
    first, second = mesh.edges.T
    length = np.maximum(np.linalg.norm(mesh.vertices[first] - mesh.vertices[second], axis=1), 1e-6).astype(np.float64)
    count = len(mesh.vertices)
    return csr_matrix((np.tile(length, 2), (np.concatenate([first, second]), np.concatenate([second, first]))), shape=(count, count))


def find_limbs(mesh: NetworkMesh, weights: np.ndarray, columns: list[int]) -> tuple[list[Limb], list[Limb]]:
    """The limbs that share some handles, raised ones and then front ones first, and stubs beside them; fewer than two limbs where it is one or none.

    Candidates are the connected pieces of the region that the handles hold, or, where those hang together at the body, of what the
    lower parts hold. One counts as a limb of its own if it is about as large as the largest, goes out side by side with the others
    and apart from them, and meets the body by itself: weapons, shields and boots meet it through the limb that bears them. What
    does all that but reaches less far, as the fangs of a spider, is a stub.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, shape (M, K).
        columns: Handles of the parts of the limb, from the body outwards.
    """
    body = weights[:, _ALL].sum(axis=1) < 0.5
    if not body.any():
        return [], []
    distance, before, _ = dijkstra(_graph(mesh), indices=np.flatnonzero(body), min_only=True, return_predecessors=True)
    regions = [weights[:, some].sum(axis=1) > 0.5 for some in (columns, columns[1:])]
    whole, lower = (_limbs(mesh, region, distance, before) if region.any() else ([], []) for region in regions)
    limbs, stubs = max(whole, lower, key=lambda found: (len(found[0]), len(found[1])))
    return sorted(limbs, key=lambda limb: (_stands(mesh, limb), -float(mesh.vertices[limb.members, 2].mean()))), stubs


def _limbs(mesh: NetworkMesh, region: np.ndarray, distance: np.ndarray, before: np.ndarray) -> tuple[list[Limb], list[Limb]]:
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
        elif all(_side_by_side(limb, other) and _apart(mesh, limb, other) for other in kept):
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


def _side_by_side(one: Limb, other: Limb) -> bool:
    shared = min(one.end, other.end) - max(one.start, other.start)
    return shared >= OVERLAP * min(one.end - one.start, other.end - other.start)


def _apart(mesh: NetworkMesh, one: Limb, other: Limb) -> bool:
    points = [mesh.vertices[limb.members] for limb in (one, other)]
    gaps = [float(np.average(cKDTree(far).query(own)[0], weights=mesh.areas[limb.members])) for own, far, limb in
            ((points[0], points[1], one), (points[1], points[0], other))]  # fmt: skip
    return min(gaps) >= APART * min(one.end - one.start, other.end - other.start)


@dataclass(eq=False)
class _Split:
    """Limbs that share their handles.

    Args:
        columns: The handles.
        legs: Those of the leg of that side.
        parts: What each of the handles weighs, shape (M, P).
        members: How much each vertex is of each limb, shape (M, L).
        stands: Which limbs stand on the ground.
    """

    columns: list[int]
    legs: list[int]
    parts: np.ndarray
    members: np.ndarray
    stands: list[bool]

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

    What spare handles held goes to their parents. Where there are too few of them, the parts of further limbs are joined from
    the far end, and then the hindmost limbs with those before them. Only characters with further limbs on both sides are split.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, rows sum to 1, shape (M, 30).

    Returns:
        Weights of the same shape, and the handle whose part each handle plays, shape (30,); None where nothing was split.
    """
    if _person(mesh, weights):
        return weights, None
    found = {(family, side): find_limbs(mesh, weights, _columns(side, family)) for family in FAMILIES for side in _SIDES}
    if any(all(len(found[family, side][0]) < 2 for family in FAMILIES) for side in _SIDES):
        return weights, None
    areas = mesh.areas / mesh.areas.sum(dtype=np.float64)
    spare = [handle for handle in map(HANDLE_NAMES.index, _SPARE_FIRST) if areas @ weights[:, handle] < SPARE]
    out, graph = _without(weights, spare), _graph(mesh)
    splits: list[list[_Split]] = []
    for family in FAMILIES:
        splits.append([])
        for side in _SIDES:
            limbs, stubs = found[family, side]
            if len(limbs) < 2:
                continue
            columns = _columns(side, family)
            members = _membership(mesh, graph, limbs + stubs)
            for number, stub in enumerate(stubs, len(limbs)):
                held = out[:, columns] * members[:, number : number + 1]
                out[:, columns] -= held
                out[:, _body_handle(mesh, out, stub)] += held.sum(axis=1)
            members = members[:, : len(limbs)] / members[:, : len(limbs)].sum(axis=1, keepdims=True)
            legs = _columns(side, FAMILIES[0])
            splits[-1].append(_Split(columns, legs, out[:, columns], members, [_stands(mesh, limb) for limb in limbs]))
    roles = np.arange(HANDLE_COUNT)
    dealt = _fitted(splits, areas, len(spare))
    spare = sorted(spare[: sum(len(set(owner)) for _, owners in dealt for owner in owners)])  # handles of a limb follow one another
    for split, _ in dealt:
        out[:, split.columns] = split.parts * split.members[:, :1]
    for split, owners in dealt:
        for limb, owner in enumerate(owners, 1):
            fresh = {part: spare.pop(0) for part in sorted(set(owner))}
            for part, own in enumerate(owner):
                roles[fresh[own]] = split.roles(limb)[0 if own == owner[0] else own]
                out[:, fresh[own]] += split.parts[:, part] * split.members[:, limb]
    if (roles == np.arange(HANDLE_COUNT)).all():
        return weights, None
    for side in _SIDES:
        arm, (limbs, _) = np.array(_columns(side, FAMILIES[1])), found[FAMILIES[1], side]
        if limbs and _stands(mesh, limbs[0]):
            kept = roles[arm] == arm
            roles[arm[kept]] = np.array(_columns(side, FAMILIES[0]))[kept]
    return (out / out.sum(axis=1, keepdims=True)).astype(np.float32), roles


def _fitted(splits: list[list[_Split]], areas: np.ndarray, room: int) -> list[tuple[_Split, list[list[int]]]]:
    """Every split with the owners of its parts (`_Split.owners`), as many handles as there is room for; both sides of a family alike."""
    most = [len(family) for family in FAMILIES]
    while True:
        dealt = [
            (split, split.owners(areas, most[number], family[-1 - side])) for number, family in enumerate(splits) for side, split in enumerate(family)
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
    places = handle_positions(mesh.vertices, weights, mesh.areas)
    away = np.linalg.norm(places - mesh.vertices[stub.members].mean(axis=0), axis=1)
    away[mesh.areas @ weights < SPARE * mesh.areas.sum()] = np.inf
    away[_ALL] = np.inf
    return int(away.argmin())


def _stands(mesh: NetworkMesh, limb: Limb) -> bool:
    """Whether a limb reaches the ground."""
    heights = mesh.vertices[:, 1]
    return bool(heights[limb.members].min() - heights.min() < GROUND * np.ptp(heights))


def _membership(mesh: NetworkMesh, graph: csr_matrix, limbs: list[Limb]) -> np.ndarray:
    """How much each vertex belongs to each limb, by the way along the mesh, shape (M, L), rows sum to 1."""
    gaps = np.stack([dijkstra(graph, indices=limb.members, min_only=True) for limb in limbs], axis=1)
    closeness = np.exp((gaps.min(axis=1, keepdims=True) - gaps) / (BLEND * mesh.cell))
    return np.asarray(closeness / closeness.sum(axis=1, keepdims=True))


def _deal(
    mesh: NetworkMesh, base: np.ndarray, members: dict[tuple[str, tuple[str, ...]], np.ndarray], spare: list[int]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Give the spare handles to the parts of the further limbs."""
    raise NotImplementedError
