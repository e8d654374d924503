"""Linear blend skinning (Eq. 3 of TapMo) and its inverses: rigid registration, a few bones for a moving point set."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np


def skin(vertices: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Blend-skin [TapMo 3] vertices at rest [m] (V, 3) by weights (V, K) in every frame of affine transforms of handles
    (N, K, 3, 4), as one GEMM, (3N, 4K) @ (4K, V).

    Returns:
        Posed positions [m], shape (N, V, 3), float32: a view with coordinates apart; `result[n]` is cheap to make
            contiguous.
    """
    frames, count = transforms.shape[:2]
    basis = skin_basis(vertices, weights)
    left = np.ascontiguousarray(np.asarray(transforms, np.float32).transpose(0, 2, 1, 3)).reshape(3 * frames, 4 * count)
    return (left @ basis).reshape(frames, 3, len(vertices)).transpose(0, 2, 1)


def skin_basis(vertices: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The right factor of `skin`: weights times homogeneous rest positions, shape (4K, V), float32."""
    basis = np.empty((weights.shape[1], 4, len(vertices)), np.float32)
    columns = np.ascontiguousarray(weights.T, dtype=np.float32)
    for axis in range(3):
        np.multiply(columns, vertices[:, axis].astype(np.float32), out=basis[:, axis])
    basis[:, 3] = columns
    return basis.reshape(-1, len(vertices))


PULL = 1e-8
"""Share of the part's own variance by which the covariance is pulled towards the identity. Measured on the reference
body in six random poses: it rotates parts by 1e-4 degrees at most, a hundred times of it by 1e-2.
"""
EMPTY = 1e-9
"""Mean weight below which a part counts as empty. Measured on the reference body: its parts have 3e-3 or 0."""


def _shares(weights: np.ndarray) -> np.ndarray:
    """Columns that sum to 1, shape (V, K), float64; a column without weight becomes the plain mean."""
    weights = np.asarray(weights, np.float64)
    total = weights.sum(axis=0)
    empty = total <= EMPTY * len(weights)
    return np.where(empty, 1 / len(weights), weights / np.where(empty, 1, total))


def part_means(vertices: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Means of the vertices at rest [m] (V, 3) by weights (V, K), shape (K, 3), float64: the centres of the parts,
    which section 3.1 of TapMo takes for handle positions. A part without weight has the mean of all vertices.
    """
    return _shares(weights).T @ np.asarray(vertices, np.float64)


def register(
    source: np.ndarray, targets: np.ndarray, weights: np.ndarray, handles: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The rigid motion of every part in every frame (Besl & McKay 1992), of vertices x at rest [m] (V, 3) to targets
    [m] (N, V, 3) by weights that are not negative (V, K). Positions h [m] (K, 3) about which it is expressed are
    `part_means` by default.

    Returns:
        Rotations R (N, K, 3, 3) and translations t (N, K, 3) [m], float64: a point x of part k goes to `R (x - h_k) +
            h_k + t`.
    """
    source = np.asarray(source, np.float64)
    frames, count = len(targets), weights.shape[1]
    shares = _shares(weights)
    means = shares.T @ source
    arms = source[:, None] - means  # (V, K, 3)
    empty = np.asarray(weights, np.float64).sum(axis=0) <= EMPTY * len(source)
    basis = np.empty((len(source), 4, count))
    basis[:, :3] = (arms * shares[..., None]).transpose(0, 2, 1)
    basis[:, 3] = shares
    variance = (arms * arms).sum(-1)
    spread = np.einsum("vk,vk->k", variance, shares)

    middle = source.mean(axis=0)
    moved = np.ascontiguousarray((np.asarray(targets, np.float64) - middle).transpose(0, 2, 1))
    sums = (moved.reshape(3 * frames, -1) @ basis.reshape(len(source), -1)).reshape(frames, 3, 4, count)
    moved_means = sums[:, :, 3].transpose(0, 2, 1) + middle  # (N, K, 3)
    covariance = sums[:, :, :3].transpose(0, 3, 1, 2).copy()  # (N, K, target axis, source axis)
    covariance[:, empty] = 0
    covariance += (PULL * spread + (spread <= 0))[:, None, None] * np.eye(3)

    u, _, vt = np.linalg.svd(covariance)
    u[..., 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[..., None]
    rotations = u @ vt
    origin = means if handles is None else np.asarray(handles, np.float64)
    translations = moved_means - origin - np.einsum("nkij,kj->nki", rotations, means - origin)
    return rotations, translations


INFLUENCES = 4
CANDIDATES = 5
CLUSTERING, ROUNDS = 4, 4
FEW_FRAMES = 120
"""Frames by which bones are chosen and weights are fitted."""
_CHUNK = 2048


@dataclass(frozen=True, eq=False)
class RigidBones:
    """B bones and the weights of M points."""

    # rotations, translations: a point goes to `R p + t` [m], shapes (N, B, 3, 3) and (N, B, 3)
    rotations: np.ndarray
    translations: np.ndarray
    weights: np.ndarray  # at most four per point above 0, rows sum to 1, shape (M, B)
    error: float  # largest distance of a point from its goal in any frame [m]


def decomposed(rest: np.ndarray, posed: np.ndarray, bones: int) -> RigidBones:
    """The skin of a number of bones, at most as many as points, that comes closest to a movement of points at rest [m]
    (M, 3) to N frames (N, M, 3) (Le and Deng 2012).
    """
    rest, posed = np.asarray(rest, np.float64), np.asarray(posed, np.float64)
    frames = np.linspace(0, len(posed) - 1, min(FEW_FRAMES, len(posed))).astype(np.int64)
    few = posed[frames]
    weights = _clusters(rest, few, min(bones, len(rest)))
    turns, moves = _rigid(rest, posed, weights)
    for _ in range(ROUNDS):
        weights = _best_weights(rest, few, turns[frames], moves[frames])
        turns, moves = _refined(rest, posed, weights, turns, moves)
    weights = _best_weights(rest, few, turns[frames], moves[frames])
    worst = 0.0
    for start in range(0, len(posed), 64):
        cut = slice(start, start + 64)
        moved = _skinned(rest, weights, turns[cut], moves[cut])
        worst = max(worst, float(np.linalg.norm(moved - posed[cut], axis=-1).max()))
    return RigidBones(turns, moves, weights, worst)


def _skinned(rest: np.ndarray, weights: np.ndarray, turns: np.ndarray, moves: np.ndarray) -> np.ndarray:
    blend = np.einsum("mb,nbac->nmac", weights, np.concatenate([turns, moves[..., None]], axis=-1), optimize=True)
    return np.asarray(np.einsum("nmac,mc->nma", blend[..., :3], rest) + blend[..., 3])


def _clusters(rest: np.ndarray, posed: np.ndarray, bones: int) -> np.ndarray:
    """Assign each point to the bone whose rigid movement comes closest to its own, as weights (M, B)."""
    seeds, gap = [int(np.square(rest - rest.mean(axis=0)).sum(axis=1).argmax())], np.full(len(rest), np.inf)
    while len(seeds) < bones:  # spread in the rest pose, and where points move apart
        moved = posed[:: max(1, len(posed) // 8)]
        poses = np.concatenate([rest[None], moved])
        gap = np.minimum(gap, np.square(poses - poses[:, seeds[-1], None]).sum(axis=-1).mean(axis=0))
        seeds.append(int(gap.argmax()))
    owner = np.square(rest[:, None] - rest[seeds][None]).sum(axis=-1).argmin(axis=1)
    for _ in range(CLUSTERING):
        turns, moves = _rigid(rest, posed, np.eye(bones)[owner])
        owner = _Products.of(rest, posed, turns, moves).errors().argmin(axis=1)
        for empty in np.setdiff1d(np.arange(bones), owner):  # takes over the point that fits worst
            fit = np.square(_skinned(rest, np.eye(bones)[owner], turns, moves) - posed).sum(axis=(0, 2))
            owner[fit.argmax()] = empty
    return np.asarray(np.eye(bones)[owner])


def _rigid(rest: np.ndarray, posed: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rigid movement of the points of each bone (Procrustes)."""
    total = np.maximum(weights.sum(axis=0), 1e-9)
    middle = weights.T @ rest / total[:, None]
    now = np.einsum("mb,nma->nba", weights, posed, optimize=True) / total[None, :, None]
    turns = np.empty((len(posed), weights.shape[1], 3, 3))
    for bone in range(weights.shape[1]):
        rows = np.flatnonzero(weights[:, bone])
        away = (rest[rows] - middle[bone]) * weights[rows, bone][:, None]
        turns[:, bone] = np.einsum("nma,mc->nac", posed[:, rows] - now[:, bone, None], away, optimize=True)
    turns = _rotations(turns)
    return turns, now - np.einsum("nbac,bc->nba", turns, middle)


def _rotations(matrices: np.ndarray) -> np.ndarray:
    """The rotation nearest to each matrix; the identity for a zero matrix."""
    size = np.abs(matrices).max(axis=(-2, -1), keepdims=True)
    u, _, vt = np.linalg.svd(matrices / np.maximum(size, 1e-30) + 1e-6 * np.eye(3))
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]
    return np.asarray(u @ vt)


@dataclass(frozen=True, eq=False)
class _Products:
    """Products of where each bone alone takes the points and of where these go, summed over all frames: they give the
    squared error of any mixture without another look at the frames.
    """

    points: np.ndarray  # homogeneous points, shape (M, 4)
    square: np.ndarray  # of where the points go, shape (M,)
    cross: np.ndarray  # with where each bone takes them, shape (M, B)
    bones: np.ndarray  # of the bones with one another, shape (B, B, 4, 4)

    @classmethod
    def of(cls, rest: np.ndarray, posed: np.ndarray, turns: np.ndarray, moves: np.ndarray) -> _Products:
        """From bones in frames, seen from the mean of the points in each frame."""
        middle = posed.mean(axis=1)
        flat = (posed - middle[:, None]).transpose(1, 0, 2).reshape(len(rest), -1)
        homogeneous = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
        placed = np.concatenate([turns, (moves - middle[:, None])[..., None]], axis=-1)
        count = placed.shape[1]
        taken = np.ascontiguousarray(placed.transpose(1, 3, 0, 2)).reshape(4 * count, -1)
        cross = ((flat @ taken.T).reshape(len(rest), count, 4) * homogeneous[:, None]).sum(axis=-1)
        bones = (taken @ taken.T).reshape(count, 4, count, 4).transpose(0, 2, 1, 3)
        return cls(homogeneous, np.square(flat).sum(axis=1), cross, np.ascontiguousarray(bones))

    def errors(self) -> np.ndarray:
        """Squared distance of each point from where each bone alone takes it, over all frames, shape (M, B)."""
        every = np.arange(len(self.bones))
        pairs = (self.points[:, :, None] * self.points[:, None]).reshape(-1, 16)
        squared = pairs @ self.bones[every, every].reshape(-1, 16).T
        return np.asarray(squared - 2 * self.cross + self.square[:, None])

    def grams(self, rows: slice, columns: np.ndarray) -> np.ndarray:
        """For some points, products G of the errors of their C bones, shape (m, C, C): weights w that sum to 1 have the
        squared error w' G w.
        """
        points, cross = self.points[rows], np.take_along_axis(self.cross[rows], columns, axis=1)
        blocks = self.bones[columns[:, :, None], columns[:, None]]
        own = ((blocks @ points[:, None, None, :, None])[..., 0] * points[:, None, None]).sum(axis=-1)
        return np.asarray(own - cross[:, :, None] - cross[:, None] + self.square[rows, None, None])


def _best_weights(rest: np.ndarray, posed: np.ndarray, turns: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """The best weights for the bones, at least 0, rows sum to 1, at most four per point, shape (M, B)."""
    bones = turns.shape[1]
    out = np.zeros((len(rest), bones))
    products = _Products.of(rest, posed, turns, moves)
    near = np.argsort(products.errors(), axis=1)[:, : min(CANDIDATES, bones)]
    for start in range(0, len(rest), _CHUNK):
        rows = slice(start, start + _CHUNK)
        columns = near[rows]
        gram = products.grams(rows, columns)
        weights = np.zeros(columns.shape)
        least = np.full(len(weights), np.inf)
        for size in range(1, min(INFLUENCES, columns.shape[1]) + 1):
            for chosen in combinations(range(columns.shape[1]), size):
                block = gram[:, chosen][:, :, chosen]
                block = block + 1e-9 * (np.trace(block, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(size)
                share = np.linalg.solve(block, np.ones((len(block), size, 1)))[..., 0]
                share /= share.sum(axis=1, keepdims=True)
                error = np.einsum("mi,mij,mj->m", share, block, share)
                good = (share >= 0).all(axis=1) & (error < least * (1 - 1e-9))
                least = np.where(good, error, least)
                weights[good] = 0
                weights[np.ix_(good, chosen)] = share[good]
        np.put_along_axis(out[rows], columns, weights, axis=1)
    return out


def _refined(
    rest: np.ndarray, posed: np.ndarray, weights: np.ndarray, turns: np.ndarray, moves: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Update the bones one after the other, each to what the others leave (Le and Deng 2012, Eq. 8)."""
    turns, moves = turns.copy(), moves.copy()
    left = posed - _skinned(rest, weights, turns, moves)
    for bone in range(weights.shape[1]):
        rows = np.flatnonzero(weights[:, bone])
        if len(rows) < 3:
            continue
        share = weights[rows, bone]
        square = share**2 / (share**2).sum()
        middle = square @ rest[rows]

        def own(share: np.ndarray = share, rows: np.ndarray = rows, bone: int = bone) -> np.ndarray:
            moved = rest[rows] @ turns[:, bone].transpose(0, 2, 1) + moves[:, bone, None]
            return np.asarray(share[None, :, None] * moved)

        want = left[:, rows] + own()
        target = np.einsum("m,nma->na", share, want) / (share**2).sum()
        spread = want - share[None, :, None] * target[:, None]
        turn = _rotations(spread.transpose(0, 2, 1) @ (share[:, None] * (rest[rows] - middle)))
        turns[:, bone] = turn
        moves[:, bone] = target - turn @ middle
        left[:, rows] = want - own()
    return turns, moves
