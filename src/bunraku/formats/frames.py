"""The frame of a file: which axis is up in it and how long its unit is, against ours, +Y up and metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.errors import OptionError

__all__ = ["BARE", "UNITS", "FileFrame", "likely_unit"]

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
