"""Other meshes of the same shape: one closed skin around many parts, as scans and image-to-3D programs give it, or few
triangles.
"""

from __future__ import annotations

import numpy as np

from bunraku_lab.synthetic.dressed.wardrobe import Piece
from bunraku_lab.synthetic.surfaces import nearest_shares

__all__ = ["melted", "simplified"]

_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])


def melted(piece: Piece, solid: Piece, cell: float, thickness: float) -> Piece:
    """The outside of all points nearer to a mesh than `thickness`, by marching cubes; weights are those of the nearest
    points.

    Args:
        piece: Everything that is seen, open and closed surfaces.
        solid: A closed surface whose inside is filled: the body.
        cell: Edge of the cubes [m].
        thickness: At least 0.6 cells, or holes appear [m].
    """
    import igl

    low = piece.points.min(axis=0) - thickness - 2 * cell
    size = np.ceil((piece.points.max(axis=0) + thickness + 2 * cell - low) / cell).astype(int) + 1
    near = np.zeros(size, bool)  # corners of cubes that the surface can cross
    corners = piece.points[piece.faces]
    steps = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1) / cell
    for count in range(1, int(min(steps.max(), 64)) + 2):
        some = corners[np.ceil(steps).clip(1, 65) == count]
        if len(some):
            a, b = np.meshgrid(np.linspace(0, 1, count + 1), np.linspace(0, 1, count + 1))
            shares = np.stack([1 - a, a * (1 - b), a * b], axis=-1).reshape(-1, 3)
            near[tuple(np.rint((np.einsum("kc,fca->fka", shares, some) - low) / cell).astype(int).reshape(-1, 3).T)] = (
                True
            )
    reach = int(np.ceil(thickness / cell)) + 1
    for axis in range(3):
        near = np.any([np.roll(near, shift, axis) for shift in range(-reach, reach + 1)], axis=0)
    number = np.argwhere(near)
    positions = number * cell + low
    distance = np.sqrt(igl.point_mesh_squared_distance(positions, piece.points, piece.faces)[0])
    inside = igl.fast_winding_number(solid.points, solid.faces, positions) > 0.5
    field = np.full(size, 1.0)
    field[tuple(number.T)] = np.where(inside, -distance, distance) - thickness
    whole = near[:-1, :-1, :-1].copy()
    for dx, dy, dz in _CORNERS[1:]:
        whole &= near[dx : dx + whole.shape[0], dy : dy + whole.shape[1], dz : dz + whole.shape[2]]
    cubes = np.argwhere(whole)
    index = np.ravel_multi_index((cubes[:, None] + _CORNERS).reshape(-1, 3).T, tuple(size))
    used, index = np.unique(index, return_inverse=True)
    grid = np.stack(np.unravel_index(used, tuple(size)), axis=1) * cell + low
    vertices, faces, _ = igl.marching_cubes(field.reshape(-1)[used], grid, index.reshape(-1, 8).astype(np.int64), 0.0)
    return _labelled(np.asarray(vertices), np.asarray(faces, np.int64), piece)


def simplified(piece: Piece, faces: int) -> Piece:
    """The mesh with at most so many triangles, as characters of games have them; weights are those of the nearest
    points.
    """
    import fast_simplification

    if faces >= len(piece.faces):
        return piece
    points, triangles = fast_simplification.simplify(
        piece.points.astype(np.float32), piece.faces.astype(np.int32), target_count=faces
    )
    if len(triangles) < 0.2 * faces:  # it collapsed
        return piece
    return _labelled(points.astype(np.float64), triangles.astype(np.int64), piece)


def _labelled(vertices: np.ndarray, faces: np.ndarray, piece: Piece) -> Piece:
    corners, shares = nearest_shares(vertices, piece.points, piece.faces)
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), 1e-9)
    joints, handles = (np.einsum("vc,vck->vk", shares, weights[corners]) for weights in (piece.joints, piece.handles))
    return Piece(vertices, faces, joints, handles)
