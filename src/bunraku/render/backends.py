"""The choice between the graphics card and the software renderer."""

from __future__ import annotations

import os
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from bunraku.errors import OptionError
from bunraku.render.camera import Camera
from bunraku.render.stage import Stage
from bunraku.render.surface import Surface

__all__ = ["Backend", "Renderer", "backend", "open_renderer"]

VARIABLE = "BUNRAKU_RENDERER"


class Renderer(Protocol):
    """Draws frames of one surface on one stage."""

    name: str

    def draw(self, vertices: np.ndarray, camera: Camera, offset: np.ndarray) -> np.ndarray:
        """One picture, shape (H, W, 3), uint8, of posed vertices [m], shape (V, 3)."""

    def close(self) -> None:
        """Give back what the graphics card holds."""


class Backend(NamedTuple):
    """Which renderer draws previews ("opengl" or "software"), and why."""

    name: str
    reason: str


@cache
def _probe() -> Backend:
    if not _has_card():  # asking EGL costs a quarter of a second
        return Backend("software", "there is no graphics card")
    try:
        from bunraku.render.opengl import open_context
    except ImportError:
        return Backend("software", "moderngl is not installed")
    try:
        context = open_context()
    except Exception as error:  # the driver's own words; any failure means no graphics card for us
        return Backend("software", f"no OpenGL 3.3 through EGL ({str(error).strip() or type(error).__name__})")
    device = str(context.info["GL_RENDERER"])
    context.release()
    if any(word in device.lower() for word in ("llvmpipe", "softpipe", "swrast", "swiftshader")):
        return Backend(
            "software", f"OpenGL runs on the CPU here ({device}); the built-in renderer is as good and starts faster"
        )
    return Backend("opengl", device)


def _has_card() -> bool:
    """Whether the system shows a graphics card; where only EGL can tell, yes."""
    nodes = ("dri/renderD*", "nvidia[0-9]*", "dxg", "kfd", "mali*", "pvr*")
    return sys.platform != "linux" or any(next(Path("/dev").glob(node), None) for node in nodes)


def backend() -> Backend:
    """Which renderer draws previews, and why; the environment variable BUNRAKU_RENDERER (opengl, software) overrules
    the choice.

    Raises:
        OptionError: The variable names another renderer.
    """
    wish = os.environ.get(VARIABLE, "").strip().lower()
    if wish in ("", "auto"):
        return _probe()
    if wish not in ("opengl", "software"):
        raise OptionError(f"{VARIABLE}={wish} is not a renderer; set it to opengl or software, or unset it")
    return Backend(wish, f"{VARIABLE} asks for it")


def open_renderer(size: tuple[int, int], surface: Surface, stage: Stage, name: str | None = None) -> Renderer:
    """A renderer for pictures of this size.

    Args:
        size: Width and height in pixels.
        surface: The mesh.
        stage: The floor, the lights and the background.
        name: "opengl" or "software"; None is what `backend` says.

    Raises:
        OptionError: OpenGL was requested and does not work here.
    """
    from bunraku.render.software import SoftwareRenderer

    chosen = name or backend().name
    if chosen == "software":
        return SoftwareRenderer(size, surface, stage)
    try:
        from bunraku.render.opengl import OpenGLRenderer

        return OpenGLRenderer(size, surface, stage)
    except Exception as error:
        if (
            name is None and VARIABLE not in os.environ
        ):  # a card that was lost since the probe must not cost the preview
            return SoftwareRenderer(size, surface, stage)
        raise OptionError(f"OpenGL does not work here ({error}); use the software renderer") from error
