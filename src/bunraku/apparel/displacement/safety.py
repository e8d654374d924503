"""The safety stage: apparel does not stretch beyond bounds, does not enter the body, and stays with its joint where it
is stiffer than anything that the networks know.

Projections in the manner of extended position-based dynamics (Macklin et al. 2016), a few passes over the nodes of one
frame, and one over the vertices. It can be switched off, and its effect is a row of its own in the tables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from bunraku.apparel.body_depth import BodyDepth, Unposed, body_depth
from bunraku.apparel.clothed import LEGS, ClothedCharacter
from bunraku.apparel.displacement.body_points import BodyPoints, nearest_index
from bunraku.apparel.displacement.carry import Carrier
from bunraku.apparel.nodes import ApparelNodes

__all__ = ["Safety", "SafetySettings", "known_share"]

HELD = 0.02  # nodes as near to where their part is held do not move, over the character's size [m]
BESIDE = 0.03  # how near to the way out through a node legs count, over the character's size [m]
DEEP = 0.006  # how deep a vertex may be in the limb near its third node, over the character's size [m]
FEW = 0.25  # share of the apparel around a node that must be pushed for it to move by as much


@dataclass(frozen=True)
class SafetySettings:
    """How much is allowed.

    Args:
        shortest, longest: Of an edge of the apparel graph, over its length at rest.
        clear: How near to the body nodes may come that were farther off at rest, over the character's size [m].
        slack: How deep vertices may be that were outside at rest, over the same [m].
        spread: How far around it a push out of the body takes the apparel along, over the same [m].
        passes: Over all edges and the body.
        most: Nodes deeper than this are left where they are: they are on the wrong side of something thin, over the
            same [m].
        lift: Nodes that hang from the pelvis are not moved farther to lie over the legs, over the same [m].
        stiff: Parts stiffer than the first begin to stay with their joints, those stiffer than the second do.
    """

    shortest: float = 0.85
    longest: float = 1.15
    clear: float = 0.003
    slack: float = 0.005
    spread: float = 0.04
    passes: int = 3
    most: float = 0.1
    lift: float = 0.25
    stiff: tuple[float, float] = (1.5, 1.75)


def known_share(stiffness: np.ndarray, settings: SafetySettings | None = None) -> np.ndarray:
    """How much of a displacement counts in parts of some stiffness: 1 up to what the networks know, 0 beyond."""
    low, high = (settings or SafetySettings()).stiff
    return np.asarray(np.clip((high - stiffness) / (high - low), 0, 1), np.float32)


class Safety:
    """The stage for one clothed character.

    Args:
        clothed: The character.
        nodes: Its nodes.
        points: The body's points, denser than those of the features.
        carrier: What takes nodes to vertices.
        settings: What is allowed.
        depth: How deep points are in its body, where that is known already.
    """

    def __init__(
        self, clothed: ClothedCharacter, nodes: ApparelNodes, points: BodyPoints, carrier: Carrier,
        settings: SafetySettings | None = None, depth: BodyDepth | None = None,
    ):  # fmt: skip
        self.settings = settings or SafetySettings()
        self.points, scale = points, clothed.scale
        here = np.repeat(np.arange(len(nodes)), nodes.neighbours.shape[1])
        pairs = np.sort(np.stack([here, nodes.neighbours.reshape(-1)], axis=1), axis=1)
        self.edges = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
        self.lengths = np.linalg.norm(nodes.rest[self.edges[:, 0]] - nodes.rest[self.edges[:, 1]], axis=1)
        self.shortest, self.longest = self.settings.shortest * self.lengths, self.settings.longest * self.lengths
        self.ends = tuple(np.ascontiguousarray(end) for end in self.edges.T)
        known = known_share(clothed.stiffness[nodes.part], self.settings)
        # where it is told how each vertex swings, the networks know of stiff parts too
        self.share = np.where(clothed.swing is None, known, np.float32(1))[:, None]
        # what lies on the body at rest stays there: the root of a part is held
        self.free = np.where(nodes.distance < HELD * scale, 0.0, 1.0)[:, None].astype(np.float32)
        degree = np.maximum(np.bincount(self.edges.reshape(-1), minlength=len(nodes)), 1)
        number = np.arange(len(self.edges))
        half = 0.5 * self.free[:, 0] / np.sqrt(degree)
        a, b = self.edges.T
        self.shared = csr_matrix(
            (np.concatenate([half[a], -half[b]]), (np.concatenate([a, b]), np.concatenate([number, number]))),
            shape=(len(nodes), len(self.edges)), dtype=np.float32,
        )  # fmt: skip
        self.depth = depth or body_depth(clothed.rest, clothed.faces, clothed.weights, clothed.apparel, scale)
        if not len(points.rest):
            self.depth = None
        if self.depth is not None:
            self.most = self.settings.most * scale
            self.gap = np.minimum(self.depth.at(nodes.rest)[0], self.settings.clear * scale)
            rest = clothed.rest[carrier.vertices].astype(np.float32)
            self.vertex_gap = np.minimum(self.depth.at(rest)[0], -self.settings.slack * scale)
            self.node, self.second, self.third = carrier.index[:, 0], carrier.index[:, 1], carrier.index[:, 2]
            self.deep_gap = np.minimum(self.vertex_gap, -DEEP * scale)
            self.around = _around(nodes, self.settings.spread * scale)
            self.scale, self.legs = scale, np.flatnonzero(np.isin(points.joint, LEGS))
            # in the rest pose the frame of the pelvis is the world's
            middle = clothed.joints[0].astype(np.float32)
            away = (nodes.rest - middle) * np.array([1, 0, 1], np.float32)
            width = np.sqrt(np.square(away).sum(axis=1))
            low = nodes.rest[:, 1] < clothed.joints[list(LEGS[:2]), 1].mean()
            hung = (nodes.joint == 0) & low & (width > 0.03 * scale) & bool(len(self.legs))
            self.hung = np.flatnonzero(hung)
            self.outward = away[hung] / width[hung, None]
            self.axis = nodes.rest[hung] - away[hung]
            self.rays = _rays(self.outward, self.axis)
            reach = self._reach(points.rest[self.legs]) if len(self.hung) else np.zeros(0)
            self.leg_gap = np.minimum(width[hung] - reach, self.settings.clear * scale)

    def __call__(self, positions: np.ndarray, affine: np.ndarray) -> tuple[np.ndarray, Unposed | None]:
        """Nodes made safe [m], shape (M, 3), and their way back to the rest pose.

        Args:
            positions: Of the nodes [m], shape (M, 3).
            affine: Affine transforms of the joints (`eq4_transforms`), shape (22, 3, 4).
        """
        out = np.array(positions, np.float32)
        if self.depth is None:
            unposed = None
        else:
            blend = self.points.blends(affine)
            body = self.points.placed(blend)
            out = self._over_legs(out, affine, body)
            unposed = self._unposed(out, blend, body)
        for _ in range(self.settings.passes):
            out = self.outside(self._bounded(out), unposed)
        return out, unposed

    def unposed(self, positions: np.ndarray, affine: np.ndarray) -> Unposed | None:
        """The way back to the rest pose of the body nearest to nodes [m], shape (M, 3), in a pose (22, 3, 4); None
        where there is no body.
        """
        if self.depth is None:
            return None
        blend = self.points.blends(affine)
        return self._unposed(positions, blend, self.points.placed(blend))

    def _unposed(self, positions: np.ndarray, blend: np.ndarray, body: np.ndarray) -> Unposed:
        near = nearest_index(positions, body)
        return Unposed.of(blend[near], self.points.joint[near])

    def outside(self, positions: np.ndarray, unposed: Unposed | None) -> np.ndarray:
        """Nodes a step out of the body, and what is around them with them, so that pieces move as a whole and are not
        flattened, shape (M, 3).
        """
        if self.depth is None or unposed is None:
            return positions
        rows, step = self.depth.push(positions, unposed, self.gap, self.most)
        if not len(rows):
            return positions
        push = np.zeros((len(positions), 4), np.float32)
        push[rows, :3] = step
        push[rows, 3] = (step != 0).any(axis=1)
        return self._spread(positions, push)

    def _spread(self, positions: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Nodes moved by what is around them: a push and 1 for each that is pushed, 0 for others, shape (M, 4)."""
        near = self.around @ push
        return np.asarray(positions + self.free * (near[:, :3] / np.maximum(near[:, 3:], FEW)))

    def _over_legs(self, positions: np.ndarray, affine: np.ndarray, body: np.ndarray) -> np.ndarray:
        """Nodes that hang from the pelvis, farther from its axis than what of the legs is between: a lifted knee that
        has come through a skirt is no longer in it, and no depth says so.
        """
        if not len(self.hung):
            return positions
        turn, shift = affine[0, :, :3], affine[0, :, 3]
        legs = body[self.legs] @ turn - shift @ turn
        own = positions[self.hung] @ turn - shift @ turn
        short = self.leg_gap + self._reach(legs) - ((own - self.axis) * self.outward).sum(axis=1)
        short = np.where(short < self.settings.lift * self.scale, np.maximum(short, 0), 0)
        push = np.zeros((len(positions), 4), np.float32)
        push[self.hung, :3] = (short[:, None] * self.outward) @ turn.T
        push[self.hung, 3] = short > 0
        return self._spread(positions, push)

    def _reach(self, legs: np.ndarray) -> np.ndarray:
        """How far the legs, in the frame of the pelvis, reach along the way out through each hanging node [m], shape
        (H,).
        """
        seen = np.empty((5, len(legs)), np.float32)
        seen[:3], seen[3], seen[4] = legs.T, 1, np.einsum("la,la->l", legs, legs)
        along, square = np.split(self.rays @ seen, 2)  # and the square of the distance from the axis
        square -= along * along
        return np.asarray(np.where(square < (BESIDE * self.scale) ** 2, along, np.float32(-1)).max(axis=1))

    def vertices(self, positions: np.ndarray, unposed: Unposed | None) -> np.ndarray:
        """Vertices that the carrier took along, out of the body where they are in it all the same [m], shape (A, 3).

        Those between two nodes that are near to different limbs are asked for both: half of what used to stay inside
        was in the limb of the second node. A third is asked only for what is deep, since each push strains edges.

        Args:
            positions: [m], shape (A, 3).
            unposed: Of the nodes.
        """
        if self.depth is None or unposed is None:
            return positions
        out = self.depth.pushed(positions, unposed.take(self.node), self.vertex_gap, self.most)
        joints = [unposed.joint[self.node]]
        for node, gap in ((self.second, self.vertex_gap), (self.third, self.deep_gap)):
            joint = unposed.joint[node]
            between = np.flatnonzero(np.logical_and.reduce([joint != one for one in joints]))
            if len(between):
                other = unposed.take(node[between])
                out[between] = self.depth.pushed(out[between], other, gap[between], self.most)
            joints.append(joint)
        return out

    def _bounded(self, positions: np.ndarray) -> np.ndarray:
        a, b = self.ends
        offset = positions.take(b, axis=0) - positions.take(a, axis=0)
        now = np.sqrt(np.einsum("ea,ea->e", offset, offset))
        wanted = np.minimum(np.maximum(now, self.shortest), self.longest)
        offset *= (1 - wanted / np.maximum(now, 1e-9))[:, None]
        return np.asarray(positions + self.shared @ offset)


def _rays(outward: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """What takes a point p, 1 and |p|^2 to how far it is along each of H rays, and below that to the square of its
    distance from where the ray begins, shape (2 H, 5).
    """
    begin = np.einsum("ha,ha->h", axis, outward)
    along = np.concatenate([outward, -begin[:, None], np.zeros((len(axis), 1))], axis=1)
    square = np.concatenate([-2 * axis, np.square(axis).sum(axis=1, keepdims=True), np.ones((len(axis), 1))], axis=1)
    return np.concatenate([along, square]).astype(np.float32)


def _around(nodes: ApparelNodes, spread: float) -> np.ndarray:
    """How much each node of the same part counts near each, rows sum to 1, shape (M, M)."""
    square = np.square(nodes.rest[:, None] - nodes.rest[None]).sum(axis=-1)
    share = np.exp(-0.5 * square / spread**2) * (nodes.part[:, None] == nodes.part[None])
    return np.asarray(share / share.sum(axis=1, keepdims=True), np.float32)
