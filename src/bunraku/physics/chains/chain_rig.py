"""Chains as rigid bodies and joints: capsules on every link, hinges with limits and springs between them, and loose
ties between neighbours of cloth, so that cloth stays cloth.

Where no collider is given, `physics.limbs` makes capsules of the body's mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bunraku.core.mmd_model import MMD_METRE, MmdBody, MmdJoint
from bunraku.physics.apparel_rig import ApparelRig
from bunraku.physics.chains.chain import Chain

__all__ = ["chain_rig", "neighbours_of"]

GRAVITY = 98 * MMD_METRE  # what springs are measured by, as in MMD's files [m/s^2]
GROUP, NOBODY = 0, 15  # collision group of the chains, and one that nothing is in
CLOTH = ("skirt", "cape")
"""Kinds whose chains are tied to their neighbours."""
TWIST = np.radians(3.0)
TIE = np.radians(30.0)
GIVE = 0.12  # how far a tie lets neighbours come apart, over their distance
SIDE = 0.5  # of the limit outwards: how far cloth swings along the body
NEXT = 1.9  # neighbours are at most so many times as far apart as they are at the median


def chain_rig(
    chains: Sequence[Chain], positions: np.ndarray, ties: Sequence[tuple[int, int]] | None = None,
    colliders: Sequence[MmdBody] = (),
) -> ApparelRig:  # fmt: skip
    """The rigid bodies and joints of chains.

    Args:
        chains: Each after the one that it hangs on.
        positions: Of the rig's bones [m], shape (J, 3).
        ties: Pairs of chains that are neighbours of one sheet; found by where they are when None (`neighbours_of`).
        colliders: Bodies that follow bones and keep the chains out.
    """
    bodies: list[MmdBody] = []
    joints: list[MmdJoint] = []
    gravity: list[float] = []
    by_bone: dict[int, int] = {}
    own: list[list[int]] = []
    centre = np.mean(positions, axis=0) if len(positions) else np.zeros(3)
    for chain in chains:
        above = by_bone.get(chain.holder)
        if above is None:
            place = positions[chain.holder]
            bodies.append(_still(f"holder {chain.holder}", chain.holder, place))
            gravity.append(1.0)
            above = by_bone[chain.holder] = len(bodies) - 1
        links = len(chain)
        masses = chain.manner.mass * (1 - 0.5 * np.arange(links) / max(links - 1, 1))
        numbers = []
        for link in range(links):
            start, end = chain.points[link], chain.points[link + 1]
            frame = _frame(end - start, _outward(chain, link, positions, centre))
            bodies.append(_link(chain, link, start, end, frame, float(masses[link])))
            gravity.append(chain.manner.gravity)
            number = len(bodies) - 1
            # the moment of what hangs on the joint, if it lay level
            middle = 0.5 * (chain.points[link:-1] + chain.points[link + 1 :])
            lever = np.linalg.norm(middle - start, axis=1)
            moment = float((masses[link:] * lever).sum()) * GRAVITY
            share = chain.manner.root + (1 - chain.manner.root) * link / max(links - 1, 1)
            joints.append(_joint(chain, (above, number), start, frame, moment, share))
            by_bone.setdefault(int(chain.bones[link]), number)
            numbers.append(number)
            above = number
        own.append(numbers)
    for first, second in neighbours_of(chains) if ties is None else ties:
        joints += _ties(chains[first], chains[second], own[first], own[second])
    for collider in colliders:
        bodies.append(replace(collider, group=NOBODY, mask=1 << GROUP))
        gravity.append(1.0)
    pulls = np.array(gravity)[:, None] * np.array([0.0, -GRAVITY, 0.0])
    same = bool(np.allclose(gravity, 1.0))
    return ApparelRig(tuple(bodies), tuple(joints), (), None if same else pulls)


def neighbours_of(chains: Sequence[Chain]) -> list[tuple[int, int]]:
    """Pairs of chains of cloth that lie next to each other: those that begin about as high on the same bone, in their
    order around it.
    """
    groups: dict[tuple[str, int], list[int]] = {}
    for number, chain in enumerate(chains):
        if chain.kind in CLOTH:
            groups.setdefault((chain.kind, chain.holder), []).append(number)
    out = []
    for members in groups.values():
        if len(members) < 3:
            continue
        tops = np.array([chains[number].points[0] for number in members])
        middle = tops.mean(axis=0)
        turn = np.arctan2(tops[:, 0] - middle[0], tops[:, 2] - middle[2])
        order = [members[row] for row in np.argsort(turn, kind="stable")]
        ends = np.array([chains[number].points[-1] for number in order])
        apart = np.linalg.norm(np.roll(ends, -1, axis=0) - ends, axis=1)
        near = apart <= NEXT * float(np.median(apart))
        out += [(order[row], order[(row + 1) % len(order)]) for row in np.flatnonzero(near)]
    return out


def _outward(chain: Chain, link: int, positions: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """The direction away from the body where a link is."""
    middle = 0.5 * (chain.points[link] + chain.points[link + 1])
    hold = positions[chain.holder] if 0 <= chain.holder < len(positions) else centre
    away = middle - np.array([hold[0], middle[1], hold[2]])
    if np.linalg.norm(away) < 1e-3:
        away = middle - centre
    return np.asarray(away)


def _frame(along: np.ndarray, outward: np.ndarray) -> np.ndarray:
    """Axes of a link, columns: y up along it, z away from the body, shape (3, 3)."""
    y = -along / max(float(np.linalg.norm(along)), 1e-9)
    z = outward - (outward @ y) * y
    if np.linalg.norm(z) < 1e-6:
        z = np.eye(3)[int(np.abs(y).argmin())]
        z = z - (z @ y) * y
    z /= np.linalg.norm(z)
    return np.stack([np.cross(y, z), y, z], axis=1)


def _still(name: str, bone: int, position: np.ndarray) -> MmdBody:
    return MmdBody(name, bone, "sphere", np.zeros(3), position, np.eye(3), 0.0, 0.0, 0.0, 0.0, 0.0, 0, GROUP, 0)


def _link(chain: Chain, link: int, start: np.ndarray, end: np.ndarray, frame: np.ndarray, mass: float) -> MmdBody:
    length = float(np.linalg.norm(end - start))
    loss = chain.manner.damping
    if chain.kind in CLOTH:
        shape = "box"
        size = np.array([max(0.8 * chain.width[link], 0.008), max(0.46 * length, 0.008), chain.thick])
        # the first row of cloth lies on the hips: between them and a lifted thigh it would be crushed
        meets = 0 if link == 0 and len(chain) > 1 else 1 << NOBODY
    else:
        radius = float(min(max(0.6 * chain.width[link], chain.thick), 0.45 * length, 0.04))
        shape, size, meets = "capsule", np.array([radius, max(length - 2 * radius, 0.002), 0.0]), 1 << NOBODY
    return MmdBody(
        f"{chain.name} {link + 1}", int(chain.bones[link]), shape, size, 0.5 * (start + end), frame, mass, loss, loss,
        0.0, 0.2, 1, GROUP, meets,
    )  # fmt: skip


def _joint(
    chain: Chain, bodies: tuple[int, int], start: np.ndarray, frame: np.ndarray, moment: float, share: float
) -> MmdJoint:
    manner = replace(chain.manner, limit=chain.manner.limit * share)
    # Bullet counts an angle from the second body to the first: about x, outwards is positive.
    outward, inward = manner.limit, manner.limit * manner.inward
    side = manner.limit * (SIDE if chain.kind in CLOTH else 1.0)
    low, high = np.array([-inward, -TWIST, -side]), np.array([outward, TWIST, side])
    spring = manner.stiffness * moment / MMD_METRE**2
    none = np.zeros(3)
    return MmdJoint(chain.name, bodies, start, frame, none, none, low, high, none, spring * np.array([1.0, 1.5, 1.0]))


def _ties(one: Chain, other: Chain, bodies: list[int], others: list[int]) -> list[MmdJoint]:
    """Ties between links of the same row, in every second row from the last up."""
    out = []
    rows = range(min(len(one), len(other)) - 1, -1, -2)
    for row in rows:
        if row == 0 and len(bodies) > 1:
            continue
        corners = np.stack([one.points[row], one.points[row + 1], other.points[row], other.points[row + 1]])
        down = corners[1] + corners[3] - corners[0] - corners[2]
        frame = _frame(down, np.cross(down, corners[3] - corners[1]))
        give = np.full(3, GIVE * float(np.linalg.norm(corners[3] - corners[1])))
        turn = np.full(3, TIE)
        none = np.zeros(3)
        out.append(
            MmdJoint(
                f"{one.name} tie {row + 1}",
                (bodies[row], others[row]),
                corners.mean(axis=0),
                frame,
                -give,
                give,
                -turn,
                turn,
                none,
                none,
            )
        )
    return out
