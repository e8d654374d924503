"""What chains tear: the edges of apparel, and those that join it to what stays, beside their lengths at rest and where
all goes with the body. Nothing that is torn is shown: places that are torn go over to the skin of the body, smoothly
along what lies around them, and the rest of their part swings on.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.core.character import Rig
from bunraku.core.rig_animation import RigAnimation
from bunraku.geometry.easing import smooth_step
from bunraku.geometry.graph import clean_mesh, unique_edges

__all__ = ["eased", "own_way", "tears", "torn_parts"]

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
    return {part: share for part, share in tears(clothed, shown, carried, frames).items() if share > MOST}


def tears(
    clothed: ClothedCharacter, shown: Callable[[np.ndarray], np.ndarray], carried: Callable[[np.ndarray], np.ndarray],
    frames: int,
) -> dict[int, float]:  # fmt: skip
    """That share of every part."""
    _, part, bad = _bad_edges(clothed, shown, carried, frames)
    count = np.bincount(part)
    share = np.bincount(part, bad) / np.maximum(count, 1)
    return {int(number): float(share[number]) for number in np.flatnonzero(count)}


def own_way(
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


def eased(animation: RigAnimation, rig: Rig, own: np.ndarray) -> RigAnimation:
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
