"""Where handles meet: the joints that skinning weights imply."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from bunraku.bodies.layout import HANDLE_PARENTS
from bunraku.bodies.reference import reference_body
from bunraku.character import Character, Handles
from bunraku.geometry.areas import vertex_areas

__all__ = ["Joints", "attached", "estimated_reference_joints", "find_joints", "reference_joints"]

PRESENT = 2e-3  # share of the surface under which a handle counts as absent and follows its parent


@dataclass(frozen=True)
class Joints:
    """Where handles meet their parents, in the rest pose.

    Args:
        positions: Joint between each handle and its parent [m], shape (K, 3); for the root the handle itself.
        parents: Nearest ancestor that is present, shape (K,); -1 for the root.
        present: Whether a handle has vertices of its own, shape (K,).
    """

    positions: np.ndarray
    parents: np.ndarray
    present: np.ndarray


def find_joints(character: Character, handles: Handles) -> Joints:
    """Joints between neighbouring handles, where both weights are large.

    The joint of k and p is the mean of the vertices weighted by area times s_k times s_p. Where the weights do not overlap
    (loose parts), it is half way between the two nearest groups of vertices.
    """
    areas = vertex_areas(character.vertices, character.faces)
    mass = handles.weights * areas[:, None]
    share = mass.sum(axis=0) / max(areas.sum(), 1e-30)
    present = share > PRESENT
    present[0] = True
    vertices = character.vertices.astype(np.float64)
    positions = handles.positions.astype(np.float64)
    parents = np.full(len(positions), -1)
    for handle in range(1, len(positions)):
        parent = HANDLE_PARENTS[handle]
        while parent > 0 and not present[parent]:
            parent = HANDLE_PARENTS[parent]
        parents[handle] = parent
        if not present[handle]:
            continue
        overlap = mass[:, handle] * handles.weights[:, parent]
        total = float(overlap.sum())
        if total > 1e-4 * float(mass[:, handle].sum()):
            positions[handle] = overlap @ vertices / total
        else:
            positions[handle] = 0.5 * (
                _nearest_group(vertices, mass[:, handle], handles.positions[parent])
                + _nearest_group(vertices, mass[:, parent], handles.positions[handle])
            )
    return Joints(positions, parents, present)


def _nearest_group(vertices: np.ndarray, mass: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Mean of the tenth of a handle's mass that is nearest to a point, shape (3,)."""
    own = np.flatnonzero(mass > 0.2 * mass.max()) if mass.max() > 0 else np.arange(0)
    if not len(own):
        return np.asarray(point, float)
    order = own[np.argsort(np.linalg.norm(vertices[own] - point, axis=1))]
    return vertices[order[: max(1, len(order) // 10)]].mean(axis=0)


def attached(rotations: np.ndarray, handles: Handles, joints: Joints) -> tuple[np.ndarray, np.ndarray]:
    """Local rotations and translations in which every joint holds; absent handles move with their parents."""
    rotations = rotations.copy()
    translations = np.zeros((*rotations.shape[:2], 3))
    h = handles.positions.astype(np.float64)
    for handle in range(1, rotations.shape[1]):
        parent = int(joints.parents[handle])
        if not joints.present[handle]:
            rotations[:, handle] = rotations[:, parent]
        joint = joints.positions[handle]
        place = np.einsum("nij,j->ni", rotations[:, parent], joint - h[parent]) + h[parent] + translations[:, parent]
        translations[:, handle] = place - np.einsum("nij,j->ni", rotations[:, handle], joint - h[handle]) - h[handle]
    return rotations, translations


@lru_cache(maxsize=1)
def reference_joints() -> Joints:
    """The reference body's handles with its true joints, positions [m] of shape (30, 3)."""
    body = reference_body()
    estimated = find_joints(body.character(), body.handles)
    return replace(estimated, positions=np.concatenate([body.joints, estimated.positions[len(body.joints) :]]))


@lru_cache(maxsize=1)
def estimated_reference_joints() -> Joints:
    """The reference body's joints as `find_joints` sees them, to compare with those of other characters [m], shape (30, 3)."""
    body = reference_body()
    return find_joints(body.character(), body.handles)
