"""Simulated chains kept off the body: links rotated out of it; and the repairs of chains in their order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from bunraku.anatomy.handles.networks import farthest_points
from bunraku.apparel.body import BAND, PLANES, BodyPoints, Planes, PosedBody, surface_points
from bunraku.apparel.chains.chain_rig import CLOTH
from bunraku.apparel.chains.cloth_repairs import (
    ChainRepair,
    DressedChains,
    SmoothNeighbours,
    averaged_turns,
    eased,
    on_skin,
)
from bunraku.apparel.clothed import ARMS, BESIDE, LEGS, ClothedCharacter
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.core.skinning import skin

_LIMB = np.array([
    0 if not name.startswith(("left_", "right_")) or name.endswith("collar")
    else 1 + name.startswith("right_") + 2 * name.endswith(("hip", "knee", "ankle", "foot"))
    for name in JOINT_NAMES
])  # fmt: skip
"""Of each joint: the trunk, an arm or a leg."""
STEEP = 0.3
"""Cosine of the ways out of a leg and of a skirt from which on the second is as long as it must be; chosen by eye."""


@dataclass(frozen=True)
class PushOutOfBody:
    """Links lie on the body and not in it, and neighbours go along. All fields were chosen by eye."""

    each: int = 20  # points of a link that are looked at
    points: int = 3000  # points of the body
    passes: int = 9  # how often links are rotated
    # passes after which what links were rotated is shared with their neighbours: after two of them alone, hair in
    # layers and the skirt of a lifted knee are torn
    shared: tuple[int, ...] = (1, 3, 5, 7)
    rounds: int = 3  # how often, each time
    most: float = 0.12  # points deeper than this are on the wrong side of something thin and stay, over the size [m]
    # How near the body points may come that were farther off at rest, over the size [m]; those that were nearer, or
    # deeper, come no nearer and no deeper than that. At 0.004 hair in layers is torn.
    clear: float = -0.002
    farthest: float = 0.35  # a link rotates no farther in one pass [rad]
    firm: float = 0.01  # links rotate little for points that are nearer to their beginning, over the size [m]
    stays: float = 0.02  # weight of a point that is outside, against one that is in the body
    smooth: float = 0.05  # standard deviation of the rotations in time [s]

    def __call__(self, animation: RigAnimation, dressed: DressedChains) -> RigAnimation:
        """The animation with its links out of the body."""
        clothed, bones = dressed.clothed, dressed.bones
        body = surface_points(clothed, self.points)
        if not dressed.chains or not len(body.rest):
            return animation
        links = _Links(self, animation, dressed)
        if not len(links.vertex):
            return animation
        every, first = animation.transforms(), animation.rotations
        moved = links.points(animation)
        near = _Near.of(body, every[:, bones], moved, links.rest, clothed.scale, self.clear)
        for number in range(self.passes):
            push = near.push(moved, links, self.most * clothed.scale)
            if not push.any():
                break
            animation = links.rotated(animation, moved, push)
            if number in self.shared:
                animation = links.shared(animation, first, dressed.chained.near)
            animation = links.bounded(animation, first)
            moved = links.points(animation)
        return animation


CHAIN_REPAIRS: tuple[ChainRepair, ...] = (SmoothNeighbours(), PushOutOfBody())
"""What corrects simulated chains, in this order; `MendTears` may follow."""


@dataclass(frozen=True, eq=False)
class _Near:
    """K points of frames near a limb, and what is nearest to each of it: points of its surface and the ways out of it.
    Each limb counts apart: what lies between a hand and a thigh must leave both.
    """

    frame: np.ndarray  # shape (K,)
    point: np.ndarray  # shape (K,)
    leg: np.ndarray  # whether the limb is a leg, shape (K,), bool
    gap: np.ndarray  # how near it may come [m], shape (K,)
    planes: Planes
    size: float

    @classmethod
    def of(
        cls, body: BodyPoints, affine: np.ndarray, moved: np.ndarray, rest: np.ndarray, size: float, clear: float
    ) -> _Near:  # fmt: skip
        """Of a body's points by the transforms of its joints (N, 22, 3, 4), for positions (N, M, 3) [m], `rest` at rest
        (M, 3), that keep `clear` of it, over the size [m].
        """
        limbs, band = _LIMB[body.joint], BAND * size
        numbers, gaps = [np.zeros((3, 0), np.int64)], [np.zeros(0)]
        nearest = [np.zeros((2, 0, PLANES, 3), np.float32)]
        posed = skin(body.rest, body.weights, affine)
        for limb in np.unique(limbs):
            members = np.flatnonzero(limbs == limb)
            if len(members) < PLANES:
                continue
            gap = PosedBody(body.rest[members], body.normals[members]).gap(rest, clear * size, size)
            low, high = posed[:, members].min(axis=1) - band, posed[:, members].max(axis=1) + band
            about = ((moved > low[:, None]) & (moved < high[:, None])).all(axis=-1) & np.isfinite(gap)
            for frame in np.flatnonzero(about.any(axis=1)):
                point = np.flatnonzero(about[frame])
                normals = np.einsum("bac,bc->ba", affine[frame, body.joint[members], :, :3], body.normals[members])
                rows, planes = PosedBody(posed[frame, members], normals).planes(moved[frame, point], band)
                point = point[rows]
                # what is farther out does not come in while others are moved
                height = planes.of(moved[frame, point])[0] - gap[point]
                kept = np.flatnonzero(height < BESIDE * size)
                point = point[kept]
                numbers.append(
                    np.stack([np.full(len(kept), frame), point, np.full(len(kept), limb in _LIMB[list(LEGS)])])
                )
                gaps.append(gap[point])
                nearest.append(np.stack([planes.positions[kept], planes.normals[kept]]).astype(np.float32))
        frame, point, leg = np.concatenate(numbers, axis=1)
        return cls(frame, point, leg > 0, np.concatenate(gaps), Planes(*np.concatenate(nearest, axis=1)), size)

    def push(self, moved: np.ndarray, links: _Links, most: float) -> np.ndarray:
        """What moves points (N, M, 3) out of the body [m], of the same shape. Points deeper than `most` stay [m]."""
        push = np.zeros(moved.shape)
        lack, way = self.planes.push(moved[self.frame, self.point], self.gap, most, self.size)
        rows = np.flatnonzero(lack)
        frame, point, way, length = self.frame[rows], self.point[rows], way[rows], lack[rows]
        skirt = links.row_of_sheet[point]
        outward = np.flatnonzero(self.leg[rows] & (skirt >= 0))
        # a skirt goes outwards, whichever way out of a leg is nearer; where that is along the leg, bit by bit
        out = links.out[frame[outward], skirt[outward]]
        along = np.einsum("pa,pa->p", way[outward], out)
        length[outward] /= np.where(along > STEEP, along, 1.0)
        way[outward] = out
        order = np.argsort(length, kind="stable")  # the largest is written last
        push[frame[order], point[order]] = (length[:, None] * way)[order]
        return push


@dataclass(frozen=True)
class BindToSkin:
    """Apparel that the body comes through all the same goes over to the skin there, where the skin does better: legs in
    long steps take a narrow robe along, and hair that would fall through a bent back stays behind it. All fields were
    chosen by eye.
    """

    frames: int = 24  # frames that are looked at
    vertices: int = 800  # of them that are looked at
    points: int = 3000  # of the body
    deep: float = 0.01  # over the size [m]
    thick: float = 0.03  # the same of what is no cloth: a lock that sinks in by its own thickness is still seen
    often: float = 0.1  # share of the frames in which it is deeper than the skin

    def __call__(
        self, animation: RigAnimation, plain: Animation | RigAnimation, dressed: DressedChains
    ) -> RigAnimation:  # fmt: skip
        """The animation whose apparel is on the skin where it must; `plain` is the same with all apparel on the body's
        skin.
        """
        frames = self.seen(len(animation))
        affine = animation.transforms()[frames][:, dressed.bones]
        free = self.free(dressed.clothed, affine, animation.vertices(frames), plain.vertices(frames))
        return animation if free.all() else on_skin(animation, dressed.bare, free)

    def seen(self, count: int) -> np.ndarray:
        """Those of `count` frames that are looked at."""
        return np.unique(np.linspace(0, count - 1, self.frames).astype(np.int64))

    def free(self, clothed: ClothedCharacter, affine: np.ndarray, moved: np.ndarray, plain: np.ndarray) -> np.ndarray:
        """How far each vertex moves freely, shape (V,); for the rest it is on the skin.

        Args:
            clothed: The character.
            affine: Transforms of its joints in the frames that are `seen`, shape (N, 22, 3, 4).
            moved: All vertices there [m], shape (N, V, 3).
            plain: The same, with all apparel on the body's skin.
        """
        size = clothed.scale
        apparel, body = np.flatnonzero(clothed.apparel), surface_points(clothed, self.points)
        free = np.ones(len(clothed.rest), np.float32)
        if not len(apparel) or not len(body.rest):
            return free
        chosen = apparel
        if len(apparel) > self.vertices:
            chosen = apparel[farthest_points(clothed.rest[apparel].astype(np.float64), self.vertices)]
        often = np.zeros(len(chosen))
        kinds = np.array([kind not in CLOTH for kind in clothed.kinds] or [False] * len(clothed.stiffness))
        lock, arms = kinds[clothed.part[chosen]], np.isin(body.joint, ARMS)
        # hair and arms pass through each other: nothing keeps them apart
        for rows, seen, deep in ((~lock, np.ones_like(arms), self.deep), (lock, ~arms, self.thick)):
            if not (rows.any() and seen.any()):
                continue
            gap = PosedBody(body.rest[seen], body.normals[seen]).gap(clothed.rest[chosen[rows]], 0.0, size)
            for sign, shown in ((1, moved), (-1, plain)):
                for pose, points in zip(affine, shown[:, chosen[rows]], strict=True):
                    positions, normals = body.posed(pose)
                    _, planes = PosedBody(positions[seen], normals[seen]).planes(points)
                    lack, _ = planes.push(points, gap, np.inf, size)
                    often[rows] += sign * (lack > deep * size) / len(affine)
        for part in range(len(clothed.stiffness)):
            through = chosen[(often > self.often) & (clothed.part[chosen] == part)]
            rows = np.flatnonzero(clothed.part == part)
            if len(through):
                apart = np.linalg.norm(moved[:, rows] - plain[:, rows], axis=-1).max(axis=0)
                free[rows] = eased(clothed.rest[rows], clothed.rest[through], apart)
        return free


class _Links:
    """The links of chains, and points that they hold: the vertex of each point and its position at rest [m].

    Attributes:
        sheet: Points of skirts, shape (S,).
        row_of_sheet: The row in `sheet` of each point, or -1, shape (M,).
        out: Outwards at those points in each frame, shape (N, S, 3).
    """

    def __init__(self, how: PushOutOfBody, animation: RigAnimation, dressed: DressedChains):
        chains, clothed, rig = dressed.chains, dressed.clothed, animation.character.rig
        assert rig is not None
        self.how, self.size, self.chains = how, clothed.scale, chains
        self.bones = np.concatenate([chain.bones for chain in chains])
        self.parents = rig.parents[self.bones]
        holder = np.array([chain.holder for chain in chains for _ in chain.bones])
        row = {int(bone): number for number, bone in enumerate(self.bones)}
        above = [int(bone) for chain in chains for bone in (chain.holder, *chain.bones[:-1])]
        self.above = np.array([row.get(bone, -1) for bone in above])
        level = np.zeros(len(self.bones), np.int64)
        for number, upper in enumerate(self.above):  # each after the one that it hangs on
            level[number] = level[upper] + 1 if upper >= 0 else 0
        self.levels = [np.flatnonzero(level == number) for number in range(int(level.max()) + 1)]
        dense = rig.dense_weights()
        held = dense[:, self.bones]
        most = np.where(held.sum(axis=1) > 0.3, held.argmax(axis=1), -1)
        vertex = [np.flatnonzero(most == number) for number in range(len(self.bones))]
        vertex = [
            rows[farthest_points(clothed.rest[rows].astype(np.float64), how.each)] if len(rows) > how.each else rows
            for rows in vertex
        ]
        self.vertex = np.concatenate(vertex).astype(np.int64)
        link = np.repeat(np.arange(len(vertex)), [len(rows) for rows in vertex])
        self.filled = np.arange(how.each) < np.array([[len(rows)] for rows in vertex])
        self.slots = np.zeros(self.filled.shape, np.int64)
        self.slots[self.filled] = np.arange(len(self.vertex))
        used = np.flatnonzero(dense[self.vertex].any(axis=0))
        self.used, self.weights = used, dense[self.vertex][:, used]
        self.rest = clothed.rest[self.vertex].astype(np.float32)
        skirt = np.array([chain.kind == "skirt" for chain in chains for _ in chain.bones])
        self.sheet = np.flatnonzero(skirt[link])
        self.row_of_sheet = np.full(len(self.vertex), -1)
        self.row_of_sheet[self.sheet] = np.arange(len(self.sheet))
        away = self.rest[self.sheet] - clothed.joints[0]
        away[:, 1] = 0
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        carriers = animation.transforms()[:, holder[link[self.sheet]], :3, :3]
        self.out = np.einsum("nmab,mb->nma", carriers, away)

    def points(self, animation: RigAnimation) -> np.ndarray:
        """Where the points are [m], shape (N, M, 3)."""
        return np.ascontiguousarray(skin(self.rest, self.weights, animation.transforms()[:, self.used]))

    def rotated(self, animation: RigAnimation, points: np.ndarray, push: np.ndarray) -> RigAnimation:
        """The animation with each link rotated so that its points come nearest to where a push (N, M, 3) wants them."""
        world, heads = animation.world()
        rotations = np.array(animation.rotations, np.float64)
        # of the links above: rotation, and rotation x head; the last row is what stays
        turns, moments = np.zeros((2, len(points), len(self.bones) + 1, 3))
        for rows in self.levels:
            slots, bones = self.slots[rows], self.bones[rows]
            moved, wanted = points[:, slots], push[:, slots]
            pushed = wanted.any(axis=-1) & self.filled[rows]
            turn, moment = turns[:, self.above[rows]], moments[:, self.above[rows]]
            left = wanted - (np.cross(turn[:, :, None], moved) - moment[:, :, None])
            weights = np.where(pushed, 1.0, self.how.stays) * self.filled[rows]
            more = _least_turn(
                moved - heads[:, bones, None], np.where(pushed[..., None], left, 0.0), weights,
                self.how.firm * self.size, self.how.farthest,
            )  # fmt: skip
            parent = world[:, self.parents[rows]]
            local = np.einsum("ncba,ncb->nca", parent, more)  # smooth where the carrier does not rotate
            local = gaussian_filter1d(local, self.how.smooth * animation.fps, axis=0, mode="nearest")
            more = np.einsum("ncab,ncb->nca", parent, local)
            rotations[:, bones] = matrix_from_axis_angle(local) @ rotations[:, bones]
            turns[:, rows], moments[:, rows] = turn + more, moment + np.cross(more, heads[:, bones])
        return replace(animation, rotations=rotations)

    def bounded(self, animation: RigAnimation, first: np.ndarray) -> RigAnimation:
        """The animation whose links, but those of cloth, are rotated no farther from rotations (N, J, 3, 3) than their
        own limits: a lock that lies on the chest of a bent head must not fold up to the chin.
        """
        rotations, before = np.array(animation.rotations, np.float64), np.asarray(first, np.float64)
        for chain in self.chains:
            if chain.kind not in CLOTH:
                here = before[:, chain.bones]
                turn = axis_angle_from_matrix(rotations[:, chain.bones] @ np.swapaxes(here, 2, 3))
                length = np.maximum(np.linalg.norm(turn, axis=-1, keepdims=True), 1e-9)
                turn *= np.minimum(chain.limits[:, None] / length, 1)
                rotations[:, chain.bones] = matrix_from_axis_angle(turn) @ here
        return replace(animation, rotations=rotations)

    def shared(
        self, animation: RigAnimation, first: np.ndarray, near: Sequence[tuple[int, int, float]]
    ) -> RigAnimation:  # fmt: skip
        """The animation whose links were rotated since rotations (N, J, 3, 3) as the mean of them and neighbours."""
        rotations, before = np.array(animation.rotations, np.float64), np.asarray(first, np.float64)
        turns = [
            axis_angle_from_matrix(rotations[:, chain.bones] @ np.swapaxes(before[:, chain.bones], 2, 3))
            for chain in self.chains
        ]
        for _ in range(self.how.rounds):
            turns = averaged_turns(turns, near)
        for chain, turn in zip(self.chains, turns, strict=True):
            rotations[:, chain.bones] = matrix_from_axis_angle(turn) @ before[:, chain.bones]
        return replace(animation, rotations=rotations)


def _least_turn(lever: np.ndarray, push: np.ndarray, weights: np.ndarray, firm: float, most: float) -> np.ndarray:
    """The small rotations w, of at most so much [rad], for which w x lever is nearest to a push in each frame, shapes
    (N, C, P, 3) and the points' weights (N, C, P) -> (N, C, 3).
    """
    square = (weights * (np.square(lever).sum(axis=-1) + firm**2)).sum(axis=-1) + 1e-12
    matrix = square[..., None, None] * np.eye(3) - np.swapaxes(weights[..., None] * lever, -1, -2) @ lever
    turn = np.linalg.solve(matrix, (weights[..., None] * np.cross(lever, push)).sum(axis=-2)[..., None])[..., 0]
    length = np.linalg.norm(turn, axis=-1, keepdims=True)
    return np.asarray(turn * np.minimum(most / np.maximum(length, 1e-9), 1))
