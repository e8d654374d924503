"""What of a pose is inside a character's body, and how deep."""

from __future__ import annotations

import igl
import numpy as np

from bunraku.apparel.body_volume import BodyVolume

__all__ = ["DEEP", "deep_inside"]

DEEP = 0.01
"""Vertices deeper than this are counted [m]."""


def deep_inside(body: BodyVolume, vertices: np.ndarray, points: np.ndarray, depth: float = DEEP) -> np.ndarray:
    """Which points are deeper than this inside a body, shape (P,), bool.

    Args:
        body: Its faces are taken.
        vertices: Of the body in this frame [m], shape (B, 3).
        points: Shape (P, 3).
        depth: [m].
    """
    vertices, points = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(points, np.float64)
    out = np.abs(igl.fast_winding_number(vertices, body.faces, points)) > 0.5
    inside = np.flatnonzero(out)
    if len(inside):
        out[inside] = igl.point_mesh_squared_distance(points[inside], vertices, body.faces)[0] > depth * depth
    return np.asarray(out)
