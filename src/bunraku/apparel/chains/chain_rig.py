"""Chains as rigid bodies and joints, and laid over the apparel of a mesh as part of its rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bunraku.apparel.chains.chain import Chain
from bunraku.apparel.clothed import ARMS, GRAVITY, LEGS
from bunraku.apparel.physics.bodies import body_limbs, rods_of
from bunraku.apparel.physics.rig import GROUPS, ApparelRig, still_body
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.avatars import MMD_METRE, MmdBody, MmdJoint
from bunraku.core.body.layout import JOINT_COUNT, handle_names
from bunraku.core.character import Character, Handles, Rig, top_influences


def handle_rig(character: Character, handles: Handles) -> Character:
    """The character with a bone for each handle: the first is the root, and all others hang on it."""
    count = len(handles.positions)
    transforms = np.tile(np.eye(4), (count, 1, 1))
    transforms[:, :3, 3] = handles.positions
    parents = np.where(np.arange(count) == 0, -1, 0)
    indices, weights = top_influences(handles.weights, min(8, count))
    rig = Rig(handle_names(handles.played), parents, transforms, indices, weights)
    return replace(character, rig=rig, avatar=None)


def on_handle_rig(animation: Animation) -> RigAnimation:
    """An animation of handles as one of `handle_rig`."""
    handles = animation.handles
    affine = animation.motion.transforms(handles.positions).astype(np.float64)
    positions = np.einsum("nkab,kb->nka", affine[..., :3], handles.positions) + affine[..., 3]
    character = handle_rig(animation.character, handles)
    return RigAnimation.of_world(character, affine[..., :3], positions, animation.fps, animation.reference)


GROUP = 0  # of collisions, of the chains; by the standard of MMD there are 16, and the last one has no bodies here
CLOTH = ("skirt", "cape")  # kinds whose chains are tied to their neighbours

# Chosen by eye on twelve rigs of public repositories in a walk and a dance.
TWIST = np.radians(3.0)  # limit of a link about itself [rad]
TIE = np.radians(30.0)  # how far a tie lets neighbours rotate against each other [rad]
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
        ties: Pairs of chains that are neighbours of one sheet; None finds them by position.
        colliders: Bodies that follow bones and keep the chains out.
    """
    bodies: list[MmdBody] = []
    joints: list[MmdJoint] = []
    gravity: list[float] = []
    by_bone: dict[int, int] = {}
    linked: list[list[int]] = []
    centre = np.mean(positions, axis=0) if len(positions) else np.zeros(3)
    for chain in chains:
        above = by_bone.get(chain.holder)
        if above is None:
            bodies.append(still_body(f"holder {chain.holder}", chain.holder, positions[chain.holder]))
            gravity.append(1.0)
            above = by_bone[chain.holder] = len(bodies) - 1
        links = len(chain)
        masses = chain.parameters.mass * (1 - 0.5 * np.arange(links) / max(links - 1, 1))
        numbers = []
        for link in range(links):
            start, end = chain.points[link], chain.points[link + 1]
            frame = _frame(end - start, _outward(chain, link, positions, centre))
            bodies.append(_link(chain, link, start, end, frame, float(masses[link])))
            gravity.append(chain.parameters.gravity)
            number = len(bodies) - 1
            # the moment of what hangs on the joint, if it lay level
            middle = 0.5 * (chain.points[link:-1] + chain.points[link + 1 :])
            lever = np.linalg.norm(middle - start, axis=1)
            moment = float((masses[link:] * lever).sum()) * GRAVITY
            joints.append(_joint(chain, link, (above, number), frame, moment))
            by_bone.setdefault(int(chain.bones[link]), number)
            numbers.append(number)
            above = number
        linked.append(numbers)
    for first, second in neighbours_of(chains) if ties is None else ties:
        joints += _ties(chains[first], chains[second], linked[first], linked[second])
    for collider in colliders:
        bodies.append(replace(collider, group=GROUPS, mask=1 << GROUP))
        gravity.append(1.0)
    pulls = np.array(gravity)[:, None] * np.array([0.0, -GRAVITY, 0.0])
    same = bool(np.allclose(gravity, 1.0))
    return ApparelRig(tuple(bodies), tuple(joints), (), None if same else pulls)


def neighbours_of(chains: Sequence[Chain]) -> list[tuple[int, int]]:
    """Pairs of chains of cloth side by side, in their order around one bone, begun about as high."""
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


def _link(chain: Chain, link: int, start: np.ndarray, end: np.ndarray, frame: np.ndarray, mass: float) -> MmdBody:
    length = float(np.linalg.norm(end - start))
    loss = chain.parameters.damping
    if chain.kind in CLOTH:
        shape = "box"
        size = np.array([max(0.8 * chain.width[link], 0.008), max(0.46 * length, 0.008), chain.thick])
        # the first row of cloth lies on the hips: between them and a lifted thigh it would be crushed
        meets = 0 if link == 0 and len(chain) > 1 else 1 << GROUPS
    else:
        radius = float(min(max(0.6 * chain.width[link], chain.thick), 0.45 * length, 0.04))
        shape, size, meets = "capsule", np.array([radius, max(length - 2 * radius, 0.002), 0.0]), 1 << GROUPS
    return MmdBody(
        f"{chain.name} {link + 1}", int(chain.bones[link]), shape, size, 0.5 * (start + end), frame, mass, loss, loss,
        0.0, 0.2, 1, GROUP, meets,
    )  # fmt: skip


def _joint(chain: Chain, link: int, bodies: tuple[int, int], frame: np.ndarray, moment: float) -> MmdJoint:
    # Bullet counts an angle from the second body to the first: about x, outwards is positive.
    outward, start = float(chain.limits[link]), chain.points[link]
    inward, side = outward * chain.parameters.inward, outward * (SIDE if chain.kind in CLOTH else 1.0)
    low, high = np.array([-inward, -TWIST, -side]), np.array([outward, TWIST, side])
    spring = chain.parameters.stiffness * moment / MMD_METRE**2
    none = np.zeros(3)
    return MmdJoint(chain.name, bodies, start, frame, none, none, low, high, none, spring * np.array([1.0, 1.5, 1.0]))


def _ties(first: Chain, second: Chain, bodies: list[int], others: list[int]) -> list[MmdJoint]:
    """Ties between links of the same row, in every second row from the last up."""
    out = []
    for row in range(min(len(first), len(second)) - 1, -1, -2):
        if row == 0 and len(bodies) > 1:
            continue
        corners = np.stack([first.points[row], first.points[row + 1], second.points[row], second.points[row + 1]])
        down = corners[1] + corners[3] - corners[0] - corners[2]
        frame = _frame(down, np.cross(down, corners[3] - corners[1]))
        give = np.full(3, GIVE * float(np.linalg.norm(corners[3] - corners[1])))
        turn, none, pair = np.full(3, TIE), np.zeros(3), (bodies[row], others[row])
        name, middle = f"{first.name} tie {row + 1}", corners.mean(axis=0)
        out.append(MmdJoint(name, pair, middle, frame, -give, give, -turn, turn, none, none))
    return out


@dataclass(frozen=True, eq=False)
class LaidChains:
    """Chains over a mesh, numbered apart from any rig: bone j < 22 is a joint of the body, bone 22 + l a link."""

    chains: tuple[Chain, ...]  # each after the one that it hangs on
    ties: tuple[tuple[int, int], ...]  # pairs of chains that are neighbours of one sheet
    vertices: np.ndarray  # vertices that links hold, shape (A,)
    # links, shares: the links that hold each, and by how much, shape (A, L); the rest of 1 is the body's
    links: np.ndarray
    shares: np.ndarray
    # pairs of chains of one piece whose skin blends into each other, and how much of it they share
    near: tuple[tuple[int, int, float], ...] = ()

    def moved(self, transforms: np.ndarray) -> LaidChains:
        """With each chain taken along by its carrier, by the transforms of the 22 joints, shape (22, 4, 4)."""
        roots: dict[int, int] = {}
        chains = []
        for chain in self.chains:
            joint = chain.holder if chain.holder < JOINT_COUNT else roots[chain.holder]
            roots |= dict.fromkeys(chain.bones.tolist(), joint)
            points = chain.points @ transforms[joint, :3, :3].T + transforms[joint, :3, 3]
            chains.append(replace(chain, points=points))
        return replace(self, chains=tuple(chains))

    def turned(self, stiffness: float, gravity: float) -> LaidChains:
        """With factors on the stiffness and gravity of all chains."""
        chains = tuple(replace(chain, parameters=chain.parameters.turned(stiffness, gravity)) for chain in self.chains)
        return replace(self, chains=chains)


@dataclass(frozen=True, eq=False)
class Chained:
    """A character whose rig has bones for its apparel."""

    character: Character  # its rig has a bone for each link after its own bones, and one for the end of each chain
    chains: tuple[Chain, ...]  # by the bones of that rig
    # ties, near: as of `LaidChains`
    ties: tuple[tuple[int, int], ...]
    ends: tuple[int, ...]  # bone of the end of each chain
    colliders: tuple[MmdBody, ...]  # capsules of the body
    near: tuple[tuple[int, int, float], ...] = ()
    legs: frozenset[int] = frozenset()  # bones of the legs

    def rig(self, tied: bool = True) -> ApparelRig:
        """Its rigid bodies and joints. Leave the ties out where `SmoothNeighbours` follows; that is much faster."""
        assert self.character.rig is not None
        return chain_rig(self.chains, self.character.rig.positions, self.ties if tied else (), self.colliders)

    def of_vertices(self, chosen: np.ndarray) -> set[int]:
        """The chains that hold any of the chosen vertices, shape (V,), bool."""
        rig = self.character.rig
        assert rig is not None
        bones = set(rig.indices[chosen][rig.weights[chosen] > 0.05].tolist())
        return {number for number, chain in enumerate(self.chains) if bones & set(chain.bones.tolist())}

    def on(self, animation: RigAnimation) -> RigAnimation:
        """An animation of the rig without chains on this one: chains go with what they hang on."""
        assert self.character.rig is not None
        frames, count = animation.rotations.shape[:2]
        rotations = np.tile(np.eye(3, dtype=np.float32), (frames, len(self.character.rig.names), 1, 1))
        translations = np.zeros((*rotations.shape[:2], 3), np.float32)
        rotations[:, :count], translations[:, :count] = animation.rotations, animation.translations
        return RigAnimation(self.character, rotations, translations, animation.fps, animation.reference)


def with_chains(character: Character, laid: LaidChains, bones: np.ndarray) -> Chained:
    """A character's rig, by the bone of each of the 22 joints, with a bone for each link of laid chains."""
    rig = character.rig
    assert rig is not None
    first = len(rig.names)
    number = np.concatenate([np.asarray(bones, np.int64), first + np.arange(sum(map(len, laid.chains)))])
    names, parents, positions = list(rig.names), list(rig.parents), list(rig.positions)
    taken, chains = set(names), []
    ends: list[tuple[str, int, np.ndarray]] = []
    for chain in laid.chains:
        label = chain.name
        while f"{label}_1" in taken:
            label += "_"
        links, holder = number[chain.bones], int(number[chain.holder])
        for link, bone in enumerate(links):
            names.append(f"{label}_{link + 1}")
            taken.add(names[-1])
            parents.append(holder if link == 0 else int(links[link - 1]))
            positions.append(chain.points[link])
            assert len(names) == bone + 1
        ends.append((f"{label}_end", int(links[-1]), chain.points[-1]))
        chains.append(replace(chain, name=label, bones=links, holder=holder))
    last = len(names)
    for label, parent, position in ends:
        names.append(label)
        parents.append(parent)
        positions.append(position)
    transforms = np.tile(np.eye(4), (len(names), 1, 1))
    transforms[:first] = rig.transforms
    transforms[first:, :3, 3] = np.array(positions[first:]).reshape(-1, 3)
    indices, weights = _skin(rig, laid, number)
    grown = Rig(tuple(names), np.array(parents, np.int64), transforms, indices, weights)
    grown_character = replace(character, rig=grown)
    moved = np.arange(len(names)) >= first
    arms = {int(bones[joint]) for joint in ARMS}  # hair that rests on them would ride along
    limbs = [limb for limb in body_limbs(grown_character, moved) if limb.bone not in arms]
    colliders = tuple(rod for limb in limbs for rod in rods_of(limb))
    legs = frozenset(int(bones[joint]) for joint in LEGS)
    ends_of = tuple(range(last, len(names)))
    return Chained(grown_character, tuple(chains), laid.ties, ends_of, colliders, laid.near, legs)


def _skin(rig: Rig, laid: LaidChains, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bones and shares of all vertices: apparel goes with its links, and for the rest with its skin."""
    width = rig.indices.shape[1] + laid.links.shape[1]
    indices, weights = np.zeros((len(rig.indices), width), np.int32), np.zeros((len(rig.indices), width), np.float32)
    indices[:, : rig.indices.shape[1]], weights[:, : rig.indices.shape[1]] = rig.indices, rig.weights
    rows = laid.vertices
    left = 1 - laid.shares.sum(axis=1)
    weights[rows, : rig.indices.shape[1]] *= left[:, None]
    indices[rows, rig.indices.shape[1] :] = number[JOINT_COUNT + laid.links]
    weights[rows, rig.indices.shape[1] :] = laid.shares
    total = weights.sum(axis=1, keepdims=True)
    return indices, weights / np.where(total > 0, total, 1)
