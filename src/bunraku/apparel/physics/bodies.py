"""Rigid bodies as MuJoCo takes them: colliders, shapes and masses, which body hangs on which, freedom of joints."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bunraku.apparel.mask import APPAREL_SHARE, moved_joints
from bunraku.apparel.physics.rig import SHORTEST, still_body
from bunraku.core.avatars import MMD_METRE, MmdBody, MmdJoint
from bunraku.core.character import Character

# a bone whose vertices are all nearer to their middle than this share of the height gets none: fingers, eyes, teeth;
# chosen by eye on simulations of Uka, Gene and the wardrobe
SMALL = 0.03
MOST = 40  # limbs; the largest are kept
OUTER = 2.0  # share of the vertices that are outside of a box, on each side [%]


def body_limbs(character: Character, moved: np.ndarray | None = None) -> list[MmdBody]:
    """Boxes that follow the bones of a character's body, at most 40. `moved` are joints that physics move, (J,)."""
    rig = character.rig
    moved = moved_joints(character) if moved is None else moved
    if rig is None or moved is None:
        return []
    holder = np.take_along_axis(rig.indices, rig.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    body = (rig.weights * moved[rig.indices]).sum(axis=1) <= APPAREL_SHARE
    height = float(np.ptp(character.vertices[:, 1]))
    boxes = []
    for bone in np.unique(holder[body & ~moved[holder]]):
        chosen = np.flatnonzero((holder == bone) & body)
        if len(chosen) < 4:
            continue
        box = _box(int(bone), rig.names[bone], character.vertices[chosen].astype(float))
        if np.linalg.norm(box.size) > SMALL * height:
            boxes.append(box)
    boxes.sort(key=lambda box: (-float(np.linalg.norm(box.size)), box.bone))
    return sorted(boxes[:MOST], key=lambda box: box.bone)


def _box(bone: int, name: str, points: np.ndarray) -> MmdBody:
    """The box of points along their principal axes."""
    _, _, rows = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    axes = rows.T * [1.0, 1.0, np.linalg.det(rows)]
    low, high = np.percentile(points @ axes, [OUTER, 100 - OUTER], axis=0)
    return still_body(name, bone, axes @ ((low + high) / 2), "box", (high - low) / 2, axes)


# Chosen by eye on simulations of Uka, Gene and the wardrobe.
TINY = 1e-3  # smaller shapes collide with nothing [m], and smaller ranges of positions and angles are none [m or rad]
MOST_RODS = 3  # capsules that stand for a box


def inertia(body: MmdBody) -> np.ndarray:
    """Moments of inertia about a body's own axes [kg m^2], (3,); a capsule has those of its box, as in Bullet."""
    if body.shape == "sphere":
        return np.full(3, 0.4 * body.mass * max(float(body.size[0]), SHORTEST) ** 2)
    half = body.size if body.shape == "box" else np.array([body.size[0], body.size[0] + body.size[1] / 2, body.size[0]])
    square = np.maximum(half, SHORTEST) ** 2
    return np.asarray(body.mass / 3 * (square.sum() - square))


def loss_rate(damping: float, most: float) -> float:
    """The rate at which speed is lost [1/s] by Bullet's `v *= (1 - damping) ** dt`, at most `most`."""
    return float(min(-np.log1p(-min(max(damping, 0.0), 1 - 1e-16)), most))


def add_shape(owner: Any, body: MmdBody, position: np.ndarray, name: str, settings: Mapping[str, Any]) -> bool:
    """Add a body's shape to an owner of an `MjSpec`, whose axes are the world's at rest and which is at a position [m],
    (3,). True where it has an extent, and so a shape. `settings` are other attributes of the shape.
    """
    import mujoco

    if body.size[0] < TINY and not (body.shape == "box" and body.size.max() >= TINY):
        return False
    axes = np.array(body.rotation, float)
    size = np.zeros(3)
    if body.shape == "box":
        kind, size = mujoco.mjtGeom.mjGEOM_BOX, np.maximum(body.size, TINY)
    elif body.shape == "capsule" and body.size[1] >= TINY:
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE
        size[:2] = body.size[0], body.size[1] / 2
        axes = np.column_stack([axes[:, 0], -axes[:, 2], axes[:, 1]])  # MuJoCo's lie along z, MMD's along y
    else:
        kind = mujoco.mjtGeom.mjGEOM_SPHERE
        size[0] = body.size[0]
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(axes).ravel())
    owner.add_geom(name=name, type=kind, size=size, pos=body.position - position, quat=quaternion, mass=0.0, **settings)
    return True


def add_rods(owner: Any, body: MmdBody, position: np.ndarray, name: str, settings: Mapping[str, Any]) -> None:
    """Add a body's shape as capsules only (`rods_of`), as `add_shape`; they are named `name`, an "r" and a number."""
    for number, rod in enumerate(rods_of(body)):
        add_shape(owner, rod, position, f"{name}r{number}", settings)


def rods_of(body: MmdBody) -> list[MmdBody]:
    """Capsules in place of a box: up to three side by side, along its longest side, fill it. Other shapes stay."""
    if body.shape != "box":
        return [body]
    order = np.argsort(-body.size, kind="stable")
    long, wide, thin = np.maximum(body.size[order], TINY)
    axes = body.rotation[:, order[[1, 0, 2]]] * [1.0, 1.0, np.linalg.det(body.rotation[:, order[[1, 0, 2]]])]
    count = int(np.clip(np.ceil(wide / thin), 1, MOST_RODS))
    size = np.array([thin, 2 * (long - thin), 0.0])
    return [
        replace(body, shape="capsule", size=size, rotation=axes, position=body.position + across * axes[:, 0])
        for across in (np.linspace(thin - wide, wide - thin, count) if count > 1 else [0.0])
    ]


# Chosen by eye on simulations of Uka, Gene and the wardrobe.
LOOSE = 100  # joints in a row that hold are better than one that lets go
SAME_PLACE = 2e-3  # joints nearer than this are at one position [m]


@dataclass(frozen=True)
class Link:
    """How a dynamic body hangs."""

    body: int  # the body
    parent: int  # the dynamic body that it hangs on, -1 for a bone
    bone: int  # the bone that it hangs on where `parent` is -1; -1 for the world
    joint: MmdJoint | None  # the joint, None for a free ball joint at its bone
    turned: bool = False  # whether the body is A of the joint, and its holder B
    # other joints of the same two bodies at the same position, each with whether the body is its A
    more: tuple[tuple[MmdJoint, bool], ...] = ()


@dataclass(frozen=True)
class Loop:
    """A joint that closes a loop, between two dynamic bodies, or -1 and a bone."""

    joint: MmdJoint
    a: int
    bone_a: int
    b: int
    bone_b: int


@dataclass
class Forest:
    """How all bodies hang."""

    links: list[Link] = field(default_factory=list)  # of the dynamic bodies, each after the one that it hangs on
    loops: list[Loop] = field(default_factory=list)  # joints that close loops
    # dynamic body that carries a body which follows a bone below it, by the index of the latter
    carried: dict[int, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # what was repaired


Owner = tuple[int, int]  # a dynamic body and -1, or -1 and a bone


def apparel_forest(bodies: tuple[MmdBody, ...], joints: tuple[MmdJoint, ...], parents: np.ndarray) -> Forest:
    """How the bodies of a character hang; `parents` are those of its bones, shape (J,)."""
    forest = Forest()
    movers: dict[int, int] = {}  # the dynamic body that moves a bone
    for index, body in enumerate(bodies):
        if body.dynamic and body.bone >= 0:
            movers.setdefault(body.bone, index)
    owners: list[Owner] = []
    for index, body in enumerate(bodies):
        if body.dynamic:
            owners.append((index, -1))
            continue
        mover = _mover(body.bone, parents, movers)
        if mover >= 0:
            forest.carried[index] = mover
        owners.append((mover, -1) if mover >= 0 else (-1, body.bone))
    edges: dict[Owner, list[tuple[int, Owner, bool]]] = {}
    for number, joint in enumerate(joints):
        a, b = owners[joint.bodies[0]], owners[joint.bodies[1]]
        if a != b and (a[0] >= 0 or b[0] >= 0):
            edges.setdefault(a, []).append((number, b, False))
            edges.setdefault(b, []).append((number, a, True))
    reached = _hang(forest, joints, edges, sorted({owner for owner in owners if owner[0] < 0}))
    depths = _depths(parents)
    left = sorted(
        (index for index, body in enumerate(bodies) if body.dynamic and (index, -1) not in reached),
        key=lambda index: (depths[bodies[index].bone] if bodies[index].bone >= 0 else len(parents), index),
    )
    loose = []
    for index in left:
        if (index, -1) in reached:
            continue
        bone = int(parents[bodies[index].bone]) if bodies[index].bone >= 0 else -1
        loose.append(bodies[index].name)
        forest.links.append(Link(index, -1, bone, None))
        reached |= {(index, -1)}
        reached |= _hang(forest, joints, edges, [(index, -1)])
    if loose:
        more = f" and {len(loose) - 3} more" if len(loose) > 3 else ""
        forest.notes.append(
            "rigid bodies hang on no body that follows its bone, and are hung on their bones: "
            f"{', '.join(loose[:3])}{more}"
        )
    _loops(forest, joints, owners)
    return forest


def locked_axes(joint: MmdJoint) -> np.ndarray:
    """Axes along which a joint holds its bodies together, shape (3,), bool."""
    width = joint.upper - joint.lower
    return (width >= 0) & (width <= TINY)


def free_axes(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Axes without limits: their range is empty, as Bullet says it; shape (3,), bool."""
    return np.asarray(lower > upper)


def _hang(
    forest: Forest, joints: tuple[MmdJoint, ...], edges: dict[Owner, list[tuple[int, Owner, bool]]], starts: list[Owner]
) -> set[Owner]:
    """Hang all bodies that can be reached from these owners; shortest paths first, ties by the file's order."""
    hung = {link.body for link in forest.links}
    done: set[Owner] = set()
    queue: list[tuple[int, int, Owner, Owner, int, bool]] = [(0, -1, start, start, -1, False) for start in starts]
    heapq.heapify(queue)
    while queue:
        cost, _, owner, above, number, turned = heapq.heappop(queue)
        if owner in done or (owner[0] in hung and number >= 0):
            continue
        done.add(owner)
        if number >= 0:
            if owner[0] < 0:
                continue
            forest.links.append(Link(owner[0], above[0], above[1], joints[number], turned))
        for edge, other, reverse in edges.get(owner, ()):
            if other not in done and other[0] >= 0:
                farther = cost + (1 if locked_axes(joints[edge]).all() else LOOSE)
                heapq.heappush(queue, (farther, edge, other, owner, edge, reverse))
    return {owner for owner in done if owner[0] >= 0}


def _loops(forest: Forest, joints: tuple[MmdJoint, ...], owners: list[Owner]) -> None:
    """Joints that nothing hangs on join the joint of a link at the same position, or close loops."""
    indices = {link.body: index for index, link in enumerate(forest.links)}
    used = {id(link.joint) for link in forest.links}
    more: dict[int, list[tuple[MmdJoint, bool]]] = {}
    for joint in joints:
        a, b = owners[joint.bodies[0]], owners[joint.bodies[1]]
        if id(joint) in used or a == b or (a[0] < 0 and b[0] < 0):
            continue
        for child, above, turned in ((b, a, False), (a, b, True)):
            link = forest.links[indices[child[0]]] if child[0] >= 0 else None
            if link is not None and (link.parent, link.bone) == above and _alike(link.joint, joint):
                more.setdefault(child[0], []).append((joint, turned))
                break
        else:
            if not free_axes(joint.lower, joint.upper).all():
                forest.loops.append(Loop(joint, *a, *b))
    for body, alike in more.items():
        link = forest.links[indices[body]]
        forest.links[indices[body]] = Link(link.body, link.parent, link.bone, link.joint, link.turned, tuple(alike))


def _alike(first: MmdJoint | None, second: MmdJoint) -> bool:
    """Whether two joints are at one position and have the same axes."""
    if first is None:
        return False
    near = np.linalg.norm(first.position - second.position) < SAME_PLACE
    return bool(near and np.trace(first.rotation.T @ second.rotation) > 2.9 and locked_axes(second).all())


def _mover(bone: int, parents: np.ndarray, movers: dict[int, int]) -> int:
    """The dynamic body that moves a bone or one above it, -1 for none."""
    seen = 0
    while bone >= 0 and seen <= len(parents):
        if bone in movers:
            return movers[bone]
        bone, seen = int(parents[bone]), seen + 1
    return -1


def _depths(parents: np.ndarray) -> list[int]:
    """Number of bones above each."""
    out = []
    for bone in range(len(parents)):
        depth, at = 0, int(parents[bone])
        while at >= 0 and depth <= len(parents):
            depth, at = depth + 1, int(parents[at])
        out.append(depth)
    return out


# Chosen by eye on simulations of Uka, Gene and the wardrobe.
GIMBAL = np.radians(80.0)  # where the middle one of three hinges turns farther, they are a ball [rad]
SLACK = 0.1  # how far a body may go along an axis that its file frees altogether [m]


@dataclass(frozen=True)
class Freedom:
    """One joint of MuJoCo."""

    kind: str  # "slide", "hinge" or "ball"
    axis: np.ndarray  # in the axes of the world at rest, shape (3,)
    # lower, upper: limits [m or rad]; both infinite without limits
    lower: float
    upper: float
    stiffness: float  # of its spring [kg/s^2 or N m/rad]

    @property
    def limited(self) -> bool:
        """Whether it has limits."""
        return bool(np.isfinite(self.lower) or np.isfinite(self.upper))


def freedoms(link: Link) -> list[Freedom]:
    """How a body may move against its holder, the outermost joint first."""
    joint = link.joint
    if joint is None:
        return [Freedom("ball", np.array([0.0, 0, 1]), -np.inf, np.inf, 0.0)]
    out = []
    low, high = _range(joint.lower, joint.upper, not link.turned)
    for axis in range(3):
        if high[axis] - low[axis] > TINY:
            start, end = (low[axis], high[axis]) if np.isfinite(low[axis]) else (-SLACK, SLACK)
            stiff = max(float(joint.spring[axis]), 0.0)
            out.append(Freedom("slide", joint.rotation[:, axis], float(start), float(end), stiff))
    low, high = _range(joint.angle_lower, joint.angle_upper, link.turned)
    stiffness = np.maximum(joint.angle_spring, 0) * MMD_METRE**2
    for other, turned in link.more:
        more_low, more_high = _range(other.angle_lower, other.angle_upper, turned)
        both_low, both_high = np.maximum(low, more_low), np.minimum(high, more_high)
        good = both_low <= both_high
        low, high = np.where(good, both_low, low), np.where(good, both_high, high)
        stiffness = stiffness + np.maximum(other.angle_spring, 0) * MMD_METRE**2
    open_axes = high - low > TINY
    if max(-low[1], high[1]) > GIMBAL and open_axes.all():
        widest = float(max(-low.min(), high.max()))
        widest = widest if widest < np.pi else np.inf
        low_end = 0.0 if np.isfinite(widest) else -np.inf
        return [*out, Freedom("ball", np.array([0.0, 0, 1]), low_end, widest, float(stiffness.mean()))]
    for axis in (0, 1, 2) if link.turned else (2, 1, 0):
        if open_axes[axis]:
            ends = float(low[axis]), float(high[axis])
            out.append(Freedom("hinge", joint.rotation[:, axis], *ends, float(stiffness[axis])))
    return out


def _range(lower: np.ndarray, upper: np.ndarray, straight: bool) -> tuple[np.ndarray, np.ndarray]:
    """Limits in the joint's own sense or reversed; infinite where the file's range is empty."""
    low, high = (lower, upper) if straight else (-upper, -lower)
    free = lower > upper
    return np.where(free, -np.inf, low), np.where(free, np.inf, high)
