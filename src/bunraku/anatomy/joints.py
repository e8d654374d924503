"""Where handles meet: the joints that skinning weights imply."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from bunraku.body.layout import HANDLE_NAMES, HANDLE_PARENTS
from bunraku.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.geometry.rotations import axis_angle_from_matrix, inverses
from bunraku.geometry.surface import vertex_areas

__all__ = [
    "Joints",
    "attach_joints",
    "downwards",
    "estimated_reference_joints",
    "find_joints",
    "reference_joints",
    "refined_joints",
]

PRESENT = 2e-3  # share of the surface under which a handle counts as absent and follows its parent
OVERLAP = 5e-3  # share of a part in which its parent has one too, under which the two are pieces that only touch
ASTRAY = 2.0  # the way from the middle of one part to that of the next by their joint, over the straight one, at most
TRACE = 0.2  # weight, of a part's largest, under which a vertex is not of the part
GROUP = 4000  # vertices of a part looked at to find where it meets another
HIP_BY_THIGH = (
    0.75  # how far a bent hip follows the thigh instead of the overlap of weights; by archive humanoids made to sit
)
CLOSE = 0.1  # how fast closeness fades, as a share of a part's size


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

    The joint of k and p is the mean of the vertices weighted by area times s_k times s_p. Where the weights hardly
    overlap (loose parts; a trace of both may lie anywhere), it is half way between the two nearest groups of vertices.
    """
    areas = character.areas
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
        shared = _shared(vertices, handles, areas, handle, parent)
        if shared is not None:
            positions[handle] = (shared * areas) @ vertices / float(shared @ areas)
            continue
        own, above = (
            np.where(handles.weights[:, part] > TRACE * handles.weights[:, part].max(), mass[:, part], 0)
            for part in (handle, parent)
        )
        positions[handle] = _between(vertices, own, above) if above.any() else positions[parent]
    return Joints(positions, parents, present)


def _shared(vertices: np.ndarray, handles: Handles, areas: np.ndarray, handle: int, parent: int) -> np.ndarray | None:
    """How much each vertex is of the place where two handles meet, the product of their shares, shape (V,); None where
    they hardly overlap, or where what they share lies nowhere between them: a trace of an arm on all fingers is no
    elbow.
    """
    own = handles.weights[:, handle].astype(np.float64)
    both = own * handles.weights[:, parent]
    mass = both * areas
    total = float(mass.sum())
    if total <= OVERLAP * float(own @ areas):
        return None
    middle, part, above = mass @ vertices / total, handles.positions[handle], handles.positions[parent]
    way = np.linalg.norm(middle - part) + np.linalg.norm(middle - above)
    return None if way > ASTRAY * np.linalg.norm(part - above) else both


def _between(vertices: np.ndarray, mass: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Where two groups of vertices are closest to each other, shape (3,): the mean over both of what is nearest to the
    other.

    Which vertices those are hardly depends on how a hinge is bent.
    """
    groups = [np.flatnonzero(some > 0.2 * some.max()) for some in (mass, other)]
    groups = [group[:: max(1, len(group) // GROUP)] for group in groups]
    points = [vertices[group] for group in groups]
    sides = []
    for own, far, group, some in ((points[0], points[1], groups[0], mass), (points[1], points[0], groups[1], other)):
        gap = cKDTree(far).query(own)[0]
        softness = CLOSE * max(float(np.sqrt(((own - own.mean(axis=0)) ** 2).sum(axis=1).mean())), 1e-12)
        share = some[group] * np.exp((gap.min() - gap) / softness)
        sides.append(share @ own / share.sum())
    return np.asarray(0.5 * (sides[0] + sides[1]))


def refined_joints(character: Character, handles: Handles, joints: Joints, rotations: np.ndarray) -> Joints:
    """Joints as they are where the rest pose has been bent: estimates of `find_joints` rid of what the bend and the
    estimate add.

    Where the weights of two handles overlap, skinning has taken a vertex p of the unbent surface to `j + M (p - j')`,
    where M = (1 - s) R_p^T + s R_k^T blends what undoes the rotations of both. Bent back, the overlap's centre lies
    from the joint where it lies on the reference body, whose true joints are known, in each part's own scale; that
    fixes j.

    Args:
        character: In its rest pose.
        handles: Its handles.
        joints: The estimate.
        rotations: Rotation of each handle from the rest pose to the reference body's, shape (K, 3, 3).
    """
    body, estimated = reference_body(), estimated_reference_joints()
    centres = body.handles.positions
    areas = character.areas
    positions = joints.positions.copy()
    h = handles.positions.astype(np.float64)
    for handle in range(1, len(body.joints)):
        parent = int(joints.parents[handle])
        if not joints.present[handle] or parent != HANDLE_PARENTS[handle]:
            continue
        j = joints.positions[handle]
        own = rotations[handle] @ (h[handle] - j) + rotations[parent] @ (j - h[parent])
        size = float(np.linalg.norm(own) / np.linalg.norm(centres[handle] - centres[parent]))
        offset = (estimated.positions[handle] - body.joints[handle]) * size
        unbent = _unbent(character, handles, areas, (handle, parent), rotations, j)
        if unbent is None:  # the parts do not overlap
            positions[handle] -= 0.5 * (rotations[handle] + rotations[parent]).T @ offset
            continue
        where, unbend, mass = unbent
        unbend *= (mass / mass.sum())[:, None, None]
        centre = np.einsum("vij,vj->i", unbend, character.vertices[where].astype(np.float64))
        positions[handle] = np.linalg.solve(unbend.sum(axis=0), centre - offset)
    return replace(joints, positions=_bent_hips(positions, joints.present, h, rotations))


def _bent_hips(positions: np.ndarray, present: np.ndarray, h: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Joint positions with hips that are bent put most of the way to where the thigh, from its knee to its middle, says
    that they are, shape (K, 3).

    The estimate by overlap is off by some per cent of the height where clothes or wide hips make the overlap large,
    which shows as shorter legs once a bent hip is straightened.
    """
    out, body = positions.copy(), reference_body()
    centres = body.handles.positions
    for side in ("left", "right"):
        hip, knee = HANDLE_NAMES.index(f"{side}_hip"), HANDLE_NAMES.index(f"{side}_knee")
        if present[[hip, knee]].all():
            bend = np.degrees(np.linalg.norm(axis_angle_from_matrix(rotations[hip])))
            size = np.linalg.norm(h[hip] - positions[knee]) / np.linalg.norm(centres[hip] - body.joints[knee])
            thigh = positions[knee] + rotations[hip].T @ (body.joints[hip] - body.joints[knee]) * size
            out[hip] += HIP_BY_THIGH * np.interp(bend, [30, 60], [0, 1]) * (thigh - positions[hip])
    return out


def _unbent(
    character: Character,
    handles: Handles,
    areas: np.ndarray,
    pair: tuple[int, int],
    rotations: np.ndarray,
    joint: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """The vertices of which a handle and its parent both hold a share, shape (n,), what bends each of them back, shape
    (n, 3, 3), and the mass of each in the overlap, by the area that it has when bent back, shape (n,). None where there
    is no overlap.
    """
    handle, parent = pair
    own, above = handles.weights[:, handle].astype(np.float64), handles.weights[:, parent].astype(np.float64)
    both = _shared(character.vertices, handles, areas, handle, parent)
    if both is None:
        return None
    near = both > 1e-3 * both.max()
    share = np.divide(own, own + above, out=np.zeros_like(own), where=near)
    faces = character.faces[near[character.faces].any(axis=1)]
    touched = np.unique(faces)
    share[touched] = np.where(near[touched], share[touched], own[touched] > above[touched])
    blend = (1 - share[touched])[:, None, None] * rotations[parent].T + share[touched][:, None, None] * rotations[
        handle
    ].T
    unbend = inverses(blend + 1e-9 * np.eye(3))
    flat = np.zeros((len(own), 3))
    flat[touched] = np.einsum("vij,vj->vi", unbend, character.vertices[touched] - joint)
    kept = near[touched]
    where = touched[kept]
    return where, unbend[kept], both[where] * vertex_areas(flat, faces)[where]


def attach_joints(rotations: np.ndarray, handles: Handles, joints: Joints) -> tuple[np.ndarray, np.ndarray]:
    """Local rotations and translations in which every joint holds; absent handles move with their parents."""
    rotations = rotations.copy()
    translations = np.zeros((*rotations.shape[:2], 3))
    h = handles.positions.astype(np.float64)
    for handle in downwards(joints.parents)[1:]:
        parent = int(joints.parents[handle])
        if not joints.present[handle]:
            rotations[:, handle] = rotations[:, parent]
        joint = joints.positions[handle]
        position = np.einsum("nij,j->ni", rotations[:, parent], joint - h[parent]) + h[parent] + translations[:, parent]
        translations[:, handle] = position - np.einsum("nij,j->ni", rotations[:, handle], joint - h[handle]) - h[handle]
    return rotations, translations


def downwards(parents: Sequence[int] | np.ndarray) -> list[int]:
    """All handles, every parent before its children."""
    depth = np.zeros(len(parents), int)
    for handle, parent in enumerate(parents):
        while parent >= 0:
            depth[handle], parent = depth[handle] + 1, parents[parent]
    return [int(handle) for handle in np.argsort(depth, kind="stable")]


@lru_cache(maxsize=1)
def reference_joints() -> Joints:
    """The reference body's handles with its true joints, positions [m] of shape (30, 3)."""
    body, estimated = reference_body(), estimated_reference_joints()
    return replace(estimated, positions=np.concatenate([body.joints, estimated.positions[len(body.joints) :]]))


@lru_cache(maxsize=1)
def estimated_reference_joints() -> Joints:
    """The reference body's joints as `find_joints` sees them, to compare with those of other characters [m], shape (30,
    3).
    """
    body = reference_body()
    return find_joints(body.character(), body.handles)
