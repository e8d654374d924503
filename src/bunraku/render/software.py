"""The renderer that always works: numba on one core, four samples a pixel."""

from __future__ import annotations

import numpy as np

from bunraku.render.camera import Camera
from bunraku.render.stage import Stage, cast_shadows
from bunraku.render.surface import Surface, compress_highlights, srgb_from_linear

__all__ = ["SoftwareRenderer"]


class SoftwareRenderer:
    """Draws frames of one surface on one stage.

    Faces that reach behind the eye are left out whole; a fitted camera has none.

    Args:
        size: Width and height in pixels.
        surface: The mesh.
        stage: The floor, the lights and the background.
    """

    name = "software"

    def __init__(self, size: tuple[int, int], surface: Surface, stage: Stage):
        width, height = size
        self._surface, self._stage = surface, stage
        self._depth = np.empty((height, width, 4), np.float32)
        self._ids = np.empty((height, width, 4), np.int32)
        self._base = np.empty((height, width, 3), np.float32)
        self._encode = srgb_from_linear(compress_highlights(np.linspace(0, 2, 8193, dtype=np.float32)))
        self._seen: tuple[bytes, ...] = ()

    def draw(self, vertices: np.ndarray, camera: Camera, offset: np.ndarray) -> np.ndarray:
        """One picture, shape (H, W, 3), uint8.

        Args:
            vertices: Posed positions [m], shape (V, 3), float32, contiguous.
            camera: Where it is seen from.
            offset: How far the lit part of the floor has moved [m], shape (3,).
        """
        from bunraku.render import kernels, shading

        stage, surface = self._stage, self._surface
        height, width = self._ids.shape[:2]
        focal = camera.focal(height)
        seen = (
            camera.position.tobytes(),
            camera.axes.tobytes(),
            np.float64(focal).tobytes(),
            np.asarray(offset, np.float64).tobytes(),
        )
        if seen != self._seen:
            shading.backdrop(
                camera.axes, camera.position, focal, stage.centre + offset, stage.ground, stage.radius, stage.cell,
                stage.top, stage.bottom, stage.floor, stage.line, self._base,
            )  # fmt: skip
            self._seen = seen
        points, normals = surface.pose(vertices)
        shadows = cast_shadows(stage, surface, vertices)
        screen = kernels.project(points, camera.axes, camera.position, focal, width, height)
        self._depth.fill(0)
        self._ids.fill(-1)
        kernels.rasterise(screen, surface.triangles, self._depth, self._ids)
        out = np.empty((height, width, 3), np.uint8)
        shading.shade(
            screen, surface.triangles, points, normals, surface.colors, self._ids, self._base, camera.axes,
            camera.position, focal,
            stage.ground, stage.light, stage.lights, shadows.heights, shadows.floor, shadows.left, shadows.near,
            shadows.texel,
            self._encode, out,
        )  # fmt: skip
        return out

    def close(self) -> None:
        """Nothing to give back."""
