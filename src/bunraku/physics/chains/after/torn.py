"""What chains tear: the edges of apparel, and those that join it to what stays, beside their lengths at rest and where
all goes with the body. Nothing that is torn is shown.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.geometry.graph import clean_mesh, unique_edges

__all__ = ["tears", "torn_parts"]

FRAMES = 24
"""Frames that are looked at."""
LONG, SHORT = 1.6, 0.5  # an edge that is so many times as long as at rest is drawn out, or folded
MOST = 0.02
"""Share of a part's edges, over all frames, that may be so beyond those that the body alone draws out or folds: what
the network finds on people of the wardrobe has 0.003 at the most, what looked torn on generated meshes 0.05 to 0.28.
"""
SPARE = 0.25  # of the median edge: shorter ones are not looked at


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
    clean = clean_mesh(clothed.rest, clothed.faces)
    first = np.unique(clean.index, return_index=True)[1]
    edges = first[unique_edges(clean.faces, len(clean.vertices))]
    part = clothed.part[edges]
    edges, part = edges[(part >= 0).any(axis=1)], part[(part >= 0).any(axis=1)].max(axis=1)
    rest = np.linalg.norm(clothed.rest[edges[:, 0]] - clothed.rest[edges[:, 1]], axis=1)
    if not len(edges):
        return {}
    long = rest > SPARE * float(np.median(rest))
    edges, part, rest = edges[long], part[long], rest[long]
    few = np.unique(np.linspace(0, frames - 1, FRAMES).astype(np.int64))
    bad = np.zeros(len(edges))
    for sign, moved in ((1, shown(few)), (-1, carried(few))):
        ratio = np.linalg.norm(moved[:, edges[:, 0]] - moved[:, edges[:, 1]], axis=-1) / rest
        bad += sign * ((ratio > LONG) | (ratio < SHORT)).mean(axis=0)
    count = np.bincount(part)
    share = np.bincount(part, bad) / np.maximum(count, 1)
    return {int(number): float(share[number]) for number in np.flatnonzero(count)}
