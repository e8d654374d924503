"""The displacement network f_d (MMDMC 4.3): its weights, and how it runs frame by frame for one character."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.special import erf, expit

from bunraku.apparel.learned.features import BASIS, GLOBAL, SCALARS, STATIC_SCALARS, STATIC_VECTORS, VECTORS
from bunraku.apparel.nodes import EdgeBlock, NodeGraph
from bunraku.core.nn.checkpoints import config_of, load_network
from bunraku.core.nn.layers import Weights, gelu

# What the networks were trained with.
STILL = 3 * STATIC_VECTORS + STATIC_SCALARS  # features of a node that never change
NODE_INPUT = STILL + 3 * VECTORS + SCALARS  # features of a node in a frame
OWN_STATE, WORLD_STATE = 7 * 3 + 1, 9
"""Features of a node's past for the recurrent part, in the frame of its joint, and in the paper's form."""
SET = 7  # outputs of the recurrent part for a node


@dataclass(frozen=True)
class DisplacementConfig:
    """Shape of the network."""

    width: int = 96  # channels of the head
    blocks: int = 2  # its edge convolutions
    recurrent: int = 64  # channels of the recurrent part, 0 for the head alone
    # "joint" remembers the difference from the head in the frame of the carrying joint; "world" is the paper's Eq. 11
    # as it stands, positions in the world from the pelvis, without the head
    frame: Literal["joint", "world"] = "joint"
    motion: tuple[int, int] = (64, 24)  # channels of the MLP of the encoded motion f_t(T), and of its output
    share: float = 1.5  # largest weight of a basis vector in the head
    keep: float = 0.97  # largest share of the difference from the head that a frame leaves
    change: float = 0.04  # largest change of that difference in a frame, over the character's size


class DisplacementPart:
    """Encoder and decoder of the head or of the recurrent part, `width` channels wide. `extra` are features of a node
    beside `NODE_INPUT`, `outputs` its numbers for a node.
    """

    def __init__(self, config: DisplacementConfig, width: int, extra: int, outputs: int, weights: Weights):
        encoder, count = weights.part("encoder"), NODE_INPUT + extra
        self.config, self.world = config, config.frame == "world"
        hidden, motion = config.motion
        self.mean, self.std = encoder.array("mean", count), encoder.array("std", count)
        self.motion = encoder.linear("motion.0", GLOBAL, hidden), encoder.linear("motion.2", hidden, motion)
        self.enter = encoder.linear("enter.0", count + motion, width), encoder.linear("enter.2", width, width)
        self.norm = encoder.norm("enter.3", width)
        self.blocks = [EdgeBlock(width, encoder.part(f"blocks.{index}")) for index in range(config.blocks)]
        self.decoder = weights.linear("decoder.0", width, width), weights.linear("decoder.2", width, outputs)


class DisplacementNetwork:
    """The head that cannot drift, and the recurrent part about it. ValueError if the weights have other sizes than the
    config.
    """

    def __init__(self, config: DisplacementConfig, weights: Weights):
        self.config = config
        self.anchor = DisplacementPart(config, config.width, 0, BASIS + 3, weights.part("anchor"))
        self.recurrent: DisplacementPart | None = None
        if config.recurrent:
            extra, outputs = (WORLD_STATE, 3) if config.frame == "world" else (OWN_STATE, SET)
            self.recurrent = DisplacementPart(config, config.recurrent, extra, outputs, weights.part("recurrent"))


def load_displacement(path: str | Path) -> DisplacementNetwork:
    """Read a checkpoint of kind "apparel", ready to use. WeightsError if the file is missing, damaged, of another kind,
    or its weights do not fit its config.
    """
    return load_network(
        path, "apparel", lambda shape, weights: DisplacementNetwork(config_of(DisplacementConfig, shape), weights)
    )


FoldedPast = tuple[np.ndarray, np.ndarray, np.ndarray]
"""The last three states, newest first: differences from the head (in the paper's form positions from the pelvis), shape
(3, M, 3); the last two displacements that were given out, (2, M, 3); and the positions of these frames, (2, M, 3).
"""


def past_of_states(
    part: DisplacementPart, states: np.ndarray, heads: np.ndarray, turns: np.ndarray, positions: np.ndarray
) -> FoldedPast:
    """The past after three frames with known displacements.

    Args:
        part: The network that goes on from it.
        states: Displacements, in the frames of the carrying joints, oldest first, shape (3, M, 3).
        heads: Output of the head in these frames, shape (3, M, 3).
        turns: Frames of the carrying joints, shape (3, M, 3, 3).
        positions: Carried positions over the character's size; from the pelvis in the paper's form, shape (3, M, 3).
    """
    world = positions + np.einsum("fmab,fmb->fma", turns, states)
    rest = world if part.world else states - heads
    return rest[::-1], states[::-1][:2], world[::-1][:2]


class FoldedNetwork:
    """The network folded for one character, by its `static_features` and the graph of its nodes."""

    def __init__(
        self, network: DisplacementNetwork, static_vectors: np.ndarray, static_scalars: np.ndarray, graph: NodeGraph
    ):
        still = np.concatenate([static_vectors.reshape(len(static_scalars), -1), static_scalars], axis=1)
        self.config = network.config
        self.world = network.recurrent is not None and network.recurrent.world
        self._anchor = _FoldedPart(network.anchor, still, graph)
        self._recurrent = None if network.recurrent is None else _FoldedPart(network.recurrent, still, graph)

    def anchor(self, vectors: np.ndarray, scalars: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """Output of the head, (M, 3), from vectors (M, VECTORS, 3), scalars (M, SCALARS) and the pose (GLOBAL,)."""
        out = self._anchor(_moving(vectors, scalars), whole)
        share = self.config.share * np.tanh(out[:, :BASIS])
        return np.asarray(np.matmul(share[:, None], vectors[:, :BASIS])[:, 0] + out[:, BASIS:])

    def recurrent(
        self, vectors: np.ndarray, scalars: np.ndarray, whole: np.ndarray, past: FoldedPast, anchor: np.ndarray,
        turns: np.ndarray, positions: np.ndarray,
    ) -> tuple[np.ndarray, FoldedPast]:  # fmt: skip
        """The next displacement (M, 3) and the new past; the first three as above, the rest as of the laboratory's
        `RecurrentPart.forward`, which has the same formula.
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
        inputs = [*state, inertia, late, own_change, head_change, speed]
        out = self._recurrent(_moving(vectors, scalars, *inputs), whole)
        most = np.maximum(np.maximum(out[:, 1:2], out[:, 2:3]), 0)
        swing, gate = np.exp(out[:, 1:2] - most), np.exp(out[:, 2:3] - most)
        shared = (swing * change + gate * inertia) / (swing + gate + np.exp(-most))
        kept = rest[0] + shared - (1 - expit(out[:, 3:4])) * head_change
        most = self.config.change
        left = self.config.keep * expit(out[:, :1]) * kept + most * np.tanh(out[:, 4:] / most)
        moved = anchor + left
        now = positions + np.einsum("mab,mb->ma", turns, moved)
        return moved, (np.stack([left, rest[0], rest[1]]), np.stack([moved, given[0]]), np.stack([now, been[0]]))


class _FoldedPart:
    def __init__(self, part: DisplacementPart, still: np.ndarray, graph: NodeGraph):
        first, self.second = part.enter
        width = len(part.mean)
        scaled = np.clip((still - part.mean[:STILL]) / part.std[:STILL], -6, 6)
        still = scaled @ first.matrix[:STILL] + first.bias
        self.mean, self.std = part.mean[STILL:], part.std[STILL:]
        self.moving = first.matrix[STILL:width]
        # the second map of the motion's MLP and that of its result are one
        enter, leave = part.motion
        self.motion = enter
        pose = first.matrix[width:]
        self.pose = leave.matrix @ pose
        self.still = (still + leave.bias @ pose).astype(np.float32)
        self.norm, self.blocks, self.decoder, self.graph = part.norm, part.blocks, part.decoder, graph

    def __call__(self, moving: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """Output of the decoder for changing features (M, MOVING), which it writes on, and (GLOBAL,) -> (M, C)."""
        moving -= self.mean
        moving /= self.std
        np.maximum(moving, -6, out=moving)
        np.minimum(moving, 6, out=moving)
        hidden = self.motion(whole[None])
        pose = (np.float32(0.5) * hidden * (1 + erf(hidden * np.float32(np.sqrt(0.5))))) @ self.pose
        x = moving @ self.moving
        x += self.still
        x += pose
        x = self.norm(self.second(gelu(x)))
        for block in self.blocks:
            x = block(x, self.graph)
        return self.decoder[1](gelu(self.decoder[0](x)))


def _moving(vectors: np.ndarray, *numbers: np.ndarray) -> np.ndarray:
    """Features that change from frame to frame of each node, in the order of `Inputs.nodes`, shape (M, MOVING)."""
    return np.concatenate([vectors.reshape(len(vectors), -1), *numbers], axis=1, dtype=np.float32)


def _back(turns: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors of the world in the frames of the joints, shapes (M, 3, 3) and (M, 3) -> (M, 3)."""
    return np.asarray(np.einsum("mba,mb->ma", turns, vectors))
