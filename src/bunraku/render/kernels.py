"""The loops of the renderer, in numpy or, built once by the installed C compiler and kept, in C (`kernels.c`)."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bunraku.render import reference

VARIABLE = "BUNRAKU_KERNELS"
SOURCE = Path(__file__).with_name("kernels.c")
# Infinities mark empty texels, so of the fast-math rules only those that respect them.
FLAGS = (
    "-O3", "-std=gnu99", "-shared", "-fno-strict-aliasing", "-fno-math-errno", "-fno-trapping-math",
    "-freciprocal-math", "-fno-signed-zeros",
)  # fmt: skip


class Native(NamedTuple):
    """The compiled loops, or None where numpy draws instead, and the reason."""

    library: ctypes.CDLL | None
    reason: str


@cache
def native() -> Native:
    """The compiled loops, built by the first call; the environment variable BUNRAKU_KERNELS=numpy disables them."""
    if os.environ.get(VARIABLE, "").strip().lower() == "numpy":
        return Native(None, f"{VARIABLE} asks for numpy")
    text = SOURCE.read_bytes() + repr(FLAGS).encode()
    mark = hashlib.sha256(text + platform.machine().encode()).hexdigest()[:16]
    name = f"bunraku-kernels-{mark}{'.dll' if sys.platform == 'win32' else '.so'}"
    compiler = next((program for word in ("cc", "gcc", "clang") if (program := shutil.which(word))), None)
    for folder in _folders():
        path = folder / name
        try:
            if not path.is_file():
                if compiler is None:
                    continue
                folder.mkdir(parents=True, exist_ok=True, mode=0o700)
                compile_kernels(compiler, path)
            if not _ours(path):
                continue
            return Native(ctypes.CDLL(str(path)), str(path))
        except (OSError, subprocess.SubprocessError):
            continue
    if compiler is None:
        return Native(None, "there is no C compiler (cc, gcc or clang)")
    return Native(None, f"{compiler} could not build {SOURCE.name}")


def _folders() -> list[Path]:
    """Folders for the compiled loops: beside their source, or the user's cache."""
    cache_home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or ""
    home = Path(cache_home) if cache_home else Path(os.path.expanduser("~")) / ".cache"
    return [SOURCE.parent / "__pycache__", home / "bunraku"]


def _ours(path: Path) -> bool:
    """Whether only this user or root can have put this file here."""
    if sys.platform == "win32":
        return True
    return path.stat().st_uid in (0, os.getuid()) and not path.stat().st_mode & 0o022


def compile_kernels(compiler: str, path: Path) -> None:
    """Build the loops as a shared library, which appears whole or not at all. OSError if the compiler, one with the
    options of gcc, cannot be started, or the folder not written; subprocess.SubprocessError if it failed.
    """
    handle, name = tempfile.mkstemp(prefix=".kernels-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    try:
        position = () if sys.platform == "win32" else ("-fPIC",)
        command = [compiler, *FLAGS, *position, str(SOURCE), "-o", name, "-lm"]
        subprocess.run(command, check=True, capture_output=True, stdin=subprocess.DEVNULL, timeout=60)
        os.chmod(name, 0o755)
        os.replace(name, path)
    finally:
        with suppress(FileNotFoundError):
            os.unlink(name)


def _call(name: str, *arguments: Any) -> bool:
    """Call a compiled loop by its name in `kernels.c` with numbers, and contiguous arrays of the types that it reads;
    False where there is none.
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
