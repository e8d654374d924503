"""What stands behind the character: the background's gradient and the floor, all but the floor's lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.render.camera import Camera
from bunraku.render.loops.reference import rays
from bunraku.render.stage import Stage

__all__ = ["Backdrop", "build_backdrop"]


@dataclass(frozen=True)
class Backdrop:
    """A picture without lines and character. It is the same wherever the camera moves to above its floor, whose lit
    part moves along.

    Args:
        base: sRGB 0..1, shape (H, W, 3), float32.
        plain: The same as it is shown, uint8.
        floor: Of each pixel: x and z of its floor point, seen from the point below the eye [m]; how far that moves
            along x and z from one pixel to the next [m]; how much of the floor is seen, 0..1. Shape (H, W, 5), float32.
    """

    base: np.ndarray
    plain: np.ndarray
    floor: np.ndarray


def build_backdrop(size: tuple[int, int], camera: Camera, stage: Stage, offset: np.ndarray) -> Backdrop:
    """The backdrop of pictures of `size` pixels; `offset` [m], shape (3,), is how far the lit part of the floor has
    moved.
    """
    focal, axes = camera.focal(size[1]), camera.axes
    columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    ray = rays(columns, rows, size, axes, focal)
    down = ray[..., 1] < -1e-4
    slope = ray / np.where(down, ray[..., 1], -1)[..., None]
    t = np.where(down, (stage.ground - camera.position[1]) * slope[..., 1] / ray[..., 1], 0)
    at = t[..., None] * ray
    centre = stage.centre + offset - camera.position
    r = ((at[..., 0] - centre[0]) ** 2 + (at[..., 2] - centre[2]) ** 2) / stage.radius**2
    fade = np.where((t > 0) & (r < 1), (1 - r) ** 2, 0)
    # Movement of the floor point for one pixel to the right and one up.
    moved = [np.abs(t / focal * (axes[:2, i, None, None] - axes[:2, 1, None, None] * slope[..., i])) for i in (0, 2)]
    base = stage.top + (stage.bottom - stage.top) * ((rows + 0.5) / size[1])[..., None]
    base = (base + (stage.floor - base) * fade[..., None]).astype(np.float32)
    floor = np.stack([at[..., 0], at[..., 2], moved[0].sum(axis=0), moved[1].sum(axis=0), fade], axis=-1)
    return Backdrop(base, (255 * base + 0.5).astype(np.uint8), floor.astype(np.float32))
