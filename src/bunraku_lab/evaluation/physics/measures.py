"""What simulated apparel is measured by: chains that stretch, bodies that do not come to rest. Of the result alone,
whatever simulated it.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from bunraku.core.character import Character
from bunraku.core.rig_animation import RigAnimation
from bunraku.physics.apparel_rig import ApparelRig

__all__ = ["Chain", "apparel_chains", "body_speeds", "chain_lengths", "link_place"]

_FREE = 1e-3  # a joint that lets its bodies come apart by more [m] is no link of a chain
_SHORT = 5e-3  # chains under this have no length to speak of [m]


@dataclass(frozen=True)
class Chain:
    """Bodies that hang on each other, from one that follows its bone to a last one.

    Args:
        bodies: Indices of the bodies, the one that holds the chain first.
        joints: Indices of the joints between them, one fewer.
        length: At rest [m]: from joint to joint, and from the last one to the last body's centre.
    """

    bodies: tuple[int, ...]
    joints: tuple[int, ...]
    length: float


def apparel_chains(character: Character, rig: ApparelRig) -> list[Chain]:
    """Chains of a character: the shortest ways over its joints from bodies that follow their bones to those at the
    ends.

    Joints that close loops (the cross-links of skirts) are not on them, nor are joints whose file lets the bodies come
    apart.
    """
    beside: dict[int, list[tuple[int, int]]] = {}
    for number, joint in enumerate(rig.joints):
        a, b = joint.bodies
        if (joint.upper - joint.lower > _FREE).any() or (joint.lower > joint.upper).any():
            continue
        beside.setdefault(a, []).append((number, b))
        beside.setdefault(b, []).append((number, a))
    above: dict[int, tuple[int, int]] = {}
    drivers: dict[int, int] = {}  # the first dynamic body of each bone; others do not show in the bones
    for index, body in enumerate(rig.bodies):
        if body.dynamic and body.bone >= 0:
            drivers.setdefault(body.bone, index)
    queue = [(0, -1, index, -1) for index, body in enumerate(rig.bodies) if not body.dynamic and body.bone >= 0]
    known = {index for _, _, index, _ in queue}
    done: set[int] = set()
    heapq.heapify(queue)
    while queue:
        distance, number, at, parent = heapq.heappop(queue)
        if at in done:
            continue
        done.add(at)
        if parent >= 0:
            above[at] = (parent, number)
        for link, other in beside.get(at, ()):
            entry = rig.bodies[other]
            if other not in done and other not in known and entry.dynamic and drivers.get(entry.bone) == other:
                heapq.heappush(queue, (distance + 1, link, other, at))
    ends = set(above) - {parent for parent, _ in above.values()}
    chains = []
    for end in sorted(ends):
        bodies, joints = [end], list[int]()
        while bodies[-1] in above:
            parent, number = above[bodies[-1]]
            bodies.append(parent)
            joints.append(number)
        positions = [
            link_place(character, rig, body, number) for body, number in zip(bodies[-2::-1], joints[::-1], strict=True)
        ] + [rig.bodies[end].position]
        length = float(sum(np.linalg.norm(b - a) for a, b in zip(positions[:-1], positions[1:], strict=True)))
        if length > _SHORT:
            chains.append(Chain(tuple(bodies[::-1]), tuple(joints[::-1]), length))
    return chains


def link_place(character: Character, rig: ApparelRig, body: int, joint: int) -> np.ndarray:
    """Where a body hangs in the rest pose [m], shape (3,): at its joint, or, where the file holds it at its bone (mode
    2), at the bone's head.
    """
    entry = rig.bodies[body]
    assert character.rig is not None
    return np.asarray(character.rig.positions[entry.bone] if entry.mode == 2 else rig.joints[joint].position)


def chain_lengths(animation: RigAnimation, rig: ApparelRig, chains: list[Chain]) -> np.ndarray:
    """How long the chains are in each frame [m], shape (N, C): along their joints, gaps between the two sides of a
    joint included.

    What is seen counts, which is the bones: a body that is held at its bone hangs on that bone's parent.

    Args:
        animation: The result; bodies are where their bones are.
        rig: Its bodies and joints.
        chains: From `apparel_chains`.
    """
    rotations, positions = animation.world()
    skeleton = animation.character.rig
    assert skeleton is not None
    rest = skeleton.positions
    out = np.empty((len(animation), len(chains)))

    def carried(bone: int, point: np.ndarray) -> np.ndarray:
        return np.asarray(positions[:, bone] + rotations[:, bone] @ (point - rest[bone]))

    gaps: dict[tuple[int, int, int], np.ndarray] = {}
    for column, chain in enumerate(chains):
        total = np.full(len(animation), chain.length)
        for a, b, number in zip(chain.bodies[:-1], chain.bodies[1:], chain.joints, strict=True):
            if (a, b, number) not in gaps:
                point, entry = link_place(animation.character, rig, b, number), rig.bodies[b]
                above = int(skeleton.parents[entry.bone]) if entry.mode == 2 else rig.bodies[a].bone
                gaps[a, b, number] = np.linalg.norm(carried(max(above, 0), point) - carried(entry.bone, point), axis=-1)
            total = total + gaps[a, b, number]
        out[:, column] = total
    return out


def body_speeds(animation: RigAnimation, rig: ApparelRig) -> np.ndarray:
    """How fast the centres of the dynamic bodies move from each frame to the next [m/s], shape (N - 1, D)."""
    rotations, positions = animation.world()
    skeleton = animation.character.rig
    assert skeleton is not None
    moving = [body for body in rig.bodies if body.dynamic and body.bone >= 0]
    bones = np.array([body.bone for body in moving], np.int64)
    offsets = np.array([body.position for body in moving]).reshape(-1, 3) - skeleton.positions[bones]
    centres = positions[:, bones] + np.einsum("ndab,db->nda", rotations[:, bones], offsets)
    return np.asarray(np.linalg.norm(np.diff(centres, axis=0), axis=-1) * animation.fps)
