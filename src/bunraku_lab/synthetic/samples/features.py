"""Eyes, cheeks, brows and smiles: small loose pieces laid on the surface of a field."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku_lab.synthetic.samples.assembly import Piece, solid
from bunraku_lab.synthetic.samples.fields import Field
from bunraku_lab.synthetic.samples.surfaces import ball_mesh, tube_mesh

__all__ = ["button", "eye", "onto_surface", "stroke"]


def onto_surface(field: Field, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest points on a surface, found by Newton's method.

    Args:
        field: The shape.
        points: Points near its surface [m], shape (M, 3).

    Returns:
        Positions on the surface [m], shape (M, 3), and outward unit normals, shape (M, 3).
    """
    points = np.array(points, float)
    for _ in range(6):
        slope = field.gradient(points)
        points -= (field.values(points) / np.maximum((slope * slope).sum(axis=1), 0.05))[:, None] * slope
    slope = field.gradient(points)
    return points, slope / np.linalg.norm(slope, axis=1, keepdims=True)


def button(field: Field, position: Sequence[float] | np.ndarray, radii: Sequence[float], color: str, joint: str, *,
           lift: float = 0.0, level: int = 2) -> Piece:  # fmt: skip
    """An ellipsoid half sunk into the surface: radii are its half width, half height and depth along the normal [m]."""
    centre, normal = onto_surface(field, np.array([position]))
    side = np.cross([0.0, 1.0, 0.0], normal[0])
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(normal[0], side), normal[0]], axis=1)
    return solid(ball_mesh(centre[0] + lift * normal[0], radii, level, turn), color, joint)


def eye(
    field: Field, position: Sequence[float], size: tuple[float, float], color: str, joint: str, white: str | None = None
) -> list[Piece]:
    """An eye with a glint, and with its white where a colour for it is given; `size` is its half width and half height
    [m].
    """
    width, height = size
    pieces, lift = [], 0.0
    if white is not None:
        pieces.append(button(field, position, (1.7 * width, 1.4 * height, 0.8 * width), white, joint))
        lift = 0.45 * width
    pieces.append(button(field, position, (width, height, 0.55 * width), color, joint, lift=lift))
    glint = np.add(position, (0.13 * width, 0.38 * height, 0.0))
    pieces.append(
        button(
            field,
            glint,
            (0.33 * width, 0.28 * height, 0.2 * width),
            "#ffffff",
            joint,
            lift=lift + 0.46 * width,
            level=1,
        )
    )
    return pieces


def stroke(field: Field, curve: np.ndarray, radii: np.ndarray | Sequence[float], color: str, joint: str) -> Piece:
    """A line drawn on the surface as a thin tube, along points near it [m], shape (P, 3)."""
    positions, normals = onto_surface(field, curve)
    return solid(tube_mesh(positions + 0.25 * np.max(radii) * normals, radii, 6), color, joint)
