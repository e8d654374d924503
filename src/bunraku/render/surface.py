"""What stays the same from frame to frame: a mesh's faces with creases found in the rest pose, and its colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.errors import OptionError

__all__ = ["Surface", "build_surface", "compress_highlights", "linear_from_srgb", "srgb_from_linear"]

CREASE = np.deg2rad(42.0)
CLAY = (206, 170, 142)


def linear_from_srgb(values: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values, both 0..1."""
    values = np.asarray(values, np.float32)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4).astype(np.float32)


def srgb_from_linear(values: np.ndarray) -> np.ndarray:
    """sRGB values of linear light, both 0..1."""
    values = np.asarray(values, np.float32)
    return np.where(
        values <= 0.0031308, values * 12.92, 1.055 * np.maximum(values, 0.0031308) ** (1 / 2.4) - 0.055
    ).astype(np.float32)


def compress_highlights(values: np.ndarray) -> np.ndarray:
    """Linear light with all above a half bent to stay below 1, so that white characters keep their shape."""
    values = np.asarray(values, np.float32)
    return np.where(values <= 0.5, values, 1 - 0.5 * np.exp(1 - 2 * np.maximum(values, 0.5))).astype(np.float32)


@dataclass(frozen=True)
class Surface:
    """A mesh as the renderer draws it: points are vertices, split where a crease parts their normals.

    Args:
        faces: Vertices of each triangle, shape (F, 3), int32.
        triangles: Points of each triangle, shape (F, 3), int32.
        clusters: Normal of each corner, shape (F, 3), int32, below `normal_count`.
        point_vertex: Vertex of each point, shape (P,), int32.
        point_cluster: Normal of each point, shape (P,), int32.
        colors: Linear colour of each point, shape (P, 3), float32.
        normal_count: Number of normals.
    """

    faces: np.ndarray
    triangles: np.ndarray
    clusters: np.ndarray
    point_vertex: np.ndarray
    point_cluster: np.ndarray
    colors: np.ndarray
    normal_count: int

    def pose(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] and unit normals of the points, both (P, 3), for vertices [m] (V, 3), float32."""
        from bunraku.render.loops.kernels import accumulate_normals

        normals = accumulate_normals(vertices, self.faces, self.clusters, self.normal_count)
        return vertices.take(self.point_vertex, axis=0), normals.take(self.point_cluster, axis=0)


def build_surface(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray | None = None) -> Surface:
    """Find the creases of a rest pose and split the vertices there.

    Args:
        vertices: Rest positions [m], shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        colors: sRGB colours, uint8, of the vertices (V, 3) or one for all (3,). None, and white all over, which is what
            files without materials come as, is drawn in the colour of clay.

    Raises:
        OptionError: The colours are of another number than the vertices, or a face names a vertex that is not there.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    vertices = np.asarray(vertices, np.float32)
    faces = np.ascontiguousarray(faces, np.int32)
    if len(faces) and not 0 <= int(faces.min()) <= int(faces.max()) < len(vertices):
        raise OptionError(f"faces must name vertices 0 to {len(vertices) - 1}")
    tint = np.asarray(CLAY if colors is None else colors, np.uint8)
    if tint.shape not in ((3,), vertices.shape):
        raise OptionError(f"colours must have shape (3,) or {vertices.shape}, not {tint.shape}")

    if int(tint.min(initial=255)) == 255:
        tint = np.asarray(CLAY, np.uint8)

    # Seams of texture coordinates hold copies of a vertex; normals run across them.
    grid = np.round((vertices - vertices.min(axis=0)) / max(float(np.ptp(vertices, axis=0).max()), 1e-30) * 2e5).astype(
        np.int64
    )
    _, welded = np.unique(grid @ np.array([1, 1 << 20, 1 << 40]), return_inverse=True)
    corners = welded[faces]
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)

    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    corner = np.arange(start.size)
    following = np.roll(corner.reshape(-1, 3), -1, axis=1).ravel()
    swap = start > end
    low, high = np.where(swap, end, start), np.where(swap, start, end)
    at_low, at_high = np.where(swap, following, corner), np.where(swap, corner, following)
    order = np.lexsort((high, low))
    first, second = order[:-1], order[1:]
    smooth = (low[first] == low[second]) & (high[first] == high[second])
    smooth &= np.einsum("fi,fi->f", normals[first // 3], normals[second // 3]) > np.cos(CREASE)
    first, second = first[smooth], second[smooth]
    rows, columns = np.concatenate([at_low[first], at_high[first]]), np.concatenate([at_low[second], at_high[second]])
    graph = coo_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=(start.size, start.size))
    count, clusters = connected_components(graph, directed=False)

    pairs = faces.ravel().astype(np.int64) * count + clusters
    unique, triangles = np.unique(pairs, return_inverse=True)
    point_vertex = (unique // count).astype(np.int32)
    point_tint = np.broadcast_to(tint, (len(unique), 3)) if tint.ndim == 1 else tint[point_vertex]
    return Surface(
        faces=faces,
        triangles=triangles.reshape(-1, 3).astype(np.int32),
        clusters=clusters.reshape(-1, 3).astype(np.int32),
        point_vertex=point_vertex,
        point_cluster=(unique % count).astype(np.int32),
        colors=np.ascontiguousarray(linear_from_srgb(point_tint / np.float32(255))),
        normal_count=int(count),
    )
