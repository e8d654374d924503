"""Losses on what moves: handle motions (Eq. 6 of TapMo), feet that stand, and the apparel of MMDMC's modules."""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.geometry.rotations import matrix_from_6d
from bunraku.generation.features import HANDLE_SIZE, ROOT_SIZE


def motion_losses(predicted: Tensor, clean: Tensor, lengths: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Motion Loss L_m of each row [TapMo 6], and its like for the change from frame to frame.

    Args:
        predicted: Predicted x0 in network units, shape (B, N, D).
        clean: True x0, shape (B, N, D).
        lengths: Real frames, shape (B,).
        weights: Weight of each feature, shape (D,), mean 1.

    Returns:
        Mean squared error (B,), and that of frame differences (B,); padded frames do not count.
    """
    error = (predicted.float() - clean) * weights.sqrt()
    real = torch.arange(clean.shape[1], device=clean.device) < lengths[:, None]
    error = error * real[..., None]
    features = clean.shape[-1]
    position = error.square().sum((1, 2)) / (lengths * features)
    change = (error[:, 1:] - error[:, :-1]) * real[:, 1:, None]
    return position, change.square().sum((1, 2)) / ((lengths - 1).clamp(min=1) * features)


FEET = ("left_ankle", "left_foot", "right_ankle", "right_foot")

# The shipped denoiser was trained with these.
NEAR = 0.05
"""Height [m] of a handle over its height at rest up to which it may stand."""
SLOW = 0.35
"""Speed [m/s] up to which it stands."""
UNIT = 0.3
"""Speed [m/s] that counts as one."""
HEIGHT_UNIT = 0.05
"""Error of height [m] that counts as one."""


@functools.cache
def _rest() -> tuple[list[int], Tensor, Tensor]:
    from bunraku.core.body.reference import reference_body

    positions = torch.from_numpy(reference_body().handles.positions.copy()).float()
    rows = [HANDLE_NAMES.index(name) for name in FEET]
    return rows, positions[rows], positions[0]


def foot_points(features: Tensor, fps: float = 20.0) -> tuple[Tensor, Tensor]:
    """Where the handles of the feet are, and how fast they move in the world.

    Args:
        features: Not normalised, shape (B, N, D), of motions of the reference body.
        fps: Frames a second [1/s].

    Returns:
        Positions in the heading's frame, over the ground [m], shape (B, N, 4, 3), and velocities in it [m/s], shape (B,
        N - 1, 4, 3), from each frame to the next.
    """
    rows, rest, root = _rest()
    rest, root = rest.to(features.device), root.to(features.device)
    starts = [ROOT_SIZE + HANDLE_SIZE * (row - 1) for row in rows]
    local = torch.stack([features[..., start : start + 3] for start in starts], dim=-2) + rest - root
    turn = matrix_from_6d(features[..., 4:10])
    points = torch.einsum("bnij,bnkj->bnki", turn, local) + root
    points = torch.cat([points[..., :1], points[..., 1:2] + features[..., None, 3:4], points[..., 2:]], dim=-1)
    # the frame before, seen from this frame's heading: turned back by the change of heading
    angle = -features[:, 1:, 0] / fps
    sine, cosine = angle.sin()[..., None], angle.cos()[..., None]
    before = points[:, :-1]
    x, z = before[..., 0], before[..., 2]
    turned = torch.stack([cosine * x + sine * z, before[..., 1], -sine * x + cosine * z], dim=-1)
    velocity = (points[:, 1:] - turned) * fps
    velocity = (
        velocity
        + torch.stack([features[:, 1:, 1], torch.zeros_like(features[:, 1:, 1]), features[:, 1:, 2]], dim=-1)[
            ..., None, :
        ]
    )
    return points, velocity


def contact_loss(predicted: Tensor, clean: Tensor, lengths: Tensor, of_body: Tensor) -> Tensor:
    """Loss of each row, shape (B,).

    Args:
        predicted: Predicted features, not normalised, shape (B, N, D).
        clean: True features, shape (B, N, D).
        lengths: Real frames, shape (B,).
        of_body: Rows that are of the reference body, shape (B,), bool; others count nothing.
    """
    rest = _rest()[1][:, 1].to(clean.device)
    with torch.no_grad():
        points, velocity = foot_points(clean.float())
        real = torch.arange(1, clean.shape[1], device=clean.device) < lengths[:, None]
        stands = (
            (points[:, 1:, :, 1] < rest + NEAR)
            & (velocity.norm(dim=-1) < SLOW)
            & real[..., None]
            & of_body[:, None, None]
        )
    found, speed = foot_points(predicted.float())
    slides = (speed / UNIT).square().sum(-1)
    lifted = ((found[:, 1:, :, 1] - points[:, 1:, :, 1]) / HEIGHT_UNIT).square()
    return ((slides + lifted).clamp(max=25.0) * stands).sum((1, 2)) / (real.sum(1) * len(FEET)).clamp(min=1)


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
