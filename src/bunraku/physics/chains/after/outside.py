"""Chains that have sunk into the body, turned out of it: they stay bones.

The points that each link holds say how they would have to move to leave the body; the link turns about its beginning by
what comes nearest to that (least squares), the links above it first. What turns is smooth in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from bunraku.apparel.body_depth import BAND, BodyDepth, Unposed, body_depth
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.displacement.body_points import BodyPoints, body_points, nearest_index
from bunraku.body.layout import JOINT_NAMES
from bunraku.core.rig_animation import RigAnimation
from bunraku.core.skinning import skin
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.handles.inference.graph import farthest_points
from bunraku.physics.chains.after.over_legs import LegsUnder
from bunraku.physics.chains.chain import Chain

__all__ = ["outside"]

EACH = 20
"""Points of a link that are looked at."""
POINTS = 1000  # of the body
PASSES = 9
MOST = 0.12  # over the size [m]: points deeper than this are on the wrong side of something thin, and stay
SLACK = 0.003  # over the size [m]: how deep points may be that were outside at rest
FARTHEST = 0.35
"""As far as a link turns in one pass [rad]."""
FIRM = 0.01  # over the size [m]: links turn little for what is nearer to where they begin
STAYS = 0.02  # what a point counts for that is where it should be, beside one that is in the body
_LIMB = np.array([
    0 if not name.startswith(("left_", "right_")) or name.endswith("collar")
    else 1 + name.startswith("right_") + 2 * name.endswith(("hip", "knee", "ankle", "foot"))
    for name in JOINT_NAMES
])  # fmt: skip
"""Of each joint: the trunk, an arm or a leg."""
_LEG_LIMBS = (3, 4)
SMOOTH = 0.05
"""Of the turns in time, standard deviation [s]."""


def outside(
    animation: RigAnimation, chains: Sequence[Chain], clothed: ClothedCharacter, bones: np.ndarray
) -> RigAnimation:
    """An animation whose chains lie on the body and not in it.

    Args:
        animation: Of the rig that the chains are part of.
        chains: By the bones of that rig, each after the one that it hangs on.
        clothed: The same mesh.
        bones: The bone of the rig that each of the 22 joints is, shape (22,).
    """
    depth = body_depth(clothed.rest, clothed.faces, clothed.weights, clothed.apparel, clothed.scale)
    points = body_points(clothed, POINTS)
    if depth is None or not len(points.rest) or not chains:
        return animation
    found = _Links.of(animation, chains, clothed, depth)
    if not len(found.vertex):
        return animation
    every = animation.transforms()
    affine = every[:, bones]
    skirt = np.flatnonzero([found.kind[link] == "skirt" for link in found.link])
    places, holders = found.rest[skirt].astype(float), found.holder[found.link[skirt]]
    legs = LegsUnder(clothed, places, holders, bones, every) if len(skirt) else None
    sheet = np.zeros(len(found.vertex), bool)
    sheet[skirt] = True
    ways = None
    for _ in range(PASSES):
        moved = found.points(animation)
        ways = ways or [_ways(points, frame, one, clothed.scale) for frame, one in zip(affine, moved, strict=True)]
        push = np.zeros(moved.shape)
        if legs is not None:
            push[:, skirt] = legs.push(moved[:, skirt])
        for frame, (own, limbs) in enumerate(zip(moved, ways, strict=True)):
            for rows, way, limb in limbs:
                if limb in _LEG_LIMBS:  # a skirt goes outwards, whichever way out of a leg is nearer
                    kept = np.flatnonzero(~sheet[rows])
                    if not len(kept):
                        continue
                    rows, way = rows[kept], way.take(kept)
                inside, step = depth.push(own[rows], way, found.gap[rows], MOST * clothed.scale)
                some = rows[inside]
                more = np.square(step).sum(axis=1) > np.square(push[frame, some]).sum(axis=1)
                push[frame, some[more]] = step[more]
        if not push.any():
            break
        animation = found.turned(animation, moved, push)
    return animation


def _ways(
    points: BodyPoints, affine: np.ndarray, own: np.ndarray, size: float
) -> list[tuple[np.ndarray, Unposed, int]]:
    """Ways back to the rest pose of points (M, 3), which points each is for, and which limb: by the trunk and by each
    limb that is near. What lies between a hand and a thigh must leave both.
    """
    blend = points.blends(affine)
    placed = points.placed(blend)
    limb = _LIMB[points.joint]
    out = []
    for number in np.unique(limb):
        place = np.flatnonzero(limb == number)
        near = place[nearest_index(own, placed[place])]
        rows = np.flatnonzero(np.square(own - placed[near]).sum(axis=1) < (BAND * size) ** 2)
        near = near[rows]
        way = Unposed.of(blend[near], points.joint[near])
        # where another limb was at rest is no part of this one
        true = limb[nearest_index(way(own[rows]), points.rest)] == number
        if true.any():
            kept = np.flatnonzero(true)
            out.append((rows[kept], way.take(kept), int(number)))
    return out


class _Links:
    """The links of chains, and points that they hold.

    Args:
        chains: The chains.
        vertex: Of each point, shape (M,).
        link: Row of the link that holds most of it, shape (M,).
        indices, weights: Bones that hold it, shape (M, K).
        gap: How near to the body each may come [m], shape (M,).
        size: Of the character.
    """

    def __init__(
        self, chains: Sequence[Chain], vertex: np.ndarray, link: np.ndarray, weights: np.ndarray, gap: np.ndarray,
        rest: np.ndarray, size: float,
    ):  # fmt: skip
        self.vertex, self.link, self.weights, self.gap, self.rest, self.size = vertex, link, weights, gap, rest, size
        self.bones = np.concatenate([chain.bones for chain in chains])
        self.kind = [chain.kind for chain in chains for _ in chain.bones]
        self.holder = np.array([chain.holder for chain in chains for _ in chain.bones])
        row = {int(bone): number for number, bone in enumerate(self.bones)}
        self.above = np.full(len(self.bones), -1)
        for chain in chains:
            over = [chain.holder, *chain.bones[:-1]]
            for bone, holder in zip(chain.bones, over, strict=True):
                self.above[row[int(bone)]] = row.get(int(holder), -1)

    @classmethod
    def of(
        cls, animation: RigAnimation, chains: Sequence[Chain], clothed: ClothedCharacter, depth: BodyDepth
    ) -> _Links:
        rig = animation.character.rig
        assert rig is not None
        dense = rig.dense_weights()
        bones = np.concatenate([chain.bones for chain in chains])
        held = dense[:, bones]
        most = np.where(held.max(axis=1) > 0.3, held.argmax(axis=1), -1)
        vertex, link = [], []
        for number in range(len(bones)):
            rows = np.flatnonzero(most == number)
            if len(rows) > EACH:
                rows = rows[farthest_points(clothed.rest[rows].astype(np.float64), EACH)]
            vertex.append(rows)
            link.append(np.full(len(rows), number))
        chosen = np.concatenate(vertex).astype(np.int64)
        rest = clothed.rest[chosen].astype(np.float32)
        gap = np.minimum(depth.at(rest)[0], np.float32(-SLACK * clothed.scale))
        return cls(chains, chosen, np.concatenate(link).astype(np.int64), dense[chosen], gap, rest, clothed.scale)

    def points(self, animation: RigAnimation) -> np.ndarray:
        """Where the points are [m], shape (N, M, 3)."""
        return np.asarray(skin(self.rest, self.weights, animation.transforms()))

    def turned(self, animation: RigAnimation, points: np.ndarray, push: np.ndarray) -> RigAnimation:
        """The animation with each link turned by what takes its points nearest to where a push (N, M, 3) wants them."""
        rig = animation.character.rig
        assert rig is not None
        world, heads = animation.world()
        rotations = np.array(animation.rotations, np.float64)
        carried = np.zeros((len(points), len(self.bones), 2, 3))  # of the links above: turn, and turn x place
        for number, bone in enumerate(self.bones):
            above = int(self.above[number])
            if above >= 0:
                carried[:, number] = carried[:, above]
            rows = self.link == number
            if not rows.any():
                continue
            lever = points[:, rows] - heads[:, None, bone]
            turn, moment = carried[:, number, 0], carried[:, number, 1]
            left = push[:, rows] - (np.cross(turn[:, None], points[:, rows]) - moment[:, None])
            parent = world[:, int(rig.parents[bone])]
            pushed = (push[:, rows] != 0).any(axis=-1)
            own = _least_turn(
                lever, np.where(pushed[..., None], left, 0.0), np.where(pushed, 1.0, STAYS), FIRM * self.size
            )
            local = np.einsum("nba,nb->na", parent, own)  # smooth where what carries it does not turn
            local = gaussian_filter1d(local, SMOOTH * animation.fps, axis=0, mode="nearest")
            own = np.einsum("nab,nb->na", parent, local)
            rotations[:, bone] = matrix_from_axis_angle(local) @ rotations[:, bone]
            carried[:, number, 0] = turn + own
            carried[:, number, 1] = moment + np.cross(own, heads[:, bone])
        return replace(animation, rotations=rotations)


def _least_turn(lever: np.ndarray, push: np.ndarray, count: np.ndarray, firm: float) -> np.ndarray:
    """The small turns w for which w x lever is nearest to a push in each frame, shapes (N, P, 3) and what each point
    counts for (N, P) -> (N, 3).
    """
    square = (count * (np.square(lever).sum(axis=-1) + firm**2)).sum(axis=1)
    matrix = square[:, None, None] * np.eye(3) - np.einsum("np,npa,npb->nab", count, lever, lever)
    turn = np.linalg.solve(matrix, (count[..., None] * np.cross(lever, push)).sum(axis=1)[..., None])[..., 0]
    length = np.linalg.norm(turn, axis=1, keepdims=True)
    return np.asarray(turn * np.minimum(FARTHEST / np.maximum(length, 1e-9), 1))
