"""How rigid the blocks of a figure stay in an animation, and how well they stay jointed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from bunraku.core.character import Character
from bunraku.geometry.closest import least_distance
from bunraku.geometry.registration import register
from bunraku.geometry.surface import surface_points

__all__ = ["BlockMotion", "block_motion"]

SPACING = 0.005  # of the points that gaps are measured between, over the height: gaps are overrated by as much
AROUND = 0.06  # points so near to where two blocks touch at rest are looked at, over the height


@dataclass(frozen=True)
class BlockMotion:
    """What an animation does to blocks.

    Args:
        shear: Farthest that a vertex is from where the best rigid motion of its block takes it, over the height.
        gaps: How much farther from one another the two blocks of each joint are than at rest, at the most in any frame,
            over the height, shape (P,).
    """

    shear: float
    gaps: np.ndarray


def block_motion(
    character: Character, label: np.ndarray, joints: Sequence[tuple[int, int]], posed: np.ndarray
) -> BlockMotion:
    """Measure shear inside blocks and gaps at their joints on the posed surface, whatever posed it.

    Args:
        character: In its rest pose, V vertices.
        label: Block of each vertex, -1 for those that are not looked at, shape (V,).
        joints: Pairs of blocks that are jointed, P.
        posed: Vertices of each frame [m], shape (N, V, 3).
    """
    rest, height = character.vertices.astype(np.float64), character.height
    count = int(label.max()) + 1
    mass = np.eye(count + 1)[label][:, :count] * np.maximum(character.areas, 1e-12)[:, None]
    centers = (mass.T @ rest) / mass.sum(axis=0)[:, None]
    rotations, translations = register(rest, posed.astype(np.float64), mass, centers)
    own = np.flatnonzero(label >= 0)
    of = label[own]
    rigid = np.einsum("nvij,vj->nvi", rotations[:, of], rest[own] - centers[of]) + centers[of] + translations[:, of]
    shear = float(np.linalg.norm(rigid - posed[:, own], axis=-1).max()) / height
    points = [_points(character, label, block) for block in range(count)]
    gaps = []
    for one, other in joints:
        first, second = points[one], points[other]
        apart = cKDTree(second).query(first)[0]
        contact = cKDTree(first[apart <= apart.min() + 2 * SPACING * height])
        first, second = (
            some[np.isfinite(contact.query(some, distance_upper_bound=AROUND * height)[0])] for some in (first, second)
        )
        tree, widest = cKDTree(second), 0.0
        for frame in range(len(posed)):
            moved = (first - centers[one]) @ rotations[frame, one].T + centers[one] + translations[frame, one]
            back = (moved - centers[other] - translations[frame, other]) @ rotations[frame, other] + centers[other]
            widest = max(widest, least_distance(tree, back) - float(apart.min()))
        gaps.append(widest / height)
    return BlockMotion(shear, np.array(gaps))


def _points(character: Character, label: np.ndarray, block: int) -> np.ndarray:
    faces = character.faces[label[character.faces[:, 0]] == block]
    corners = character.vertices[faces].astype(np.float64)
    double = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(double, axis=1).sum()) / 2
    spread = max(int(area / (SPACING * character.height) ** 2), 200)
    own = character.vertices[np.unique(faces)].astype(np.float64)
    return np.concatenate([surface_points(character.vertices, faces, spread)[0], own])
