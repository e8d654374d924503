"""Bone-heat skinning (Baran & Popovic 2007, section 4): weights as the equilibrium of heat that bones give off.

The surface conducts heat. Each vertex is heated by the nearest bone that it sees, the harder the nearer it is; a bone
is kept at 1 while the others are at 0. Its temperature is the bone's weight.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import splu

from bunraku.geometry.graph import bridge_edges, clean_mesh, mesh_parts, unique_edges
from bunraku.geometry.surface import vertex_areas
from bunraku_lab.baselines.volume import Volume

__all__ = ["bone_distances", "bone_heat", "cotangent_laplacian", "embedded_bone_heat"]

_HEAT = 0.22  # c of the paper, where the mesh is scaled to fit a unit cube


def cotangent_laplacian(vertices: np.ndarray, faces: np.ndarray) -> csr_matrix:
    """Minus the cotangent Laplacian: conductances of the edges off the diagonal, negative, rows sum to 0, shape (V, V).

    Negative conductances, which obtuse triangles bring, are cut to 0, so that weights stay between 0 and 1. Loose parts
    are joined by bridges that conduct as the average edge does.
    """
    count = len(vertices)
    rows, columns, values = [], [], []
    for corner in range(3):
        i, j, k = (faces[:, (corner + shift) % 3] for shift in range(3))
        u, v = vertices[j] - vertices[i], vertices[k] - vertices[i]
        area = np.linalg.norm(np.cross(u, v), axis=1)
        cotangent = (u * v).sum(axis=1) / np.maximum(area, 1e-12)
        rows.append(j)
        columns.append(k)
        values.append(0.5 * np.clip(cotangent, -100, 100))
    matrix = csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(count, count))
    matrix = (matrix + matrix.T).tocsr()
    matrix.data = np.maximum(matrix.data, 1e-6)
    bridges = bridge_edges(vertices, mesh_parts(unique_edges(faces, count), count))
    if len(bridges):
        links = csr_matrix(
            (np.full(len(bridges), float(matrix.data.mean())), (bridges[:, 0], bridges[:, 1])), shape=(count, count)
        )
        matrix = matrix + links + links.T
    return csr_matrix(diags(np.asarray(matrix.sum(axis=1)).ravel()) - matrix)


def bone_distances(points: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances from points to bones, shape (P, B), and the nearest points on the bones, shape (P, B, 3)."""
    bones = ends - starts
    square = np.maximum(np.square(bones).sum(axis=1), 1e-18)
    share = np.clip(np.einsum("pbi,bi->pb", points[:, None] - starts, bones) / square, 0, 1)
    nearest = starts + share[..., None] * bones
    return np.linalg.norm(points[:, None] - nearest, axis=-1), nearest


def bone_heat(
    vertices: np.ndarray,
    faces: np.ndarray,
    starts: np.ndarray,
    ends: np.ndarray,
    owners: Sequence[int] | np.ndarray,
    volume: Volume | None = None,
) -> np.ndarray:
    """Weights of bones: the solution of `(-L + H) w = H p`.

    H of a vertex is c over the squared distance to its nearest visible bone, per unit of area; where several bones are
    as near, p gives each an equal share. A bone is visible where the line to it stays inside the mesh; vertices that
    see none, as on sheets, take no heat of their own, and where a whole mesh is so, all bones count as visible.

    Args:
        vertices: Welded positions, largest extent 1, shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        starts, ends: Of the bones, shape (B, 3).
        owners: The joint that moves each bone, shape (B,).
        volume: The inside of the mesh; None makes every bone visible.

    Returns:
        Weights of the joints, shape (V, max(owners) + 1), float32, rows sum to 1.
    """
    distances, nearest = bone_distances(vertices, starts, ends)
    visible = np.ones(distances.shape, bool)
    if volume is not None:
        slack = 0.75 * volume.step  # the surface itself is between grid points
        for bone in range(len(starts)):
            visible[:, bone] = volume.shallowest(vertices, nearest[:, bone], 6) > -slack
    sees = np.asarray(visible.any(axis=1))
    if sees.mean() < 0.05:
        visible[:], sees[:] = True, True
    seen = np.where(visible, distances, np.inf)
    least = seen.min(axis=1)
    heated = (seen <= 1.0001 * least[:, None]) & sees[:, None]
    joints = np.asarray(owners)
    share = np.zeros((len(vertices), int(joints.max()) + 1))
    np.add.at(share.T, joints, heated.T.astype(float))
    share = np.minimum(share, 1)  # bones that meet at a joint and belong to it are one source
    share /= np.maximum(share.sum(axis=1, keepdims=True), 1)
    areas = vertex_areas(vertices, faces) + 1e-12
    heat = np.where(sees, _HEAT / np.maximum(np.where(sees, least, 1), 1e-3) ** 2, 0) * areas + 1e-9 * areas
    solver = splu((cotangent_laplacian(vertices, faces) + diags(heat)).tocsc())
    weights = np.maximum(solver.solve(heat[:, None] * share), 0)
    total = weights.sum(axis=1, keepdims=True)
    return np.asarray(np.where(total > 1e-9, weights / np.maximum(total, 1e-9), 1 / share.shape[1]), np.float32)


def embedded_bone_heat(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Bone-heat weights of the human skeleton embedded in a mesh: automatic rigging as Pinocchio does it.

    Args:
        vertices: Positions [m], +Y up, facing +Z, shape (V, 3).
        faces: Vertex indices, shape (F, 3).

    Returns:
        Weights of the 22 joints, shape (V, 22), float32; joints at the ends of limbs that move no bone have none.
    """
    from bunraku_lab.baselines.embedding import embedded_human

    mesh = clean_mesh(vertices, faces)
    skeleton, volume = embedded_human(mesh.vertices, mesh.faces)
    owners, tips = np.array(skeleton.bones()).T
    weights = bone_heat(mesh.vertices, mesh.faces, skeleton.points[owners], skeleton.points[tips], owners, volume)
    out = np.zeros((len(mesh.vertices), skeleton.joints), np.float32)
    out[:, : weights.shape[1]] = weights
    return out[mesh.index]
