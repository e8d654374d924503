"""The displacement network of apparel, f_d of section 4 of MMDMC: head and recurrent part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.learned import network
from bunraku.apparel.learned.features import (
    BASIS,
    GLOBAL,
    LEAD_IN,
    Frame,
    MotionFeatures,
    lead_in_transforms,
    rest_transforms,
)
from bunraku.apparel.learned.network import (
    NODE_INPUT,
    OWN_STATE,
    SET,
    WORLD_STATE,
    DisplacementConfig,
)
from bunraku.apparel.nodes import ApparelNodes
from bunraku.core.body.layout import JOINT_COUNT, JOINT_MIRROR
from bunraku.core.nn.layers import Weights
from bunraku_lab.nn.checkpoints import SavedNetwork
from bunraku_lab.nn.differentiable import arrays_of
from bunraku_lab.nn.graph import EdgeBlock, NodeGraph


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

    def __init__(self, config: DisplacementConfig, width: int, extra: int = 0):
        super().__init__()
        count, (hidden, motion) = NODE_INPUT + extra, config.motion
        self.register_buffer("mean", torch.zeros(count))
        self.register_buffer("std", torch.ones(count))
        self.motion = nn.Sequential(nn.Linear(GLOBAL, hidden), nn.GELU(), nn.Linear(hidden, motion))
        self.enter = nn.Sequential(
            nn.Linear(count + motion, width), nn.GELU(), nn.Linear(width, width), nn.LayerNorm(width)
        )  # without the norm the features grow a hundredfold in training, and the decoder dies
        self.blocks = nn.ModuleList(EdgeBlock(width) for _ in range(config.blocks))

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
        config: Of the network.
    """

    def __init__(self, config: DisplacementConfig):
        super().__init__()
        self.most, width = config.share, config.width
        self.encoder = NodeEncoder(config, width)
        last = nn.Linear(width, BASIS + 3)
        self.decoder = nn.Sequential(nn.Linear(width, width), nn.GELU(), last)
        nn.init.normal_(last.weight, 0, 1e-3)
        nn.init.zeros_(last.bias)

    def forward(self, inputs: Inputs) -> torch.Tensor:
        """Displacement of each node in the frame of its carrying joint, over the character's size, shape (M, 3)."""
        out = self.decoder(self.encoder(inputs.nodes(), inputs))
        share = self.most * torch.tanh(out[:, :BASIS])
        mixed: torch.Tensor = torch.einsum("mk,mka->ma", share, inputs.vectors[:, :BASIS]) + out[:, BASIS:]
        return mixed


BEGIN = (3.0, -0.8, -1.6, -0.2, 0.0, 0.0, 0.0)
"""What the decoder says before it has learned: fitted to be about the best linear prediction of the wardrobe's apparel.
"""
SPREADS = (0.02, 0.005, 0.003, 0.02, 0.03, 0.006, 0.005, 0.01)
"""What the encoder divides by: difference, velocity, acceleration, inertia, lag, own change, head's change, speed; the
shipped network was trained so."""


@dataclass
class Past:
    """The last three states.

    Args:
        rest: Difference from the head (frame="joint"), in the frame of the carrying joint, or position from the pelvis
            (frame="world"), newest first, shape (3, M, 3).
        whole: The last two displacements that were given out, in the joint's frame, newest first, shape (2, M, 3).
        positions: Positions of the last two frames in the world, newest first, shape (2, M, 3).
    """

    rest: torch.Tensor
    whole: torch.Tensor
    positions: torch.Tensor


def past_of_states(
    part: RecurrentPart, states: torch.Tensor, heads: torch.Tensor, turns: torch.Tensor, positions: torch.Tensor
) -> Past:
    """The past after three frames whose displacements are known.

    Args:
        part: The network that goes on from it.
        states: Displacements, in the frames of the carrying joints, oldest first, shape (3, M, 3).
        heads: What the head says of these frames, shape (3, M, 3).
        turns: Frames of the carrying joints, shape (3, M, 3, 3).
        positions: Carried positions, as `RecurrentPart.forward` takes them, shape (3, M, 3).
    """
    world = positions + torch.einsum("fmab,fmb->fma", turns, states)
    rest = world if part.world else states - heads
    return Past(rest.flip(0), states.flip(0)[:2], world.flip(0)[:2])


def node_state(past: torch.Tensor) -> torch.Tensor:
    """State, velocity and acceleration of each node, of its last three states [MMDMC 12], shape (3, M, 3) -> (M, 9).

    The global feature f_t(T) joins them in `NodeEncoder`.
    """
    now, before, early = past
    return torch.cat([now, now - before, now - 2 * before + early], dim=1)


class RecurrentPart(nn.Module):
    """The network f_d.

    Args:
        config: Of the network.
    """

    def __init__(self, config: DisplacementConfig):
        super().__init__()
        self.config, width, world = config, config.recurrent, config.frame == "world"
        self.world = world
        self.encoder = NodeEncoder(config, width, WORLD_STATE if world else OWN_STATE)
        last = nn.Linear(width, 3 if world else SET)
        self.decoder = nn.Sequential(nn.Linear(width, width), nn.GELU(), last)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        spreads = torch.tensor([0.1] * WORLD_STATE if world else [*np.repeat(SPREADS[:-1], 3), SPREADS[-1]])
        self.encoder.std[-len(spreads) :] = spreads
        if not world:
            with torch.no_grad():
                last.bias.copy_(torch.tensor(BEGIN))

    def forward(
        self, inputs: Inputs, past: Past, anchor: torch.Tensor, turns: torch.Tensor, positions: torch.Tensor
    ) -> tuple[torch.Tensor, Past]:
        """The next displacement: the last state and a change of it [MMDMC 11], shape (M, 3), and the new past.

        In the frame of the carrying joint, e(t) = e*(t) + r(t) with

            r(t) = a (r(t-1) + s dr(t-1) + g (u(t) - e(t-1)) - (1 - h) de*(t)) + d

        where u is where inertia alone takes the node and e* what the head says. What the network sets is bounded: a
        below 1, s + g too (they share 1), h between 0 and 1, and d. So what is remembered fades whatever it says.

        Args:
            inputs: Features of the frame.
            past: The last three states.
            anchor: What the head says, e*, shape (M, 3).
            turns: Frames of the carrying joints, shape (M, 3, 3).
            positions: Carried positions over the character's size; from the pelvis where `world`, shape (M, 3).
        """
        state = node_state(past.rest)
        if self.world:
            change = self.decoder(self.encoder(torch.cat([inputs.nodes(), state], dim=1), inputs))
            now = past.rest[0] + change
            moved = torch.einsum("mba,mb->ma", turns, now - positions)
            whole = torch.stack([moved, past.whole[0]])
            return moved, Past(torch.cat([now[None], past.rest[:2]]), whole, past.positions)
        carried_on = 2 * past.positions[0] - past.positions[1]
        inertia = torch.einsum("mba,mb->ma", turns, carried_on - positions) - past.whole[0]
        late = past.whole[0] - anchor
        own_change = past.whole[0] - past.whole[1]
        head_change = past.rest[0] - late  # e*(t) - e*(t-1)
        speed = own_change.norm(dim=1, keepdim=True)
        own = torch.cat([state, inertia, late, own_change, head_change, speed], dim=1)
        out = self.decoder(self.encoder(torch.cat([inputs.nodes(), own], dim=1), inputs))
        keep = self.config.keep * torch.sigmoid(out[:, :1])
        shares = torch.softmax(torch.cat([out[:, 1:3], torch.zeros_like(out[:, :1])], dim=1), dim=1)
        followed = torch.sigmoid(out[:, 3:4])
        kept = past.rest[0] + shares[:, :1] * state[:, 3:6] + shares[:, 1:2] * inertia - (1 - followed) * head_change
        most = self.config.change
        rest = keep * kept + most * torch.tanh(out[:, 4:] / most)
        moved = anchor + rest
        now = positions + torch.einsum("mab,mb->ma", turns, moved)
        whole = torch.stack([moved, past.whole[0]])
        return moved, Past(torch.cat([rest[None], past.rest[:2]]), whole, torch.cat([now[None], past.positions[:1]]))


class DisplacementNetwork(SavedNetwork):
    """The head that cannot drift, and the recurrent part about it.

    Args:
        config: Its shape.
    """

    kind = "apparel"
    shape = DisplacementConfig

    def __init__(self, config: DisplacementConfig | None = None):
        super().__init__()
        self.config = config = config or DisplacementConfig()
        self.anchor = AnchorHead(config)
        self.recurrent = RecurrentPart(config) if config.recurrent else None


def running_displacement(model: DisplacementNetwork) -> network.DisplacementNetwork:
    """A displacement network as the runtime has it, with a copy of the weights."""
    return network.DisplacementNetwork(model.config, Weights(arrays_of(model)))


def normalize_inputs(model: DisplacementNetwork, nodes: torch.Tensor) -> None:
    """Set what the encoders subtract and divide by, from the features of many nodes, shape (M, NODE_INPUT)."""
    mean, std = nodes.mean(dim=0), nodes.std(dim=0).clamp(min=1e-3)
    for part in (model.anchor, model.recurrent):
        if part is not None:
            part.encoder.mean[: len(mean)] = mean
            part.encoder.std[: len(std)] = std


def mirror_global(whole: np.ndarray) -> np.ndarray:
    """`Frame.whole` of the mirror image in the plane x = 0, shape (..., GLOBAL)."""
    joints = whole[..., :-3].reshape(*whole.shape[:-1], JOINT_COUNT, 9)[..., list(JOINT_MIRROR), :]
    sign = np.array([-1, 1, 1, 1, -1, -1, -1, 1, 1], whole.dtype)
    up = whole[..., -3:] * np.array([-1, 1, 1], whole.dtype)
    return np.concatenate([(joints * sign).reshape(*whole.shape[:-1], -1), up], axis=-1)


def clip_features(clothed: ClothedCharacter, nodes: ApparelNodes, transforms: np.ndarray) -> list[Frame]:
    """Features of all frames of a clip at 30 frames a second that begins from the rest pose, after `LEAD_IN` frames
    that lead there.

    Args:
        clothed: The character.
        nodes: Its nodes.
        transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
    """
    start = rest_transforms(clothed.joints, transforms[0])
    state = MotionFeatures(clothed, nodes, start)
    for pose in lead_in_transforms(clothed.joints, transforms[0], LEAD_IN):
        state.advance(pose)
    return [state.advance(pose) for pose in transforms]
