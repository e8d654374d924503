"""Which body hangs on which: a forest over the graph of joints, so that a chain of bodies cannot stretch.

Bodies that follow their bones are the roots. From them the graph is gone through by the fewest joints, where one that
lets its bodies come apart counts as many; the joint by which a body is reached first is the one that it hangs on. Other
joints close loops.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field

import numpy as np

from bunraku.core.mmd_model import MmdBody, MmdJoint

__all__ = ["Forest", "Link", "Loop", "apparel_forest", "free_axes", "locked_axes"]

LOOSE = 100  # joints in a row that hold are better than one that lets go
TIGHT = 1e-3  # a range of places below is none [m]
STIFF = 1e-3  # a range of angles below is none [rad]
SAME_PLACE = 2e-3  # joints nearer than this are at one position [m]


@dataclass(frozen=True)
class Link:
    """How a dynamic body hangs.

    Args:
        body: The body.
        parent: The dynamic body that it hangs on, -1 where that is a bone.
        bone: The bone that it hangs on where `parent` is -1; -1 for the world.
        joint: The joint, None for a free ball joint at its bone.
        turned: Whether the body is A of the joint, and what it hangs on is B.
        more: Other joints of the same two bodies at the same position, each with whether the body is its A.
    """

    body: int
    parent: int
    bone: int
    joint: MmdJoint | None
    turned: bool = False
    more: tuple[tuple[MmdJoint, bool], ...] = ()


@dataclass(frozen=True)
class Loop:
    """A joint that closes a loop.

    Args:
        joint: The joint.
        a: A dynamic body, or -1 for a bone.
        bone_a: The bone where `a` is -1.
        b, bone_b: The same of the other end.
    """

    joint: MmdJoint
    a: int
    bone_a: int
    b: int
    bone_b: int


@dataclass
class Forest:
    """How all bodies hang.

    Args:
        links: Of the dynamic bodies, each after the one that it hangs on.
        loops: Joints that close loops.
        carried: Dynamic body that carries a body which follows a bone below it, by the index of the latter.
        notes: What was repaired.
    """

    links: list[Link] = field(default_factory=list)
    loops: list[Loop] = field(default_factory=list)
    carried: dict[int, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


Owner = tuple[int, int]  # a dynamic body and -1, or -1 and a bone


def apparel_forest(bodies: tuple[MmdBody, ...], joints: tuple[MmdJoint, ...], parents: np.ndarray) -> Forest:
    """How the bodies of a character hang.

    Args:
        bodies: The bodies.
        joints: The joints.
        parents: Parent of each bone, shape (J,).
    """
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
    return (width >= 0) & (width <= TIGHT)


def free_axes(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Axes without limits: their range is empty, which is how Bullet says it; shape (3,), bool."""
    return np.asarray(lower > upper)


def _hang(
    forest: Forest, joints: tuple[MmdJoint, ...], edges: dict[Owner, list[tuple[int, Owner, bool]]], starts: list[Owner]
) -> set[Owner]:
    """Hang all bodies that can be reached from some owners; shortest paths first, ties by the file's order."""
    known = {link.body for link in forest.links}
    done: set[Owner] = set()
    queue: list[tuple[int, int, Owner, Owner, int, bool]] = [(0, -1, start, start, -1, False) for start in starts]
    heapq.heapify(queue)
    while queue:
        cost, _, owner, above, number, turned = heapq.heappop(queue)
        if owner in done or (owner[0] in known and number >= 0):
            continue
        done.add(owner)
        if number >= 0:
            if owner[0] < 0:
                continue
            forest.links.append(Link(owner[0], above[0], above[1], joints[number], turned))
        for edge, other, reverse in edges.get(owner, ()):
            if other not in done and other[0] >= 0:
                heapq.heappush(
                    queue, (cost + (1 if locked_axes(joints[edge]).all() else LOOSE), edge, other, owner, edge, reverse)
                )
    return {owner for owner in done if owner[0] >= 0}


def _loops(forest: Forest, joints: tuple[MmdJoint, ...], owners: list[Owner]) -> None:
    """Joints that nothing hangs on: those of one place with the joint of a link join it, others close loops."""
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
    for body, found in more.items():
        link = forest.links[indices[body]]
        forest.links[indices[body]] = Link(link.body, link.parent, link.bone, link.joint, link.turned, tuple(found))


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
    """How many bones are above each."""
    out = []
    for bone in range(len(parents)):
        depth, at = 0, int(parents[bone])
        while at >= 0 and depth <= len(parents):
            depth, at = depth + 1, int(parents[at])
        out.append(depth)
    return out
