"""What a shape tells of how it stands by simple means, beside the network: what it would rest on, and where what is on
top of it leans.

The network sees 128 tokens of a shape that leans by up to 15 degrees, so what is flat on the ground escapes it. Both
witnesses have a doubt as those of `orientation_evidence` have. Their weights are those of the least cross-entropy on
the 151 characters of the training archive that are not held out (`fitted_weights` of the laboratory).
"""

from __future__ import annotations

import numpy as np

from bunraku.geometry.axes import AXES, ORIENTATIONS, axis_vector

__all__ = ["LEAN_WEIGHT", "REST_WEIGHTS", "lean", "rest"]

REST_WEIGHTS = np.array([0.20, 1.49, 5.87])
"""Of the numbers of `rest`: log of what lies flat, whether it stands by itself, how wide its base is."""
LEAN_WEIGHT = 3.95
_FLAT, _LOW, _DOWN = 0.012, 0.025, -0.9
"""How high over the lowest point, of the largest extent, what lies flat and what carries may be; and the cosine from
which on a normal points down."""
_EDGE, _LEAST = 0.02, 2e-3
_TOP = 0.85
_ANGLES = np.linspace(0, 2 * np.pi, 16, endpoint=False)
_AROUND = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
"""Directions in which corners of a hull in the plane are looked for first."""
_UPS = np.array([axis_vector(up) for up, _ in ORIENTATIONS])
_FRONTS = np.array([axis_vector(front) for _, front in ORIENTATIONS])


def rest(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """How a shape would rest on the ground with each of `AXES` up, shape (6, 3).

    Args:
        points: Spread evenly over its surface, any unit, shape (N, 3).
        normals: Their unit normals, shape (N, 3).

    Returns:
        Log of the share of the surface that lies flat on the ground; whether its middle is above what carries it, from
        0 to 1 over a few hundredths of its extent; and the area within what carries it, of its footprint.
    """
    extent = max(float(np.ptp(points, axis=0).max()), 1e-100)
    middle = points.mean(axis=0)
    rows = []
    for axis in AXES:
        up = axis_vector(axis)
        height = points @ up
        height = (height - height.min()) / extent
        flat = float(((height < _FLAT) & (normals @ up < _DOWN)).mean())
        across = np.delete(np.arange(3), "xyz".index(axis[1]))
        inside, base = _carried(points[height < _LOW][:, across] / extent, middle[across] / extent)
        footprint = max(float(np.prod(np.ptp(points[:, across], axis=0))) / extent**2, 1e-12)
        rows.append((np.log(flat + _LEAST), 1 / (1 + np.exp(-np.clip(inside / _EDGE, -50, 50))), base / footprint))
    return np.array(rows)


def _carried(low: np.ndarray, middle: np.ndarray) -> tuple[float, float]:
    """How far a point is inside the hull of others in the plane, shape (N, 2), and the area of that hull; -1 and 0
    where they have none.
    """
    if len(low) < 3 or np.ptp(low, axis=0).min() < 1e-6:
        return -1.0, 0.0
    corners = _hull(low)
    edges = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1, keepdims=True)
    area = 0.5 * float((corners[:, 0] * edges[:, 1] - corners[:, 1] * edges[:, 0]).sum())
    return (float((outward * (corners - middle)).sum(axis=1).min()), area) if area > 1e-12 else (-1.0, 0.0)


def _hull(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull of points in the plane, counter-clockwise, shape (C, 2), by Andrew's monotone chain.

    Qhull would load a tenth of a second and ten megabytes of scipy.
    """
    rough = points[(points @ _AROUND.T).argmax(axis=0)]  # what lies within these corners is none
    edges = np.roll(rough, -1, axis=0) - rough
    beyond = edges[:, 0] * (points[:, 1:] - rough[:, 1]) - edges[:, 1] * (points[:, :1] - rough[:, 0])
    rows = np.unique(points[(beyond <= 1e-12).any(axis=1)], axis=0).tolist()
    corners: list[list[float]] = []
    for line in (rows, rows[::-1]):
        side: list[list[float]] = []
        for x, y in line:
            while len(side) > 1:
                (u, v), (w, z) = side[-2:]
                if (w - u) * (y - v) - (z - v) * (x - u) > 0:
                    break
                side.pop()
            side.append([x, y])
        corners += side[:-1]
    return np.array(corners)


def lean(points: np.ndarray) -> np.ndarray:
    """How far the top of a shape is before its middle in each of `ORIENTATIONS`, of its largest extent, shape (24,).

    Heads are in front of trunks.

    Args:
        points: Spread evenly over its surface, any unit, shape (N, 3).
    """
    heights = points @ _UPS.T
    low, high = heights.min(axis=0), heights.max(axis=0)
    top = heights >= low + _TOP * (high - low)
    before = (points - points.mean(axis=0)) @ _FRONTS.T
    return np.asarray((before * top).sum(axis=0) / top.sum(axis=0) / max(float(np.ptp(points, axis=0).max()), 1e-100))
