"""The frame of a file: which axis is up in it and how long its unit is, against ours, +Y up and metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.errors import OptionError

__all__ = ["UNITS", "FileFrame"]

UNITS: dict[str, float] = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Length of each unit that a file may have [m]."""

_TURNS = {"+y": np.eye(3), "+z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])}


@dataclass(frozen=True, eq=False)
class FileFrame:
    """How places and turns of ours are said in a file.

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
