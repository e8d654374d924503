"""Pieces put together: one mesh, its colours, and where it is asked for a skeleton with skin weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.core.character import Character, Rig, top_influences
from bunraku_lab.synthetic.samples.fields import Field
from bunraku_lab.synthetic.samples.meshing import field_mesh, neighbour_average
from bunraku_lab.synthetic.samples.paint import Paint, paint_mesh, rgb

__all__ = ["Bones", "Piece", "assemble", "clay", "mirror_bones", "mirror_piece", "solid"]

Bones = dict[str, tuple[str, tuple[float, float, float]]]


@dataclass(frozen=True)
class Piece:
    """A part of a character.

    Args:
        vertices: Positions [m], shape (V, 3).
        faces: Triangles, shape (F, 3).
        colors: sRGB of each vertex, shape (V, 3), uint8.
        weights: Share of each joint by name, each shape (V,); rows need not sum to 1 yet.
    """

    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray
    weights: Mapping[str, np.ndarray]


def solid(mesh: tuple[np.ndarray, np.ndarray], color: str, joint: str | Mapping[str, np.ndarray]) -> Piece:
    """A mesh of one colour, moved by one joint or by given shares."""
    vertices, faces = mesh
    weights = {joint: np.ones(len(vertices))} if isinstance(joint, str) else joint
    return Piece(vertices, faces, np.tile(np.array(rgb(color), np.uint8), (len(vertices), 1)), weights)


def mirror_piece(piece: Piece) -> Piece:
    """The image across x = 0, moved by the joints of the other side."""
    swapped = {name.replace("Left", "Right"): share for name, share in piece.weights.items()}
    return Piece(piece.vertices * [-1, 1, 1], piece.faces[:, ::-1], piece.colors, swapped)


def clay(field: Field, count: int, bones: Bones, base: str, paints: Sequence[Paint] = (), *, half: bool = False,
         softness: float = 0.025, crease: float = 0.03) -> Piece:  # fmt: skip
    """Mesh, paint and weigh a distance field.

    Args:
        field: The shape; its lumps name the joints that move them.
        count: Vertices to aim at, before the paint's seams double some.
        bones: The skeleton.
        base: Colour where no paint is.
        paints: The paints.
        half: Build one half and mirror it.
        softness: Width over which the weight passes from one joint to the next [m].
        crease: See `field_mesh`.
    """
    vertices, faces = field_mesh(field, count, half=half, crease=crease)
    names = tuple(bones)
    weights = _weigh(vertices, faces, field, bones, softness)

    def project(points: np.ndarray) -> np.ndarray:
        slope = field.gradient(points)
        return points - (field.values(points) / np.maximum((slope * slope).sum(axis=1), 0.05))[:, None] * slope

    painted, cut, colors = paint_mesh(vertices, faces, base, paints, project)
    if len(painted) != len(vertices):
        from scipy.spatial import cKDTree

        distance, near = cKDTree(vertices).query(painted, k=3)
        share = 1 / (distance + 1e-4)
        weights = ((share / share.sum(axis=1, keepdims=True))[..., None] * weights[near]).sum(axis=1)
    return Piece(painted, cut, colors, {name: weights[:, i] for i, name in enumerate(names)})


def _weigh(vertices: np.ndarray, faces: np.ndarray, field: Field, bones: Bones, softness: float) -> np.ndarray:
    """Skin weights: a joint counts by how near its lumps are, and only on its own lumps and those of its neighbours in
    the skeleton.
    """
    names = tuple(bones)
    distance = field.distances(vertices, names)
    owner = distance.argmin(axis=1)
    parents = [names.index(bones[name][0]) if bones[name][0] else -1 for name in names]
    near = np.eye(len(names), dtype=bool)
    for child, parent in enumerate(parents):
        if parent >= 0:
            near[child, parent] = near[parent, child] = True
    weights = np.exp(-(distance - distance.min(axis=1, keepdims=True)) / softness) * near[owner]
    weights /= weights.sum(axis=1, keepdims=True)
    average = neighbour_average(len(vertices), faces)
    for _ in range(4):
        weights = 0.5 * weights + 0.5 * (average @ weights)
    return weights


def mirror_bones(bones: Bones) -> Bones:
    """The bones with a Right... for every Left..., directly after it."""
    out: Bones = {}
    for name, (parent, (x, y, z)) in bones.items():
        out[name] = (parent, (x, y, z))
        if name.startswith("Left"):
            out[name.replace("Left", "Right")] = (parent.replace("Left", "Right"), (-x, y, z))
    return {name: out[name] for name in sorted(out, key=lambda n: _depth(out, n))}


def _depth(bones: Bones, name: str) -> int:
    depth = 0
    while bones[name][0]:
        name, depth = bones[name][0], depth + 1
    return depth


def assemble(name: str, pieces: Sequence[Piece], bones: Bones, rigged: bool) -> Character:
    """One character from its pieces, set on y = 0."""
    vertices = np.concatenate([piece.vertices for piece in pieces])
    drop = float(vertices[:, 1].min())
    vertices = vertices - [0, drop, 0]
    starts = np.cumsum([0] + [len(piece.vertices) for piece in pieces[:-1]])
    faces = np.concatenate([piece.faces + start for piece, start in zip(pieces, starts, strict=True)])
    colors = np.concatenate([piece.colors for piece in pieces])
    # Faces of one colour together, so that a file can hold each colour as one primitive and keep the order.
    _, shade = np.unique(colors[faces[:, 0]], axis=0, return_inverse=True)
    faces = faces[np.argsort(shade.ravel(), kind="stable")]
    rig = None
    if rigged:
        names = tuple(bones)
        dense = np.concatenate(
            [
                np.stack([np.broadcast_to(piece.weights.get(n, 0.0), len(piece.vertices)) for n in names], 1)
                for piece in pieces
            ]
        )
        dense = np.where(dense < 0.01 * dense.max(axis=1, keepdims=True), 0, dense)
        transforms = np.tile(np.eye(4), (len(names), 1, 1))
        transforms[:, :3, 3] = np.array([bones[n][1] for n in names]) - [0, drop, 0]
        parents = np.array([names.index(bones[n][0]) if bones[n][0] else -1 for n in names])
        rig = Rig(names, parents, transforms, *top_influences(dense, 4))
    return Character(name, vertices, faces, rig, colors)
