"""Axes and units: the 24 right-angle rotations, and which axis is up and how long a unit is in a file."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from bunraku.errors import OptionError

__all__ = [
    "AXES", "BARE", "FileFrame", "ORIENTATIONS", "ROUND", "UNITS", "axis_name", "axis_vector", "covered",
    "default_orientation", "direction_bins", "directions_about", "goes_round", "likely_unit", "right_angle_rotations",
    "upright_rotation",
]  # fmt: skip


BINS, ROUND = 12, 0.75
"""Of the directions about a line; and the share of them that what goes round it covers."""

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
ORIENTATIONS: tuple[tuple[str, str], ...] = tuple((up, front) for up, front in product(AXES, AXES) if up[1] != front[1])
"""All pairs of up and front, 24 of them."""


def axis_name(text: str) -> str:
    """An axis as it is written here: "Z", "z" and "+Z" are "+z".

    Raises:
        OptionError: It is no axis.
    """
    name = text.strip().lower()
    name = name if name[:1] in ("+", "-") else f"+{name}"
    if name not in AXES:
        raise OptionError(f"'{text}' is no axis; there are {', '.join(AXES)}")
    return name


def axis_vector(name: str) -> np.ndarray:
    """The unit vector of an axis, shape (3,)."""
    vector = np.zeros(3)
    vector["xyz".index(name[1])] = 1 if name[0] == "+" else -1
    return vector


def upright_rotation(up: str, front: str) -> np.ndarray:
    """The rotation that takes one axis to +Y and another to +Z, shape (3, 3); its entries are -1, 0 and 1.

    Raises:
        OptionError: Both are the same axis, or opposite ones.
    """
    if up[1] == front[1]:
        raise OptionError(f"{up} cannot be up while {front} is the front; choose two axes at a right angle")
    above, ahead = axis_vector(up), axis_vector(front)
    return np.array([np.cross(above, ahead), above, ahead]) + 0.0  # no negative zeros


def right_angle_rotations() -> np.ndarray:
    """`upright_rotation` of each of `ORIENTATIONS`: the rotation group of the cube, shape (24, 3, 3)."""
    return np.stack([upright_rotation(up, front) for up, front in ORIENTATIONS])


def default_orientation(up: str | None = None, front: str | None = None) -> tuple[str, str]:
    """Up and front where no guess decides: +Y and +Z, the rule of glTF, or what is nearest to it with an axis that is
    known.

    A file with +Z up faces -Y, as modelling programs have it.
    """
    if up is not None:
        return up, front or {"+z": "-y", "-z": "+y"}.get(up, "+z")
    if front is not None:
        return ("+z" if front[1] == "y" else "+y"), front
    return "+y", "+z"


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


def direction_bins(directions: np.ndarray, count: int) -> np.ndarray:
    """In which of `count` equal parts of a turn directions about a line [rad], shape (M,), lie, shape (M,), int64."""
    return np.asarray(((directions + np.pi) / (2 * np.pi) * count).astype(np.int64) % count)


def covered(directions: np.ndarray, count: int = BINS) -> float:
    """Share of all directions about a line in which there is something, of so many.

    Args:
        directions: [rad], shape (M,).
        count: Of equal parts of a turn.
    """
    return float((np.bincount(direction_bins(directions, count), minlength=count) > 0).mean())


def goes_round(directions: np.ndarray) -> bool:
    """Whether what is in some directions about a line [rad], shape (M,), goes round it."""
    return covered(directions) >= ROUND


UNITS: dict[str, float] = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Length of each unit that a file may have [m]."""
BARE = (".obj", ".ply", ".stl")
"""Formats that say neither which axis is up nor how long their unit is; the others have a rule."""
_LEAST = {"mm": 400.0, "cm": 10.0, "m": 0.04}

_TURNS = {"+y": np.eye(3), "+z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])}


@dataclass(frozen=True, eq=False)
class FileFrame:
    """How positions and rotations of ours are written in a file.

    Args:
        turn: What turns our axes to the file's, shape (3, 3).
        scale: Units of the file in a metre.
    """

    turn: np.ndarray
    scale: float

    @classmethod
    def of(cls, up: str, unit: str) -> FileFrame:
        """The frame of a file.

        Args:
            up: "+y", or "+z", in which case what faces +Z with us faces -Y, as in Blender.
            unit: One of `UNITS`.

        Raises:
            OptionError: There is no such axis or unit.
        """
        if unit not in UNITS:
            raise OptionError(f"'{unit}' is no unit; there are {', '.join(UNITS)}")
        if up not in _TURNS:
            raise OptionError(f"up is +y or +z in a file, not {up}")
        return cls(_TURNS[up], 1 / UNITS[unit])

    @property
    def ours(self) -> bool:
        """Whether the file's frame is the one inside."""
        return self.scale == 1 and np.array_equal(self.turn, np.eye(3))

    def points(self, points: np.ndarray) -> np.ndarray:
        """Points [m], shape (..., 3), as the file says them, in their own type."""
        return points if self.ours else np.asarray(points @ (self.scale * self.turn.T), points.dtype)


def likely_unit(height: float) -> str:
    """The unit that a height is likely to be in: most characters are between a hand and a house tall.

    Returns:
        "mm" from 400 on, "cm" from 10 on, "m" from 0.04 on; "" for less, which may be shrunk.
    """
    return next((unit for unit, least in _LEAST.items() if height >= least), "")
