"""Simulated chains kept off the body: skirts laid over legs, and links that have sunk into the body rotated out of
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.spatial import cKDTree

from bunraku.anatomy.handles.networks import farthest_points
from bunraku.apparel.body import BAND, BodyDepth, BodyPoints, Unposed, body_depth, body_points, nearest_index
from bunraku.apparel.chains.chain import Chain
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.core.animation import RigAnimation
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.character import Rig
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.skinning import skin

__all__ = ["LegsUnder", "over_legs", "push_out_of_body"]

SAMPLES = 8
"""Places of a thigh, and of a shin, that are looked at."""
THICK = 0.045
"""Over the size [m]: half the thickness of a leg that no skin shows."""
GAP = 0.012
"""Over the size [m]: how far a skirt lies over a leg."""
WIDE = 0.08
"""Over the size [m]: a leg that is so far beside a column counts whole for it."""
FARTHEST = 1.4
"""As far as a column turns [rad]."""
SPREAD = 0.4
"""Of its turn, that its neighbours have at least."""
NEAREST = 24
"""Vertices whose skin says where a point of a column would go with the bare mesh."""
BACK = np.linspace(0, 1, 6)
"""How far a column goes back to the skin: the least of these that takes it over the legs."""
ENOUGH = 0.03
"""So far a leg may be beyond a column [rad]."""
DEEPEST = 0.2
"""Over the size [m]: a leg that is farther beyond a point is none of its."""
ABOUT = 0.06
"""Over the size [m]: a point stands for no more than what lies so far about it."""
HOLD, SMOOTH = 0.15, 0.06
"""How long a turn is held, and its standard deviation in time [s]."""
_LEGS = [
    [JOINT_NAMES.index(f"{side}_{part}") for part in ("hip", "knee", "ankle")] for side in ("left", "right")
]  # fmt: skip


def over_legs(
    animation: RigAnimation, chains: Sequence[Chain], near: Sequence[tuple[int, int, float]],
    clothed: ClothedCharacter, bones: np.ndarray, bare: Rig,
) -> RigAnimation:  # fmt: skip
    """An animation whose skirts lie over the legs.

    Args:
        animation: Of the rig that the chains are part of.
        chains: By the bones of that rig.
        near: Pairs of chains that are neighbours, as of `LaidChains`.
        clothed: The same mesh.
        bones: The bone of the rig that each of the 22 joints is, shape (22,).
        bare: The rig without the chains, whose skin goes with the legs.
    """
    skirts = [number for number, chain in enumerate(chains) if chain.kind == "skirt"]
    if not skirts:
        return animation
    affine = animation.transforms()
    posed, rest, thick = _legs(affine, clothed, bones)
    columns = {number: _Column(chains[number], clothed, rest, thick) for number in skirts}
    share = np.zeros((len(animation), len(chains)))
    worlds = animation.world()
    lines, backs = {}, {}
    for number, column in columns.items():
        legs = column.local(posed, affine)
        lines[number] = column.local(column.posed(*worlds), affine)
        backs[number] = column.local(_on_skin(column.chain, animation, clothed, bare, affine), affine)
        turns = np.stack(
            [column.turn(legs, lines[number] + some * (backs[number] - lines[number])) for some in BACK], axis=1
        )
        good = turns <= np.maximum(turns.min(axis=1, keepdims=True), ENOUGH)
        share[:, number] = BACK[good.argmax(axis=1)]
    share = _spread(share, near, animation.fps)
    rotations = np.array(animation.rotations, np.float64)
    for number, column in columns.items():
        line = lines[number] + share[:, number, None, None] * (backs[number] - lines[number])
        _aim(rotations, worlds[0], column.chain, affine[:, column.chain.holder, :3, :3], lines[number], line)
    animation = replace(animation, rotations=rotations)
    worlds = animation.world()
    extra = np.zeros((len(animation), len(chains)))
    for number, column in columns.items():
        line = column.local(column.posed(*worlds), affine)
        extra[:, number] = np.clip(column.turn(column.local(posed, affine), line), 0, FARTHEST)
    extra = _spread(extra, near, animation.fps)
    rotations = np.array(animation.rotations, np.float64)
    for number, column in columns.items():
        bone = int(column.chain.bones[0])
        rotations[:, bone] = matrix_from_axis_angle(extra[:, number, None] * column.axis) @ rotations[:, bone]
    return replace(animation, rotations=rotations)


class LegsUnder:
    """How far points of skirts would have to go outwards for the legs to lie behind them.

    Args:
        clothed: The character.
        points: At rest [m], shape (M, 3).
        holders: The bone that carries each, shape (M,).
        bones: The bone of the rig that each of the 22 joints is, shape (22,).
        affine: Transforms of all bones, shape (N, B, 3, 4).
    """

    def __init__(
        self, clothed: ClothedCharacter, points: np.ndarray, holders: np.ndarray, bones: np.ndarray, affine: np.ndarray
    ):
        self.most = DEEPEST * clothed.scale
        self.legs, rest, self.thick = _legs(affine, clothed, bones)
        away = points - clothed.joints[0]
        away[:, 1] = 0
        out = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        self.out = np.einsum("nmab,mb->nma", affine[:, holders, :3, :3], out)
        # a point stands for the surface about it, and legs pass between points
        next_one = cKDTree(points).query(points, min(3, len(points)))[0]
        self.about = np.minimum(next_one.reshape(len(points), -1)[:, -1], ABOUT * clothed.scale)
        self.least = _beyond(points[None], rest[None], out[None], self.thick, self.about)[0]

    def push(self, points: np.ndarray) -> np.ndarray:
        """The way of points (N, M, 3) [m], 0 where legs are behind them."""
        beyond = np.maximum(_beyond(points, self.legs, self.out, self.thick, self.about) - self.least, 0)
        return np.asarray(np.where(beyond < self.most, beyond, 0.0)[..., None] * self.out)


def _beyond(
    points: np.ndarray, legs: np.ndarray, out: np.ndarray, thick: np.ndarray, about: np.ndarray
) -> np.ndarray:  # fmt: skip
    """How far balls (N, P, 3), half so thick (P,), reach beyond points (N, M, 3), each of which stands for what lies so
    far about it (M,), in their directions, shape (N, M).
    """
    found = np.zeros(points.shape[:2])
    for place, radius in zip(np.swapaxes(legs, 0, 1), thick, strict=True):
        away = place[:, None] - points
        ahead = (away * out).sum(axis=-1)
        beside = np.sqrt(np.maximum(np.square(away).sum(axis=-1) - np.square(ahead), 0))
        left = radius**2 - np.square(np.maximum(beside - about, 0))
        found = np.maximum(found, np.where(left > 0, ahead + np.sqrt(np.maximum(left, 0)), 0))
    return found


class _Column:
    """A column of a skirt and the legs at rest: what it is measured by in the frame of what carries it."""

    def __init__(self, chain: Chain, clothed: ClothedCharacter, rest: np.ndarray, thick: np.ndarray):
        self.chain, self.thick = chain, thick
        out = chain.points[len(chain.points) // 2] - clothed.joints[0]
        self.out = np.array([out[0], 0.0, out[2]]) / max(float(np.hypot(out[0], out[2])), 1e-9)
        self.axis = np.cross([0.0, -1.0, 0.0], self.out)
        self.wide = max(float(chain.width.max()), WIDE * clothed.scale)
        # what carries it lies along the world's axes at rest
        self.least = _turns(rest[None], chain.points[None], self.out, thick, self.wide)[0]

    def local(self, points: np.ndarray, affine: np.ndarray) -> np.ndarray:
        """Points [m] in the frame of what carries it, shape (N, P, 3)."""
        own = affine[:, self.chain.holder]
        return np.asarray(np.einsum("nba,npb->npa", own[:, :3, :3], points - own[:, None, :3, 3]))

    def posed(self, world: np.ndarray, heads: np.ndarray) -> np.ndarray:
        """Its points [m], shape (N, R + 1, 3)."""
        chain = self.chain
        last = chain.bones[-1]
        end = heads[:, last] + world[:, last] @ (chain.points[-1] - chain.points[-2])
        return np.asarray(np.concatenate([heads[:, chain.bones], end[:, None]], axis=1))

    def turn(self, legs: np.ndarray, line: np.ndarray) -> np.ndarray:
        """How far a line of its points would have to turn to lie over the legs as at rest [rad], shape (N,)."""
        return np.asarray(np.maximum(_turns(legs, line, self.out, self.thick, self.wide) - self.least, 0).max(axis=1))


def _on_skin(
    chain: Chain, animation: RigAnimation, clothed: ClothedCharacter, bare: Rig, affine: np.ndarray
) -> np.ndarray:  # fmt: skip
    """Where the points of a column would be if what it holds went with the bare mesh [m], shape (N, R + 1, 3)."""
    rig = animation.character.rig
    assert rig is not None
    held = (rig.weights * np.isin(rig.indices, chain.bones)).sum(axis=1)
    rows = np.flatnonzero(held > 0.25 * held.max())
    gap = np.linalg.norm(clothed.rest[rows] - chain.points[:, None], axis=-1)
    near = np.argsort(gap, axis=1)[:, :NEAREST]
    chosen, place = np.unique(rows[near], return_inverse=True)
    bones = np.unique(bare.indices[chosen])
    weights = np.zeros((len(chosen), len(bones)), np.float32)
    columns = np.searchsorted(bones, bare.indices[chosen])
    np.add.at(weights, (np.arange(len(chosen))[:, None], columns), bare.weights[chosen])
    moved = skin(clothed.rest[chosen].astype(np.float32), weights, affine[:, bones, :3].astype(np.float32))
    place = place.reshape(near.shape)
    offset = chain.points - clothed.rest[chosen][place].mean(axis=1)
    turned = np.einsum("nab,pb->npa", affine[:, chain.holder, :3, :3], offset)
    return np.asarray(moved[:, place].mean(axis=2) + turned)


def _spread(values: np.ndarray, near: Sequence[tuple[int, int, float]], fps: float) -> np.ndarray:
    """Values of columns (N, C) that their neighbours share in part, held and smooth in time."""
    whole = np.array(values)
    for one, other, _ in near:
        whole[:, one] = np.maximum(whole[:, one], SPREAD * values[:, other])
        whole[:, other] = np.maximum(whole[:, other], SPREAD * values[:, one])
    size = max(1, round(HOLD * fps))
    return np.asarray(gaussian_filter1d(maximum_filter1d(whole, size, axis=0), SMOOTH * fps, axis=0, mode="nearest"))


def _aim(
    rotations: np.ndarray, world: np.ndarray, chain: Chain, frame: np.ndarray, line: np.ndarray, goal: np.ndarray
) -> None:  # fmt: skip
    """Turn the links of a chain, whose points (N, R + 1, 3) are given in a frame (N, 3, 3), along those of a goal."""
    before = np.diff(line, axis=1)
    after = np.diff(goal, axis=1)
    above = None
    for link, bone in enumerate(chain.bones):
        turn = _least_rotation(before[:, link], after[:, link])
        turn = frame @ turn @ np.swapaxes(frame, 1, 2)
        own = turn @ world[:, bone]
        if above is None:  # what carries it stays
            parent = world[:, bone] @ np.swapaxes(rotations[:, bone], 1, 2)
        else:
            parent = above
        rotations[:, bone] = np.swapaxes(parent, 1, 2) @ own
        above = own


def _least_rotation(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The least rotations that turn vectors along others, shape (N, 3) each -> (N, 3, 3)."""
    one = one / np.maximum(np.linalg.norm(one, axis=1, keepdims=True), 1e-9)
    other = other / np.maximum(np.linalg.norm(other, axis=1, keepdims=True), 1e-9)
    cross = np.cross(one, other)
    sine = np.linalg.norm(cross, axis=1, keepdims=True)
    angle = np.arctan2(sine, (one * other).sum(axis=1, keepdims=True))
    return np.asarray(matrix_from_axis_angle(cross / np.maximum(sine, 1e-9) * np.minimum(angle, 3.0)))


def _turns(legs: np.ndarray, line: np.ndarray, out: np.ndarray, thick: np.ndarray, wide: float) -> np.ndarray:
    """How far a column would have to turn for places of legs to lie behind it [rad], 0 where they do, shape (N, P).

    Args:
        legs: The places [m], shape (N, P, 3).
        line: Its points [m], shape (N, R + 1, 3).
        out: The direction in which it turns.
        thick: Half how thick the legs are there [m], shape (P,).
        wide: Half of what it holds [m].
    """
    away, chain = legs - line[:, :1], line - line[:, :1]
    beyond, down = away @ out + thick, -away[..., 1]
    lateral = np.abs(away @ np.cross([0.0, 1.0, 0.0], out))
    drop = np.maximum.accumulate(-chain[..., 1], axis=1) + 1e-6 * np.arange(line.shape[1])
    there = np.stack([np.interp(v, d, o) for v, d, o in zip(down, drop, chain @ out, strict=True)])
    counts = smooth_step((lateral - 0.4 * wide) / (0.4 * wide + 0.8 * thick), 1.0, 0.0)
    counts = counts * ((down > 0.25 * thick) & (down < drop[:, -1:] + thick))
    level = np.maximum(down, 1e-6)
    return np.asarray(np.maximum((np.arctan2(beyond, level) - np.arctan2(there, level)) * counts, 0))


def _legs(
    affine: np.ndarray, clothed: ClothedCharacter, bones: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where places down the middle of both legs are [m], posed (N, P, 3) and in the rest pose (P, 3), and half the
    legs' thickness there (P,).
    """
    places, rests, thick = [], [], []
    share = (np.arange(SAMPLES) + 0.5)[:, None] / SAMPLES
    for leg in _LEGS:
        for above, below in zip(leg[:-1], leg[1:], strict=True):
            start, end = clothed.joints[above].astype(float), clothed.joints[below].astype(float)
            own = affine[:, bones[above]]
            rest = start + share * (end - start)
            rests.append(rest)
            places.append(np.einsum("nab,pb->npa", own[:, :3, :3], rest) + own[:, None, :3, 3])
            skin = clothed.rest[(clothed.weights[:, above] > 0.5) & (clothed.part < 0)]
            radius = THICK * clothed.scale
            if len(skin) > 8:
                along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
                away = skin - start
                off = np.linalg.norm(away - (away @ along)[:, None] * along, axis=1)
                radius = float(np.clip(np.percentile(off, 85), 0.4 * radius, 2 * radius))
            thick.append(np.full(SAMPLES, radius + GAP * clothed.scale))
    return np.concatenate(places, axis=1), np.concatenate(rests), np.concatenate(thick)


EACH = 20
"""Points of a link that are looked at."""
POINTS = 1000  # of the body
PASSES = 9
MOST = 0.12  # over the size [m]: points deeper than this are on the wrong side of something thin, and stay
SLACK = 0.003  # over the size [m]: how deep points may be that were outside at rest
FARTHEST_OUT = 0.35
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
SMOOTH_OUT = 0.05
"""Of the turns in time, standard deviation [s]."""


def push_out_of_body(
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
            local = gaussian_filter1d(local, SMOOTH_OUT * animation.fps, axis=0, mode="nearest")
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
    return np.asarray(turn * np.minimum(FARTHEST_OUT / np.maximum(length, 1e-9), 1))
