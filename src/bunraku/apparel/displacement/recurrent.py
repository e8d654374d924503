"""The recurrent part of section 4.3: displacement from the three past states of the apparel itself and the motion.

Ours works in the frame of the carrying joint, around the head that cannot drift: what it remembers is only how the
apparel differs from that head, and it forgets. The paper's form, world positions that a network adds to frame by frame,
is `frame="world"`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

from bunraku.apparel.displacement.anchor import Inputs, NodeEncoder

__all__ = ["Past", "RecurrentPart", "node_state", "past_of_states"]

KEEP = 0.95  # most of the difference from the head that a frame leaves
MOST = 0.04  # largest change of it in a frame, over the wearer's size
STATE = 5 * 3 + 1


@dataclass
class Past:
    """The last three states.

    Args:
        rest: Difference from the head (frame="joint"), in the frame of the carrying joint, or position from the pelvis
            (frame="world"), newest first, shape (3, M, 3).
        whole: The displacement that was given out last, in the frame of the carrying joint, shape (M, 3).
        places: Positions of the last two frames in the world, newest first, shape (2, M, 3).
    """

    rest: torch.Tensor
    whole: torch.Tensor
    places: torch.Tensor


def past_of_states(
    part: RecurrentPart, states: torch.Tensor, heads: torch.Tensor, turns: torch.Tensor, places: torch.Tensor
) -> Past:
    """The past after three frames whose displacements are known.

    Args:
        part: The network that goes on from it.
        states: Displacements, in the frames of the carrying joints, oldest first, shape (3, M, 3).
        heads: What the head says of these frames, shape (3, M, 3).
        turns: Frames of the carrying joints, shape (3, M, 3, 3).
        places: Carried places, as `RecurrentPart.forward` takes them, shape (3, M, 3).
    """
    world = places + torch.einsum("fmab,fmb->fma", turns, states)
    rest = world if part.world else states - heads
    return Past(rest.flip(0), states[2], world.flip(0)[:2])


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
        self.encoder = NodeEncoder(9 if world else STATE, width, blocks)
        last = nn.Linear(width, 3 if world else 5)
        self.decoder = nn.Sequential(nn.Linear(width, width), nn.GELU(), last)
        nn.init.zeros_(last.weight)  # it begins by forgetting slowly what it is told, and adds nothing
        nn.init.zeros_(last.bias)

    def forward(
        self, inputs: Inputs, past: Past, anchor: torch.Tensor, turns: torch.Tensor, places: torch.Tensor
    ) -> tuple[torch.Tensor, Past]:
        """The next displacement: the last state and a change of it [MMDMC 11], shape (M, 3), and the new past.

        In the frame of the carrying joint, r(t) = a (r(t-1) + g dr(t-1)) + d and e(t) = e*(t) + r(t), with a and g
        below 1 and d bounded, so r is bounded too.

        Args:
            inputs: Features of the frame.
            past: The last three states.
            anchor: What the head says, e*, shape (M, 3).
            turns: Frames of the carrying joints, shape (M, 3, 3).
            places: Carried places over the wearer's size; from the pelvis where `world`, shape (M, 3).
        """
        state = node_state(past.rest)
        if self.world:
            change = self.decoder(self.encoder(torch.cat([inputs.nodes(), state], dim=1), inputs))
            now = past.rest[0] + change
            moved = torch.einsum("mba,mb->ma", turns, now - places)
            return moved, Past(torch.cat([now[None], past.rest[:2]]), moved, past.places)
        carried_on = 2 * past.places[0] - past.places[1]  # where inertia alone takes the node
        inertia = torch.einsum("mba,mb->ma", turns, carried_on - places) - anchor
        late = past.whole - anchor
        speed = state[:, 3:6].norm(dim=1, keepdim=True)
        own = torch.cat([state, inertia, late, speed], dim=1)
        out = self.decoder(self.encoder(torch.cat([inputs.nodes(), own], dim=1), inputs))
        keep = KEEP * torch.sigmoid(out[:, :1] + 3)
        swing = torch.sigmoid(out[:, 1:2])
        rest = keep * (past.rest[0] + swing * state[:, 3:6]) + MOST * torch.tanh(out[:, 2:] / MOST)
        moved = anchor + rest
        now = places + torch.einsum("mab,mb->ma", turns, moved)
        return moved, Past(torch.cat([rest[None], past.rest[:2]]), moved, torch.cat([now[None], past.places[:1]]))
