"""Clothed characters whose apparel swings as a file beside theirs says, for the networks: the same kinds and names of
chains as `manners_file` has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bunraku.apparel.clothed import FREE, LOADS, NARROW, SOFTEST, STIFFEST, ClothedCharacter
from bunraku.apparel.swing import Swing
from bunraku.body.layout import JOINT_COUNT
from bunraku.physics.chains.chain import KINDS
from bunraku.physics.chains.from_shape import shape_chains
from bunraku.physics.chains.laid import LaidChains
from bunraku.physics.chains.manners_file import told_of

__all__ = ["part_kinds", "with_told_parts"]

LIGHT = 1e-3
"""Gravity counts as no weaker than so much of itself where springs are measured by the weight."""


def with_told_parts(clothed: ClothedCharacter, told: Mapping[str, Mapping[str, float]]) -> ClothedCharacter:
    """A clothed character whose apparel swings as is told; what is not told stays.

    A part gets the mean of what is told of the chains over it, by how much they hold. Where a file says how each vertex
    swings, those that a chain holds swing so far in all as its links together. Mass counts for nothing here.

    Args:
        clothed: The character.
        told: What is told, by kinds and names of chains (`manners_beside`).

    Raises:
        CharacterError: The mesh is broken.
    """
    if not told:
        return clothed
    laid = shape_chains(clothed)
    own = [told_of(chain.kind, chain.name, told) for chain in laid.chains]
    if not any(own):
        return clothed
    held = _held(laid)
    counts = _counts(clothed, laid, held)
    total = np.maximum(counts.sum(axis=1), 1e-9)
    stiffness, damping = np.array(clothed.stiffness, np.float64), np.array(clothed.damping, np.float64)
    limit = np.array(clothed.limit, np.float64)
    new = [_numbers(one) for one in own]
    for number, (ratio, lost, turn) in enumerate(new):
        share = counts[:, number] / total
        if ratio is not None:
            stiffness += share * (ratio - clothed.stiffness)
        if lost is not None:
            damping += share * (lost - clothed.damping)
        if turn is not None:
            limit += share * (turn - clothed.limit)
    swing = clothed.swing
    if swing is not None:
        swing = np.array(swing)
        for number, chain in enumerate(laid.chains):
            rows = laid.vertices[(held[:, number] > 0.5 * held.sum(axis=1)) & (held[:, number] > 0)]
            if own[number] and len(rows):
                swing[rows] = Swing.of_rows(swing[rows]).told(own[number], len(chain)).rows()
    return replace(
        clothed, stiffness=np.clip(stiffness, SOFTEST, STIFFEST).astype(np.float32),
        damping=damping.astype(np.float32), limit=limit.astype(np.float32), swing=swing,
    )  # fmt: skip


def part_kinds(clothed: ClothedCharacter, laid: LaidChains) -> list[str]:
    """The kind of each part, that of the chains that hold the most of it; "" where none does.

    Args:
        clothed: The character.
        laid: The chains over its apparel.
    """
    counts = _counts(clothed, laid, _held(laid))
    out = []
    for row in counts:
        by_kind = {kind: sum(share for share, chain in zip(row, laid.chains, strict=True) if chain.kind == kind)
                   for kind in KINDS}  # fmt: skip
        best = max(by_kind, key=lambda kind: by_kind[kind])
        out.append(best if by_kind[best] > 0 else "")
    return out


def _held(laid: LaidChains) -> np.ndarray:
    """How much each chain holds of each vertex, shape (A, C)."""
    owner = np.zeros(laid.count, np.int64)
    for number, chain in enumerate(laid.chains):
        owner[chain.bones - JOINT_COUNT] = number
    out = np.zeros((len(laid.vertices), len(laid.chains)))
    for links, shares in zip(laid.links.T, laid.shares.T, strict=True):
        np.add.at(out, (np.arange(len(out)), owner[links]), shares)
    return out


def _counts(clothed: ClothedCharacter, laid: LaidChains, held: np.ndarray) -> np.ndarray:
    """How much each chain holds of each part, shape (P, C)."""
    out = np.zeros((len(clothed.stiffness), len(laid.chains)))
    np.add.at(out, clothed.part[laid.vertices], held)
    return out


def _numbers(told: Mapping[str, float]) -> tuple[float | None, float | None, float | None]:
    """Stiffness, damping and limit [rad] as parts have them; None for what is not told."""
    limit = float(np.clip(np.radians(told["limit"]), NARROW, FREE)) if "limit" in told else None
    ratio = None if limit is None else LOADS - float(np.log10(limit))
    if told.get("stiffness", 0.0) > 0:
        spring = float(np.log10(told["stiffness"] / max(told.get("gravity", 1.0), LIGHT)))
        ratio = spring if ratio is None else max(ratio, spring)
    return ratio, told.get("damping"), limit
