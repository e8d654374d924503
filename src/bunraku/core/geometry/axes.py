"""Axes and units: the 24 right-angle rotations, and which axis is up and how long a unit is in a file."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from bunraku.errors import OptionError

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
ORIENTATIONS: tuple[tuple[str, str], ...] = tuple((up, front) for up, front in product(AXES, AXES) if up[1] != front[1])
"""All pairs of up and front, 24 of them."""


def axis_name(text: str) -> str:
    """An axis in canonical form: "Z", "z" and "+Z" are "+z". OptionError if it is not an axis."""
    name = text.strip().lower()
    name = name if name[:1] in ("+", "-") else f"+{name}"
    if name not in AXES:
        raise OptionError(f"'{text}' is not an axis; there are {', '.join(AXES)}")
    return name


def axis_vector(name: str) -> np.ndarray:
    """The unit vector of an axis, shape (3,)."""
    vector = np.zeros(3)
    vector["xyz".index(name[1])] = 1 if name[0] == "+" else -1
    return vector


def upright_rotation(up: str, front: str) -> np.ndarray:
    """The rotation that takes one axis to +Y and another to +Z, shape (3, 3); its entries are -1, 0 and 1. OptionError
    if the axes are not at a right angle.
    """
    if up[1] == front[1]:
        raise OptionError(f"{up} cannot be up while {front} is the front; choose two axes at a right angle")
    above, ahead = axis_vector(up), axis_vector(front)
    return np.array([np.cross(above, ahead), above, ahead]) + 0.0  # no negative zeros


def right_angle_rotations() -> np.ndarray:
    """`upright_rotation` of each of `ORIENTATIONS`: the rotation group of the cube, shape (24, 3, 3)."""
    return np.stack([upright_rotation(up, front) for up, front in ORIENTATIONS])


def default_orientation(up: str | None = None, front: str | None = None) -> tuple[str, str]:
    """Up and front where nothing decides: +Y and +Z, as in glTF, or what is closest to that with the known axis. A file
    with +Z up faces -Y, as in modelling programs.
    """
    if up is not None:
        return up, front or {"+z": "-y", "-z": "+y"}.get(up, "+z")
    if front is not None:
        return ("+z" if front[1] == "y" else "+y"), front
    return "+y", "+z"


def direction_bins(directions: np.ndarray, count: int) -> np.ndarray:
    """The bin of each direction [rad], shape (M,), int64, among `count` equal parts of a full circle."""
    return np.asarray(((directions + np.pi) / (2 * np.pi) * count).astype(np.int64) % count)


UNITS: dict[str, float] = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Length of each unit that a file may have [m]. By definition."""
BARE = (".obj", ".ply", ".stl")
"""Formats that state neither their up axis nor their unit."""
_LEAST = {"mm": 400.0, "cm": 10.0, "m": 0.04}

_TURNS = {"+y": np.eye(3), "+z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])}


@dataclass(frozen=True, eq=False)
class FileFrame:
    """How our positions and rotations are written in a file."""

    turn: np.ndarray  # rotates our axes to the file's, shape (3, 3)
    scale: float  # units of the file in a metre

    @classmethod
    def of(cls, up: str, unit: str) -> FileFrame:
        """The frame of a file with +Y up, or with +Z, where our +Z is the file's -Y, as in Blender, in one of `UNITS`.
        OptionError if there is no such axis or unit.
        """
        if unit not in UNITS:
            raise OptionError(f"'{unit}' is not a unit; there are {', '.join(UNITS)}")
        if up not in _TURNS:
            raise OptionError(f"up is +y or +z in a file, not {up}")
        return cls(_TURNS[up], 1 / UNITS[unit])

    @property
    def ours(self) -> bool:
        """Whether the file's frame is the one inside."""
        return self.scale == 1 and np.array_equal(self.turn, np.eye(3))

    def points(self, points: np.ndarray) -> np.ndarray:
        """Points [m], shape (..., 3), in the file's frame, in their own type."""
        return points if self.ours else np.asarray(points @ (self.scale * self.turn.T), points.dtype)


def likely_unit(height: float) -> str:
    """The likely unit of a character's height: most are between a hand and a house tall. "mm" from 400 on, "cm" from 10
    on, "m" from 0.04 on, and "" for less, which may be shrunk.
    """
    return next((unit for unit, least in _LEAST.items() if height >= least), "")
