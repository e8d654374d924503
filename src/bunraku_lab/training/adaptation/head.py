"""The linear layer of the adaptation while it is fine-tuned (Eq. 11 of TapMo)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

__all__ = ["AdaptationHead", "label_distance", "whitening"]


class AdaptationHead(nn.Module):
    """`adaptation_out` while it learns: its weights plus a change that is linear in whitened inputs.

    The frames of a token share most of the change.

    Args:
        weight: The layer's weights so far, shape (F * 3 K, D), for F frames a token.
        bias: Shape (F * 3 K,).
        white: Whitening of the inputs, shape (q, D).
        centre: Their mean, shape (D,).
        handles: K.
    """

    weight: Tensor
    bias: Tensor
    white: Tensor
    centre: Tensor

    def __init__(self, weight: Tensor, bias: Tensor, white: Tensor, centre: Tensor, handles: int):
        super().__init__()
        self.handles, self.patch = handles, len(weight) // (3 * handles)
        for name, value in (("weight", weight), ("bias", bias), ("white", white), ("centre", centre)):
            self.register_buffer(name, value.clone())
        self.shared = nn.Parameter(torch.zeros(3 * handles, len(white) + 1))
        self.apart = nn.Parameter(torch.zeros(self.patch, 3 * handles, len(white) + 1))

    def _change(self) -> Tensor:
        return (self.shared + 0.3 * self.apart).flatten(0, 1)

    def forward(self, seen: Tensor) -> Tensor:
        """Inputs (B, T, D) to (B, T, F, K, 3)."""
        inner = (seen - self.centre) @ self.white.T
        one = torch.ones_like(inner[..., :1])
        out = seen @ self.weight.T + self.bias + torch.cat([inner, one], -1) @ self._change().T
        return out.unflatten(-1, (self.patch, self.handles, 3))

    @torch.no_grad()
    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight and bias of the plain linear layer that does the same."""
        change = self._change()
        weight = self.weight + change[:, :-1] @ self.white
        return weight, self.bias + change[:, -1] - change[:, :-1] @ (self.white @ self.centre)


def whitening(seen: Tensor, hidden: int, mesh_size: int) -> tuple[Tensor, Tensor]:
    """What makes inputs even: hidden states by their main directions, the mesh token by at most `mesh_size` of its own.

    Args:
        seen: Inputs, shape (rows, D), of which the first `hidden` are hidden states.
        hidden: Their number d.
        mesh_size: Directions of the mesh token; 0 leaves it out.

    Returns:
        Whitening (q, D) and centre (D,).
    """
    centre = seen.mean(0)
    blocks = []
    for part, most in ((slice(0, hidden), hidden), (slice(hidden, seen.shape[1]), mesh_size)):
        values = seen[:, part] - centre[part]
        if not values.shape[1] or not most:
            continue
        spread, directions = torch.linalg.eigh((values.T @ values / len(values)).double())
        order = torch.arange(len(spread)).flip(0)[:most]
        spread, directions = spread[order], directions[:, order]
        kept = spread > 1e-4 * spread[0].clamp(min=1e-12)
        # directions that hardly vary are not blown up to the size of those that do
        scale = (spread[kept] + 0.01 * spread[0]).rsqrt()
        block = torch.zeros(int(kept.sum()), seen.shape[1])
        block[:, part] = (directions[:, kept] * scale).T.float()
        blocks.append(block)
    return torch.cat(blocks), centre


def label_distance(delta: Tensor, label: Tensor) -> Tensor:
    """[TapMo 11]: the squared distance of the adaptation from its pseudo-label, mean over frames and handles but the
    root [cm^2].

    Args:
        delta: What the layer says [m], shape (B, N, K, 3).
        label: What Eq. 10 says [m], shape (B, N, K, 3).
    """
    return (label - delta)[:, :, 1:].square().sum(-1).mean() * 1e4
