"""An animation small enough to draw often."""

from __future__ import annotations

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion


def tube(rows: int = 12, around: int = 16) -> tuple[np.ndarray, np.ndarray]:
    height, angle = np.meshgrid(np.linspace(0, 1.8, rows), np.arange(around) * 2 * np.pi / around, indexing="ij")
    vertices = np.stack([0.25 * np.sin(angle), height, 0.25 * np.cos(angle)], -1).reshape(-1, 3)
    faces = []
    for row in range(rows - 1):
        for k in range(around):
            a, b = row * around + k, row * around + (k + 1) % around
            faces += [(a, b, a + around), (b, b + around, a + around)]
    return vertices, np.array(faces)


def swinging(rows: int = 12, around: int = 16, frames: int = 11, fps: float = 20.0) -> Animation:
    """A tube whose upper half bends to and fro while it slides."""
    vertices, faces = tube(rows, around)
    share = np.clip((vertices[:, 1] - 0.6) / 0.6, 0, 1)
    handles = Handles(np.array([[0, 0.6, 0], [0, 1.2, 0]]), np.stack([1 - share, share], axis=1))
    angle = 0.6 * np.sin(np.arange(frames) / fps * 5)
    rotations = np.tile(np.eye(3), (frames, 2, 1, 1))
    rotations[:, 1, 0, 0] = rotations[:, 1, 1, 1] = np.cos(angle)
    rotations[:, 1, 0, 1], rotations[:, 1, 1, 0] = -np.sin(angle), np.sin(angle)
    slide = np.zeros((frames, 3))
    slide[:, 0] = np.arange(frames) * 0.02
    motion = HandleMotion(np.zeros((frames, 2, 3)), rotations, slide, np.tile(np.eye(3), (frames, 1, 1)), fps)
    return Animation(
        Character("tube", vertices, faces, colors=np.full((len(vertices), 3), 120, np.uint8)), handles, motion
    )
