"""The rigid motions of all parts together that come closest to a moving mesh.

`bunraku.geometry.registration` fits each part on its own, as if its vertices moved with it alone. Where weights blend,
parts pull at the same vertices, and motions that know of one another rebuild the mesh better. This is the fixed-weight
half of skinning decomposition (Le & Deng 2012): each part in turn is fitted to what the others leave, which never makes
the fit worse.
"""

from __future__ import annotations

import numpy as np

__all__ = ["refine_registration"]

_LIGHT = 1e-3  # weight under which a vertex has no say in a part


def refine_registration(
    source: np.ndarray,
    targets: np.ndarray,
    weights: np.ndarray,
    transforms: np.ndarray,
    fixed: tuple[int, ...] = (),
    sweeps: int = 6,
) -> np.ndarray:
    """Improve the motions of parts so that their blend comes closer to the targets, in the sense of least squares.

    Args:
        source: Rest vertices x [m], shape (V, 3).
        targets: Moved vertices of each frame [m], shape (N, V, 3).
        weights: Skinning weights, rows sum to 1, shape (V, K).
        transforms: Affine motions to start from, `[R | o]` with x going to `sum_k w_k (R_k x + o_k)`, shape (N, K, 3,
            4).
        fixed: Parts whose motion stays.
        sweeps: How often each part is fitted.

    Returns:
        The motions, shape (N, K, 3, 4), float64; the sum of squared distances is no larger than before.
    """
    source, weights = np.asarray(source, np.float64), np.asarray(weights, np.float64)
    out = np.array(transforms, np.float64)
    homogeneous = np.concatenate([source, np.ones((len(source), 1))], axis=1)
    left = np.asarray(targets, np.float64) - np.einsum("vk,nkij,vj->nvi", weights, out, homogeneous, optimize=True)
    parts = [k for k in range(weights.shape[1]) if k not in fixed]
    own = {k: np.flatnonzero(weights[:, k] > _LIGHT) for k in parts}
    for _ in range(sweeps):
        for k in parts:
            rows = own[k]
            if len(rows) < 3:
                continue
            w, x = weights[rows, k], source[rows]
            wanted = left[:, rows] + w[:, None] * np.einsum(
                "nij,vj->nvi", out[:, k], homogeneous[rows]
            )  # w (R x + o), ideally
            square = w * w / (w @ w)
            centre, goal = square @ x, (w / (w @ w)) @ wanted  # (3,), (N, 3)
            covariance = np.einsum("v,nvi,vj->nij", w, wanted - w[:, None] * goal[:, None], x - centre)
            spread = float(np.einsum("v,vj,vj->", square, x - centre, x - centre)) * (w @ w)
            if spread <= 0:
                continue
            u, _, vt = np.linalg.svd(covariance + 1e-8 * spread * out[:, k, :, :3])
            u[..., 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[:, None]
            turn = u @ vt
            out[:, k, :, :3], out[:, k, :, 3] = turn, goal - turn @ centre
            left[:, rows] = wanted - w[:, None] * np.einsum("nij,vj->nvi", out[:, k], homogeneous[rows])
    return out
