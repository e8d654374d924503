"""Simulated chains kept off the body: skirts laid over legs, and links rotated out of the body; and the repairs of
chains in their order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.spatial import cKDTree

from bunraku.anatomy.handles.networks import farthest_points
from bunraku.apparel.body import BAND, BodyDepth, BodyPoints, Unposed, body_depth, body_points, nearest_index
from bunraku.apparel.chains.chain import Chain
from bunraku.apparel.chains.cloth_repairs import ChainRepair, DressedChains, SmoothNeighbours
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.core.animation import RigAnimation
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.skinning import skin

_LEGS = [[JOINT_NAMES.index(f"{side}_{part}") for part in ("hip", "knee", "ankle")] for side in ("left", "right")]
_LIMB = np.array([
    0 if not name.startswith(("left_", "right_")) or name.endswith("collar")
    else 1 + name.startswith("right_") + 2 * name.endswith(("hip", "knee", "ankle", "foot"))
    for name in JOINT_NAMES
])  # fmt: skip
"""Of each joint: the trunk, an arm or a leg."""
_LEG_LIMBS = (3, 4)


@dataclass(frozen=True)
class LegBalls:
    """Legs as rows of balls. All fields were chosen by eye.

    Args:
        samples: Balls of a thigh, and of a shin.
        thick: Radius of a leg without skin that shows it, over the size [m].
        gap: How far apparel stays off a leg, over the size [m].
    """

    samples: int = 8
    thick: float = 0.045
    gap: float = 0.012

    def __call__(
        self, affine: np.ndarray, clothed: ClothedCharacter, bones: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centres of the balls [m], posed by transforms of all bones (N, P, 3) and at rest (P, 3); radii (P,)."""
        posed, rests, radii = [], [], []
        share = (np.arange(self.samples) + 0.5)[:, None] / self.samples
        for leg in _LEGS:
            for above, below in zip(leg[:-1], leg[1:], strict=True):
                start, end = clothed.joints[above].astype(float), clothed.joints[below].astype(float)
                frame = affine[:, bones[above]]
                rest = start + share * (end - start)
                rests.append(rest)
                posed.append(np.einsum("nab,pb->npa", frame[:, :3, :3], rest) + frame[:, None, :3, 3])
                skin = clothed.rest[(clothed.weights[:, above] > 0.5) & (clothed.part < 0)]
                radius = self.thick * clothed.scale
                if len(skin) > 8:
                    along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
                    away = skin - start
                    off = np.linalg.norm(away - (away @ along)[:, None] * along, axis=1)
                    radius = float(np.clip(np.percentile(off, 85), 0.4 * radius, 2 * radius))
                radii.append(np.full(self.samples, radius + self.gap * clothed.scale))
        return np.concatenate(posed, axis=1), np.concatenate(rests), np.concatenate(radii)


@dataclass(frozen=True)
class SkirtsOverLegs:
    """Skirts lie over the legs: a column goes back to the skin of the bare mesh as far as it must, and what is still
    missing is rotated outwards. All fields were chosen by eye.

    Args:
        legs: The legs.
        wide: A leg that is so far beside a column counts in full, over the size [m].
        farthest: A column rotates no farther outwards [rad].
        spread: Share of a column's rotation that its neighbours have at least.
        nearest: Vertices whose skin says where a point of a column would go with the bare mesh.
        steps: Ways back to the skin that are tried, evenly from none to all of it.
        enough: A leg may be so far beyond a column [rad].
        hold, smooth: How long a rotation is held, and its standard deviation in time [s].
    """

    legs: LegBalls = LegBalls()
    wide: float = 0.08
    farthest: float = 1.4
    spread: float = 0.4
    nearest: int = 24
    steps: int = 6
    enough: float = 0.03
    hold: float = 0.15
    smooth: float = 0.06

    def __call__(self, animation: RigAnimation, dressed: DressedChains) -> RigAnimation:
        """The animation with skirts over its legs."""
        chains, clothed = dressed.chains, dressed.clothed
        if not any(chain.kind == "skirt" for chain in chains):
            return animation
        affine = animation.transforms()
        posed, rest, radii = self.legs(affine, clothed, dressed.bones)
        columns = {
            number: _Column(chain, clothed, rest, radii, self.wide)
            for number, chain in enumerate(chains) if chain.kind == "skirt"
        }  # fmt: skip
        share = np.zeros((len(animation), len(chains)))
        worlds, back = animation.world(), np.linspace(0, 1, self.steps)
        lines, backs = {}, {}
        for number, column in columns.items():
            legs = column.local(posed, affine)
            lines[number] = column.local(column.posed(*worlds), affine)
            backs[number] = column.local(self._on_skin(column.chain, animation, dressed, affine), affine)
            turns = np.stack(
                [column.turn(legs, lines[number] + part * (backs[number] - lines[number])) for part in back], axis=1
            )
            good = turns <= np.maximum(turns.min(axis=1, keepdims=True), self.enough)
            share[:, number] = back[good.argmax(axis=1)]
        share = self._spread(share, dressed.chained.near, animation.fps)
        rotations = np.array(animation.rotations, np.float64)
        for number, column in columns.items():
            line = lines[number] + share[:, number, None, None] * (backs[number] - lines[number])
            _aim(rotations, worlds[0], column.chain, affine[:, column.chain.holder, :3, :3], lines[number], line)
        animation = replace(animation, rotations=rotations)
        worlds = animation.world()
        extra = np.zeros((len(animation), len(chains)))
        for number, column in columns.items():
            line = column.local(column.posed(*worlds), affine)
            extra[:, number] = np.clip(column.turn(column.local(posed, affine), line), 0, self.farthest)
        extra = self._spread(extra, dressed.chained.near, animation.fps)
        rotations = np.array(animation.rotations, np.float64)
        for number, column in columns.items():
            bone = int(column.chain.bones[0])
            rotations[:, bone] = matrix_from_axis_angle(extra[:, number, None] * column.axis) @ rotations[:, bone]
        return replace(animation, rotations=rotations)

    def _on_skin(self, chain: Chain, animation: RigAnimation, dressed: DressedChains, affine: np.ndarray) -> np.ndarray:
        """Where the points of a column would go with the bare mesh [m], shape (N, R + 1, 3)."""
        clothed, bare, rig = dressed.clothed, dressed.bare, animation.character.rig
        assert rig is not None
        held = (rig.weights * np.isin(rig.indices, chain.bones)).sum(axis=1)
        rows = np.flatnonzero(held > 0.25 * held.max())
        gap = np.linalg.norm(clothed.rest[rows] - chain.points[:, None], axis=-1)
        near = np.argsort(gap, axis=1)[:, : self.nearest]
        chosen, index = np.unique(rows[near], return_inverse=True)
        bones = np.unique(bare.indices[chosen])
        weights = np.zeros((len(chosen), len(bones)), np.float32)
        columns = np.searchsorted(bones, bare.indices[chosen])
        np.add.at(weights, (np.arange(len(chosen))[:, None], columns), bare.weights[chosen])
        moved = skin(clothed.rest[chosen].astype(np.float32), weights, affine[:, bones, :3].astype(np.float32))
        index = index.reshape(near.shape)
        offset = chain.points - clothed.rest[chosen][index].mean(axis=1)
        rotated = np.einsum("nab,pb->npa", affine[:, chain.holder, :3, :3], offset)
        return np.asarray(moved[:, index].mean(axis=2) + rotated)

    def _spread(self, values: np.ndarray, near: Sequence[tuple[int, int, float]], fps: float) -> np.ndarray:
        """Values of columns (N, C) that their neighbours share in part, held and smooth in time."""
        shared = np.array(values)
        for first, second, _ in near:
            shared[:, first] = np.maximum(shared[:, first], self.spread * values[:, second])
            shared[:, second] = np.maximum(shared[:, second], self.spread * values[:, first])
        held = maximum_filter1d(shared, max(1, round(self.hold * fps)), axis=0)
        return np.asarray(gaussian_filter1d(held, self.smooth * fps, axis=0, mode="nearest"))


class _Column:
    """A column of a skirt, measured in the frame of its carrier, and the legs at rest."""

    def __init__(self, chain: Chain, clothed: ClothedCharacter, rest: np.ndarray, radii: np.ndarray, wide: float):
        self.chain, self.radii = chain, radii
        out = chain.points[len(chain.points) // 2] - clothed.joints[0]
        self.out = np.array([out[0], 0.0, out[2]]) / max(float(np.hypot(out[0], out[2])), 1e-9)
        self.axis = np.cross([0.0, -1.0, 0.0], self.out)
        self.wide = max(float(chain.width.max()), wide * clothed.scale)
        # the carrier's axes are the world's at rest
        self.least = _turns(rest[None], chain.points[None], self.out, radii, self.wide)[0]

    def local(self, points: np.ndarray, affine: np.ndarray) -> np.ndarray:
        """Points [m] in the frame of the carrier, shape (N, P, 3)."""
        frame = affine[:, self.chain.holder]
        return np.asarray(np.einsum("nba,npb->npa", frame[:, :3, :3], points - frame[:, None, :3, 3]))

    def posed(self, world: np.ndarray, heads: np.ndarray) -> np.ndarray:
        """The points of the column [m], shape (N, R + 1, 3)."""
        chain = self.chain
        last = chain.bones[-1]
        end = heads[:, last] + world[:, last] @ (chain.points[-1] - chain.points[-2])
        return np.asarray(np.concatenate([heads[:, chain.bones], end[:, None]], axis=1))

    def turn(self, legs: np.ndarray, line: np.ndarray) -> np.ndarray:
        """How far a line of points would have to rotate to lie over the legs as at rest [rad], shape (N,)."""
        return np.asarray(np.maximum(_turns(legs, line, self.out, self.radii, self.wide) - self.least, 0).max(axis=1))


def _turns(legs: np.ndarray, line: np.ndarray, out: np.ndarray, radii: np.ndarray, wide: float) -> np.ndarray:
    """How far a column (N, R + 1, 3) would have to rotate towards `out` for balls of legs (N, P, 3) with radii (P,) to
    lie behind it [rad], 0 where they do, shape (N, P). `wide` is half the width of what the column holds [m].
    """
    away, chain = legs - line[:, :1], line - line[:, :1]
    beyond, down = away @ out + radii, -away[..., 1]
    lateral = np.abs(away @ np.cross([0.0, 1.0, 0.0], out))
    drop = np.maximum.accumulate(-chain[..., 1], axis=1) + 1e-6 * np.arange(line.shape[1])
    there = np.stack([np.interp(v, d, o) for v, d, o in zip(down, drop, chain @ out, strict=True)])
    counts = smooth_step((lateral - 0.4 * wide) / (0.4 * wide + 0.8 * radii), 1.0, 0.0)
    counts = counts * ((down > 0.25 * radii) & (down < drop[:, -1:] + radii))
    level = np.maximum(down, 1e-6)
    return np.asarray(np.maximum((np.arctan2(beyond, level) - np.arctan2(there, level)) * counts, 0))


def _aim(
    rotations: np.ndarray, world: np.ndarray, chain: Chain, frame: np.ndarray, line: np.ndarray, goal: np.ndarray
) -> None:  # fmt: skip
    """Rotate the links of a chain, whose points (N, R + 1, 3) are given in a frame (N, 3, 3), along those of a goal."""
    before, after = np.diff(line, axis=1), np.diff(goal, axis=1)
    above = None
    for link, bone in enumerate(chain.bones):
        turn = frame @ _least_rotation(before[:, link], after[:, link]) @ np.swapaxes(frame, 1, 2)
        rotation = turn @ world[:, bone]
        if above is None:  # the carrier stays
            above = world[:, bone] @ np.swapaxes(rotations[:, bone], 1, 2)
        rotations[:, bone] = np.swapaxes(above, 1, 2) @ rotation
        above = rotation


def _least_rotation(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The least rotations that take vectors along others, shape (N, 3) each -> (N, 3, 3)."""
    start = start / np.maximum(np.linalg.norm(start, axis=1, keepdims=True), 1e-9)
    end = end / np.maximum(np.linalg.norm(end, axis=1, keepdims=True), 1e-9)
    cross = np.cross(start, end)
    sine = np.linalg.norm(cross, axis=1, keepdims=True)
    angle = np.arctan2(sine, (start * end).sum(axis=1, keepdims=True))
    return np.asarray(matrix_from_axis_angle(cross / np.maximum(sine, 1e-9) * np.minimum(angle, 3.0)))


@dataclass(frozen=True)
class PushOutOfBody:
    """Links lie on the body and not in it. All fields were chosen by eye.

    Args:
        legs: The legs that skirts must lie over.
        each: Points of a link that are looked at.
        points: Points of the body.
        passes: How often links are rotated.
        most: Points deeper than this are on the wrong side of something thin and stay, over the size [m].
        slack: How deep points may be that were outside at rest, over the size [m].
        farthest: A link rotates no farther in one pass [rad].
        firm: Links rotate little for points that are nearer to their beginning, over the size [m].
        stays: Weight of a point that is outside, against one that is in the body.
        smooth: Standard deviation of the rotations in time [s].
        deepest: A leg that is farther beyond a point of a skirt does not push it, over the size [m].
        about: A point of a skirt stands for no more than what lies so far about it, over the size [m].
    """

    legs: LegBalls = LegBalls()
    each: int = 20
    points: int = 1000
    passes: int = 9
    most: float = 0.12
    slack: float = 0.003
    farthest: float = 0.35
    firm: float = 0.01
    stays: float = 0.02
    smooth: float = 0.05
    deepest: float = 0.2
    about: float = 0.06

    def __call__(self, animation: RigAnimation, dressed: DressedChains) -> RigAnimation:
        """The animation with its links out of the body."""
        clothed, bones = dressed.clothed, dressed.bones
        depth = body_depth(clothed.rest, clothed.faces, clothed.weights, clothed.apparel, clothed.scale)
        points = body_points(clothed, self.points)
        if depth is None or not len(points.rest) or not dressed.chains:
            return animation
        links = _Links(self, animation, dressed, depth)
        if not len(links.vertex):
            return animation
        every = animation.transforms()
        affine = every[:, bones]
        sheet = np.array([links.kind[link] == "skirt" for link in links.link])
        skirt = np.flatnonzero(sheet)
        rest, holders = links.rest[skirt].astype(float), links.holder[links.link[skirt]]
        legs = _LegsBehind(self, clothed, rest, holders, bones, every) if len(skirt) else None
        ways = None
        for _ in range(self.passes):
            moved = links.points(animation)
            ways = ways or [_ways(points, *frame, clothed.scale) for frame in zip(affine, moved, strict=True)]
            push = np.zeros(moved.shape)
            if legs is not None:
                push[:, skirt] = legs.push(moved[:, skirt])
            for frame, (positions, limbs) in enumerate(zip(moved, ways, strict=True)):
                for rows, way, limb in limbs:
                    if limb in _LEG_LIMBS:  # a skirt goes outwards, whichever way out of a leg is nearer
                        kept = np.flatnonzero(~sheet[rows])
                        if not len(kept):
                            continue
                        rows, way = rows[kept], way.take(kept)
                    inside, step = depth.push(positions[rows], way, links.gap[rows], self.most * clothed.scale)
                    pushed = rows[inside]
                    more = np.square(step).sum(axis=1) > np.square(push[frame, pushed]).sum(axis=1)
                    push[frame, pushed[more]] = step[more]
            if not push.any():
                break
            animation = links.rotated(animation, moved, push)
        return animation


CHAIN_REPAIRS: tuple[ChainRepair, ...] = (SmoothNeighbours(), SkirtsOverLegs(), PushOutOfBody())
"""What corrects simulated chains, in this order; `MendTears` may follow."""


class _LegsBehind:
    """How far points of skirts (M, 3), each with the bone that carries it (M,), have to go outwards for the legs to lie
    behind them, by the transforms of all bones (N, B, 3, 4).
    """

    def __init__(
        self, how: PushOutOfBody, clothed: ClothedCharacter, points: np.ndarray, holders: np.ndarray, bones: np.ndarray,
        affine: np.ndarray,
    ):  # fmt: skip
        self.most = how.deepest * clothed.scale
        self.legs, rest, self.radii = how.legs(affine, clothed, bones)
        away = points - clothed.joints[0]
        away[:, 1] = 0
        out = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        self.out = np.einsum("nmab,mb->nma", affine[:, holders, :3, :3], out)
        # a point stands for the surface about it, and legs pass between points
        beside = cKDTree(points).query(points, min(3, len(points)))[0]
        self.about = np.minimum(beside.reshape(len(points), -1)[:, -1], how.about * clothed.scale)
        self.least = _beyond(points[None], rest[None], out[None], self.radii, self.about)[0]

    def push(self, points: np.ndarray) -> np.ndarray:
        """What moves points (N, M, 3) [m], 0 where legs are behind them."""
        beyond = np.maximum(_beyond(points, self.legs, self.out, self.radii, self.about) - self.least, 0)
        return np.asarray(np.where(beyond < self.most, beyond, 0.0)[..., None] * self.out)


def _beyond(
    points: np.ndarray, balls: np.ndarray, out: np.ndarray, radii: np.ndarray, about: np.ndarray
) -> np.ndarray:  # fmt: skip
    """How far balls (N, P, 3) reach beyond points (N, M, 3), which stand for what is near (M,), along `out`, (N, M)."""
    farthest = np.zeros(points.shape[:2])
    for centre, radius in zip(np.swapaxes(balls, 0, 1), radii, strict=True):
        away = centre[:, None] - points
        ahead = (away * out).sum(axis=-1)
        beside = np.sqrt(np.maximum(np.square(away).sum(axis=-1) - np.square(ahead), 0))
        left = radius**2 - np.square(np.maximum(beside - about, 0))
        farthest = np.maximum(farthest, np.where(left > 0, ahead + np.sqrt(np.maximum(left, 0)), 0))
    return farthest


def _ways(
    points: BodyPoints, affine: np.ndarray, positions: np.ndarray, size: float
) -> list[tuple[np.ndarray, Unposed, int]]:
    """Ways back to the rest pose of positions (M, 3), the rows that each is for, and its limb: by the trunk and by each
    limb that is near. What lies between a hand and a thigh must leave both.
    """
    blend = points.blends(affine)
    body = points.placed(blend)
    limbs = _LIMB[points.joint]
    out = []
    for limb in np.unique(limbs):
        members = np.flatnonzero(limbs == limb)
        near = members[nearest_index(positions, body[members])]
        rows = np.flatnonzero(np.square(positions - body[near]).sum(axis=1) < (BAND * size) ** 2)
        near = near[rows]
        way = Unposed.of(blend[near], points.joint[near])
        # where another limb was at rest is not part of this one
        kept = np.flatnonzero(limbs[nearest_index(way(positions[rows]), points.rest)] == limb)
        if len(kept):
            out.append((rows[kept], way.take(kept), int(limb)))
    return out


class _Links:
    """The links of chains, and points that they hold: the vertex of each point and the row of its link, its position at
    rest [m], and how near to the body it may come [m].
    """

    def __init__(self, how: PushOutOfBody, animation: RigAnimation, dressed: DressedChains, depth: BodyDepth):
        chains, clothed, rig = dressed.chains, dressed.clothed, animation.character.rig
        assert rig is not None
        self.how, self.size, self.parents = how, clothed.scale, rig.parents
        self.bones = np.concatenate([chain.bones for chain in chains])
        self.kind = [chain.kind for chain in chains for _ in chain.bones]
        self.holder = np.array([chain.holder for chain in chains for _ in chain.bones])
        row = {int(bone): number for number, bone in enumerate(self.bones)}
        above = [int(bone) for chain in chains for bone in (chain.holder, *chain.bones[:-1])]
        self.above = [row.get(bone, -1) for bone in above]
        dense = rig.dense_weights()
        held = dense[:, self.bones]
        most = np.where(held.max(axis=1) > 0.3, held.argmax(axis=1), -1)
        vertex = [np.flatnonzero(most == number) for number in range(len(self.bones))]
        vertex = [
            rows[farthest_points(clothed.rest[rows].astype(np.float64), how.each)] if len(rows) > how.each else rows
            for rows in vertex
        ]
        self.vertex = np.concatenate(vertex).astype(np.int64)
        self.link = np.repeat(np.arange(len(vertex)), [len(rows) for rows in vertex])
        self.weights, self.rest = dense[self.vertex], clothed.rest[self.vertex].astype(np.float32)
        self.gap = np.minimum(depth.at(self.rest)[0], np.float32(-how.slack * clothed.scale))

    def points(self, animation: RigAnimation) -> np.ndarray:
        """Where the points are [m], shape (N, M, 3)."""
        return np.asarray(skin(self.rest, self.weights, animation.transforms()))

    def rotated(self, animation: RigAnimation, points: np.ndarray, push: np.ndarray) -> RigAnimation:
        """The animation with each link rotated so that its points come nearest to where a push (N, M, 3) wants them."""
        world, heads = animation.world()
        rotations = np.array(animation.rotations, np.float64)
        carried = np.zeros((len(points), len(self.bones), 2, 3))  # of the links above: rotation, and rotation x head
        for number, (bone, above) in enumerate(zip(self.bones, self.above, strict=True)):
            if above >= 0:
                carried[:, number] = carried[:, above]
            rows = self.link == number
            if not rows.any():
                continue
            lever = points[:, rows] - heads[:, None, bone]
            turn, moment = carried[:, number, 0], carried[:, number, 1]
            left = push[:, rows] - (np.cross(turn[:, None], points[:, rows]) - moment[:, None])
            parent = world[:, int(self.parents[bone])]
            pushed = (push[:, rows] != 0).any(axis=-1)
            wanted, weights = np.where(pushed[..., None], left, 0.0), np.where(pushed, 1.0, self.how.stays)
            more = _least_turn(lever, wanted, weights, self.how.firm * self.size, self.how.farthest)
            local = np.einsum("nba,nb->na", parent, more)  # smooth where the carrier does not rotate
            local = gaussian_filter1d(local, self.how.smooth * animation.fps, axis=0, mode="nearest")
            more = np.einsum("nab,nb->na", parent, local)
            rotations[:, bone] = matrix_from_axis_angle(local) @ rotations[:, bone]
            carried[:, number, 0] = turn + more
            carried[:, number, 1] = moment + np.cross(more, heads[:, bone])
        return replace(animation, rotations=rotations)


def _least_turn(lever: np.ndarray, push: np.ndarray, weights: np.ndarray, firm: float, most: float) -> np.ndarray:
    """The small rotations w, of at most so much [rad], for which w x lever is nearest to a push in each frame, shapes
    (N, P, 3) and the points' weights (N, P) -> (N, 3).
    """
    square = (weights * (np.square(lever).sum(axis=-1) + firm**2)).sum(axis=1)
    matrix = square[:, None, None] * np.eye(3) - np.einsum("np,npa,npb->nab", weights, lever, lever)
    turn = np.linalg.solve(matrix, (weights[..., None] * np.cross(lever, push)).sum(axis=1)[..., None])[..., 0]
    length = np.linalg.norm(turn, axis=1, keepdims=True)
    return np.asarray(turn * np.minimum(most / np.maximum(length, 1e-9), 1))
