"""Animations as one mesh file a frame: OBJ or binary PLY, for programs that take vertex caches."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bunraku.core.resample import checked_fps
from bunraku.errors import FormatError
from bunraku.formats.files import check_output_folder, open_to_others, writing
from bunraku.formats.frames import FileFrame

if TYPE_CHECKING:
    from bunraku.core.animation import Animation
    from bunraku.core.character import Character
    from bunraku.core.point_animation import PointAnimation

__all__ = ["check_sequence", "write_obj_sequence", "write_ply_sequence"]

Frame = Callable[[np.ndarray], bytes]


def write_obj_sequence(
    animation: Animation | PointAnimation, path: Path, *, fps: float | None = None, up: str = "+y", unit: str = "m"
) -> Path:
    """Write `walk.obj` as a folder `walk` with `walk_0000.obj`, `walk_0001.obj` and so on: positions and triangles.

    Args:
        animation: The animation.
        path: Where; its suffix names the format, its stem the folder and the files.
        fps: Frames a second [1/s]; those of the motion by default.
        up: The axis that is up in the files, "+y" or "+z".
        unit: Unit of lengths, one of `bunraku.formats.frames.UNITS`.

    Returns:
        The folder.

    Raises:
        FormatError: The folder cannot be written, or holds other files.
        OptionError: `fps` is no number from 1 to 1000, or there is no such axis or unit.
    """
    return _write(animation, path, fps, FileFrame.of(up, unit), _obj_frame(animation.character))


def write_ply_sequence(
    animation: Animation | PointAnimation, path: Path, *, fps: float | None = None, up: str = "+y", unit: str = "m"
) -> Path:
    """Write `walk.ply` as a folder `walk` of binary PLY files, with vertex colours; see `write_obj_sequence`."""
    return _write(animation, path, fps, FileFrame.of(up, unit), _ply_frame(animation.character))


def _obj_frame(character: Character) -> Frame:
    faces = character.faces + 1
    tail = (("f %d %d %d\n" * len(faces)) % tuple(faces.reshape(-1).tolist())).encode()
    pattern = "v %.9g %.9g %.9g\n" * len(character.vertices)
    return lambda vertices: (pattern % tuple(vertices.reshape(-1).tolist())).encode() + tail


def _ply_frame(character: Character) -> Frame:
    colors = character.colors
    fields: list[tuple] = [("position", "<f4", 3)] + ([("color", "u1", 3)] if colors is not None else [])
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    if colors is not None:
        properties += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    count, faces = len(character.vertices), len(character.faces)
    head = f"ply\nformat binary_little_endian 1.0\ncomment bunraku\nelement vertex {count}\n{properties}"
    head += f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.empty(count, fields)
    if colors is not None:
        rows["color"] = colors
    triangles = np.empty(faces, [("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, character.faces
    tail = triangles.tobytes()

    def frame(vertices: np.ndarray) -> bytes:
        rows["position"] = vertices
        return head.encode() + rows.tobytes() + tail

    return frame


def _write(animation: Animation | PointAnimation, path: Path, fps: float | None, axes: FileFrame, frame: Frame) -> Path:
    moved = animation.at(checked_fps(fps, animation.motion.fps))
    frames = len(moved.motion)
    check_output_folder(path)
    folder = check_sequence(path)
    temporary = ""
    with writing(path, "files"):
        try:
            temporary = tempfile.mkdtemp(prefix=f".{path.stem[:100]}.", suffix=".tmp", dir=path.parent)
            digits = max(4, len(str(frames - 1)))
            for start in range(0, frames, 16):
                for offset, vertices in enumerate(moved.vertices(slice(start, start + 16))):
                    Path(temporary, f"{path.stem}_{start + offset:0{digits}d}{path.suffix}").write_bytes(
                        frame(np.ascontiguousarray(axes.points(vertices)))
                    )
            open_to_others(Path(temporary), 0o777)
            if folder.exists():
                shutil.rmtree(folder)
            os.replace(temporary, folder)
        finally:
            if temporary:
                with suppress(OSError):
                    shutil.rmtree(temporary)
    return folder


def check_sequence(path: Path) -> Path:
    """The folder that a sequence of this name goes to.

    Raises:
        FormatError: The folder holds anything but an earlier sequence of this name, which is all that is replaced.
    """
    folder = path.with_suffix("")
    if not folder.exists():
        return folder
    pattern = re.compile(re.escape(path.stem) + r"_\d{4,}" + re.escape(path.suffix))
    if not folder.is_dir() or any(
        not pattern.fullmatch(entry.name) or not entry.is_file() for entry in folder.iterdir()
    ):
        raise FormatError(path, f"{folder} exists and holds other files; choose another name for the sequence")
    return folder
