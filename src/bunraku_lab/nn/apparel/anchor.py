"""The head that cannot drift: displacement of apparel from a window of motion alone.

It sees the motion through the filters of `features`, and none of its own output: the same motion gives the same apparel
whatever went before, a minute in as in the first second. The displacement is a mixture of the vectors that a node is
given (sways, lags, tilt, pushes out of the body), with weights that the network sets, and a rest.
"""

from __future__ import annotations

import torch
from torch import nn

from bunraku.apparel.displacement.features import BASIS, GLOBAL
from bunraku.apparel.displacement.weights import MOTION, MOTION_HIDDEN, NODE_INPUT, SHARE
from bunraku_lab.nn.apparel.graph import EdgeBlock, NodeGraph

__all__ = ["AnchorHead", "Inputs", "NodeEncoder"]


class Inputs:
    """Features of M nodes in one frame each.

    Args:
        static_vectors: Shape (M, STATIC_VECTORS, 3).
        static_scalars: Shape (M, STATIC_SCALARS).
        vectors: Shape (M, VECTORS, 3).
        scalars: Shape (M, SCALARS).
        whole: Of each character, shape (B, GLOBAL).
        graph: Of all nodes.
    """

    def __init__(
        self, static_vectors: torch.Tensor, static_scalars: torch.Tensor, vectors: torch.Tensor, scalars: torch.Tensor,
        whole: torch.Tensor, graph: NodeGraph,
    ):  # fmt: skip
        self.static_vectors, self.static_scalars, self.vectors, self.scalars = (
            static_vectors, static_scalars, vectors, scalars,
        )  # fmt: skip
        self.whole, self.graph = whole, graph

    def nodes(self) -> torch.Tensor:
        """All numbers of each node, shape (M, NODE_INPUT)."""
        return torch.cat(
            [self.static_vectors.flatten(1), self.static_scalars, self.vectors.flatten(1), self.scalars], dim=1
        )


class NodeEncoder(nn.Module):
    """Features of nodes through an MLP and edge convolutions.

    Args:
        extra: Numbers of each node beside those of `Inputs`.
        width: Channels.
        blocks: Edge convolutions.
        motion: Channels of the encoded motion f_t(T).
    """

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, extra: int = 0, width: int = 96, blocks: int = 2, motion: int = MOTION):
        super().__init__()
        count = NODE_INPUT + extra
        self.register_buffer("mean", torch.zeros(count))
        self.register_buffer("std", torch.ones(count))
        self.motion = nn.Sequential(nn.Linear(GLOBAL, MOTION_HIDDEN), nn.GELU(), nn.Linear(MOTION_HIDDEN, motion))
        self.enter = nn.Sequential(
            nn.Linear(count + motion, width), nn.GELU(), nn.Linear(width, width), nn.LayerNorm(width)
        )  # without the norm the features grow a hundredfold in training, and the decoder dies
        self.blocks = nn.ModuleList(EdgeBlock(width) for _ in range(blocks))

    def forward(self, nodes: torch.Tensor, inputs: Inputs) -> torch.Tensor:
        """Shape (M, NODE_INPUT + extra) -> (M, width)."""
        known = ((nodes - self.mean) / self.std).clamp(-6, 6)
        x: torch.Tensor = self.enter(torch.cat([known, self.motion(inputs.whole)[inputs.graph.owner]], dim=1))
        for block in self.blocks:
            x = block(x, inputs.graph)
        return x


class AnchorHead(nn.Module):
    """The head.

    Args:
        width, blocks: As in `NodeEncoder`.
    """

    def __init__(self, width: int = 96, blocks: int = 2):
        super().__init__()
        self.encoder = NodeEncoder(0, width, blocks)
        last = nn.Linear(width, BASIS + 3)
        self.decoder = nn.Sequential(nn.Linear(width, width), nn.GELU(), last)
        nn.init.normal_(last.weight, 0, 1e-3)
        nn.init.zeros_(last.bias)

    def forward(self, inputs: Inputs) -> torch.Tensor:
        """Displacement of each node in the frame of its carrying joint, over the character's size, shape (M, 3)."""
        out = self.decoder(self.encoder(inputs.nodes(), inputs))
        share = SHARE * torch.tanh(out[:, :BASIS])
        mixed: torch.Tensor = torch.einsum("mk,mka->ma", share, inputs.vectors[:, :BASIS]) + out[:, BASIS:]
        return mixed
