"""A moving point set as a skin: few bones that move rigidly, and four weights of each point for them.

Smooth skinning decomposition with rigid bones (Le and Deng 2012): weights and bones are fitted in turn, each the best
there is for the other. The weights of a point are found exactly, by trying all sets of at most four of the bones that
are nearest to its movement.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

__all__ = ["RigidBones", "decomposed"]

INFLUENCES = 4
CANDIDATES = 5
CLUSTERING, ROUNDS = 4, 4
FEW_FRAMES = 120  # that bones are chosen and weights are fitted by
_CHUNK = 2048


@dataclass(frozen=True, eq=False)
class RigidBones:
    """B bones and the weights of M points.

    Args:
        rotations: Shape (N, B, 3, 3).
        translations: A point goes to `R p + t` [m], shape (N, B, 3).
        weights: At most four a point over 0, rows sum to 1, shape (M, B).
        error: Farthest that a point is from where it should be in any frame [m].
    """

    rotations: np.ndarray
    translations: np.ndarray
    weights: np.ndarray
    error: float


def decomposed(rest: np.ndarray, posed: np.ndarray, bones: int) -> RigidBones:
    """The skin of so many bones that is nearest to a movement.

    Args:
        rest: Points in the rest pose [m], shape (M, 3).
        posed: Points in N frames [m], shape (N, M, 3).
        bones: How many, at most as many as points.
    """
    rest, posed = np.asarray(rest, np.float64), np.asarray(posed, np.float64)
    some = np.linspace(0, len(posed) - 1, min(FEW_FRAMES, len(posed))).astype(np.int64)
    few = posed[some]
    weights = _clusters(rest, few, min(bones, len(rest)))
    turns, moves = _rigid(rest, posed, weights)
    for _ in range(ROUNDS):
        weights = _best_weights(rest, few, turns[some], moves[some])
        turns, moves = _refined(rest, posed, weights, turns, moves)
    weights = _best_weights(rest, few, turns[some], moves[some])
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
    """Each point with one bone, that whose rigid movement is nearest to its own, shape (M, B)."""
    seeds, gap = [int(np.square(rest - rest.mean(axis=0)).sum(axis=1).argmax())], np.full(len(rest), np.inf)
    while len(seeds) < bones:  # spread in the rest pose, and where points move apart
        moved = posed[:: max(1, len(posed) // 8)]
        own = np.concatenate([rest[None], moved])
        gap = np.minimum(gap, np.square(own - own[:, seeds[-1], None]).sum(axis=-1).mean(axis=0))
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
    """The rotation nearest to each matrix, the identity for those of nothing."""
    size = np.abs(matrices).max(axis=(-2, -1), keepdims=True)
    u, _, vt = np.linalg.svd(matrices / np.maximum(size, 1e-30) + 1e-6 * np.eye(3))
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]
    return np.asarray(u @ vt)


@dataclass(frozen=True, eq=False)
class _Products:
    """Products of where each bone alone takes points and of where these go, over all frames: with them square errors of
    any mixture are known without another look at the frames.

    Args:
        whole: Points with a 1 behind, shape (M, 4).
        square: Of where the points go, shape (M,).
        cross: With where each bone takes them, shape (M, B).
        bones: Of the bones with one another, shape (B, B, 4, 4).
    """

    whole: np.ndarray
    square: np.ndarray
    cross: np.ndarray
    bones: np.ndarray

    @classmethod
    def of(cls, rest: np.ndarray, posed: np.ndarray, turns: np.ndarray, moves: np.ndarray) -> _Products:
        """Of bones in frames, seen from the middle of the points in each frame."""
        middle = posed.mean(axis=1)
        flat = (posed - middle[:, None]).transpose(1, 0, 2).reshape(len(rest), -1)
        whole = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
        placed = np.concatenate([turns, (moves - middle[:, None])[..., None]], axis=-1)
        count = placed.shape[1]
        taken = np.ascontiguousarray(placed.transpose(1, 3, 0, 2)).reshape(4 * count, -1)
        cross = ((flat @ taken.T).reshape(len(rest), count, 4) * whole[:, None]).sum(axis=-1)
        bones = (taken @ taken.T).reshape(count, 4, count, 4).transpose(0, 2, 1, 3)
        return cls(whole, np.square(flat).sum(axis=1), cross, np.ascontiguousarray(bones))

    def errors(self) -> np.ndarray:
        """Square distance of each point from where each bone alone takes it, over all frames, shape (M, B)."""
        every = np.arange(len(self.bones))
        pairs = (self.whole[:, :, None] * self.whole[:, None]).reshape(-1, 16)
        own = pairs @ self.bones[every, every].reshape(-1, 16).T
        return np.asarray(own - 2 * self.cross + self.square[:, None])

    def grams(self, rows: slice, columns: np.ndarray) -> np.ndarray:
        """Of some points, products of how far each of C bones of theirs is off with how far each other is, shape (m, C,
        C): with weights w of a sum of 1 the square error is w' G w.
        """
        whole, cross = self.whole[rows], np.take_along_axis(self.cross[rows], columns, axis=1)
        blocks = self.bones[columns[:, :, None], columns[:, None]]
        own = ((blocks @ whole[:, None, None, :, None])[..., 0] * whole[:, None, None]).sum(axis=-1)
        return np.asarray(own - cross[:, :, None] - cross[:, None] + self.square[rows, None, None])


def _best_weights(rest: np.ndarray, posed: np.ndarray, turns: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """The weights that are best for the bones, not below 0 and with a sum of 1, at most four a point, shape (M, B)."""
    bones = turns.shape[1]
    out = np.zeros((len(rest), bones))
    products = _Products.of(rest, posed, turns, moves)
    near = np.argsort(products.errors(), axis=1)[:, : min(CANDIDATES, bones)]
    for start in range(0, len(rest), _CHUNK):
        rows = slice(start, start + _CHUNK)
        columns = near[rows]
        gram = products.grams(rows, columns)
        found = np.zeros(columns.shape)
        least = np.full(len(found), np.inf)
        for size in range(1, min(INFLUENCES, columns.shape[1]) + 1):
            for chosen in combinations(range(columns.shape[1]), size):
                own = gram[:, chosen][:, :, chosen]
                own = own + 1e-9 * (np.trace(own, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(size)
                share = np.linalg.solve(own, np.ones((len(own), size, 1)))[..., 0]
                share /= share.sum(axis=1, keepdims=True)
                error = np.einsum("mi,mij,mj->m", share, own, share)
                good = (share >= 0).all(axis=1) & (error < least * (1 - 1e-9))
                least = np.where(good, error, least)
                found[good] = 0
                found[np.ix_(good, chosen)] = share[good]
        np.put_along_axis(out[rows], columns, found, axis=1)
    return out


def _refined(
    rest: np.ndarray, posed: np.ndarray, weights: np.ndarray, turns: np.ndarray, moves: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Bones one after the other, each the best for what the others leave (Le and Deng 2012, Eq. 8)."""
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
