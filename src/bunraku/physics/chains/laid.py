"""Chains laid over the apparel of a mesh, and the rig that they become part of."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bunraku.apparel.clothed import LEGS
from bunraku.body.layout import JOINT_COUNT
from bunraku.core.character import Character, Rig
from bunraku.core.mmd_model import MmdBody
from bunraku.core.rig_animation import RigAnimation
from bunraku.physics.apparel_rig import ApparelRig
from bunraku.physics.chains.chain import Chain
from bunraku.physics.chains.chain_rig import chain_rig
from bunraku.physics.limbs import body_limbs

__all__ = ["Chained", "LaidChains", "with_chains"]


@dataclass(frozen=True, eq=False)
class LaidChains:
    """Chains over a mesh, numbered apart from any rig: bone j < 22 is a joint of the body, bone 22 + l a link.

    Args:
        chains: Each after the one that it hangs on.
        ties: Pairs of chains that are neighbours of one sheet.
        vertices: Vertices that links hold, shape (A,).
        links: Links that hold each of them, shape (A, L).
        shares: How much each holds, shape (A, L); what is left of 1 is the body's.
        near: Pairs of chains of one piece whose skin passes over into each other, and how much of it they share.
    """

    chains: tuple[Chain, ...]
    ties: tuple[tuple[int, int], ...]
    vertices: np.ndarray
    links: np.ndarray
    shares: np.ndarray
    near: tuple[tuple[int, int, float], ...] = ()

    @property
    def count(self) -> int:
        """How many links there are."""
        return sum(len(chain) for chain in self.chains)

    def moved(self, transforms: np.ndarray) -> LaidChains:
        """With each chain taken along by what carries it.

        Args:
            transforms: Of the 22 joints, shape (22, 4, 4).
        """
        roots: dict[int, int] = {}
        chains = []
        for chain in self.chains:
            joint = chain.holder if chain.holder < JOINT_COUNT else roots[chain.holder]
            roots |= dict.fromkeys(chain.bones.tolist(), joint)
            points = chain.points @ transforms[joint, :3, :3].T + transforms[joint, :3, 3]
            chains.append(replace(chain, points=points))
        return replace(self, chains=tuple(chains))

    def turned(self, stiffness: float, gravity: float) -> LaidChains:
        """With all manners dialled (`Manner.turned`)."""
        chains = tuple(replace(chain, manner=chain.manner.turned(stiffness, gravity)) for chain in self.chains)
        return replace(self, chains=chains)


@dataclass(frozen=True, eq=False)
class Chained:
    """A character whose rig has bones for its apparel.

    Args:
        character: The character, its rig with a bone for each link after its own, and one for the end of each chain.
        chains: By the bones of that rig.
        ties: As of `LaidChains`.
        ends: Bone of the end of each chain.
        colliders: Capsules of the legs.
        near: As of `LaidChains`.
    """

    character: Character
    chains: tuple[Chain, ...]
    ties: tuple[tuple[int, int], ...]
    ends: tuple[int, ...]
    colliders: tuple[MmdBody, ...]
    near: tuple[tuple[int, int, float], ...] = ()

    def rig(self, tied: bool = True) -> ApparelRig:
        """Its rigid bodies and joints; without ties for what `together` joins, which is much faster."""
        assert self.character.rig is not None
        return chain_rig(self.chains, self.character.rig.positions, self.ties if tied else (), self.colliders)

    def of_vertices(self, chosen: np.ndarray) -> set[int]:
        """The chains that hold some of the chosen vertices, shape (V,), bool."""
        rig = self.character.rig
        assert rig is not None
        bones = set(rig.indices[chosen][rig.weights[chosen] > 0.05].tolist())
        return {number for number, chain in enumerate(self.chains) if bones & set(chain.bones.tolist())}

    def on(self, animation: RigAnimation) -> RigAnimation:
        """An animation of the rig that the chains were added to, on this one: chains go with what they hang on."""
        assert self.character.rig is not None
        frames, count = animation.rotations.shape[:2]
        rotations = np.tile(np.eye(3, dtype=np.float32), (frames, len(self.character.rig.names), 1, 1))
        translations = np.zeros((*rotations.shape[:2], 3), np.float32)
        rotations[:, :count], translations[:, :count] = animation.rotations, animation.translations
        return RigAnimation(self.character, rotations, translations, animation.fps, animation.reference)


def with_chains(character: Character, laid: LaidChains, bones: np.ndarray) -> Chained:
    """A character's rig with a bone for each link of the chains that were laid over its mesh.

    Args:
        character: With a rig.
        laid: Over the same vertices.
        bones: The bone of the rig that each of the 22 joints is, shape (22,).
    """
    rig = character.rig
    assert rig is not None
    first = len(rig.names)
    number = np.concatenate([np.asarray(bones, np.int64), first + np.arange(laid.count)])
    names, parents, places = list(rig.names), list(rig.parents), list(rig.positions)
    taken, chains = set(names), []
    ends: list[tuple[str, int, np.ndarray]] = []
    for chain in laid.chains:
        label = chain.name
        while f"{label}_1" in taken:
            label += "_"
        own, holder = number[chain.bones], int(number[chain.holder])
        for link, bone in enumerate(own):
            names.append(f"{label}_{link + 1}")
            taken.add(names[-1])
            parents.append(holder if link == 0 else int(own[link - 1]))
            places.append(chain.points[link])
            assert len(names) == bone + 1
        ends.append((f"{label}_end", int(own[-1]), chain.points[-1]))
        chains.append(replace(chain, name=label, bones=own, holder=holder))
    last = len(names)
    for label, parent, place in ends:
        names.append(label)
        parents.append(parent)
        places.append(place)
    transforms = np.tile(np.eye(4), (len(names), 1, 1))
    transforms[:first] = rig.transforms
    transforms[first:, :3, 3] = np.array(places[first:]).reshape(-1, 3)
    indices, weights = _skin(rig, laid, number)
    grown = Rig(tuple(names), np.array(parents, np.int64), transforms, indices, weights)
    grown_character = replace(character, rig=grown)
    moved = np.arange(len(names)) >= first
    legs = {int(bones[joint]) for joint in LEGS}
    colliders = tuple(_capsule(limb) for limb in body_limbs(grown_character, moved) if limb.bone in legs)
    return Chained(grown_character, tuple(chains), laid.ties, tuple(range(last, len(names))), colliders, laid.near)


def _capsule(box: MmdBody) -> MmdBody:
    """A capsule in the place of a limb's box."""
    order = np.argsort(box.size)
    radius = float(box.size[order[:2]].mean())
    along = box.rotation[:, order[2]]
    other = np.cross(along, box.rotation[:, order[0]])
    axes = np.stack([np.cross(along, other), along, other], axis=1)
    size = np.array([radius, max(2 * (float(box.size[order[2]]) - radius), 1e-3), 0.0])
    return replace(box, shape="capsule", size=size, rotation=axes)


def _skin(rig: Rig, laid: LaidChains, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bones and shares of all vertices: those of the apparel go with their links, and for the rest with their skin."""
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
