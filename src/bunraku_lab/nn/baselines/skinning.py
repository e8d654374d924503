"""Linear blend skinning of the baselines, in torch."""

from __future__ import annotations

import torch

__all__ = ["moved_by"]


def moved_by(rest: torch.Tensor, weights: torch.Tensor, affine: torch.Tensor) -> torch.Tensor:
    """Linear blend skinning, shape (P, V, 3).

    Args:
        rest: One rest pose for all, shape (V, 3), or one for each pose, shape (P, V, 3).
        weights: Shape (V, J).
        affine: Affine transforms of the joints, shape (P, J, 3, 4).
    """
    blended = torch.einsum("vj,pjab->pvab", weights, affine)
    return (blended[..., :3] @ rest.expand(len(affine), -1, -1)[..., None])[..., 0] + blended[..., 3]
