"""A mesh that moves: the same triangles in every frame, without any skeleton."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.errors import FormatError, MotionError

__all__ = ["MeshMotion", "load_mesh_motion"]

MAX_VALUES = 400_000_000  # coordinates of all frames: 1.6 GB


@dataclass(frozen=True, eq=False)
class MeshMotion:
    """Vertices of a mesh in each frame.

    Args:
        vertices: Positions, +Y up and facing +Z in the first frame [m], shape (N, V, 3).
        faces: Triangles, shape (F, 3).
        fps: Frames a second [1/s].
        name: What it is called.

    Raises:
        MotionError: Shapes disagree, a value is not finite, or there is no frame.
    """

    vertices: np.ndarray
    faces: np.ndarray
    fps: float = 20.0
    name: str = "mesh"

    def __post_init__(self) -> None:
        vertices, faces = np.asarray(self.vertices, np.float32), np.asarray(self.faces, np.int64)
        if vertices.ndim != 3 or vertices.shape[2] != 3 or not vertices.size:
            raise MotionError(f"a moving mesh needs vertices of shape (frames, vertices, 3), not {vertices.shape}")
        if faces.ndim != 2 or faces.shape[1:] != (3,) or not len(faces) or faces.min() < 0 or faces.max() >= vertices.shape[1]:
            raise MotionError("a moving mesh needs triangles of shape (F, 3) that name its vertices")
        if not np.isfinite(vertices).all():
            raise MotionError("a moving mesh has coordinates that are not numbers")
        if not 0 < self.fps < np.inf:
            raise MotionError("frames a second must be positive and finite")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    def __len__(self) -> int:
        return len(self.vertices)


def load_mesh_motion(folder: str | Path, fps: float = 20.0) -> MeshMotion:
    """Read a folder of OBJ or PLY files, one a frame in the order of their names, all with the same triangles.

    Args:
        folder: The folder.
        fps: Frames a second [1/s].

    Raises:
        FormatError: There are no such files, one cannot be read, or their meshes differ.
    """
    from bunraku.io import load_character

    folder = Path(folder)
    kinds = [sorted(file for file in folder.iterdir() if file.suffix.lower() == suffix and file.is_file()) for suffix in (".ply", ".obj")]
    files = max(kinds, key=len)
    if not files:
        raise FormatError(folder, "it holds no .obj or .ply files; name a folder with one mesh a frame")
    first = load_character(files[0])
    count = len(first.vertices)
    if count * 3 * len(files) > MAX_VALUES:
        raise FormatError(folder, f"{len(files)} frames of {count:,} vertices are too many; simplify the meshes or leave frames out")
    vertices = np.empty((len(files), count, 3), np.float32)
    for number, file in enumerate(files):
        mesh = first if not number else load_character(file)
        if mesh.vertices.shape != first.vertices.shape or not np.array_equal(mesh.faces, first.faces):
            raise FormatError(file, f"its mesh has other triangles than {files[0].name}; export all frames with the same vertices in the same order")
        vertices[number] = mesh.vertices
    return MeshMotion(vertices, first.faces, fps, folder.name)
