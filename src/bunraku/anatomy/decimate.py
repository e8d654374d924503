"""A character with few vertices that stands for one with many, where only joints, stances and lowest points are asked
for.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from bunraku.core.character import Character, Handles
from bunraku.geometry.areas import vertex_areas
from bunraku.geometry.extremes import part_extremes

__all__ = ["decimated"]

CELLS = 8000  # about how many vertices the surface is left with
MANY = 12000  # characters with fewer vertices are left as they are
SPREAD = 1.5  # cells of a grid that a surface goes through, over its area in faces of them


def decimated(character: Character, handles: Handles) -> tuple[Character, Handles]:
    """The character and its handles on fewer vertices; both as they are where there are few.

    Vertices in one cell of a grid that one handle moves the most become one, at the mean of their places and weights.
    The extreme points of every part stay themselves, so feet stand where they stood. Handle positions and roles stay.
    """
    if len(character.vertices) <= MANY:
        return character, handles
    vertices, used = character.vertices, np.flatnonzero(character.surface)
    low = vertices[used].min(axis=0)
    some = character.faces[:: max(1, len(character.faces) // MANY)]
    area = (
        float(vertex_areas(vertices[some.ravel()], np.arange(some.size).reshape(-1, 3)).sum())
        * len(character.faces)
        / len(some)
    )
    cell = max(float(np.sqrt(SPREAD * area / CELLS)), 1e-4 * float(np.ptp(vertices[used], axis=0).max()))
    place = ((vertices[used] - low) / cell).astype(np.int64)
    wide = place.max(axis=0) + 1
    weights = handles.weights[used]
    key = ((place[:, 0] * wide[1] + place[:, 1]) * wide[2] + place[:, 2]) * weights.shape[1] + weights.argmax(axis=1)
    own = part_extremes(vertices[used], weights)
    key[own] = -1 - np.arange(len(own))
    label = np.unique(key, return_inverse=True)[1]
    count = int(label.max()) + 1
    mean = csr_matrix((np.ones(len(used), np.float32), (label, np.arange(len(used)))), shape=(count, len(used)))
    total = np.bincount(label, minlength=count)[:, None]
    index = np.zeros(len(vertices), np.int64)
    index[used] = label
    faces = index[character.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    ordered = np.sort(faces, axis=1)
    first = np.unique((ordered[:, 0] * count + ordered[:, 1]) * count + ordered[:, 2], return_index=True)[1]
    kept = np.unique(faces[first])
    if len(kept) < 100:  # nothing but crumbs
        return character, handles
    again = np.full(count, -1)
    again[kept] = np.arange(len(kept))
    light = Character(character.name, ((mean @ vertices[used]) / total)[kept], again[faces[first]])
    shares = ((mean @ weights) / total)[kept]
    return light, Handles(
        handles.positions, shares / shares.sum(axis=1, keepdims=True), handles.features, handles.roles
    )
