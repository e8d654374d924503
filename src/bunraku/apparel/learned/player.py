"""Learned apparel, frame by frame: from a pose to the apparel's vertices, and the safety stage that bounds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from bunraku.apparel.body import PLANES, BodyPoints, Planes, PosedBody, eq4_transforms, surface_points
from bunraku.apparel.clothed import BESIDE, LAYER, LEGS, ClothedCharacter
from bunraku.apparel.learned.features import (
    LEAD_IN,
    Frame,
    MotionFeatures,
    lead_in_transforms,
    rest_transforms,
    static_features,
)
from bunraku.apparel.learned.network import DisplacementNetwork, FoldedNetwork, FoldedPast, past_of_states
from bunraku.apparel.nodes import ApparelNodes, NodeGraph, apparel_nodes

NEAR = PLANES  # nodes that a vertex follows
FEW = 0.25
"""Share of what is around a node that must be pushed for it to be pushed by as much; chosen by eye on clips of the
wardrobe.
"""
RIGID = 0.03
"""Weight of the carrying joint's own rotation in that of a node, over the spread of its neighbours; chosen by eye."""


class Carrier:
    """Takes the displacement of nodes to the apparel vertices of a clothed character; every part has some nodes."""

    def __init__(self, clothed: ClothedCharacter, nodes: ApparelNodes):
        self.vertices = np.flatnonzero(clothed.part >= 0)
        self.nodes = nodes
        self.index = np.zeros((len(self.vertices), NEAR), np.int64)
        self.share = np.zeros((len(self.vertices), NEAR), np.float32)
        parts = clothed.part[self.vertices]
        for part in np.unique(parts):
            rows, nodes_of_part = np.flatnonzero(parts == part), np.flatnonzero(nodes.part == part)
            near = min(NEAR, len(nodes_of_part))
            gap, nearest = cKDTree(nodes.rest[nodes_of_part]).query(clothed.rest[self.vertices[rows]], near)
            gap, nearest = gap.reshape(len(rows), near), nearest.reshape(len(rows), near)
            # the farthest of the four counts for nothing, so that nothing jumps where another takes its place
            weight = 1 / (gap**2 + 1e-8)
            if near == NEAR:
                weight = np.maximum(weight - weight[:, -1:] * 0.999, 0)
            self.index[rows, :near] = nodes_of_part[nearest]
            self.share[rows, :near] = weight / weight.sum(axis=1, keepdims=True)
        self._mixed(clothed, nodes)
        neighbours = nodes.rest[nodes.neighbours] - nodes.rest[:, None]
        self.spokes = neighbours.astype(np.float32)
        reach = np.square(self.spokes).sum(axis=(1, 2)) / 3 + 1e-8
        self.prior = (RIGID * reach).astype(np.float32)

    def _mixed(self, clothed: ClothedCharacter, nodes: ApparelNodes) -> None:
        """What of `positions` is the same in all frames, as one matrix each."""
        count, rest = len(self.vertices), clothed.rest[self.vertices].astype(np.float32)
        weights = clothed.weights[self.vertices].astype(np.float32)
        homogeneous = np.concatenate([rest, np.ones((count, 1), np.float32)], axis=1)
        self.skin = (weights[:, :, None] * homogeneous[:, None]).reshape(count, -1)
        # a vertex near node i goes to rest_i + moved_i + turn_i (rest - rest_i), and then with its own joint
        pairs = weights.argmax(axis=1)[:, None] * len(nodes) + self.index
        used, number = np.unique(pairs, return_inverse=True)
        self.joint, self.node = np.divmod(used, len(nodes))
        away = np.concatenate([rest[:, None] - nodes.rest[self.index], np.ones((count, NEAR, 1))], axis=2)
        mixed = (self.share[..., None] * away).astype(np.float32)
        columns = 4 * number.reshape(pairs.shape)[..., None] + np.arange(4)
        rows = np.broadcast_to(np.arange(count)[:, None, None], columns.shape)
        kept = mixed != 0
        self.mix = csr_matrix((mixed[kept], (rows[kept], columns[kept])), shape=(count, 4 * len(used)))

    def positions(self, moved: np.ndarray, affine: np.ndarray) -> np.ndarray:
        """Positions of the apparel vertices [m], shape (A, 3).

        Args:
            moved: Displacement of the nodes, in the frame of the carrying joint each [m], shape (M, 3).
            affine: Affine transforms of the joints (`eq4_transforms`), shape (22, 3, 4).
        """
        turned = affine.transpose(0, 2, 1).astype(np.float32)  # [R | t]', shape (22, 4, 3)
        swung = np.matmul(self._swung(moved)[self.node], turned[self.joint, :3])
        return np.asarray(self.skin @ turned.reshape(-1, 3) + self.mix @ swung.reshape(-1, 3))

    def _swung(self, moved: np.ndarray) -> np.ndarray:
        """What takes the way from a node to a vertex, and 1 below it, to the vertex' displacement, shape (M, 4, 3)."""
        turns = node_turns(self.nodes, self.spokes, self.prior, moved).transpose(0, 2, 1)
        return np.concatenate([turns - np.eye(3, dtype=np.float32), moved[:, None]], axis=1, dtype=np.float32)


def node_turns(nodes: ApparelNodes, spokes: np.ndarray, prior: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Rotations of nodes against the joint that carries them, by their neighbours (Procrustes), shape (M, 3, 3)."""
    bent = spokes + moved[nodes.neighbours] - moved[:, None]
    product = np.matmul(bent.transpose(0, 2, 1), spokes)
    product[:, [0, 1, 2], [0, 1, 2]] += prior[:, None]
    return polar_rotation(product)


def polar_rotation(matrices: np.ndarray, rounds: int = 10) -> np.ndarray:
    """The rotation nearest to each matrix, shape (..., 3, 3), float32; the identity where none is nearer than others.

    By the fast optimal attitude matrix (Markley 1993): with the sum `s` of the singular values, the last one with the
    sign of the determinant, it is `((k + |B|^2) B + s adj(B)' - B B' B) / (k s - det B)`, `k = (s^2 - |B|^2) / 2`. The
    sum is the largest root of `(s^2 - |B|^2)^2 - 8 s det B - 4 |adj B|^2`, found by Newton's iteration from above.
    """
    shape = np.shape(matrices)
    # one row for each of the nine elements: a few long operations in place of many strided ones
    b = np.array(np.reshape(matrices, (-1, 9)).T, np.float64, order="C")
    b /= np.maximum(np.sqrt(np.einsum("em,em->m", b, b)), 1e-30)
    cofactors = b[_MINORS[0]] * b[_MINORS[1]] - b[_MINORS[2]] * b[_MINORS[3]]
    det = np.einsum("em,em->m", b[:3], cofactors[:3])
    last = 4 * np.einsum("em,em->m", cofactors, cofactors)
    root = np.sqrt(1 + np.sqrt(3 * last))  # |B| is 1, and no sum of three products is over sqrt(3) |adj B|
    for _ in range(rounds):
        square = root * root - 1
        slope = 4 * root * square - 8 * det
        step = (square * square - 8 * det * root - last) / np.where(slope > 1e-12, slope, np.inf)
        root = root - step
        if np.abs(step).max(initial=0) < 1e-12:
            break
    half = 0.5 * (root * root - 1)
    below = half * root - det
    rows = b.reshape(3, 3, -1)
    gram = (rows[:, None] * rows).sum(axis=2)  # B B'
    cubed = (gram[:, :, None] * rows).sum(axis=1).reshape(9, -1)
    clear = below > 2e-3  # a product of sums of singular values; for less, no rotation is nearer than others
    rotation = ((half + 1) * b + root * cofactors - cubed) / np.where(clear, below, 1.0)
    rotation = np.where(clear, rotation, np.eye(3).reshape(9, 1))
    return np.ascontiguousarray(rotation.T, np.float32).reshape(shape)


_MINORS = np.array([
    (4, 5, 3, 7, 8, 6, 1, 2, 0), (8, 6, 7, 2, 0, 1, 5, 3, 4), (5, 3, 4, 8, 6, 7, 2, 0, 1), (7, 8, 6, 1, 2, 0, 4, 5, 3),
])  # fmt: skip
"""Elements whose products, the first two less the last two, are the cofactors of a matrix."""

# Chosen by eye on Gene, Uka and the wardrobe.
STEPS = 2  # out of the body for vertices: what is near a deep one is not what is near where it comes out


@dataclass(frozen=True)
class SafetySettings:
    """Bounds of the safety stage. Lengths are over the character's size [m]."""

    # shortest, longest: of an edge of the apparel graph, over its length at rest
    shortest: float = 0.85
    longest: float = 1.15
    clear: float = 0.003  # how near to the body nodes may come that were farther off at rest
    slack: float = 0.005  # how deep vertices may be that were outside at rest
    spread: float = 0.04  # how far around it a push out of the body takes the apparel along
    passes: int = 3  # over all edges and the body
    most: float = 0.1  # nodes deeper than this are on the wrong side of something thin and stay
    lift: float = 0.25  # nodes that hang from the pelvis are moved no farther to lie over the legs
    # parts stiffer than the first begin to stay with their joints, those stiffer than the second do
    stiff: tuple[float, float] = (1.5, 1.75)


def known_share(stiffness: np.ndarray, settings: SafetySettings | None = None) -> np.ndarray:
    """How much of a displacement counts in parts of a stiffness: 1 as far as the networks know it, 0 beyond."""
    low, high = (settings or SafetySettings()).stiff
    return np.asarray(np.clip((high - stiffness) / (high - low), 0, 1), np.float32)


class Safety:
    """The stage for one clothed character and its nodes, by body points denser than those of the features."""

    def __init__(
        self, clothed: ClothedCharacter, nodes: ApparelNodes, points: BodyPoints, carrier: Carrier,
        settings: SafetySettings | None = None,
    ):  # fmt: skip
        self.settings = settings or SafetySettings()
        self.points, scale = points, clothed.scale
        here = np.repeat(np.arange(len(nodes)), nodes.neighbours.shape[1])
        pairs = np.sort(np.stack([here, nodes.neighbours.reshape(-1)], axis=1), axis=1)
        self.edges = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
        self.lengths = np.linalg.norm(nodes.rest[self.edges[:, 0]] - nodes.rest[self.edges[:, 1]], axis=1)
        self.shortest, self.longest = self.settings.shortest * self.lengths, self.settings.longest * self.lengths
        self.ends = tuple(np.ascontiguousarray(end) for end in self.edges.T)
        share = known_share(clothed.stiffness[nodes.part], self.settings)
        # where the swing of each vertex is known, the networks know stiff parts too
        self.share = np.where(clothed.swing is None, share, np.float32(1))[:, None]
        # what lies on the body at rest stays there: the root of a part is held
        self.free = np.where(nodes.distance < LAYER * scale, 0.0, 1.0)[:, None].astype(np.float32)
        degree = np.maximum(np.bincount(self.edges.reshape(-1), minlength=len(nodes)), 1)
        number = np.arange(len(self.edges))
        half = 0.5 * self.free[:, 0] / np.sqrt(degree)
        a, b = self.edges.T
        self.shared = csr_matrix(
            (np.concatenate([half[a], -half[b]]), (np.concatenate([a, b]), np.concatenate([number, number]))),
            shape=(len(nodes), len(self.edges)), dtype=np.float32,
        )  # fmt: skip
        self.body = PosedBody(points.rest, points.normals) if len(points.rest) else None
        if self.body is not None:
            self.most = self.settings.most * scale
            self.gap = self.body.gap(nodes.rest, self.settings.clear * scale, scale)
            self.vertex_gap = self.body.gap(clothed.rest[carrier.vertices], -self.settings.slack * scale, scale)
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

    def __call__(self, positions: np.ndarray, affine: np.ndarray) -> tuple[np.ndarray, PosedBody | None]:
        """Nodes made safe [m], (M, 3), and the body in the pose; `affine` as of `Carrier.positions`."""
        out = np.array(positions, np.float32)
        if self.body is None:
            for _ in range(self.settings.passes):
                out = self._bounded(out)
            return out, None
        body = self.posed(affine)
        out = self._over_legs(out, affine, body.positions)
        near = body.planes(out)[1]
        for _ in range(self.settings.passes):
            out = self.outside(self._bounded(out), near)
        return out, body

    def posed(self, affine: np.ndarray) -> PosedBody:
        """The body in a pose, by the transforms of its joints (22, 3, 4)."""
        return PosedBody(*self.points.posed(affine))

    def outside(self, positions: np.ndarray, near: Planes) -> np.ndarray:
        """Nodes one step out of the body with their surroundings, so that pieces are not flattened, (M, 3)."""
        lack, way = near.push(positions, self.gap, self.most, self.scale)
        if not lack.any():
            return positions
        push = np.concatenate([lack[:, None] * way, (lack > 0)[:, None]], axis=1, dtype=np.float32)
        return self._spread(positions, push)

    def _spread(self, positions: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Nodes moved by their surroundings: a push and 1 for each that is pushed, 0 for others, shape (M, 4)."""
        near = self.around @ push
        return np.asarray(positions + self.free * (near[:, :3] / np.maximum(near[:, 3:], FEW)))

    def _over_legs(self, positions: np.ndarray, affine: np.ndarray, body: np.ndarray) -> np.ndarray:
        """Nodes that hang from the pelvis, farther from its axis than the legs between: a lifted knee that has come
        through a skirt is no longer in it, so no depth shows it.
        """
        if not len(self.hung):
            return positions
        turn, shift = affine[0, :, :3], affine[0, :, 3]
        legs = body[self.legs] @ turn - shift @ turn
        local = positions[self.hung] @ turn - shift @ turn
        short = self.leg_gap + self._reach(legs) - ((local - self.axis) * self.outward).sum(axis=1)
        short = np.where(short < self.settings.lift * self.scale, np.maximum(short, 0), 0)
        push = np.zeros((len(positions), 4), np.float32)
        push[self.hung, :3] = (short[:, None] * self.outward) @ turn.T
        push[self.hung, 3] = short > 0
        return self._spread(positions, push)

    def _reach(self, legs: np.ndarray) -> np.ndarray:
        """How far the legs, in the pelvis' frame, reach along the way out through each hanging node [m], (H,)."""
        seen = np.empty((5, len(legs)), np.float32)
        seen[:3], seen[3], seen[4] = legs.T, 1, np.einsum("la,la->l", legs, legs)
        along, square = np.split(self.rays @ seen, 2)  # and the square of the distance from the axis
        square -= along * along
        return np.asarray(np.where(square < (BESIDE * self.scale) ** 2, along, np.float32(-1)).max(axis=1))

    def vertices(self, positions: np.ndarray, body: PosedBody | None) -> np.ndarray:
        """Vertices that the carrier took along, out of the body where they are still in it [m], shape (A, 3)."""
        if body is None:
            return positions
        out, rows = np.array(positions), np.arange(len(positions))
        for _ in range(STEPS):
            lack, way = body.planes(out[rows])[1].push(out[rows], self.vertex_gap[rows], self.most, self.scale)
            out[rows] += lack[:, None] * way
            rows = rows[lack > 0]
        return out

    def _bounded(self, positions: np.ndarray) -> np.ndarray:
        a, b = self.ends
        offset = positions.take(b, axis=0) - positions.take(a, axis=0)
        now = np.sqrt(np.einsum("ea,ea->e", offset, offset))
        wanted = np.minimum(np.maximum(now, self.shortest), self.longest)
        offset *= (1 - wanted / np.maximum(now, 1e-9))[:, None]
        return np.asarray(positions + self.shared @ offset)


def _rays(outward: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """What takes a point p, 1 and |p|^2 to its distance along each of H rays, and below that to the square of its
    distance from the beginning of the ray, shape (2 H, 5).
    """
    begin = np.einsum("ha,ha->h", axis, outward)
    along = np.concatenate([outward, -begin[:, None], np.zeros((len(axis), 1))], axis=1)
    square = np.concatenate([-2 * axis, np.square(axis).sum(axis=1, keepdims=True), np.ones((len(axis), 1))], axis=1)
    return np.concatenate([along, square]).astype(np.float32)


def _around(nodes: ApparelNodes, spread: float) -> np.ndarray:
    """Weight of each node of the same part near each, rows sum to 1, shape (M, M)."""
    square = np.square(nodes.rest[:, None] - nodes.rest[None]).sum(axis=-1)
    share = np.exp(-0.5 * square / spread**2) * (nodes.part[:, None] == nodes.part[None])
    return np.asarray(share / share.sum(axis=1, keepdims=True), np.float32)


SAFE_POINTS = 1500  # of the body; chosen by eye


class ApparelPlayer:
    """A clothed character whose apparel the network moves, with or without safety and the recurrent part."""

    def __init__(
        self, clothed: ClothedCharacter, network: DisplacementNetwork, *, nodes: int = 256, safe: bool = True,
        recurrent: bool = True,
    ):  # fmt: skip
        self.clothed, self.network = clothed, network
        parts = int(clothed.part.max(initial=-1)) + 1
        self.nodes = apparel_nodes(clothed, max(nodes, min(3 * parts, 512)))
        self.carrier = Carrier(clothed, self.nodes)
        graph = NodeGraph(self.nodes.neighbours, self.nodes.part)
        self.folded = FoldedNetwork(network, *static_features(clothed, self.nodes), graph)
        self.safety = Safety(clothed, self.nodes, surface_points(clothed, SAFE_POINTS), self.carrier) if safe else None
        self.recurrent = network.recurrent if recurrent else None
        self.features: MotionFeatures | None = None
        self.past: FoldedPast | None = None

    def start(self, transforms: np.ndarray) -> None:
        """Begin a second before a first frame, `[R | t]` of the joints (Eq. 1), (22, 3, 4), from the rest pose."""
        joints = self.clothed.joints
        self.features = MotionFeatures(self.clothed, self.nodes, rest_transforms(joints, transforms))
        self.past = None
        for pose in lead_in_transforms(joints, transforms, LEAD_IN):
            frame = self.features.advance(pose)
            if self.recurrent is not None:
                self._moved(frame, pose)

    def advance(self, transforms: np.ndarray) -> np.ndarray:
        """The next frame, a thirtieth of a second later: positions of the apparel vertices (`carrier.vertices`) [m],
        shape (A, 3), float32, by `[R | t]` of the joints (Eq. 1), shape (22, 3, 4).
        """
        if self.features is None:
            self.start(transforms)
        assert self.features is not None
        frame = self.features.advance(np.asarray(transforms, np.float32))
        moved = self._moved(frame, transforms) * np.float32(self.clothed.scale)
        affine = eq4_transforms(np.asarray(transforms, np.float32)[None], self.clothed.joints)[0]
        if self.safety is None:
            return self.carrier.positions(moved, affine)
        moved = self.safety.share * moved
        safe, body = self.safety(frame.positions + np.einsum("mab,mb->ma", frame.turns, moved), affine)
        moved = np.einsum("mba,mb->ma", frame.turns, safe - frame.positions)
        return self.safety.vertices(self.carrier.positions(moved, affine), body)

    def _carried_by(self, frame: Frame, transforms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Frames of the carrying joints and carried positions as the recurrent part takes them."""
        root = transforms[0, :, 3] if self.network.recurrent is not None and self.network.recurrent.world else 0.0
        return frame.turns, ((frame.positions - root) / self.clothed.scale).astype(np.float32)

    def _moved(self, frame: Frame, transforms: np.ndarray) -> np.ndarray:
        """Displacement of the nodes in the frames of their joints, over the size, shape (M, 3)."""
        inputs = network_inputs(frame)
        anchor = self.folded.anchor(*inputs)
        if self.recurrent is None:
            return anchor
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
        3), float32, by `[R | t]` of the joints, shape (N, 22, 3, 4).
        """
        self.start(np.asarray(transforms[0], np.float32))
        return np.stack([self.advance(pose) for pose in transforms])


def network_inputs(frame: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.ascontiguousarray(frame.vectors), frame.scalars, frame.whole
