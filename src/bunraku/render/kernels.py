"""The loops of the renderer, in C and in numpy."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from bunraku.render import reference
from bunraku.render.native import native


def _call(name: str, *arguments: Any) -> bool:
    """Call a compiled loop; False where there is none.

    Args:
        name: The function in `kernels.c`.
        arguments: Arrays of the types that it reads, contiguous; numbers.
    """
    library = native().library
    if library is None:
        return False
    words: list[Any] = []
    for value in arguments:
        if isinstance(value, np.ndarray):
            if not value.flags.c_contiguous:
                raise ValueError(f"{name}: an array is not contiguous")
            words.append(ctypes.c_void_p(value.ctypes.data))
        else:
            words.append(ctypes.c_double(value) if isinstance(value, float) else ctypes.c_int64(value))
    getattr(library, name)(*words)
    return True


def _floats(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)


def _doubles(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float64)


def measure(vertices: np.ndarray, axes: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    bounds, support = np.empty((2, 3), np.float32), np.empty(4)
    points = _floats(vertices)
    if _call("measure", len(points), points, _doubles(axes), _doubles(slopes), bounds, support):
        return bounds, support
    return reference.measure(vertices, axes, slopes)


def accumulate_normals(vertices: np.ndarray, faces: np.ndarray, clusters: np.ndarray, count: int) -> np.ndarray:
    out = np.empty((count, 3), np.float32)
    if _call("accumulate_normals", _floats(vertices), len(faces), faces, clusters, count, out):
        return out
    return reference.accumulate_normals(vertices, faces, clusters, count)


def project(points: np.ndarray, axes: np.ndarray, eye: np.ndarray, focal: float, width: int, height: int) -> np.ndarray:
    out = np.empty((len(points), 3), np.float32)
    if _call("project", len(points), _floats(points), _doubles(axes), _doubles(eye), focal, width, height, out):
        return out
    return reference.project(points, axes, eye, focal, width, height)


def rasterise(screen: np.ndarray, faces: np.ndarray, depth: np.ndarray, ids: np.ndarray) -> tuple[int, int, int, int]:
    height, width = depth.shape[:2]
    window = np.zeros(4, np.int32)
    if not _call("rasterise", screen, len(faces), faces, width, height, depth, ids, window):
        return reference.rasterise(screen, faces, depth, ids)
    left, top, right, bottom = window.tolist()
    return left, top, right, bottom


def drop_shadow(
    vertices: np.ndarray, faces: np.ndarray, slopes: tuple[float, float], ground: float, corner: tuple[float, float],
    texel: float, lowest: bool, heights: np.ndarray,
) -> None:  # fmt: skip
    if not _call(
        "drop_shadow", vertices, len(faces), faces, *map(float, (*slopes, ground, *corner, texel)), int(lowest),
        len(heights), heights,
    ):  # fmt: skip
        reference.drop_shadow(vertices, faces, slopes, ground, corner, texel, lowest, heights)


def soften(image: np.ndarray, width: int) -> np.ndarray:
    out, size = np.empty_like(image), len(image)
    if _call("box", size, width, image, out, np.empty_like(image), np.empty(size)):
        return out
    return reference.soften(image, width)


def draw_grid(
    floor: np.ndarray, offset: np.ndarray, cell: float, color: np.ndarray, base: np.ndarray, plain: np.ndarray
) -> None:
    (height, width), thickness = base.shape[:2], reference.LINE_WIDTH * cell
    if not _call(
        "draw_grid", width, height, floor, _doubles(offset), float(cell), float(thickness), _doubles(color), base,
        plain,
    ):  # fmt: skip
        reference.draw_grid(floor, offset, cell, color, base, plain)


def shade(
    window: tuple[int, int, int, int],
    mesh: reference.Drawn,
    view: reference.View,
    lighting: reference.Lighting,
    shadows: reference.ShadowMap,
    ids: np.ndarray,
    base: np.ndarray,
    out: np.ndarray,
) -> None:
    height, width = ids.shape[:2]
    if not _call(
        "shade", width, height, np.array(window, np.int32), *mesh, ids, base, _doubles(view.axes), _doubles(view.eye),
        view.focal, float(lighting.ground), _doubles(lighting.light), _doubles(lighting.lights), shadows.heights,
        shadows.floor, len(shadows.heights), *map(float, (*shadows.corner, shadows.texel)), lighting.encode,
        len(lighting.encode) - 1, out,
    ):  # fmt: skip
        reference.shade(window, mesh, view, lighting, shadows, ids, base, out)
