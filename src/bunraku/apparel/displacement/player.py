"""Learned apparel, frame by frame: a pose in, the positions of the apparel vertices out. What a game engine calls."""

from __future__ import annotations

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.displacement.body_points import body_points
from bunraku.apparel.displacement.carry import Carrier
from bunraku.apparel.displacement.features import LEAD_IN, Frame, MotionFeatures, static_features
from bunraku.apparel.displacement.folded import FoldedNetwork, FoldedPast, past_of_states
from bunraku.apparel.displacement.lead_in import lead_in_transforms, rest_transforms
from bunraku.apparel.displacement.safety import Safety
from bunraku.apparel.displacement.weights import DisplacementNetwork
from bunraku.apparel.node_graph import NodeGraph
from bunraku.apparel.nodes import apparel_nodes
from bunraku.apparel.skinning import eq4_transforms

__all__ = ["NODES", "ApparelPlayer"]

NODES = 256
FADE = 0.9
"""What a frame leaves of a difference from the head that is known, where no recurrent part is."""
SAFE_POINTS = 1500


class ApparelPlayer:
    """A clothed character whose apparel the network moves.

    Args:
        clothed: The character.
        network: The network.
        nodes: Most nodes.
        safe: Whether the safety stage runs.
        recurrent: Whether the recurrent part runs, where the network has one.
    """

    def __init__(
        self, clothed: ClothedCharacter, network: DisplacementNetwork, *, nodes: int = NODES, safe: bool = True,
        recurrent: bool = True,
    ):  # fmt: skip
        self.clothed, self.network = clothed, network
        parts = int(clothed.part.max(initial=-1)) + 1
        self.nodes = apparel_nodes(clothed, max(nodes, min(3 * parts, 512)))
        self.carrier = Carrier(clothed, self.nodes)
        graph = NodeGraph(self.nodes.neighbours, self.nodes.part)
        self.folded = FoldedNetwork(network, *static_features(clothed, self.nodes), graph)
        self.safety = Safety(clothed, self.nodes, body_points(clothed, SAFE_POINTS), self.carrier) if safe else None
        self.recurrent = network.recurrent if recurrent else None
        self.features: MotionFeatures | None = None
        self.past: FoldedPast | None = None
        self.known: np.ndarray | None = None

    def start(self, transforms: np.ndarray) -> None:
        """Begin before a first frame: a second from the rest pose into it.

        Args:
            transforms: `[R | t]` of the joints (Eq. 1) in the first frame, shape (22, 3, 4).
        """
        joints = self.clothed.joints
        self.features = MotionFeatures(self.clothed, self.nodes, rest_transforms(joints, transforms))
        self.past = self.known = None
        for pose in lead_in_transforms(joints, transforms, LEAD_IN):
            frame = self.features.advance(pose)
            if self.recurrent is not None:
                self._moved(frame, pose)

    def know(self, states: np.ndarray, transforms: np.ndarray) -> None:
        """Go through three frames whose apparel is known, and go on from there; `start` comes before it.

        Args:
            states: Displacements of the nodes in the frames of their joints, over the size, shape (3, M, 3).
            transforms: `[R | t]` of the joints in these frames, shape (3, 22, 3, 4).
        """
        assert self.features is not None
        kept = []
        for state, pose in zip(states, transforms, strict=True):
            frame = self.features.advance(np.asarray(pose, np.float32))
            kept.append((state.astype(np.float32), self.folded.anchor(*_told(frame)), *self._carried_by(frame, pose)))
        self.known = kept[-1][0] - kept[-1][1]
        if self.recurrent is not None:
            self.past = past_of_states(self.recurrent, *(np.stack(column) for column in zip(*kept, strict=True)))

    def advance(self, transforms: np.ndarray) -> np.ndarray:
        """The next frame, a thirtieth of a second later.

        Args:
            transforms: `[R | t]` of the joints (Eq. 1), shape (22, 3, 4).

        Returns:
            Where the apparel vertices (`carrier.vertices`) are [m], shape (A, 3), float32.
        """
        if self.features is None:
            self.start(transforms)
        assert self.features is not None
        frame = self.features.advance(np.asarray(transforms, np.float32))
        moved = self._moved(frame, transforms) * np.float32(self.clothed.scale)
        affine = eq4_transforms(np.asarray(transforms, np.float32)[None], self.clothed.joints)[0]
        if self.safety is None:
            return self._carried(moved, affine)
        moved = self.safety.share * moved
        safe, unposed = self.safety(frame.positions + np.einsum("mab,mb->ma", frame.turns, moved), affine)
        moved = np.einsum("mba,mb->ma", frame.turns, safe - frame.positions)
        return self.safety.vertices(self._carried(moved, affine), unposed)

    def _carried(self, moved: np.ndarray, affine: np.ndarray) -> np.ndarray:
        """The apparel vertices that go with the nodes [m], shape (A, 3), float32."""
        return self.carrier.positions(moved, affine)

    def _carried_by(self, frame: Frame, transforms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Frames of the carrying joints and carried positions as the recurrent part takes them."""
        root = transforms[0, :, 3] if self.network.recurrent is not None and self.network.recurrent.world else 0.0
        return frame.turns, ((frame.positions - root) / self.clothed.scale).astype(np.float32)

    def _moved(self, frame: Frame, transforms: np.ndarray) -> np.ndarray:
        """Displacement of the nodes in the frames of their joints, over the size, shape (M, 3)."""
        inputs = _told(frame)
        anchor = self.folded.anchor(*inputs)
        if self.recurrent is None:
            if self.known is None:
                return anchor
            self.known = FADE * self.known
            return np.asarray(anchor + self.known)
        turns, positions = self._carried_by(frame, transforms)
        if self.past is None:  # at rest, as far as is known
            first = np.zeros_like(anchor) if self.recurrent.world else anchor
            self.past = past_of_states(
                self.recurrent, *(np.stack([value] * 3) for value in (first, anchor, turns, positions))
            )
        moved, self.past = self.folded.recurrent(*inputs, self.past, anchor, turns, positions)
        return moved

    def clip(self, transforms: np.ndarray) -> np.ndarray:
        """The apparel vertices in all frames of a clip at 30 frames a second that begins from rest [m], shape (N, A,
        3), float32.

        Args:
            transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
        """
        self.start(np.asarray(transforms[0], np.float32))
        return np.stack([self.advance(pose) for pose in transforms])


def _told(frame: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Input of the network for a frame alone."""
    return np.ascontiguousarray(frame.vectors), frame.scalars, frame.whole
