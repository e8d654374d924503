"""Directions about a line, and how many of them something covers: a sleeve goes round an arm, hair lies on one side."""

from __future__ import annotations

import numpy as np

__all__ = ["covered", "directions_about"]

BINS = 12


def directions_about(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Directions of points about a line [rad], shape (M,).

    Args:
        points: [m], shape (M, 3).
        start, end: Of the line [m], shape (3,).
    """
    along = end - start
    along = along / max(float(np.linalg.norm(along)), 1e-9)
    side = np.eye(3)[int(np.abs(along).argmin())]
    side = side - (side @ along) * along
    side /= np.linalg.norm(side)
    away = points - start
    return np.asarray(np.arctan2(away @ np.cross(along, side), away @ side))


def covered(directions: np.ndarray) -> float:
    """Share of all directions in which there is something, of twelve.

    Args:
        directions: [rad], shape (M,).
    """
    bins = ((directions + np.pi) / (2 * np.pi) * BINS).astype(np.int64) % BINS
    return float((np.bincount(bins, minlength=BINS) > 0).mean())
