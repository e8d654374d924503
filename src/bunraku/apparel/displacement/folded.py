"""The displacement network for one clothed character, frame by frame: what never changes is worked into its matrices.

It says what `AnchorHead` and `RecurrentPart` say, to float rounding, in less time: the static features and the
biases are one sum, the pose of the body is one row that is added, no module is called, and what is small is done in
numpy, each of whose operations costs a fraction of torch's.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy.special import erf, expit
from torch.nn import functional as F

from bunraku.apparel.displacement import anchor as head
from bunraku.apparel.displacement import recurrent as memory
from bunraku.apparel.displacement.anchor import AnchorHead
from bunraku.apparel.displacement.features import BASIS, STATIC_SCALARS, STATIC_VECTORS
from bunraku.apparel.displacement.graph import EdgeBlock, NodeGraph
from bunraku.apparel.displacement.network import DisplacementNetwork
from bunraku.apparel.displacement.recurrent import RecurrentPart

__all__ = ["FoldedNetwork", "FoldedPast"]

_STILL = 3 * STATIC_VECTORS + STATIC_SCALARS
FoldedPast = tuple[np.ndarray, np.ndarray, np.ndarray]
"""`recurrent.Past` as arrays: `rest`, `whole` and `places`."""


class FoldedNetwork:
    """The network as it is at this moment; weights that change later do not count.

    Args:
        network: The network.
        static_vectors, static_scalars: Of the character's nodes (`static_features`).
        graph: Of the nodes.
    """

    def __init__(
        self, network: DisplacementNetwork, static_vectors: np.ndarray, static_scalars: np.ndarray, graph: NodeGraph
    ):
        still = torch.from_numpy(np.concatenate([static_vectors.reshape(len(static_scalars), -1), static_scalars], 1))
        self.world = network.recurrent is not None and network.recurrent.world
        with torch.no_grad():
            self._anchor = _FoldedPart(network.anchor, still, graph)
            self._recurrent = None if network.recurrent is None else _FoldedPart(network.recurrent, still, graph)

    def anchor(self, vectors: np.ndarray, scalars: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """What the head says (`AnchorHead`), shape (M, 3).

        Args:
            vectors: Shape (M, VECTORS, 3).
            scalars: Shape (M, SCALARS).
            whole: Shape (GLOBAL,).
        """
        out = self._anchor(_moving(vectors, scalars), whole)
        share = head.MOST * np.tanh(out[:, :BASIS])
        return np.asarray(np.matmul(share[:, None], vectors[:, :BASIS])[:, 0] + out[:, BASIS:])

    def recurrent(
        self, vectors: np.ndarray, scalars: np.ndarray, whole: np.ndarray, past: FoldedPast, anchor: np.ndarray,
        turns: np.ndarray, positions: np.ndarray,
    ) -> tuple[np.ndarray, FoldedPast]:  # fmt: skip
        """The next displacement (M, 3) and the new past; the first three as above, the rest as
        `RecurrentPart.forward` takes them, whose formula this is.
        """
        assert self._recurrent is not None
        rest, given, been = past
        change, before = rest[0] - rest[1], rest[1] - rest[2]
        state = [rest[0], change, change - before]
        if self.world:
            now = rest[0] + self._recurrent(_moving(vectors, scalars, *state), whole)
            moved = _back(turns, now - positions)
            return moved, (np.stack([now, rest[0], rest[1]]), np.stack([moved, given[0]]), been)
        inertia = _back(turns, 2 * been[0] - been[1] - positions) - given[0]
        late, own_change = given[0] - anchor, given[0] - given[1]
        head_change = rest[0] - late
        speed = np.sqrt(np.einsum("ma,ma->m", own_change, own_change))[:, None]
        own = [*state, inertia, late, own_change, head_change, speed]
        out = self._recurrent(_moving(vectors, scalars, *own), whole)
        most = np.maximum(np.maximum(out[:, 1:2], out[:, 2:3]), 0)
        swing, gate = np.exp(out[:, 1:2] - most), np.exp(out[:, 2:3] - most)
        shared = (swing * change + gate * inertia) / (swing + gate + np.exp(-most))
        kept = rest[0] + shared - (1 - expit(out[:, 3:4])) * head_change
        left = memory.KEEP * expit(out[:, :1]) * kept + memory.MOST * np.tanh(out[:, 4:] / memory.MOST)
        moved = anchor + left
        now = positions + np.einsum("mab,mb->ma", turns, moved)
        return moved, (np.stack([left, rest[0], rest[1]]), np.stack([moved, given[0]]), np.stack([now, been[0]]))


class _FoldedPart:
    """Encoder and decoder of the head or of the recurrent part."""

    def __init__(self, part: AnchorHead | RecurrentPart, still: torch.Tensor, graph: NodeGraph):
        encoder: Any = part.encoder  # whose layers torch knows as modules of any kind
        first, self.second, self.norm = encoder.enter[0], encoder.enter[2], encoder.enter[3]
        own = encoder.mean.shape[0]
        known = ((still - encoder.mean[:_STILL]) / encoder.std[:_STILL]).clamp(-6, 6)
        still = F.linear(known, first.weight[:, :_STILL], first.bias)
        self.mean, self.std = encoder.mean[_STILL:].numpy(), encoder.std[_STILL:].numpy()
        self.moving = first.weight[:, _STILL:own].t().contiguous()
        # the second map of the motion's MLP and that of its result are one
        enter, leave = encoder.motion[0], encoder.motion[2]
        self.motion = enter.weight.numpy(), enter.bias.numpy()
        pose = first.weight[:, own:]
        self.pose = (pose @ leave.weight).numpy()
        self.still = (still + pose @ leave.bias).numpy()
        self.blocks = [_FoldedBlock(block, graph) for block in encoder.blocks]
        self.decoder = part.decoder[0], part.decoder[2]

    def __call__(self, moving: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """What the decoder says of numbers that change from frame to frame, shapes (M, MOVING), which it takes to
        write on, and (GLOBAL,) -> (M, C).
        """
        moving -= self.mean
        moving /= self.std
        np.maximum(moving, -6, out=moving)
        np.minimum(moving, 6, out=moving)
        hidden = self.motion[0] @ whole + self.motion[1]
        pose = self.pose @ (0.5 * hidden * (1 + erf(hidden * np.float32(np.sqrt(0.5)))))
        with torch.inference_mode():
            x = F.gelu(torch.addmm(torch.from_numpy(self.still + pose), torch.from_numpy(moving), self.moving))
            x = _normed(self.norm, _linear(self.second, x))
            for block in self.blocks:
                x = block(x)
            return np.asarray(_linear(self.decoder[1], F.gelu(_linear(self.decoder[0], x))))


class _FoldedBlock:
    """`EdgeBlock`, whose edge convolution is (W1 - W2) x_i + b + max_j W2 x_j."""

    def __init__(self, block: EdgeBlock, graph: NodeGraph):
        self.norm: Any = block.norm
        self.part, self.pooled = graph.part, block.pooled.weight
        own, neighbour = block.edge.own, block.edge.neighbour
        self.own, self.bias, self.neighbour = own.weight - neighbour.weight, own.bias, neighbour.weight
        # all first neighbours, then all second ones: the maximum over them is one over rows that lie together
        self.around = graph.around.view(len(graph.position), -1).t().reshape(-1)
        width = len(self.bias)
        self.rows, self.least = graph.part[:, None].expand(-1, width), torch.full((graph.parts, width), -1e4)

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        values = F.linear(x, self.neighbour)
        most = values.index_select(0, self.around).view(-1, *x.shape).amax(dim=0)
        largest = torch.scatter_reduce(self.least, 0, self.rows, x, "amax")
        pooled = F.linear(largest, self.pooled).index_select(0, self.part)
        hidden = F.linear(x, self.own, self.bias).add_(pooled).add_(most)
        return F.gelu(_normed(self.norm, hidden)).add_(x)


def _moving(vectors: np.ndarray, *numbers: np.ndarray) -> np.ndarray:
    """What changes from frame to frame of each node, in the order of `Inputs.nodes`, shape (M, MOVING)."""
    return np.concatenate([vectors.reshape(len(vectors), -1), *numbers], axis=1, dtype=np.float32)


def _back(turns: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors of the world in the frames of the joints, shapes (M, 3, 3) and (M, 3) -> (M, 3)."""
    return np.asarray(np.einsum("mba,mb->ma", turns, vectors))


def _linear(layer: Any, x: torch.Tensor) -> torch.Tensor:
    return F.linear(x, layer.weight, layer.bias)


def _normed(layer: torch.nn.LayerNorm, x: torch.Tensor) -> torch.Tensor:
    return F.layer_norm(x, layer.normalized_shape, layer.weight, layer.bias, layer.eps)
