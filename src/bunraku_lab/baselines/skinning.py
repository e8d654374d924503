"""Skinning without learning, to compare handles with: geodesic k-means, a human skeleton embedded in any mesh
(Pinocchio, Baran & Popovic 2007), and the weights of bone heat (section 4 there).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import dijkstra
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from bunraku.core.body.layout import JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.graph import bridge_edges, clean_mesh, mesh_parts, unique_edges
from bunraku.core.geometry.surface import vertex_areas

_MEDOIDS = 24  # vertices near a cluster's mean that are tried as its medoid


def geodesic_graph(vertices: np.ndarray, faces: np.ndarray) -> csr_matrix:
    """Lengths of the edges of a mesh, loose parts joined by bridges, shape (V, V), symmetric.

    Args:
        vertices: Positions, shape (V, 3).
        faces: Vertex indices, shape (F, 3).
    """
    edges = unique_edges(faces, len(vertices))
    edges = np.concatenate([edges, bridge_edges(vertices, mesh_parts(edges, len(vertices)))])
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    lengths = np.maximum(lengths, 1e-9)  # an edge of length 0 would not be stored
    both = np.concatenate([edges, edges[:, ::-1]])
    return csr_matrix((np.tile(lengths, 2), (both[:, 0], both[:, 1])), shape=(len(vertices),) * 2)


def _seeds(graph: csr_matrix, areas: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """First medoids by k-means++ (Arthur & Vassilvitskii 2007) with geodesic distances."""
    chosen = [int(rng.choice(len(areas), p=areas / areas.sum()))]
    nearest = dijkstra(graph, indices=chosen[0])
    for _ in range(count - 1):
        score = areas * nearest**2
        if score.sum() <= 0:
            break
        chosen.append(int(rng.choice(len(areas), p=score / score.sum())))
        nearest = np.minimum(nearest, dijkstra(graph, indices=chosen[-1], limit=float(nearest.max())))
    return np.array(chosen)


def _medoid(graph: csr_matrix, members: np.ndarray, points: np.ndarray, areas: np.ndarray) -> int:
    """The member nearest to the mean with the least area-weighted sum of squared geodesic distances to the others."""
    mean = np.average(points[members], axis=0, weights=areas[members])
    order = np.argsort(np.square(points[members] - mean).sum(axis=1), kind="stable")
    tried = order[:: max(1, len(order) // (4 * _MEDOIDS))][:_MEDOIDS]
    distances = dijkstra(graph[members][:, members], indices=tried)
    return int(members[tried[(distances**2 @ areas[members]).argmin()]])


def cluster_vertices(
    graph: csr_matrix, points: np.ndarray, areas: np.ndarray, count: int = 30, seed: int = 0, rounds: int = 12
) -> tuple[np.ndarray, np.ndarray]:
    """Lloyd's algorithm with geodesic distances and medoids.

    Args:
        graph: Lengths of the edges, one connected graph, shape (V, V).
        points: Positions, shape (V, 3).
        areas: Surface of each vertex, above 0, shape (V,).
        count: Clusters; no more than there are vertices.
        seed: Of the first medoids.
        rounds: Most rounds; it stops earlier where nothing changes.

    Returns:
        The cluster of each vertex (V,), each connected and none empty, and the medoids (K,).
    """
    medoids = _seeds(graph, areas, min(count, len(points)), np.random.default_rng(seed))
    for _ in range(rounds):
        label = _assigned(graph, medoids)
        order = np.argsort(label, kind="stable")
        groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
        moved = np.array([_medoid(graph, members, points, areas) for members in groups])
        if (moved == medoids).all():
            break
        medoids = moved
    return _assigned(graph, medoids), medoids


def _assigned(graph: csr_matrix, medoids: np.ndarray) -> np.ndarray:
    """Number of the medoid that is nearest to each vertex along the surface, shape (V,)."""
    _, _, source = dijkstra(graph, indices=medoids, min_only=True, return_predecessors=True)
    number = np.zeros(graph.shape[0], np.int64)
    number[medoids] = np.arange(len(medoids))
    return number[source]


def geodesic_clusters(vertices: np.ndarray, faces: np.ndarray, count: int = 30, seed: int = 0) -> np.ndarray:
    """Hard skinning weights of geodesic k-means clusters.

    Args:
        vertices: Positions [m], shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        count: Clusters.
        seed: Of the first medoids.

    Returns:
        One 1 a row, shape (V, count), float32.
    """
    mesh = clean_mesh(vertices, faces)
    areas = vertex_areas(mesh.vertices, mesh.faces) + 1e-12
    label, _ = cluster_vertices(geodesic_graph(mesh.vertices, mesh.faces), mesh.vertices, areas, count, seed)
    return np.eye(count, dtype=np.float32)[label[mesh.index]]


@dataclass(frozen=True, eq=False)
class Volume:
    """Signed distances to the surface at the points of a grid, above 0 inside.

    Args:
        depth: Shape (X, Y, Z).
        low: Position of the first grid point, shape (3,).
        step: Distance of grid points.
    """

    depth: np.ndarray
    low: np.ndarray
    step: float

    def at(self, points: np.ndarray) -> np.ndarray:
        """Depth at points, trilinear, shape [..., 3] -> [...]."""
        positions = ((np.asarray(points) - self.low) / self.step).reshape(-1, 3).T
        out: np.ndarray = map_coordinates(self.depth, positions, order=1, mode="nearest")
        return out.reshape(np.asarray(points).shape[:-1])

    def shallowest(self, start: np.ndarray, end: np.ndarray, samples: int = 8) -> np.ndarray:
        """Least depth along straight lines, ends left out, shapes [..., 3] x 2 -> [...]."""
        least = np.full(np.broadcast_shapes(start.shape, end.shape)[:-1], np.inf)
        for share in (np.arange(samples) + 1) / (samples + 1):
            least = np.minimum(least, self.at(start + share * (end - start)))
        return least

    def points(self) -> np.ndarray:
        """Positions of the grid points, shape (X, Y, Z, 3)."""
        axes = [low + self.step * np.arange(count) for low, count in zip(self.low, self.depth.shape, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def surface_samples(vertices: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """Points spread over a surface by area, always the same ones, shape (about count, 3)."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    ends = np.cumsum(area)
    face = np.searchsorted(ends, (np.arange(count) + 0.5) / count * ends[-1]).clip(max=len(faces) - 1)
    u, v = np.random.default_rng(0).random((2, count, 1))
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    return np.asarray(a[face] + u * (b - a)[face] + v * (c - a)[face])


def volume_of(vertices: np.ndarray, faces: np.ndarray, cells: int = 56) -> Volume:
    """The volume of a mesh; loose parts that overlap count as one, and holes are closed by their winding numbers.

    Args:
        vertices: Positions, shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        cells: Grid cells along the largest extent.
    """
    import igl

    low, high = vertices.min(axis=0), vertices.max(axis=0)
    step = float((high - low).max()) / cells
    low = low - 2 * step
    shape = np.ceil((high - low) / step).astype(int) + 3
    grid = Volume(np.zeros(shape), low, step)
    points = grid.points().reshape(-1, 3)
    soup = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int64)
    winding = np.asarray(igl.fast_winding_number(*soup, points)).reshape(-1)
    near = np.concatenate([surface_samples(vertices, faces, 30_000), vertices])
    distance, _ = cKDTree(near).query(points)
    return Volume(np.where(winding > 0.5, distance, -distance).reshape(shape), low, step)


_LENGTH, _DIRECTION, _OUTSIDE, _DEPTH, _SIDE = 1.0, 0.5, 6.0, 0.4, 1.0
_ENDS = {"head": "top", "left_wrist": "tip", "right_wrist": "tip", "left_foot": "tip", "right_foot": "tip"}


@dataclass(frozen=True, eq=False)
class Template:
    """A skeleton to embed, in units of its height, standing on y = 0 and facing +Z.

    Args:
        points: Joints and the ends of the limbs, parents before children, shape (P, 3).
        parents: Shape (P,), -1 for the root.
        sides: +1 left, -1 right, 0 in the middle, shape (P,).
        joints: How many of the points, the first ones, are joints.
        lean: Share of the height by which a middle point may be off the middle, or a limb's over it, at a cost of 1.
    """

    points: np.ndarray
    parents: np.ndarray
    sides: np.ndarray
    joints: int
    lean: float = 0.1


@dataclass(frozen=True, eq=False)
class EmbeddedSkeleton:
    """A template inside a mesh.

    Args:
        points: Where the template's points are, shape (P, 3).
        parents: Shape (P,).
        joints: How many of the points are joints; the others are ends of limbs.
        cost: What the placement costs.
    """

    points: np.ndarray
    parents: np.ndarray
    joints: int
    cost: float

    def bones(self) -> list[tuple[int, int]]:
        """Each bone as (joint that moves it, point at its other end)."""
        return [(int(parent), point) for point, parent in enumerate(self.parents) if parent >= 0]


@lru_cache(maxsize=1)
def human_template() -> Template:
    """The reference body's 22 joints, and the top of its head, its finger tips and its toes."""
    body = reference_body()
    height = float(np.ptp(body.vertices[:, 1]))
    points, parents = list(body.joints), list(JOINT_PARENTS)
    for name in _ENDS:
        joint = JOINT_NAMES.index(name)
        own = body.vertices[body.joint_weights[:, joint] > 0.5]
        axis = body.joints[joint] - body.joints[JOINT_PARENTS[joint]]
        axis = (
            np.array([0, 1.0, 0])
            if name == "head"
            else np.array([0, 0, 1.0])
            if name.endswith("foot")
            else axis / np.linalg.norm(axis)
        )
        reach = float(((own - body.joints[joint]) @ axis).max())
        points.append(body.joints[joint] + 0.9 * reach * axis)
        parents.append(joint)
    names = [*JOINT_NAMES, *_ENDS]
    sides = np.array([1 if name.startswith("left") else -1 if name.startswith("right") else 0 for name in names])
    floor = body.vertices[:, 1].min()
    return Template((np.array(points) - [0, floor, 0]) / height, np.array(parents), sides, len(JOINT_NAMES))


def sphere_centres(volume: Volume, most: int = 350) -> tuple[np.ndarray, np.ndarray]:
    """Centres of spheres that fill a volume, the largest first, none of whose centres is inside a larger one.

    Args:
        volume: The inside of the mesh.
        most: Most spheres.

    Returns:
        Centres (S, 3) and radii (S,). Sheets without an inside get the grid points that are nearest to them.
    """
    depth = volume.depth
    inside = depth > 0
    if inside.sum() < 8:
        inside = depth > np.partition(depth.ravel(), -200)[-min(200, depth.size)]
    # On the medial surface the depth does not grow at full slope in any direction.
    slope = np.linalg.norm(np.stack(np.gradient(depth, volume.step)), axis=0)
    medial = inside & ((slope < 0.8) | (depth < 1.5 * volume.step))
    chosen = medial if medial.sum() >= 8 else inside
    points, radii = volume.points()[chosen], np.maximum(depth[chosen], 0.5 * volume.step)
    order = np.argsort(-radii, kind="stable")
    points, radii = points[order], radii[order]
    free = np.ones(len(points), bool)
    centres = []
    for number in range(len(points)):
        if not free[number]:
            continue
        centres.append(number)
        if len(centres) == most:
            break
        free &= np.square(points - points[number]).sum(axis=1) > radii[number] ** 2
    return points[centres], radii[centres]


def _joint_costs(template: Template, points: np.ndarray, radii: np.ndarray, middle: float, size: float) -> np.ndarray:
    """Cost of each candidate for each point of the template, shape (P, S)."""
    off = (points[:, 0] - middle) / size
    shallow = 1 / (1 + radii / (0.03 * size))
    out = np.empty((len(template.points), len(points)))
    for point, side in enumerate(template.sides):
        away = np.abs(off) if side == 0 else np.maximum(-side * off, 0)
        out[point] = _SIDE * (away / template.lean) ** 2 + _DEPTH * shallow
    return out


def _bone_costs(start: np.ndarray, end: np.ndarray, wanted: np.ndarray, size: float) -> np.ndarray:
    """Cost of the length and the direction of bones from starts to ends, shapes [..., 3] x 2 -> [...]."""
    bone = end - start
    length = np.sqrt(np.square(bone).sum(-1) + 1e-12)
    want = float(np.linalg.norm(wanted))
    stretch = np.log((length + 0.03 * size) / (want + 0.03 * size)) ** 2
    turn = 1 - (bone @ (wanted / want)) / length
    share = want / size + 0.05  # long bones count for more
    return np.asarray(_LENGTH * stretch + _DIRECTION * turn * (1 + turn) * share / 0.1)


def _outside_costs(start: np.ndarray, end: np.ndarray, volume: Volume, size: float) -> np.ndarray:
    """Cost of bones that leave the mesh, shapes [..., 3] x 2 -> [...]."""
    return np.asarray(_OUTSIDE * np.maximum(-volume.shallowest(start, end) - 0.5 * volume.step, 0) / size / 0.02)


def embed_skeleton(template: Template, volume: Volume, low: np.ndarray, high: np.ndarray) -> EmbeddedSkeleton:
    """Place a template inside a volume at the least cost.

    Args:
        template: The skeleton.
        volume: The inside of the mesh.
        low, high: Corners of the mesh's bounding box, shape (3,).
    """
    size = float(high[1] - low[1]) or float((high - low).max())
    points, radii = sphere_centres(volume)
    costs = _joint_costs(template, points, radii, float(low[0] + high[0]) / 2, size)
    count = len(template.points)
    outside = _outside_costs(points[:, None], points[None], volume, size)
    best = np.zeros((count, len(points)), np.int64)  # where each point goes, for each place of its parent
    for point in range(count - 1, 0, -1):
        parent = int(template.parents[point])
        bones = _bone_costs(
            points[:, None], points[None], (template.points[point] - template.points[parent]) * size, size
        )
        total = bones + outside + costs[point]
        best[point] = total.argmin(axis=1)
        costs[parent] += total.min(axis=1)
    index = np.zeros(count, np.int64)
    index[0] = costs[0].argmin()
    for point in range(1, count):
        index[point] = best[point, index[template.parents[point]]]
    found = _refined(template, points[index], volume, low, high, size)
    return EmbeddedSkeleton(found, template.parents, template.joints, float(costs[0].min()))


def _refined(
    template: Template, points: np.ndarray, volume: Volume, low: np.ndarray, high: np.ndarray, size: float,
    rounds: int = 6,
) -> np.ndarray:  # fmt: skip
    """Joints moved by shrinking steps wherever that lowers the cost of what they touch."""
    points = points.copy()
    middle = float(low[0] + high[0]) / 2
    children = [np.flatnonzero(template.parents == point) for point in range(len(points))]
    offsets = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    for turn in range(rounds):
        step = 1.5 * volume.step * 0.7**turn
        for point, parent in enumerate(template.parents):
            tried = points[point] + step * offsets
            unary = template.__class__(
                template.points[[point]], template.parents[[point]], template.sides[[point]], 1, template.lean
            )
            cost = _joint_costs(unary, tried, np.maximum(volume.at(tried), 0), middle, size)[0]
            if parent >= 0:
                cost += _bone_costs(
                    points[parent], tried, (template.points[point] - template.points[parent]) * size, size
                )
                cost += _outside_costs(points[parent], tried, volume, size)
            for child in children[point]:
                cost += _bone_costs(
                    tried, points[child], (template.points[child] - template.points[point]) * size, size
                )
                cost += _outside_costs(tried, points[child], volume, size)
            points[point] = tried[cost.argmin()]
    return points


def embedded_human(vertices: np.ndarray, faces: np.ndarray) -> tuple[EmbeddedSkeleton, Volume]:
    """The human skeleton inside a mesh that stands up and faces +Z, and the volume it was found in.

    Args:
        vertices: Positions, shape (V, 3).
        faces: Vertex indices, shape (F, 3).
    """
    volume = volume_of(vertices, faces)
    return embed_skeleton(human_template(), volume, vertices.min(axis=0), vertices.max(axis=0)), volume


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
    vertices: np.ndarray, faces: np.ndarray, starts: np.ndarray, ends: np.ndarray, owners: Sequence[int] | np.ndarray,
    volume: Volume | None = None,
) -> np.ndarray:  # fmt: skip
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

    mesh = clean_mesh(vertices, faces)
    skeleton, volume = embedded_human(mesh.vertices, mesh.faces)
    owners, tips = np.array(skeleton.bones()).T
    weights = bone_heat(mesh.vertices, mesh.faces, skeleton.points[owners], skeleton.points[tips], owners, volume)
    out = np.zeros((len(mesh.vertices), skeleton.joints), np.float32)
    out[:, : weights.shape[1]] = weights
    return out[mesh.index]
