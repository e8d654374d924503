"""Repairs of predicted skinning weights: limbs that are not there, hair on arms, parts of handles that lie apart, and
small loose parts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from bunraku.anatomy.handles.limbs import FAMILIES, LIMB_HANDLES, SIDES, limb_handles
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.body.reference import handle_positions
from bunraku.core.geometry.axes import directions_about, goes_round
from bunraku.core.geometry.graph import mean_operator, mesh_parts
from bunraku.core.geometry.simplify import NetworkMesh
from bunraku.core.motion import line_up

__all__ = [
    "LooseParts",
    "ears_to_head",
    "edge_strain",
    "find_loose_parts",
    "hair_off_arms",
    "hair_to_head",
    "joined_regions",
    "seat_parts",
    "without_doubtful_limbs",
    "without_torn_edges",
]


TOUCH = 1.5  # loose parts nearer than this touch, in cells
HELD = 0.35  # a vertex belongs to the region of a handle that holds so much of it
APART = 0.06  # least distance of a stray region from the main one, as a share of the extent; fingers are nearer
SURELY = 0.5  # a limb is there if it holds so much of some vertex
LESSER = 0.5  # a region apart is a stray one if it is smaller than this share of the main one
TURN = np.radians(60)  # a limb turns so far in walks
MOST = 2.0  # an edge may grow by so much of its length in such a turn
SHARP = 1e-4  # share of the surface under which two parts do not blend where they meet
ROOTED = 0.9  # so much of what is around a piece of an arm is of the head: it is an ear, a horn, a tusk or a trunk
TRUNK = 0.15  # least share of the surface of a trunk that would bear arms; what is all head has them on its head
HUNG = 0.05  # of a loose part that the head holds: it is hair, or a veil, and not a sleeve
ROOT, ROOTS = 0.15, 0.5  # of its height, that is its root; share of that which the head holds
OTHER = 0.3  # of the trunk that such a part is: more is the body itself
LIMB = 0.7  # the same of a limb, of which long hair takes more than is left
ROUNDS = 16  # of softening
LEAST_TAIL = 0.004  # share of the surface from which what hangs behind the hips is a tail, and not a flap
_LIMBS = [
    i for i, name in enumerate(HANDLE_NAMES) if name.startswith(("left_", "right_")) or name in ("tail", "tail_tip")
]
_LEGS = [i for i, name in enumerate(HANDLE_NAMES) if name.endswith(("hip", "knee", "ankle", "foot"))]
_HEAD = [HANDLE_NAMES.index(name) for name in ("head", "head_top", "face", "neck")]
_TOP = HANDLE_NAMES.index("head_top")
_TRUNK = [HANDLE_NAMES.index(name) for name in ("pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar")]
_TAIL, _TIP = HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")
_WHOLE = [[limb_handles(side, family) for side in SIDES] for family in FAMILIES] + [[[_TAIL, _TIP]]]
"""The handles of each limb, left and right; not wings, of which a trace tells that a body flies."""
_LINES = [line_up(handle, HANDLE_PARENTS) for handle in range(HANDLE_COUNT)]
_SUBTREES = [[other for other, line in enumerate(_LINES) if handle in line] for handle in range(HANDLE_COUNT)]
"""Each handle with those below it."""


def without_doubtful_limbs(weights: np.ndarray) -> np.ndarray:
    """Weights without the limbs that hold no vertex by `SURELY` on either side; what they held is shared by the other
    handles of its vertices.

    Args:
        weights: Of vertices, rows sum to 1, shape (M, 30).
    """
    out = np.array(weights, np.float64)
    for sides in _WHOLE:
        if max(float(weights[:, limb].sum(axis=1).max()) for limb in sides) < SURELY:
            out[:, np.concatenate(sides)] = 0
    left = out.sum(axis=1, keepdims=True)
    return np.where(left > 0, out / np.maximum(left, 1e-12), weights).astype(np.float32)


def ears_to_head(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
    """Weights in which what grows from a head is no arm: ears, horns, tusks and a trunk are what stands on the head.

    An arm of a body with a trunk meets that trunk. A piece of an arm's region that meets the head alone goes to the
    handle of the head's top, so it moves with the head about its own root; beside a larger piece that does meet the
    trunk it would fly about a joint that is not its own.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, rows sum to 1, shape (M, 30).
    """
    areas = mesh.areas.astype(np.float64)
    if areas @ weights[:, _TRUNK].sum(axis=1) < TRUNK * areas.sum():
        return weights
    out = np.array(weights, np.float64)
    edges = _touching(mesh)
    for side in SIDES:
        arm = limb_handles(side, FAMILIES[1])
        held = weights[:, arm].sum(axis=1) > SURELY
        if not held.any():
            continue
        label = np.where(held, mesh_parts(edges[held[edges].all(axis=1)], len(held)), -1)
        for piece in (label == number for number in np.unique(label[held])):
            around = out[_rim(edges, piece)].sum(axis=0)
            around[arm] = 0
            if around.sum() > 0 and around[_HEAD].sum() > ROOTED * around.sum():
                near = piece | (np.bincount(edges[piece[edges].any(axis=1)].ravel(), minlength=len(piece)) > 0)
                out[near, _TOP] += out[near][:, arm].sum(axis=1)
                out[np.ix_(near, arm)] = 0
    return (out / out.sum(axis=1, keepdims=True)).astype(np.float32)


def hair_to_head(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
    """Weights in which no loose part that hangs from the head goes with a limb that it lies on: twin tails and long
    hair are not dragged by hands and knees.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, rows sum to 1, shape (M, 30).
    """
    areas = mesh.areas.astype(np.float64)
    part = mesh.components

    def held(handles: list[int], share: np.ndarray = areas) -> np.ndarray:
        return np.bincount(part, share * weights[:, handles].sum(axis=1), part.max() + 1)

    height = mesh.vertices[:, 1]
    low, high = np.full(part.max() + 1, np.inf), np.full(part.max() + 1, -np.inf)
    np.minimum.at(low, part, height)
    np.maximum.at(high, part, height)
    top = height >= (high - ROOT * (high - low))[part]
    trunk, everywhere = held(_TRUNK), list(range(weights.shape[1]))
    hangs = held(_HEAD, areas * top) > ROOTS * held(everywhere, areas * top)
    loose = hangs & (held(_HEAD) > HUNG * held(everywhere)) & (trunk < OTHER * trunk.sum())
    out = np.array(weights, np.float64)
    for limb in (limb_handles(side, family) for side in SIDES for family in FAMILIES):
        own = held(limb)
        rows = np.flatnonzero((loose & (own < LIMB * own.sum()))[part])
        out[rows, _TOP] += out[rows][:, limb].sum(axis=1)
        out[rows[:, None], limb] = 0
    return out.astype(np.float32)


def joined_regions(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
    """Weights in which no limb's handle holds two regions that do not touch: the lesser ones go back to the handles
    around them.

    What lies apart from a leg and hangs behind the hips in the middle of the body is a tail, and gets the tail's
    handles where they hold nothing yet.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, rows sum to 1, shape (M, 30).
    """
    out = np.array(weights, np.float64)
    edges = _touching(mesh)
    areas = mesh.areas.astype(np.float64)
    spare_tail = areas @ weights[:, [_TAIL, _TIP]].sum(axis=1) < LEAST_TAIL * areas.sum()
    for handle in _LIMBS:
        held = out[:, handle] > HELD
        if not held.any():
            continue
        label = np.where(held, mesh_parts(edges[held[edges].all(axis=1)], len(held)), -1)
        mass = np.bincount(label[held], areas[held] * out[held, handle])
        pieces = np.flatnonzero(mass > 0)
        tails = [piece for piece in pieces if handle in _LEGS and spare_tail and _is_tail(mesh, out, label == piece)]
        main = max((piece for piece in pieces if piece not in tails), key=lambda piece: mass[piece], default=-1)
        for piece in pieces:
            stray = label == piece
            if piece == main or main < 0 or _gap(mesh, stray, label == main) < APART:
                continue
            if piece in tails:
                out[stray, _TAIL] += out[stray, handle]
                out[stray, handle] = 0
            elif mass[piece] < LESSER * mass[main]:
                _give_back(mesh, out, stray, handle)
    return (out / out.sum(axis=1, keepdims=True)).astype(np.float32)


def _touching(mesh: NetworkMesh) -> np.ndarray:
    """Edges without the bridges, and pairs of vertices on different loose parts that touch, shape (E, 2)."""
    own = mesh.edges[mesh.components[mesh.edges[:, 0]] == mesh.components[mesh.edges[:, 1]]]
    near = cKDTree(mesh.vertices).query_pairs(TOUCH * mesh.cell, output_type="ndarray")
    near = near[mesh.components[near[:, 0]] != mesh.components[near[:, 1]]]
    return np.concatenate([own, near])


def _gap(mesh: NetworkMesh, piece: np.ndarray, other: np.ndarray) -> float:
    """Least distance of two sets of vertices, as a share of the extent."""
    return float(cKDTree(mesh.vertices[other]).query(mesh.vertices[piece])[0].min())


def _is_tail(mesh: NetworkMesh, weights: np.ndarray, piece: np.ndarray) -> bool:
    """Whether a piece hangs behind the hips, in the middle of the body."""
    hips = handle_positions(mesh.vertices, weights.astype(np.float32), mesh.areas)[0]
    points, areas = mesh.vertices[piece], mesh.areas[piece]
    position = np.average(points, axis=0, weights=areas)
    behind = position[2] < hips[2] - 2 * mesh.cell
    middle = abs(position[0] - hips[0]) < 0.15 * np.ptp(mesh.vertices[:, 0])
    return bool(behind and middle and areas.sum() > LEAST_TAIL * mesh.areas.sum())


def _rim(edges: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """Vertices beside a piece, as often as edges lead to them."""
    first, second = edges.T
    return np.concatenate([second[piece[first] & ~piece[second]], first[piece[second] & ~piece[first]]])


def _give_back(mesh: NetworkMesh, weights: np.ndarray, piece: np.ndarray, handle: int) -> None:
    """Give what a handle holds of a piece to the handles that hold the piece's surroundings, in place."""
    rim = _rim(mesh.edges, piece)
    around = weights[rim].sum(axis=0) if len(rim) else weights[piece].sum(axis=0)
    around[handle] = 0
    if around.sum() <= 1e-9:
        return
    weights[piece] += weights[piece, handle][:, None] * (around / around.sum())
    weights[piece, handle] = 0


def edge_strain(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
    """By how much of its length each edge grows at the most when a limb turns by `TURN` about its joint, shape (E,).

    A vertex v of which the limb holds the share W goes to `v + W (R - I) (v - j)`, so an edge grows by the difference
    of W over its ends times `2 sin(TURN / 2)` times the distance from the joint j.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, shape (M, 30).
    """
    first, second = mesh.edges.T
    points = mesh.vertices.astype(np.float64)
    length = np.maximum(np.linalg.norm(points[first] - points[second], axis=1), 0.25 * mesh.cell)
    middle = 0.5 * (points[first] + points[second])
    out = np.zeros(len(mesh.edges))
    for handle in _LIMBS:
        share = weights[:, _SUBTREES[handle]].sum(axis=1)
        step = np.abs(share[first] - share[second])
        if float(mesh.areas @ weights[:, handle]) <= 0 or step.sum() <= 0:
            continue
        overlap = mesh.areas * share * (1 - share)
        if overlap.sum() > SHARP * mesh.areas.sum():
            joint = overlap @ points / overlap.sum()
        else:  # parts that meet without a blend
            joint = step @ middle / step.sum()
        away = np.linalg.norm(middle - joint, axis=1)
        out = np.maximum(out, 2 * np.sin(TURN / 2) * step * away / length)
    return out


def without_torn_edges(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
    """Weights softened where a limb's turn would stretch an edge by more than `MOST` of its length.

    Only vertices of such edges change, and, where that is not enough, those around them; bridges between loose parts
    are no edges.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, rows sum to 1, shape (M, 30).
    """
    own = mesh.components[mesh.edges[:, 0]] == mesh.components[mesh.edges[:, 1]]
    mean: csr_matrix = mean_operator(mesh.edges[own], len(weights))
    out = np.array(weights, np.float64)
    active = np.zeros(len(out), bool)
    for _ in range(ROUNDS):
        torn = own & (edge_strain(mesh, out) > MOST)
        if not torn.any():
            break
        active[mesh.edges[torn]] = True
        around = active | (np.asarray(mean @ active) > 0)
        out[around] = 0.5 * out[around] + 0.5 * np.asarray(mean @ out)[around]
    return (out / out.sum(axis=1, keepdims=True)).astype(np.float32)


ARM_HELD = 0.1  # a vertex goes with an arm that holds so much of it
DRAPED_ROOT, DRAPED_ROOTS = (
    0.15,
    0.5,
)  # of a part's height, that is its root; share of that which the limbs hold at the most
FEWEST = 12  # vertices of a part


def hair_off_arms(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
    """Weights in which a loose part that hangs from the head or the trunk goes with no arm that it does not go round;
    what the arm held goes to the other handles of its vertices, or else to those of its root.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, rows sum to 1, shape (M, 30).
    """
    part, areas = mesh.components, mesh.areas.astype(np.float64)
    out = np.array(weights, np.float64)
    others = np.setdiff1d(np.arange(HANDLE_COUNT), LIMB_HANDLES)
    places = handle_positions(mesh.vertices, weights, mesh.areas)
    for arm in (np.array(limb_handles(side, FAMILIES[1])) for side in SIDES):
        held = weights[:, arm].sum(axis=1) > ARM_HELD
        angle = directions_about(mesh.vertices, places[arm[0]], places[arm[-1]])
        for number in np.unique(part[held]):
            own = part == number
            mine = own & held
            if own.sum() < FEWEST or goes_round(angle[mine]):
                continue
            height = mesh.vertices[own, 1]
            rows = np.flatnonzero(own)
            top = rows[height >= height.max() - DRAPED_ROOT * np.ptp(height)]
            root = areas[top] @ weights[top][:, others]
            if root.sum() < DRAPED_ROOTS * areas[top].sum():
                continue
            away = out[np.ix_(rows, arm)].sum(axis=1)
            out[np.ix_(rows, arm)] = 0
            left = out[rows].sum(axis=1)
            kept = left > 0.5
            out[rows[kept]] *= ((left + away) / np.maximum(left, 1e-9))[kept, None]
            out[np.ix_(rows[~kept], others)] += away[~kept, None] * root / root.sum()
    return out.astype(np.float32)


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
POWER = 3
TOUCHES = 0.012  # parts nearer than this touch, as a share of the character's extent
TINY = 0.008  # share of the surface under which a piece is no limb, however sure its handle is
_SKULL = [HANDLE_NAMES.index(name) for name in ("head", "head_top", "face")]
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
    heads = own[:, _SKULL].sum(axis=1) if own.shape[1] == HANDLE_COUNT else np.zeros(count)
    hair = single & (own.max(axis=1) < CLEAR[1]) & (heads > CLEAR[0])  # it holds to the head, whatever shares it
    rows[hair] = np.eye(own.shape[1])[min(_SKULL[0], own.shape[1] - 1)]
    rows **= POWER
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
                row = row**POWER
                rows[piece], share[piece] = row / row.sum(), 1.0
        waiting &= ~fresh
    flecks = waiting & (areas < TINY * areas.sum())
    for piece in np.flatnonzero(flecks):  # it touches nothing, and is no limb: it stays with what it lies nearest to
        on = (label == piece) & (parts.host >= 0)
        if on.any():
            nearest = on & (parts.gap <= parts.gap[on].min() + _NEAR)
            row = mesh.push_surface(weights, parts.host[nearest]).mean(axis=0) ** POWER
            rows[piece], share[piece] = row / row.sum(), 1.0
    for part in np.flatnonzero(sits):  # what sits on a piece that follows follows too
        on = parts.host[label == part]
        host = np.bincount(label[on[on >= 0]], minlength=len(sits)).argmax()
        rows[part] = (1 - share[host]) * rows[part] + share[host] * rows[host]


def _jointed(handle: int, other: int) -> bool:
    """Whether two handles are one, or at most two joints apart."""
    lines = line_up(handle, HANDLE_PARENTS), line_up(other, HANDLE_PARENTS)
    return sum(len(set(one) - set(both)) for one, both in (lines, lines[::-1])) <= 2
