"""Faces as drawn characters have them: eyes, brows and a mouth laid on the front of the head."""

from __future__ import annotations

import numpy as np

from bunraku_lab.synthetic.people.figure import Figure
from bunraku_lab.synthetic.surfaces import patch
from bunraku_lab.synthetic.wardrobe.kit.model import Costume

__all__ = ["add_face"]


class _Front:
    """The front of the head as a height over X and Y."""

    def __init__(self, figure: Figure):
        skin = figure.skin
        inside = np.isin(skin.faces, np.flatnonzero(skin.weights[:, 15] > 0.5)).all(axis=1)
        corners = skin.points[skin.faces[inside]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        middle = figure.skull[0][2]
        self.corners = corners[(normal[:, 2] > 0) & (corners[:, :, 2].mean(axis=1) > middle)]

    def at(self, positions: np.ndarray) -> np.ndarray:
        """Z of the skin at X and Y, shape (V,)."""
        a, b, c = (self.corners[:, i] for i in range(3))
        u, v = (b - a)[:, :2], (c - a)[:, :2]
        det = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        det = np.where(np.abs(det) < 1e-12, 1e-12, det)
        w = positions[:, None, :] - a[None, :, :2]
        s = (w[..., 0] * v[:, 1] - w[..., 1] * v[:, 0]) / det
        t = (u[:, 0] * w[..., 1] - u[:, 1] * w[..., 0]) / det
        depth = a[None, :, 2] + s * (b - a)[None, :, 2] + t * (c - a)[None, :, 2]
        inside = (s >= -1e-6) & (t >= -1e-6) & (s + t <= 1 + 1e-6)
        found = np.where(inside, depth, -np.inf).max(axis=1)
        near = np.argmin(np.square(positions[:, None] - self.corners.mean(axis=1)[None, :, :2]).sum(axis=2), axis=1)
        return np.asarray(np.where(np.isfinite(found), found, self.corners[near].mean(axis=1)[:, 2]))


def add_face(costume: Costume, figure: Figure, rng: np.random.Generator) -> None:
    """Add eyes of an iris and a pupil with a light in it, lashes, brows and a mouth; all go with the head."""
    front, bone, u = _Front(figure), costume.bone_index("頭"), rng.uniform
    low, top = float(figure.head[:, 1].min()), float(figure.head[:, 1].max())
    wide = float(figure.skull[1][0])
    drawn = figure.kind in ("drawn", "chibi", "toon")
    size = wide * (u(0.22, 0.3) if drawn else u(0.17, 0.21))
    tall = size * (u(1.0, 1.45) if drawn else u(0.62, 0.8))
    height = low + (u(0.42, 0.46) if drawn else u(0.47, 0.5)) * (top - low)
    apart = wide * (u(0.4, 0.47) if drawn else u(0.38, 0.42))
    if figure.eyes is not None:
        apart, height = float(abs(figure.eyes[0, 0])), float(figure.eyes[0, 1])
    shape = float(u(2.0, 3.0))
    level = 0.01 * wide

    def lay(
        points: np.ndarray, faces: np.ndarray, center: tuple[float, float], step: int, material: str, bulge: float = 0.0
    ) -> None:
        positions = points + center
        z = front.at(positions)
        ahead = front.at(np.array([center]))[0]
        z = np.maximum(z, ahead - 0.25 * size) if bulge else z
        costume.add(np.column_stack([positions, z + level * (1 + 0.7 * step) + 0.002]), faces, bone, 1, material)

    slant = float(u(-0.08, 0.12))
    for side in (1, -1):
        at = (side * apart, height)
        tilt = np.array([[1, slant * side], [0, 1]])

        def oval(
            rings: int, around: int, half: tuple[float, float], square: float = shape, tilt: np.ndarray = tilt
        ) -> tuple[np.ndarray, np.ndarray]:
            points, faces = patch(rings, around, half, squareness=square)
            return points @ tilt, faces

        lay(*oval(3, 20, (size, tall)), at, 0, "eye white", 1)
        lay(*oval(3, 18, (0.62 * size, 0.86 * tall), 2.2), (at[0], at[1] - 0.04 * tall), 1, "iris", 1)
        lay(*oval(2, 14, (0.3 * size, 0.45 * tall), 2.0), (at[0], at[1] - 0.02 * tall), 2, "pupil", 1)
        lay(*oval(2, 10, (0.17 * size, 0.2 * tall), 2.0), (at[0] + 0.2 * size, at[1] + 0.4 * tall), 3, "eye light", 1)
        lash, faces = _arc(size * 1.12, tall * 1.02, 0.2 * tall, side)
        lay(lash @ tilt, faces, at, 3, "lashes", 1)
        brow, faces = _arc(size * 0.95, 0.35 * tall, 0.09 * tall, side)
        lay(brow @ tilt, faces, (at[0], height + 1.25 * tall), 2, "brow", 1)
    mouth, faces = _arc(0.28 * wide * u(0.6, 1.1), -0.07 * wide * u(0.3, 1.6), 0.035 * wide, 0)
    lay(mouth, faces, (0.0, low + 0.19 * (top - low)), 1, "mouth")


def _arc(half: float, rise: float, thick: float, side: int) -> tuple[np.ndarray, np.ndarray]:
    """A bow over the top of an ellipse, thicker in the middle, shape (V, 2), and its faces."""
    t = np.linspace(-1, 1, 13)
    high = rise * np.sqrt(np.maximum(1 - 0.92 * t**2, 0.0))
    deep = thick * (1 - 0.8 * np.abs(t) ** 2) * (1 + 0.4 * t * np.sign(side))
    upper, lower = np.column_stack([half * t, high + 0.5 * deep]), np.column_stack([half * t, high - 0.5 * deep])
    a = np.arange(12)
    faces = np.concatenate([np.stack([a + 13, a + 14, a + 1], axis=1), np.stack([a + 13, a + 1, a], axis=1)])
    return np.concatenate([upper, lower]), faces
