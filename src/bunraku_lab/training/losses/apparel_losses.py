"""The losses of MMDMC's modules: apparel mask, body, apparel displacement, joint refinement. The paper weighs vertices
by 1, edges by 100 and smoothness and the size of the refinement by 0.01; our lengths are in metres, and what each run
takes is in its settings.
"""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["edge_loss", "mask_loss", "refinement_loss", "smoothness_loss", "vertex_loss"]


def mask_loss(logits: Tensor, truth: Tensor) -> Tensor:
    """Binary cross entropy of the apparel mask, L_b of section 4.1 [MMDMC 3].

    The paper's formula has the two arguments in each other's place and no sign; this is what it means.

    Args:
        logits: Before the sigmoid, shape (N,).
        truth: 1 for apparel, shape (N,).
    """
    return torch.nn.functional.binary_cross_entropy_with_logits(logits, truth)


def vertex_loss(points: Tensor, truth: Tensor) -> Tensor:
    """Mean L1 distance of points, L_vb and L_va [MMDMC 8] [MMDMC 14].

    Args:
        points: Predicted [m], shape (..., N, 3).
        truth: True [m], shape (..., N, 3).
    """
    return (points - truth).abs().sum(-1).mean()


def edge_loss(points: Tensor, rest: Tensor, edges: Tensor) -> Tensor:
    """Mean change of the lengths of edges from the rest pose, L_eb and L_ea [MMDMC 9] [MMDMC 15].

    Args:
        points: Predicted [m], shape (..., N, 3).
        rest: In the rest pose [m], shape (N, 3) or as the points.
        edges: Pairs of points, shape (E, 2).
    """
    now = _lengths(points, edges)
    return (now - _lengths(rest, edges)).abs().mean() if len(edges) else points.sum() * 0


def smoothness_loss(weights: Tensor, edges: Tensor) -> Tensor:
    """Mean change of the skinning weights over edges, L_s of section 4.2 [MMDMC 10].

    Args:
        weights: W, shape (N, J).
        edges: Pairs of vertices, shape (E, 2).
    """
    return (weights[edges[:, 0]] - weights[edges[:, 1]]).square().sum(-1).add(1e-12).sqrt().mean()


def refinement_loss(change: Tensor) -> Tensor:
    """Mean square of what the joint refinement adds, L_r of section 4.4.

    Args:
        change: Of each vertex, shape (..., N, 3).
    """
    return change.square().sum(-1).mean()


def _lengths(points: Tensor, edges: Tensor) -> Tensor:
    gap = points[..., edges[:, 0], :] - points[..., edges[:, 1], :]
    return gap.square().sum(-1).add(1e-12).sqrt()
