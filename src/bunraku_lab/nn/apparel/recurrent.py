"""The recurrent part of section 4.3: displacement from the three past states of the apparel itself and the motion.

Ours works in the frame of the carrying joint, around the head that cannot drift: what it remembers is only how the
apparel differs from that head, and it forgets. The paper's form, world positions that a network adds to frame by frame,
is `frame="world"`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from bunraku.apparel.displacement.weights import CHANGE, KEEP, OWN_STATE, SET, WORLD_STATE
from bunraku_lab.nn.apparel.anchor import Inputs, NodeEncoder

__all__ = ["Past", "RecurrentPart", "node_state", "past_of_states"]

BEGIN = (3.0, -0.8, -1.6, -0.2, 0.0, 0.0, 0.0)
"""What the decoder says before it has learned: about the best linear prediction of the wardrobe's apparel."""
SPREADS = (0.02, 0.005, 0.003, 0.02, 0.03, 0.006, 0.005, 0.01)
"""What the encoder divides by: difference, velocity, acceleration, inertia, lag, own change, head's change, speed."""


@dataclass
class Past:
    """The last three states.

    Args:
        rest: Difference from the head (frame="joint"), in the frame of the carrying joint, or position from the pelvis
            (frame="world"), newest first, shape (3, M, 3).
        whole: The last two displacements that were given out, in the frame of the carrying joint, newest first, shape
            (2, M, 3).
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
        width, blocks: As in `NodeEncoder`.
        world: Whether it is the paper's form.
    """

    def __init__(self, width: int = 64, blocks: int = 2, world: bool = False):
        super().__init__()
        self.world = world
        self.encoder = NodeEncoder(WORLD_STATE if world else OWN_STATE, width, blocks)
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
        keep = KEEP * torch.sigmoid(out[:, :1])
        shares = torch.softmax(torch.cat([out[:, 1:3], torch.zeros_like(out[:, :1])], dim=1), dim=1)
        followed = torch.sigmoid(out[:, 3:4])
        kept = past.rest[0] + shares[:, :1] * state[:, 3:6] + shares[:, 1:2] * inertia - (1 - followed) * head_change
        rest = keep * kept + CHANGE * torch.tanh(out[:, 4:] / CHANGE)
        moved = anchor + rest
        now = positions + torch.einsum("mab,mb->ma", turns, moved)
        whole = torch.stack([moved, past.whole[0]])
        return moved, Past(torch.cat([rest[None], past.rest[:2]]), whole, torch.cat([now[None], past.positions[:1]]))
