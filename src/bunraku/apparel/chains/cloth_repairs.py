"""Simulated chains as cloth: what every repair of them reads, neighbours that move alike, and tears that are mended."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from bunraku.apparel.chains.chain import Chain
from bunraku.apparel.chains.chain_rig import Chained
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.character import Rig
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.graph import clean_mesh, unique_edges
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle

Frames = Callable[[np.ndarray], np.ndarray]
"""Vertices [m] of the frames with the given indices, shape (F,) -> (F, V, 3)."""


@dataclass(frozen=True, eq=False)
class DressedChains:
    """Chains on a clothed character."""

    chained: Chained  # the character whose rig has bones for its chains
    clothed: ClothedCharacter  # the same mesh
    bones: np.ndarray  # the bone of the rig that each of the 22 joints is, shape (22,)
    bare: Rig  # the rig without the chains; its skin goes with the body

    @property
    def chains(self) -> tuple[Chain, ...]:
        """The chains, each after the one that it hangs on."""
        return self.chained.chains


class ChainRepair(Protocol):
    """One correction of simulated chains."""

    def __call__(self, animation: RigAnimation, dressed: DressedChains) -> RigAnimation:
        """The corrected animation of the rig that the chains are part of."""


@dataclass(frozen=True)
class SmoothNeighbours:
    """Neighbouring chains rotate alike. All fields were chosen by eye."""

    # weight of a neighbour by its kind; a link itself has the weight 1
    alike: tuple[tuple[str, float], ...] = (("hair", 3.0), ("cape", 2.0), ("skirt", 0.7))
    others: float = 1.0  # weight of neighbours of other kinds
    passes: int = 3  # how often neighbours are averaged

    def __call__(self, animation: RigAnimation, dressed: DressedChains) -> RigAnimation:
        """The animation with smooth rotations."""
        chains, near = dressed.chains, dressed.chained.near
        if not near:
            return animation
        rotations = np.array(animation.rotations, np.float64)
        turns = [axis_angle_from_matrix(rotations[:, chain.bones]) for chain in chains]
        weights = dict(self.alike)
        pairs = [(one, other, share * weights.get(chains[one].kind, self.others)) for one, other, share in near]
        sags = _sags(turns, chains)
        turns = [turn - sags.get(number, 0.0) for number, turn in enumerate(turns)]
        for _ in range(self.passes):
            turns = averaged_turns(turns, pairs)
        for number, (chain, turn) in enumerate(zip(chains, turns, strict=True)):
            rotations[:, chain.bones] = matrix_from_axis_angle(turn + sags.get(number, 0.0))
        return replace(animation, rotations=rotations)


def _sags(turns: Sequence[np.ndarray], chains: Sequence[Chain]) -> dict[int, np.ndarray]:
    """What all columns of a skirt rotate alike, each about its own axis, by the number of the chain, shape (N, R, 3)
    each. An average of rotations about axes that lie all round would lose this sag.
    """
    out: dict[int, np.ndarray] = {}
    skirts = [number for number, chain in enumerate(chains) if chain.kind == "skirt"]
    for name in {chains[number].name.rpartition("_")[0] for number in skirts}:
        rows = [number for number in skirts if chains[number].name.rpartition("_")[0] == name]
        away = np.array([chains[number].points[-1] for number in rows])
        away -= away.mean(axis=0)
        away[:, 1] = 0
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        axes = np.cross(away, [0.0, 1.0, 0.0])
        for link in range(max(len(chains[number]) for number in rows)):
            linked = [index for index, number in enumerate(rows) if len(chains[number]) > link]
            alike = np.mean([turns[rows[index]][:, link] @ axes[index] for index in linked], axis=0)
            for index in linked:
                sag = out.setdefault(rows[index], np.zeros_like(turns[rows[index]]))
                sag[:, link] = alike[:, None] * axes[index]
    return out


def averaged_turns(turns: Sequence[np.ndarray], pairs: Sequence[tuple[int, int, float]]) -> list[np.ndarray]:
    """Rotations of the links of each chain (N, R, 3), averaged with as many of its neighbours: the numbers of two
    chains each, and the weight of one to the other, which has 1 itself.
    """
    totals, weights = [np.array(turn) for turn in turns], [np.ones((turn.shape[1], 1)) for turn in turns]
    for one, other, weight in [*pairs, *((second, first, weight) for first, second, weight in pairs)]:
        rows = min(turns[one].shape[1], turns[other].shape[1])
        totals[one][:, :rows] += weight * turns[other][:, :rows]
        weights[one][:rows] += weight
    return [total / weight for total, weight in zip(totals, weights, strict=True)]


@dataclass(frozen=True)
class MendTears:
    """Torn areas of apparel go over to the skin of the body, and the chains of their parts swing less."""

    frames: int = 24  # frames that are looked at; chosen
    # longest, shortest: an edge that is longer or shorter, over its length at rest, is stretched or folded; chosen
    longest: float = 1.6
    shortest: float = 0.5
    # Share of a part's edges, over all frames, that may be stretched or folded more often than the body alone does it.
    # What the part network finds on people of the wardrobe has 0.003 at the most; what looked torn on generated meshes
    # had 0.05 to 0.28.
    most: float = 0.02
    spare: float = 0.25  # edges shorter than this share of the median are not looked at; chosen
    often: float = 0.08  # share of the frames from which on a torn edge makes a torn area; chosen
    attempts: int = 3  # how often torn areas are mended; from the second time on their chains also swing less
    damping: float = 0.5  # share of the rotations that is left of such chains; chosen

    def __call__(
        self, animation: RigAnimation, plain: Animation | RigAnimation, dressed: DressedChains
    ) -> tuple[RigAnimation, set[int]]:
        """The mended animation, and the parts that are torn all the same.

        Args:
            animation: Of the rig that the chains are part of.
            plain: The same with all apparel going with the body.
            dressed: The chains.
        """
        clothed, count = dressed.clothed, len(animation)
        swings, torn = animation, self.torn_parts(clothed, animation.vertices, plain.vertices, count)
        free = np.ones(len(clothed.rest), np.float32)
        for attempt in range(self.attempts):
            if not torn:
                break
            if attempt:
                swings = self._damped(swings, dressed, torn)
                animation = on_skin(swings, dressed.bare, free)
            free = free * self.free_shares(clothed, animation.vertices, plain.vertices, count, torn)
            animation = on_skin(swings, dressed.bare, free)
            torn = self.torn_parts(clothed, animation.vertices, plain.vertices, count)
        return animation, torn

    def torn_parts(self, clothed: ClothedCharacter, shown: Frames, carried: Frames, count: int) -> set[int]:
        """The parts that are torn, by vertices with apparel moved and all carried, in some of `count` frames."""
        return {part for part, share in self.torn_shares(clothed, shown, carried, count).items() if share > self.most}

    def torn_shares(self, clothed: ClothedCharacter, shown: Frames, carried: Frames, count: int) -> dict[int, float]:
        """The share of every part's edges that is stretched or folded; arguments as of `torn_parts`."""
        _, part, bad = self._bad_edges(clothed, shown, carried, count)
        edges = np.bincount(part)
        share = np.bincount(part, bad) / np.maximum(edges, 1)
        return {int(number): float(share[number]) for number in np.flatnonzero(edges)}

    def free_shares(
        self, clothed: ClothedCharacter, shown: Frames, carried: Frames, count: int, torn: Collection[int]
    ) -> np.ndarray:
        """How far each vertex may move freely, shape (V,): 0 at the torn areas of the `torn` parts, 1 far from them."""
        edges, part, bad = self._bad_edges(clothed, shown, carried, count)
        looked_at = self._looked_at(count)
        apart = np.linalg.norm(shown(looked_at) - carried(looked_at), axis=-1).max(axis=0)
        out = np.ones(len(clothed.rest), np.float32)
        for number in torn:  # what lies beside it is another part
            area = np.unique(edges[(bad > self.often) & (part == number)])
            rows = np.flatnonzero(clothed.part == number)
            if len(area) and len(rows):
                out[rows] = eased(clothed.rest[rows], clothed.rest[area], apart[rows])
        return out

    def _looked_at(self, count: int) -> np.ndarray:
        return np.unique(np.linspace(0, count - 1, self.frames).astype(np.int64))

    def _damped(self, animation: RigAnimation, dressed: DressedChains, torn: Collection[int]) -> RigAnimation:
        """The animation with smaller rotations of the chains that hold torn parts."""
        rotations = np.array(animation.rotations, np.float64)
        for number in dressed.chained.of_vertices(np.isin(dressed.clothed.part, list(torn))):
            bones = dressed.chains[number].bones
            rotations[:, bones] = matrix_from_axis_angle(self.damping * axis_angle_from_matrix(rotations[:, bones]))
        return replace(animation, rotations=rotations)

    def _bad_edges(
        self, clothed: ClothedCharacter, shown: Frames, carried: Frames, count: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Edges of apparel (E, 2), their parts, and in how much more frames they are bad than where all is carried."""
        clean = clean_mesh(clothed.rest, clothed.faces)
        first = np.unique(clean.index, return_index=True)[1]
        edges = first[unique_edges(clean.faces, len(clean.vertices))]
        part = clothed.part[edges]
        edges, part = edges[(part >= 0).any(axis=1)], part[(part >= 0).any(axis=1)].max(axis=1)
        rest = np.linalg.norm(clothed.rest[edges[:, 0]] - clothed.rest[edges[:, 1]], axis=1)
        bad = np.zeros(len(edges))
        if len(edges):
            long = rest > self.spare * float(np.median(rest))
            edges, part, rest, bad = edges[long], part[long], rest[long], bad[long]
            looked_at = self._looked_at(count)
            for sign, moved in ((1, shown(looked_at)), (-1, carried(looked_at))):
                ratio = np.linalg.norm(moved[:, edges[:, 0]] - moved[:, edges[:, 1]], axis=-1) / rest
                bad += sign * ((ratio > self.longest) | (ratio < self.shortest)).mean(axis=0)
        return edges, part, bad


def eased(points: np.ndarray, bound: np.ndarray, apart: np.ndarray) -> np.ndarray:
    """How far points (P, 3) of a part move freely, shape (P,), where others of it, (B, 3), are bound to the skin: the
    farther each is apart from its skin at the most [m], (P,), the farther it must be from those that are bound.
    """
    return np.asarray(smooth_step(cKDTree(bound).query(points)[0] / np.maximum(apart, 1e-6), 0.0, 1.0))


def on_skin(animation: RigAnimation, bare: Rig, free: np.ndarray) -> RigAnimation:
    """An animation whose vertices move freely by a share (V,), and for the rest with the skin of its bare rig."""
    grown = animation.character.rig
    assert grown is not None
    share = free[:, None]
    skin = Rig(
        grown.names, grown.parents, grown.transforms, np.concatenate([grown.indices, bare.indices], axis=1),
        np.concatenate([grown.weights * share, bare.weights * (1 - share)], axis=1),
    )  # fmt: skip
    return replace(animation, character=replace(animation.character, rig=skin))
