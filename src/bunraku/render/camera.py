"""The preview's camera: a pinhole, and the closest one that keeps a whole motion in the picture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bunraku.errors import OptionError

__all__ = ["Camera", "Framing", "view_axes"]

FIELD_OF_VIEW = np.deg2rad(26.0)
YAW = np.deg2rad(32.0)
ELEVATION = np.deg2rad(13.0)
FOLLOW = 0.8
"""A path longer than this many times the character is followed."""


def view_axes(yaw: float = YAW, elevation: float = ELEVATION) -> np.ndarray:
    """Camera axes that look at the origin from a direction.

    Args:
        yaw: Rotation of the viewer about +Y from +Z (the character's front) towards +X [rad].
        elevation: Height of the viewer above the horizon [rad].

    Returns:
        Rows right, up and back (towards the viewer) in world coordinates, shape (3, 3), float64.
    """
    back = np.array([np.sin(yaw) * np.cos(elevation), np.sin(elevation), np.cos(yaw) * np.cos(elevation)])
    right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
    return np.stack([right, np.cross(back, right), back])


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with square pixels and its principal point in the middle of the picture.

    Args:
        position: Position of the eye [m], shape (3,).
        axes: Rows right, up and back in world coordinates, shape (3, 3).
        field_of_view: Angle from the picture's lower to its upper border [rad].
    """

    position: np.ndarray
    axes: np.ndarray
    field_of_view: float = float(FIELD_OF_VIEW)

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", np.asarray(self.position, np.float64).reshape(3))
        object.__setattr__(self, "axes", np.asarray(self.axes, np.float64).reshape(3, 3))
        if not 0 < self.field_of_view < np.pi:
            raise OptionError("a camera's field of view must be between 0 and pi radians")

    def moved(self, offset: np.ndarray) -> Camera:
        """The same camera at another place, `offset` [m] away."""
        return replace(self, position=self.position + offset)

    def focal(self, height: int) -> float:
        """Focal length in pixels for a picture that is `height` pixels high."""
        return 0.5 * height / float(np.tan(0.5 * self.field_of_view))

    def project(self, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Pixel coordinates and distance of points.

        Args:
            points: Positions [m], shape (..., 3).
            size: Width and height of the picture in pixels.

        Returns:
            Column, row (0, 0 is the upper left corner of the upper left pixel) and distance along the line of sight
            [m], shape (..., 3), float64.
        """
        width, height = size
        local = (np.asarray(points, np.float64) - self.position) @ self.axes.T
        depth = -local[..., 2]
        scale = self.focal(height) / np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        return np.stack([0.5 * width + local[..., 0] * scale, 0.5 * height - local[..., 1] * scale, depth], axis=-1)


class Framing:
    """Measures a motion frame by frame, then gives the closest camera that keeps all of it in the picture.

    For a fixed direction the four sides of the view are planes of known slope, so the closest camera follows from four
    support values per frame; no vertex has to be kept. A path about as long as the character is followed: the camera
    moves with the smoothed path, and the ground shows the movement.

    Args:
        frames: Number of frames N.
        size: Width and height of the picture in pixels.
        fps: Frames a second [1/s].
        axes: Rows right, up and back, shape (3, 3).
        margin: Share of the picture's half width and height left empty at each border; a pair gives the lower border
            another.
        floor: Height on which the character stands at rest [m]; it is the ground where the motion stays near it.
    """

    def __init__(
        self,
        frames: int,
        size: tuple[int, int],
        fps: float = 20.0,
        axes: np.ndarray | None = None,
        margin: float | tuple[float, float] = 0.1,
        floor: float | None = None,
    ):
        self.axes = view_axes() if axes is None else np.asarray(axes, np.float64)
        self.bounds = np.zeros((frames, 2, 3), np.float32)
        self._support = np.zeros((frames, 4))
        self._fps = fps
        self._floor = floor
        above, below = (margin, margin) if isinstance(margin, float) else margin
        slope = float(np.tan(0.5 * FIELD_OF_VIEW))
        self._slopes = np.array([slope * size[0] / size[1] * (1 - above), slope * (1 - above), slope * (1 - below)])

    def add(self, frame: int, vertices: np.ndarray) -> None:
        """Measure one frame: vertices [m], shape (V, 3), float32, contiguous."""
        from bunraku.render.loops.kernels import measure

        self.bounds[frame], self._support[frame] = measure(vertices, self.axes, self._slopes)

    @property
    def extent(self) -> float:
        """Largest extent of the character in any frame [m]."""
        return max(float((self.bounds[:, 1] - self.bounds[:, 0]).max()), 1e-9)

    @property
    def ground(self) -> float:
        """Height of the ground [m]: the floor of the rest pose, through which a weapon or a tail may pass for a while;
        of a motion elsewhere, or without a floor, what the lowest vertices of nearly all frames stand above.
        """
        lowest = float(np.quantile(self.bounds[:, 0, 1], 0.05, method="lower"))
        if self._floor is not None and abs(lowest - self._floor) < 0.4 * self.extent:
            return self._floor
        return lowest

    def offsets(self) -> np.ndarray:
        """How far the camera and the lit part of the floor have moved in each frame [m], shape (N, 3); zeros for a
        short path.
        """
        centre = self.bounds.mean(axis=1).astype(np.float64)
        out = np.zeros_like(centre)
        path = centre[:, [0, 2]]
        if float(np.ptp(path, axis=0).max(initial=0)) <= FOLLOW * self.extent:
            return out
        from bunraku.geometry.filters import gaussian

        # Mirrored about its ends the path goes on as it came, so that a straight walk is followed without lag.
        sigma = 0.6 * self._fps
        spare = min(int(4 * sigma) + 1, len(path) - 1)
        longer = np.pad(path, ((spare, spare), (0, 0)), mode="reflect", reflect_type="odd")
        smooth = gaussian(longer, sigma)[spare : spare + len(path)]
        out[:, [0, 2]] = smooth - path.mean(axis=0)
        return out

    def camera(self) -> Camera:
        """The closest camera, to be moved by `offsets` in each frame."""
        local = self.offsets() @ self.axes.T
        across, above, below = self._slopes
        right = (self._support[:, 0] - local[:, 0] - across * local[:, 2]).max()
        left = (self._support[:, 1] - local[:, 0] + across * local[:, 2]).min()
        top = (self._support[:, 2] - local[:, 1] - above * local[:, 2]).max()
        bottom = (self._support[:, 3] - local[:, 1] + below * local[:, 2]).min()
        back = max((right - left) / (2 * across), (top - bottom) / (above + below))
        # What the tighter side leaves free is shared by both borders of the other one.
        x, y = 0.5 * (right + left), 0.5 * (top - above * back + bottom + below * back)
        return Camera(np.array([x, y, back]) @ self.axes, self.axes)
