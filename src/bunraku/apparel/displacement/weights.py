"""The weights of the displacement network f_d of MMDMC 4.3, read for `FoldedNetwork`, which runs it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bunraku.apparel.displacement.features import BASIS, GLOBAL, SCALARS, STATIC_SCALARS, STATIC_VECTORS, VECTORS
from bunraku.apparel.node_graph import EdgeBlock
from bunraku.nn.checkpoints import config_of, load_network
from bunraku.nn.weights import Weights

__all__ = [
    "CHANGE", "KEEP", "MOTION", "MOTION_HIDDEN", "NODE_INPUT", "OWN_STATE", "SET", "SHARE", "STILL", "WORLD_STATE",
    "DisplacementConfig", "DisplacementNetwork", "DisplacementPart", "load_displacement",
]  # fmt: skip

STILL = 3 * STATIC_VECTORS + STATIC_SCALARS
"""Numbers of a node that never change."""
NODE_INPUT = STILL + 3 * VECTORS + SCALARS
"""Numbers of a node in a frame."""
MOTION_HIDDEN, MOTION = 64, 24
"""Channels of the MLP of the encoded motion f_t(T), and of what it says."""
SHARE = 1.5
"""Largest weight of a basis vector in what the head says."""
KEEP = 0.97
"""Most of the difference from the head that a frame leaves."""
CHANGE = 0.04
"""Largest change of that difference in a frame, over the character's size."""
OWN_STATE, WORLD_STATE = 7 * 3 + 1, 9
"""Numbers of a node's past that the recurrent part reads, in the frame of its joint, and in the paper's form."""
SET = 7
"""Numbers that the recurrent part sets for a node."""


@dataclass(frozen=True)
class DisplacementConfig:
    """Shape of the network.

    Args:
        width: Channels of the head.
        blocks: Its edge convolutions.
        recurrent: Channels of the recurrent part, 0 for the head alone.
        frame: "joint" remembers the difference from the head in the frame of the carrying joint; "world" is the
            paper's Eq. 11 as it stands, positions in the world from the pelvis, without the head.
    """

    width: int = 96
    blocks: int = 2
    recurrent: int = 64
    frame: Literal["joint", "world"] = "joint"


class DisplacementPart:
    """Encoder and decoder of the head or of the recurrent part.

    Args:
        extra: Numbers of a node beside `NODE_INPUT`.
        width: Channels.
        blocks: Edge convolutions.
        said: Numbers that it says of a node.
        weights: Of a checkpoint.
        world: Whether it is the paper's form of the recurrent part.
    """

    def __init__(self, extra: int, width: int, blocks: int, said: int, weights: Weights, world: bool = False):
        encoder, count = weights.part("encoder"), NODE_INPUT + extra
        self.world = world
        self.mean, self.std = encoder.array("mean", count), encoder.array("std", count)
        self.motion = (
            encoder.linear("motion.0", GLOBAL, MOTION_HIDDEN), encoder.linear("motion.2", MOTION_HIDDEN, MOTION),
        )  # fmt: skip
        self.enter = encoder.linear("enter.0", count + MOTION, width), encoder.linear("enter.2", width, width)
        self.norm = encoder.norm("enter.3", width)
        self.blocks = [EdgeBlock(width, encoder.part(f"blocks.{index}")) for index in range(blocks)]
        self.decoder = weights.linear("decoder.0", width, width), weights.linear("decoder.2", width, said)


class DisplacementNetwork:
    """The head that cannot drift, and the recurrent part about it.

    Args:
        config: Its shape.
        weights: Of a checkpoint.

    Raises:
        ValueError: The weights have other sizes.
    """

    def __init__(self, config: DisplacementConfig, weights: Weights):
        self.config = config
        self.anchor = DisplacementPart(0, config.width, config.blocks, BASIS + 3, weights.part("anchor"))
        self.recurrent: DisplacementPart | None = None
        if config.recurrent:
            world = config.frame == "world"
            extra, said = (WORLD_STATE, 3) if world else (OWN_STATE, SET)
            part = weights.part("recurrent")
            self.recurrent = DisplacementPart(extra, config.recurrent, config.blocks, said, part, world)


def load_displacement(path: str | Path) -> DisplacementNetwork:
    """Read a checkpoint of kind "apparel", ready to use.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(
        path, "apparel", lambda shape, weights: DisplacementNetwork(config_of(DisplacementConfig, shape), weights)
    )
