"""Neighbouring chains of one piece turn alike, so that hair, a cape or a skirt stays one sheet: the turn of each link
is averaged with those of the links beside it, by how much of the skin they share.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from bunraku.core.rig_animation import RigAnimation
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.physics.chains.chain import Chain

__all__ = ["swung_less", "together"]

ALIKE = {"hair": 3.0, "cape": 2.0, "skirt": 0.7}
"""What neighbours count for, beside a link itself; those of other kinds count as much."""
OTHERS = 1.0
PASSES = 3
LESS = 0.5
"""What is left of the turns of a chain that would tear its part."""


def together(
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


def swung_less(animation: RigAnimation, chains: Sequence[Chain], chosen: Collection[int]) -> RigAnimation:
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
