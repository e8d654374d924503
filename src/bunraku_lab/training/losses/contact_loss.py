"""The contact loss: a foot that stands in the true motion stands in the predicted one, at the same height and without
sliding.
"""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from bunraku.body.layout import HANDLE_NAMES
from bunraku.diffusion.features import HANDLE_SIZE, ROOT_SIZE
from bunraku.geometry.rotations import matrix_from_6d

__all__ = ["contact_loss", "foot_points"]

FEET = ("left_ankle", "left_foot", "right_ankle", "right_foot")
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
    from bunraku.body.reference import reference_body

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
