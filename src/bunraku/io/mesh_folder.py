"""A moving mesh from a folder with one mesh a frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bunraku.core.mesh_motion import MeshMotion
from bunraku.errors import FormatError
from bunraku.io.registry import load_character

__all__ = ["load_mesh_motion"]

MAX_VALUES = 400_000_000  # coordinates of all frames: 1.6 GB


def load_mesh_motion(folder: str | Path, fps: float = 20.0) -> MeshMotion:
    """Read a folder of OBJ or PLY files, one a frame in the order of their names, all with the same triangles.

    Args:
        folder: The folder.
        fps: Frames a second [1/s].

    Raises:
        FormatError: There are no such files, one cannot be read, or their meshes differ.
    """

    folder = Path(folder)
    kinds = [
        sorted(file for file in folder.iterdir() if file.suffix.lower() == suffix and file.is_file())
        for suffix in (".ply", ".obj")
    ]
    files = max(kinds, key=len)
    if not files:
        raise FormatError(folder, "it holds no .obj or .ply files; name a folder with one mesh a frame")
    first = load_character(files[0], unit="m")
    count = len(first.vertices)
    if count * 3 * len(files) > MAX_VALUES:
        raise FormatError(
            folder, f"{len(files)} frames of {count:,} vertices are too many; simplify the meshes or leave frames out"
        )
    vertices = np.empty((len(files), count, 3), np.float32)
    for number, file in enumerate(files):
        mesh = first if not number else load_character(file, unit="m")
        if mesh.vertices.shape != first.vertices.shape or not np.array_equal(mesh.faces, first.faces):
            raise FormatError(
                file,
                f"its mesh has other triangles than {files[0].name}; export all frames with the same vertices in the "
                "same order",
            )
        vertices[number] = mesh.vertices
    return MeshMotion(vertices, first.faces, fps, folder.name)
