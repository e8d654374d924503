"""The renderer on a graphics card: the same picture as the software renderer's, through moderngl on EGL."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from bunraku.render.camera import Camera
from bunraku.render.loops.reference import LINE_WIDTH
from bunraku.render.stage import TEXELS, Stage, cast_shadows
from bunraku.render.surface import Surface

__all__ = ["OpenGLRenderer", "open_context"]

SHADERS = Path(__file__).with_name("shaders")


def open_context() -> Any:
    """A moderngl context without a window.

    Raises:
        Exception: EGL or OpenGL 3.3 is missing; the message is the driver's.
    """
    return moderngl.create_context(standalone=True, backend="egl", require=330)


class OpenGLRenderer:
    """Draws frames of one surface on one stage with four samples a pixel.

    Args:
        size: Width and height in pixels.
        surface: The mesh.
        stage: The floor, the lights and the background.
    """

    name = "opengl"

    def __init__(self, size: tuple[int, int], surface: Surface, stage: Stage):
        self._size, self._surface, self._stage = size, surface, stage
        self._context = context = open_context()
        try:
            samples = min(4, context.max_samples)
            self._canvas = context.framebuffer(
                [context.renderbuffer(size, 4, samples=samples)], context.depth_renderbuffer(size, samples=samples)
            )
            self._result = context.framebuffer([context.renderbuffer(size, 4)])
            common = (SHADERS / "common.glsl").read_text() + f"#define LINE_WIDTH {LINE_WIDTH}\n"
            self._floor = context.program(
                (SHADERS / "floor.vert").read_text(), common + (SHADERS / "floor.frag").read_text()
            )
            self._mesh = context.program(
                (SHADERS / "mesh.vert").read_text(), common + (SHADERS / "mesh.frag").read_text()
            )
            self._points = context.buffer(reserve=24 * len(surface.point_vertex), dynamic=True)
            colors = context.buffer(surface.colors.tobytes())
            index = context.buffer(surface.triangles.tobytes())
            content = [(self._points, "3f 3f", "position", "normal"), (colors, "3f", "albedo")]
            self._mesh_array = context.vertex_array(self._mesh, content, index, index_element_size=4)
            self._floor_array = context.vertex_array(self._floor, [])
            self._maps = [context.texture((TEXELS, TEXELS), 1, dtype="f4") for _ in range(2)]
        except BaseException:
            context.release()
            raise
        for unit, texture in enumerate(self._maps):
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            texture.use(unit)
        lights = stage.lights
        self._set(
            heights=0, floor_shadow=1, ground=stage.ground, radius=stage.radius, cell=stage.cell, light=stage.light,
            key_color=lights[0],
            sky_color=lights[1], bounce_color=lights[2], rim_color=lights[3], top_color=stage.top,
            bottom_color=stage.bottom,
            floor_color=stage.floor, line_color=stage.line,
        )  # fmt: skip

    def _set(self, **values: Any) -> None:
        """Set uniforms in both programs; a compiler may have dropped those that a program does not use."""
        for program in (self._floor, self._mesh):
            for name, value in values.items():
                if name in program:
                    program[name].value = (
                        tuple(np.asarray(value).tolist()) if isinstance(value, (tuple, np.ndarray)) else value
                    )

    def draw(self, vertices: np.ndarray, camera: Camera, offset: np.ndarray) -> np.ndarray:
        """One picture, shape (H, W, 3), uint8; arguments as for the software renderer."""
        context, (width, height) = self._context, self._size
        points, normals = self._surface.pose(vertices)
        shadows = cast_shadows(self._stage, self._surface, vertices)
        self._points.write(np.concatenate([points, normals], axis=1))
        self._maps[0].write(np.maximum(shadows.heights, np.float32(-1e30)))
        self._maps[1].write(shadows.floor)
        depth = (camera.position - points) @ camera.axes[2]
        far = max(float(depth.max()), 1e-6)
        near = max(float(depth.min()), 1e-3 * far)
        self._set(
            eye=camera.position, right=camera.axes[0], up=camera.axes[1], back=camera.axes[2],
            focal=camera.focal(height),
            size=(float(width), float(height)), range=(0.98 * near, 1.02 * far), centre=self._stage.centre + offset,
            corner=(float(shadows.left), float(shadows.near)), texel=shadows.texel,
        )  # fmt: skip
        self._canvas.use()
        context.disable(moderngl.CULL_FACE)
        self._canvas.clear()
        context.disable(moderngl.DEPTH_TEST)
        self._floor_array.render(moderngl.TRIANGLES, vertices=3)
        context.enable(moderngl.DEPTH_TEST)
        self._mesh_array.render(moderngl.TRIANGLES)
        context.copy_framebuffer(self._result, self._canvas)
        pixels = np.frombuffer(self._result.read(components=3, alignment=1), np.uint8)
        return np.ascontiguousarray(pixels.reshape(height, width, 3)[::-1])

    def close(self) -> None:
        """Give the context back, with all that it holds."""
        self._context.release()
