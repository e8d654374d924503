"""What the colours of a mesh tell of where it faces: eyes, mouths and open coats are in front, so what is seen from
there has more colours than what is seen from behind or from a side.
"""

from __future__ import annotations

import numpy as np

from bunraku.geometry.axes import AXES, axis_vector
from bunraku.geometry.surface import face_normals

__all__ = ["COLOR_WEIGHT", "front_scores", "variety"]

COLOR_WEIGHT = 8.0
"""Of the log of `variety`. On every second character of the archive, of the 60 that have colours, the most varied of
four sides is the front for 70 % and the front is more varied than the back for 80 %; of the 19 files for priors that
have colours, for 68 and 79 %. The cross-entropy of the four, where equal chances have 1.39, is 1.00 and 0.88."""
_PLAIN = 3e-3
"""A variance of colours that is as good as none."""
_FACING = 0.3
"""Cosine from which on a face counts as seen, and more the straighter it looks."""


def variety(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Variance of the colours that are seen from each of `AXES`, by area, shape (6,).

    Args:
        vertices: Positions, any unit, shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        colors: Of each vertex, sRGB, shape (V, 3), uint8.
    """
    normals = face_normals(vertices, faces).astype(np.float64)
    areas = np.linalg.norm(normals, axis=1)
    middles = vertices[faces].mean(axis=1) - vertices.mean(axis=0)
    outward = -1 if (middles * normals).sum() < 0 else 1  # some files have their faces inside out
    seen = colors[faces].mean(axis=1) / 255
    found = []
    for axis in AXES:
        share = areas * np.clip(outward * (normals @ axis_vector(axis)) / np.maximum(areas, 1e-300) - _FACING, 0, None)
        share = share / max(float(share.sum()), 1e-300)
        found.append(float(share @ np.square(seen - share @ seen).sum(axis=1)))
    return np.array(found)


def front_scores(varied: np.ndarray) -> np.ndarray:
    """How much rather each of `AXES` is the front than others at a right angle to the same up axis, by `variety`,
    shape (6,); the largest is 1.
    """
    logs = COLOR_WEIGHT * np.log(varied + _PLAIN)
    return np.asarray(np.exp(logs - logs.max()))
