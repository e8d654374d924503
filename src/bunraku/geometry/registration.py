"""Weighted rigid registration of all parts in all frames at once (Besl & McKay 1992).

A part k is the column k of a weight matrix. Its handle h_k is the weighted mean of the rest vertices, and its motion in
a frame is the rotation R and translation t that bring `R (x - h_k) + h_k + t` closest to the moved vertices in the
sense of weighted least squares. This is the form of the local transforms of Eq. 3 of TapMo.

The covariances of all parts and frames are one matrix product; the rotations are one batch of 3x3 singular value
decompositions with the sign of the last singular value set so that no part is mirrored. Everything is in double
precision inside.

Parts that do not fix a rotation (one point, points on one line) take the solution nearest to the identity: a tiny
multiple of the identity is added to the covariance, far below what a proper part has. A part without weight does not
turn and follows the mean of all vertices.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import torch

__all__ = ["part_means", "register", "register_reference", "register_torch"]

_PULL = 1e-8  # share of the part's own variance by which the covariance is pulled to the identity
_EMPTY = 1e-9  # mean weight under which a part counts as empty


def _shares(weights: np.ndarray) -> np.ndarray:
    """Columns that sum to 1, shape (V, K), float64; a column without weight becomes the plain mean."""
    weights = np.asarray(weights, np.float64)
    total = weights.sum(axis=0)
    empty = total <= _EMPTY * len(weights)
    return np.where(empty, 1 / len(weights), weights / np.where(empty, 1, total))


def part_means(vertices: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted means of the vertices: the centres of the parts, which section 3.1 of TapMo takes for handle positions.

    Args:
        vertices: Rest positions [m], shape (V, 3).
        weights: Skinning weights, shape (V, K).

    Returns:
        Means h [m], shape (K, 3), float64. A part without weight has the mean of all vertices.
    """
    return _shares(weights).T @ np.asarray(vertices, np.float64)


def register(
    source: np.ndarray, targets: np.ndarray, weights: np.ndarray, handles: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The rigid motion of every part in every frame (Besl & McKay 1992).

    Args:
        source: Rest vertices x [m], shape (V, 3).
        targets: Moved vertices of each frame [m], shape (N, V, 3).
        weights: Skinning weights, not negative, shape (V, K).
        handles: Positions h [m] about which the motions are expressed, shape (K, 3); the weighted means of the source
            (`part_means`) when not given.

    Returns:
        Rotations R (N, K, 3, 3) and translations t (N, K, 3) [m], float64: a point x of part k goes to `R (x - h_k) +
        h_k + t`.
    """
    source = np.asarray(source, np.float64)
    frames, count = len(targets), weights.shape[1]
    shares = _shares(weights)
    means = shares.T @ source
    arms = source[:, None] - means  # (V, K, 3)
    empty = np.asarray(weights, np.float64).sum(axis=0) <= _EMPTY * len(source)
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
    covariance += (_PULL * spread + (spread <= 0))[:, None, None] * np.eye(3)

    u, _, vt = np.linalg.svd(covariance)
    u[..., 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[..., None]
    rotations = u @ vt
    origin = means if handles is None else np.asarray(handles, np.float64)
    translations = moved_means - origin - np.einsum("nkij,kj->nki", rotations, means - origin)
    return rotations, translations


def register_reference(
    source: np.ndarray, target: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`register` of one part in one frame as the paper has it.

    Args:
        source: Rest vertices [m], shape (V, 3).
        target: Moved vertices [m], shape (V, 3).
        weight: The part's weights, shape (V,), not all zero; the points must not lie on one line.

    Returns:
        Handle h (3,), rotation R (3, 3) and translation t (3,).
    """
    handle = np.average(source, axis=0, weights=weight)
    middle = np.average(target, axis=0, weights=weight)
    covariance = np.zeros((3, 3))
    for x, y, w in zip(source, target, weight, strict=True):
        covariance += w * np.outer(y - middle, x - handle)
    u, _, vt = np.linalg.svd(covariance)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return handle, rotation, middle - handle


def register_torch(
    source: torch.Tensor, targets: torch.Tensor, weights: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """`register` for training: differentiable in the weights, the source and the targets.

    The rotation's gradient is that of the polar factor, `U [(B - B^T) / (s_i + s_j)] V^T` with B the incoming gradient
    in the frames of U and V. It divides by sums of singular values, not by their differences as the gradient of an SVD
    does, so it is finite where singular values coincide. Where a sum vanishes too (points on a line), the rotation
    takes no gradient.

    Args:
        source: Rest vertices [m], shape (V, 3).
        targets: Moved vertices [m], shape (N, V, 3).
        weights: Skinning weights, shape (V, K).

    Returns:
        Rotations (N, K, 3, 3), translations (N, K, 3) [m] and handles (K, 3) [m], in the type of the source.
    """
    import torch

    kind = source.dtype
    source, targets, weights = source.double(), targets.double(), weights.double()
    total = weights.sum(0)
    empty = total <= _EMPTY * len(source)
    shares = torch.where(
        empty, torch.full_like(weights, 1 / len(source)), weights / torch.where(empty, torch.ones_like(total), total)
    )
    means = shares.T @ source
    arms = source[:, None] - means
    spread = (arms.detach().square().sum(-1) * shares.detach()).sum(0)
    middle = source.detach().mean(0)
    moved = targets - middle
    moved_means = torch.einsum("nvi,vk->nki", moved, shares) + middle
    covariance = torch.einsum("nvi,vkj->nkij", moved, arms * (shares * ~empty)[..., None])
    covariance = covariance + (_PULL * spread + (spread <= 0))[:, None, None] * torch.eye(
        3, dtype=covariance.dtype, device=covariance.device
    )
    rotations = _polar_rotation(covariance)
    return rotations.to(kind), (moved_means - means).to(kind), means.to(kind)


def _polar_rotation(matrix: torch.Tensor) -> torch.Tensor:
    """The nearest rotation to each 3x3 matrix, shape [..., 3, 3], with a gradient that stays finite."""
    import torch

    class Polar(torch.autograd.Function):
        @staticmethod
        def forward(ctx: Any, value: torch.Tensor) -> torch.Tensor:
            u, s, vt = torch.linalg.svd(value)
            sign = torch.sign(torch.linalg.det(u) * torch.linalg.det(vt))
            flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], -1)
            u, s = u * flip[..., None, :], s * flip
            ctx.save_for_backward(u, s, vt)
            return u @ vt

        @staticmethod
        def backward(ctx: Any, *gradients: Any) -> torch.Tensor:
            u, s, vt = ctx.saved_tensors
            b = u.mT @ gradients[0] @ vt.mT
            sums = s[..., :, None] + s[..., None, :]
            safe = sums > 1e-6 * s[..., :1, None]
            inner = torch.where(safe, (b - b.mT) / torch.where(safe, sums, torch.ones_like(sums)), torch.zeros_like(b))
            return u @ inner @ vt

    result: torch.Tensor = Polar.apply(matrix)  # type: ignore[no-untyped-call]
    return result
