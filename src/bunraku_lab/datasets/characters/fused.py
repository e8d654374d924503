"""Fused forms of rigged characters: one skin over what touches, as image-to-3D programs and sculptors' remeshers make
it, with the rig's truth carried over.

A character takes a pose in which limbs touch one another or the trunk, is remeshed by voxels, thinned, and given the
weights of its own surface: each vertex takes those of the nearest point of it that looks the same way, so that the two
sides of a contact stay two parts.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from bunraku.core.character import Character, Rig, top_influences
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError
from bunraku.geometry.surface import face_normals, vertex_normals
from bunraku_lab.datasets.characters.known_rigs import facing_turn
from bunraku_lab.datasets.characters.remeshed import filled_cells, fused_mesh
from bunraku_lab.datasets.characters.training_character import (
    TrainingCharacter,
    forward_kinematics,
    human_rest,
    random_pose,
)
from bunraku_lab.synthetic.families.shapes import thinned
from bunraku_lab.synthetic.samples.meshing import neighbour_average

__all__ = ["fused_character"]

POINTS = 200_000
CELLS = (48, 128)  # voxels along the largest extent
NEAR = 12  # points of the surface that a vertex chooses among
AGAINST = 2.0  # cells by which a point that looks the other way counts as farther
FACES = (1_200, 20_000)


def fused_character(character: Character, truth: TrainingCharacter, name: str, rng: np.random.Generator) -> Character:
    """A rigged character in a pose that it may have been sculpted in, remeshed as one skin.

    Args:
        character: With a rig.
        truth: The same as the predictor trains on it (`bunraku_lab.datasets.characters.build.training_character`).
        name: Its name in the archive.
        rng: Of all choices.

    Raises:
        CharacterError: There is no rig, or no surface.
    """
    rig = character.rig
    if rig is None:
        raise CharacterError(f"{name}: there is no rig in this file; only rigged characters can be fused")
    turn = facing_turn(name, rig.names, rig.positions)
    faces = np.asarray(character.faces)
    vertices = character.vertices.astype(np.float64) @ turn.T
    used = vertices[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    vertices = (vertices - (low + high) / 2) / max(float((high - low).max()), 1e-12)
    weights = np.nan_to_num(rig.dense_weights().astype(np.float64))
    total = weights.sum(axis=1, keepdims=True)
    weights = np.where(total > 1e-6, weights / np.maximum(total, 1e-6), 1 / weights.shape[1])
    rotations = random_pose(rng, truth, float(rng.choice([0.0, 0.3, 0.5])), share=0.4)
    if rng.random() < 0.75:
        human_rest(rng, truth, rotations)
    transforms = forward_kinematics(truth.joints, truth.parents, rotations)
    vertices = skin(vertices, weights, transforms[None])[0].astype(np.float64)
    joints = np.einsum("jab,jb->ja", transforms[:, :, :3], truth.joints) + transforms[:, :, 3]
    points, normals, shares = _spread(vertices, faces, weights, rng)
    cells = int(np.exp(rng.uniform(*np.log(CELLS))))
    area = float(np.linalg.norm(face_normals(vertices, faces), axis=1).sum()) / 2
    cells = min(cells, filled_cells(points, area))
    skinned, triangles = fused_mesh(points, cells)
    if rng.random() < 0.7:
        skinned, triangles = thinned((skinned, triangles), int(np.exp(rng.uniform(*np.log(FACES)))))
    carried = _carried(skinned, triangles, points, normals, shares, float(np.ptp(points, axis=0).max()) / cells)
    placed = np.tile(np.eye(4), (len(joints), 1, 1))
    placed[:, :3, 3] = joints @ turn
    posed = Rig(rig.names, rig.parents, placed, *top_influences(carried, 4))
    return Character(f"{name} fused", (skinned @ turn).astype(np.float32), triangles, posed)


def _spread(
    vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points all over a mesh with their unit normals and weights, shapes (N, 3), (N, 3), (N, J)."""
    normals = face_normals(vertices, faces)
    areas = np.linalg.norm(normals, axis=1)
    if not np.isfinite(areas).all() or areas.sum() <= 0:
        raise CharacterError("the posed character has no surface")
    chosen = rng.choice(len(faces), POINTS, p=areas / areas.sum())
    shares = np.sort(rng.random((POINTS, 2)), axis=1)
    corner = np.stack([shares[:, 0], shares[:, 1] - shares[:, 0], 1 - shares[:, 1]], axis=1)
    corners = faces[chosen]
    return (
        np.einsum("nk,nkc->nc", corner, vertices[corners]),
        normals[chosen] / np.maximum(areas[chosen], 1e-12)[:, None],
        np.einsum("nk,nkj->nj", corner, weights[corners]),
    )


def _carried(
    vertices: np.ndarray,
    faces: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    shares: np.ndarray,
    size: float,
) -> np.ndarray:
    """Weights of the vertices of a skin by the points that it covers, shape (V, J)."""
    away, near = cKDTree(points).query(vertices, k=NEAR)
    looks = vertex_normals(vertices, faces)
    agreement = np.abs(np.einsum("vc,vkc->vk", looks, normals[near]))  # open sheets look both ways
    best = (away + AGAINST * size * (1 - agreement)).argmin(axis=1)
    carried = shares[near[np.arange(len(near)), best]]
    mean = neighbour_average(len(vertices), faces)
    for _ in range(2):  # single vertices that took another part's row follow those around them
        carried = 0.5 * carried + 0.5 * (mean @ carried)
    return np.asarray(carried / np.maximum(carried.sum(axis=1, keepdims=True), 1e-9), np.float32)
