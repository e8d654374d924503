"""Simulated chains as cloth: neighbours move alike, and places that are torn are mended."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from bunraku.apparel.chains.chain import Chain
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.core.animation import RigAnimation
from bunraku.core.character import Rig
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.graph import clean_mesh, unique_edges
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle

__all__ = ["damped", "free_shares", "mend_tears", "smooth_neighbours", "torn_parts", "torn_shares"]

ALIKE = {"hair": 3.0, "cape": 2.0, "skirt": 0.7}
"""What neighbours count for, beside a link itself; those of other kinds count as much."""
OTHERS = 1.0
PASSES = 3
LESS = 0.5
"""What is left of the turns of a chain that would tear its part."""


def smooth_neighbours(
    animation: RigAnimation, chains: Sequence[Chain], near: Sequence[tuple[int, int, float]]
) -> RigAnimation:  # fmt: skip
    """An animation whose neighbouring chains turn alike.

    Args:
        animation: Of the rig that the chains are part of.
        chains: By the bones of that rig.
        near: Pairs of chains that are neighbours, and how much of their skin they share, from 0 to 1.
    """
    if not near:
        return animation
    turns = [axis_angle_from_matrix(np.asarray(animation.rotations[:, chain.bones], np.float64)) for chain in chains]
    beside: list[list[tuple[int, float]]] = [[] for _ in chains]
    for one, other, share in near:
        count = share * ALIKE.get(chains[one].kind, OTHERS)
        beside[one].append((other, count))
        beside[other].append((one, count))
    sags = _sags(turns, chains)
    turns = [turn - sags.get(number, 0.0) for number, turn in enumerate(turns)]
    for _ in range(PASSES):
        turns = [
            _mean(own, [(turns[other], count) for other, count in some])
            for own, some in zip(turns, beside, strict=True)
        ]
    rotations = np.array(animation.rotations, np.float64)
    turns = [turn + sags.get(number, 0.0) for number, turn in enumerate(turns)]
    for chain, own in zip(chains, turns, strict=True):
        rotations[:, chain.bones] = matrix_from_axis_angle(own)
    return replace(animation, rotations=rotations)


def damped(animation: RigAnimation, chains: Sequence[Chain], chosen: Collection[int]) -> RigAnimation:
    """An animation with the links of some chains turned half as far."""
    rotations = np.array(animation.rotations, np.float64)
    for number in chosen:
        bones = chains[number].bones
        rotations[:, bones] = matrix_from_axis_angle(LESS * axis_angle_from_matrix(rotations[:, bones]))
    return replace(animation, rotations=rotations)


def _sags(turns: Sequence[np.ndarray], chains: Sequence[Chain]) -> dict[int, np.ndarray]:
    """What all columns of a skirt turn alike, each about its own axis, as it sags or spreads, by the number of the
    chain, shape (N, R, 3) each: an average of turns about axes that lie all round would lose it.
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
            some = [place for place, number in enumerate(rows) if len(chains[number]) > link]
            alike = np.mean([turns[rows[place]][:, link] @ axes[place] for place in some], axis=0)
            for place in some:
                sag = out.setdefault(rows[place], np.zeros_like(turns[rows[place]]))
                sag[:, link] = alike[:, None] * axes[place]
    return out


def _mean(own: np.ndarray, others: list[tuple[np.ndarray, float]]) -> np.ndarray:
    """Turns of the links of a chain (N, R, 3), averaged with those of as many links of others."""
    total, weight = np.array(own), np.ones((1, own.shape[1], 1))
    for other, count in others:
        rows = min(own.shape[1], other.shape[1])
        total[:, :rows] += count * other[:, :rows]
        weight[:, :rows] += count
    return np.asarray(total / weight)


FRAMES = 24
"""Frames that are looked at."""
LONG, SHORT = 1.6, 0.5  # an edge that is so many times as long as at rest is drawn out, or folded
MOST = 0.02
"""Share of a part's edges, over all frames, that may be so beyond those that the body alone draws out or folds: what
the network finds on people of the wardrobe has 0.003 at the most, what looked torn on generated meshes 0.05 to 0.28.
"""
SPARE = 0.25  # of the median edge: shorter ones are not looked at
OFTEN = 0.08
"""Of the frames: an edge that is torn in more of them, beyond those in which the body alone tears it, makes a place."""
REACH = 0.08
"""Over the size [m]: so far from a torn place apparel goes its own way again whole."""


def torn_parts(
    clothed: ClothedCharacter, shown: Callable[[np.ndarray], np.ndarray], carried: Callable[[np.ndarray], np.ndarray],
    frames: int,
) -> dict[int, float]:  # fmt: skip
    """The parts that are torn, and by how much: the share of their edges that is drawn out or folded.

    Args:
        clothed: The character.
        shown: Vertices of some frames with apparel moved [m], from their numbers (F,) to shape (F, V, 3).
        carried: The same with all going with the body.
        frames: How many there are.
    """
    return {part: share for part, share in torn_shares(clothed, shown, carried, frames).items() if share > MOST}


def torn_shares(
    clothed: ClothedCharacter, shown: Callable[[np.ndarray], np.ndarray], carried: Callable[[np.ndarray], np.ndarray],
    frames: int,
) -> dict[int, float]:  # fmt: skip
    """That share of every part."""
    _, part, bad = _bad_edges(clothed, shown, carried, frames)
    count = np.bincount(part)
    share = np.bincount(part, bad) / np.maximum(count, 1)
    return {int(number): float(share[number]) for number in np.flatnonzero(count)}


def free_shares(
    clothed: ClothedCharacter, shown: Callable[[np.ndarray], np.ndarray], carried: Callable[[np.ndarray], np.ndarray],
    frames: int, torn: Collection[int],
) -> np.ndarray:  # fmt: skip
    """How far each vertex may go its own way, shape (V,): 0 at the torn places of some parts, 1 far from them.

    Args:
        clothed, shown, carried, frames: As of `torn_parts`.
        torn: The parts.
    """
    edges, part, bad = _bad_edges(clothed, shown, carried, frames)
    out = np.ones(len(clothed.rest), np.float32)
    for number in torn:  # what lies beside it is another part
        places = np.unique(edges[(bad > OFTEN) & (part == number)])
        rows = np.flatnonzero(clothed.part == number)
        if len(places) and len(rows):
            away = cKDTree(clothed.rest[places]).query(clothed.rest[rows])[0] / clothed.scale
            out[rows] = smooth_step(away, 0.0, REACH)
    return out


def mend_tears(animation: RigAnimation, rig: Rig, own: np.ndarray) -> RigAnimation:
    """An animation whose vertices go their own way so far only, and for the rest as the skin of a rig says.

    Args:
        animation: Of a rig with further bones.
        rig: The one without them.
        own: As of `own_way`, shape (V,).
    """
    grown = animation.character.rig
    assert grown is not None
    share = own[:, None]
    skin = Rig(
        grown.names, grown.parents, grown.transforms, np.concatenate([grown.indices, rig.indices], axis=1),
        np.concatenate([grown.weights * share, rig.weights * (1 - share)], axis=1),
    )  # fmt: skip
    character = replace(animation.character, rig=skin)
    return replace(animation, character=character)


def _bad_edges(
    clothed: ClothedCharacter, shown: Callable[[np.ndarray], np.ndarray], carried: Callable[[np.ndarray], np.ndarray],
    frames: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Edges of apparel, shape (E, 2), the part of each, and in how much more of the frames it is drawn out or folded
    than where all goes with the body.
    """
    clean = clean_mesh(clothed.rest, clothed.faces)
    first = np.unique(clean.index, return_index=True)[1]
    edges = first[unique_edges(clean.faces, len(clean.vertices))]
    part = clothed.part[edges]
    edges, part = edges[(part >= 0).any(axis=1)], part[(part >= 0).any(axis=1)].max(axis=1)
    rest = np.linalg.norm(clothed.rest[edges[:, 0]] - clothed.rest[edges[:, 1]], axis=1)
    bad = np.zeros(len(edges))
    if len(edges):
        long = rest > SPARE * float(np.median(rest))
        edges, part, rest, bad = edges[long], part[long], rest[long], bad[long]
        few = np.unique(np.linspace(0, frames - 1, FRAMES).astype(np.int64))
        for sign, moved in ((1, shown(few)), (-1, carried(few))):
            ratio = np.linalg.norm(moved[:, edges[:, 0]] - moved[:, edges[:, 1]], axis=-1) / rest
            bad += sign * ((ratio > LONG) | (ratio < SHORT)).mean(axis=0)
    return edges, part, bad
