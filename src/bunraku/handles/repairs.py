"""What a predictor's weights break, repaired: limbs that are nowhere, parts of handles that lie apart, and edges that a
turn would tear.

A handle is one rigid motion about one joint. Where the predictor gives it two regions that do not touch (a hand and an
ear), the lesser one would fly about a joint that is not its own; and where its share rises steeply far from the joint,
a turn stretches the edges there. A limb of which no vertex is mainly a part is a doubt of the predictor's (the horns of
a monster are hands at a third), and its turns would shear what it holds.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES, HANDLE_PARENTS
from bunraku.body.reference import handle_positions
from bunraku.core.motion import line_up
from bunraku.geometry.graph import mean_operator, mesh_parts
from bunraku.geometry.simplify import NetworkMesh
from bunraku.handles.limbs import FAMILIES, SIDES, limb_handles

__all__ = ["edge_strain", "eased", "grown_from_heads", "hung_from_heads", "reunited", "without_doubts"]

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


def without_doubts(weights: np.ndarray) -> np.ndarray:
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


def grown_from_heads(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
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


def hung_from_heads(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
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


def reunited(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
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


def eased(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
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
