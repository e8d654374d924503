"""A mesh that moves: the same triangles in every frame, without any skeleton."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.errors import MotionError

__all__ = ["MeshMotion"]


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
        if (
            faces.ndim != 2
            or faces.shape[1:] != (3,)
            or not len(faces)
            or faces.min() < 0
            or faces.max() >= vertices.shape[1]
        ):
            raise MotionError("a moving mesh needs triangles of shape (F, 3) that name its vertices")
        if not np.isfinite(vertices).all():
            raise MotionError("a moving mesh has coordinates that are not numbers")
        if not 0 < self.fps < np.inf:
            raise MotionError("frames a second must be positive and finite")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    def __len__(self) -> int:
        return len(self.vertices)
