"""Soft shapes: rounded lumps blended into one signed distance field, as a sculptor presses clay onto clay."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

__all__ = ["Field", "Lump", "ball", "bar", "limb", "mirrored"]

Vector = Sequence[float] | np.ndarray
_EMPTY = 10.0


@dataclass(frozen=True)
class Lump:
    """A tapered bar with round ends and an elliptic section; with both ends at one position, an ellipsoid.

    Args:
        start: First end of the axis [m], shape (3,).
        end: Second end of the axis [m], shape (3,).
        radii: Radius at the two ends [m].
        joint: The joint that moves it.
        stretch: Factors on the radius along the three axes of `turn`, shape (3,).
        turn: Axes of the stretch as columns, shape (3, 3).
        blend: Width over which it melts into what was there before [m].
        carve: Take the shape away in place of adding it.
    """

    start: np.ndarray
    end: np.ndarray
    radii: tuple[float, float]
    joint: str = ""
    stretch: np.ndarray | None = None
    turn: np.ndarray | None = None
    blend: float = 0.02
    carve: bool = False

    @property
    def reach(self) -> float:
        """Largest distance of its surface from its axis [m]."""
        return max(self.radii) * (1.0 if self.stretch is None else float(np.max(self.stretch)))

    def distance(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Signed distance to first order, negative inside [m]; the three coordinates broadcast against each other."""
        axis = self.end - self.start
        qx, qy, qz = x - self.start[0], y - self.start[1], z - self.start[2]
        length = float(axis @ axis)
        radius: np.ndarray | float = self.radii[0]
        if length > 0:
            along = np.clip((qx * axis[0] + qy * axis[1] + qz * axis[2]) / length, 0, 1)
            qx, qy, qz = qx - along * axis[0], qy - along * axis[1], qz - along * axis[2]
            if self.radii[0] != self.radii[1]:
                radius = self.radii[0] + along * (self.radii[1] - self.radii[0])
        if self.stretch is None:
            return np.sqrt(qx * qx + qy * qy + qz * qz) - radius
        if self.turn is not None:
            r = self.turn
            qx, qy, qz = (qx * r[0, i] + qy * r[1, i] + qz * r[2, i] for i in range(3))
        sx, sy, sz = (float(s) for s in self.stretch)
        qx, qy, qz = qx / sx, qy / sy, qz / sz
        whole = np.sqrt(qx * qx + qy * qy + qz * qz) + 1e-7
        slope = np.sqrt((qx / sx) ** 2 + (qy / sy) ** 2 + (qz / sz) ** 2) + 1e-7 / max(sx, sy, sz)
        return (whole - radius) * whole / slope


def bar(
    start: Vector, end: Vector, radius: float | tuple[float, float], joint: str = "", *, stretch: Vector | None = None,
    turn: np.ndarray | None = None, blend: float = 0.02, carve: bool = False,
) -> Lump:  # fmt: skip
    """A `Lump` from plain numbers."""
    both = (float(radius), float(radius)) if isinstance(radius, (int, float)) else (float(radius[0]), float(radius[1]))
    shape = None if stretch is None else np.asarray(stretch, float)
    return Lump(np.asarray(start, float), np.asarray(end, float), both, joint, shape, turn, blend, carve)


def ball(
    centre: Vector,
    radii: float | Vector,
    joint: str = "",
    *,
    turn: np.ndarray | None = None,
    blend: float = 0.02,
    carve: bool = False,
) -> Lump:
    """An ellipsoid with these radii [m]."""
    if isinstance(radii, (int, float)):
        return bar(centre, centre, radii, joint, blend=blend, carve=carve)
    return bar(centre, centre, 1.0, joint, stretch=radii, turn=turn, blend=blend, carve=carve)


def limb(points: Sequence[Vector], radii: Sequence[float], joints: Sequence[str] | str, *, blend: float = 0.02,
inner: float = 0.006,
         stretch: Vector | None = None, bends: int = 1) -> list[Lump]:  # fmt: skip
    """Bars from point to point; the first melts into the body by `blend`, the others into each other by `inner` [m].

    Args:
        points: The joints of the limb [m], length P.
        radii: Radius at each point [m], length P.
        joints: Joint of each of the P - 1 bars, or one for all.
        blend: See above.
        inner: See above.
        stretch: See `Lump`.
        bends: Split each bar into this many along a smooth curve through the points.
    """
    names = [joints] * (len(points) - 1) if isinstance(joints, str) else joints
    knots = np.column_stack([np.asarray(points, float), np.asarray(radii, float)])
    slopes = np.gradient(knots, axis=0)
    out: list[Lump] = []
    for i, name in enumerate(names):
        t = np.linspace(0, 1, bends + 1)[:, None]
        between = 3 * t**2 - 2 * t**3
        row = knots[i] + t * (knots[i + 1] - knots[i])
        if bends > 1:
            row = (
                (1 - between) * knots[i]
                + between * knots[i + 1]
                + t * (1 - t) * ((1 - t) * slopes[i] - t * slopes[i + 1])
            )
        for low, high in pairwise(row):
            out.append(bar(low[:3], high[:3], (low[3], high[3]), name, stretch=stretch, blend=inner if out else blend))
    return out


def mirrored(lumps: Iterable[Lump]) -> list[Lump]:
    """The lumps and their images across x = 0, each left one followed by its right one; joints named Left... become
    Right....
    """
    flip = np.diag([-1.0, 1.0, 1.0])
    out = []
    for lump in lumps:
        turn = None if lump.turn is None else flip @ lump.turn
        out += [
            lump,
            replace(
                lump, start=flip @ lump.start, end=flip @ lump.end, turn=turn, joint=lump.joint.replace("Left", "Right")
            ),
        ]
    return out


def _melt(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """The smaller of two distances, rounded over a width."""
    if width <= 0:
        return np.minimum(a, b)
    h = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - h * h * (0.25 * width)


class Field:
    """Lumps joined in order into one distance field.

    Args:
        lumps: The shapes, joined or carved one after another.
        floor: Height below which nothing exists [m], for flat soles; None for no floor.
    """

    def __init__(self, lumps: Sequence[Lump], floor: float | None = None):
        self.lumps = tuple(lumps)
        self.floor = floor

    def _join(self, total: np.ndarray, lump: Lump, distance: np.ndarray) -> np.ndarray:
        return -_melt(-total, distance, lump.blend) if lump.carve else _melt(total, distance, lump.blend)

    def values(self, points: np.ndarray) -> np.ndarray:
        """Signed distance, negative inside [m], shape (M,), at points [m], shape (M, 3)."""
        x, y, z = np.ascontiguousarray(points.T)
        total = np.full(len(points), _EMPTY)
        for lump in self.lumps:
            total = self._join(total, lump, lump.distance(x, y, z))
        return total if self.floor is None else -_melt(-total, y - self.floor, 0.012)

    def gradient(self, points: np.ndarray, step: float = 5e-4) -> np.ndarray:
        """Gradient of the distance by central differences, shape (M, 3): the outward direction, about unit length."""
        moved = np.concatenate([points + sign * step * axis for axis in np.eye(3) for sign in (1, -1)])
        values = self.values(moved).reshape(3, 2, len(points))
        return (values[:, 0] - values[:, 1]).T / (2 * step)

    def distances(self, points: np.ndarray, joints: Sequence[str]) -> np.ndarray:
        """Distance to the nearest lump of each joint [m], shape (M, J)."""
        x, y, z = np.ascontiguousarray(points.T)
        out = np.full((len(points), len(joints)), _EMPTY)
        where = {name: i for i, name in enumerate(joints)}
        for lump in self.lumps:
            if lump.joint in where and not lump.carve:
                column = where[lump.joint]
                out[:, column] = np.minimum(out[:, column], lump.distance(x, y, z))
        return out

    def grid(self, spacing: float, half: bool) -> tuple[np.ndarray, np.ndarray]:
        """The field sampled on a regular grid.

        Args:
            spacing: Distance of neighbouring samples [m].
            half: Only x >= 0, with the first samples exactly on x = 0.

        Returns:
            Position of the first sample [m], shape (3,), and the samples, shape (X, Y, Z), float32.
        """
        solid = [lump for lump in self.lumps if not lump.carve]
        low = np.min([np.minimum(lump.start, lump.end) - lump.reach for lump in solid], axis=0) - 3 * spacing
        high = np.max([np.maximum(lump.start, lump.end) + lump.reach for lump in solid], axis=0) + 3 * spacing
        # the middle of the grid lies a little beside round numbers, so that no sample is exactly on a surface
        low += 1e-5
        if half:
            low[0] = 0.0
        count = np.ceil((high - low) / spacing).astype(int) + 1
        axes = [(low[i] + spacing * np.arange(count[i])).astype(np.float32) for i in range(3)]
        total = np.full(count, _EMPTY, np.float32)
        for lump in self.lumps:
            pad = lump.reach + lump.blend + 2 * spacing
            first = np.maximum(np.floor((np.minimum(lump.start, lump.end) - pad - low) / spacing).astype(int), 0)
            last = np.minimum(np.ceil((np.maximum(lump.start, lump.end) + pad - low) / spacing).astype(int) + 1, count)
            if (last <= first).any():
                continue
            box = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
            x, y, z = (axes[i][box[i]].reshape([-1 if j == i else 1 for j in range(3)]) for i in range(3))
            total[box] = self._join(total[box], lump, lump.distance(x, y, z))
        if self.floor is not None:
            total = -_melt(-total, (axes[1] - np.float32(self.floor))[None, :, None], 0.012)
        return low, total
