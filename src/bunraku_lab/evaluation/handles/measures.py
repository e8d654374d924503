"""What handles are measured by, for one character: registration, other resolutions, and stretched edges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.graph import clean_mesh, unique_edges
from bunraku.core.geometry.surface import split_estimate, split_long_edges
from bunraku.core.motion import HandleMotion, handle_offsets
from bunraku.core.skinning import part_means, register, skin

_LIGHT = 1e-3  # weight under which a vertex has no say in a part, by definition


def refine_registration(
    source: np.ndarray, targets: np.ndarray, weights: np.ndarray, transforms: np.ndarray, fixed: tuple[int, ...] = (),
    sweeps: int = 6,
) -> np.ndarray:  # fmt: skip
    """Improve the motions of parts so that their blend comes closer to the targets, in the sense of least squares.

    Args:
        source: Rest vertices x [m], shape (V, 3).
        targets: Moved vertices of each frame [m], shape (N, V, 3).
        weights: Skinning weights, rows sum to 1, shape (V, K).
        transforms: Affine motions `[R | o]` to start from, x going to `sum_k w_k (R_k x + o_k)`, shape (N, K, 3, 4).
        fixed: Parts whose motion stays.
        sweeps: How often each part is fitted.

    Returns:
        The motions, shape (N, K, 3, 4), float64; the sum of squared distances is no larger than before.
    """
    source, weights = np.asarray(source, np.float64), np.asarray(weights, np.float64)
    out = np.array(transforms, np.float64)
    homogeneous = np.concatenate([source, np.ones((len(source), 1))], axis=1)
    left = np.asarray(targets, np.float64) - np.einsum("vk,nkij,vj->nvi", weights, out, homogeneous, optimize=True)
    parts = [k for k in range(weights.shape[1]) if k not in fixed]
    own = {k: np.flatnonzero(weights[:, k] > _LIGHT) for k in parts}
    for _ in range(sweeps):
        for k in parts:
            rows = own[k]
            if len(rows) < 3:
                continue
            w, x = weights[rows, k], source[rows]
            wanted = left[:, rows] + w[:, None] * np.einsum(
                "nij,vj->nvi", out[:, k], homogeneous[rows]
            )  # w (R x + o), ideally
            square = w * w / (w @ w)
            centre, goal = square @ x, (w / (w @ w)) @ wanted  # (3,), (N, 3)
            covariance = np.einsum("v,nvi,vj->nij", w, wanted - w[:, None] * goal[:, None], x - centre)
            spread = float(np.einsum("v,vj,vj->", square, x - centre, x - centre)) * (w @ w)
            if spread <= 0:
                continue
            u, _, vt = np.linalg.svd(covariance + 1e-8 * spread * out[:, k, :, :3])
            u[..., 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[:, None]
            turn = u @ vt
            out[:, k, :, :3], out[:, k, :, 3] = turn, goal - turn @ centre
            left[:, rows] = wanted - w[:, None] * np.einsum("nij,vj->nvi", out[:, k], homogeneous[rows])
    return out


def _sides(name: str, *parts: str) -> dict[str, tuple[str, ...]]:
    return {f"{side}_{name}": tuple(f"{side}_{part}" for part in parts) for side in ("left", "right")}


NAMED_PARTS: dict[str, tuple[str, ...]] = {
    "head": ("head",), **_sides("hand", "wrist", "fingers"), **_sides("forearm", "elbow"), **_sides("upper_arm",
    "shoulder"),
    "chest": ("spine2", "spine3"), "hips": ("pelvis",), **_sides("thigh", "hip"), **_sides("shin", "knee"),
    **_sides("foot", "ankle", "foot"),
}  # fmt: skip
"""The parts of a humanoid that people name, and the handles whose bones make each up."""


def main_handles(weights: np.ndarray) -> np.ndarray:
    """The handle with the largest weight on each vertex, shape (V, K) -> (V,)."""
    return weights.argmax(axis=1)


def root_error(handle: np.ndarray, root: np.ndarray, height: float) -> float:
    """Distance between the first handle and the rig's root joint, over the height.

    Args:
        handle: h_0 [m], shape (3,).
        root: The root joint b_1 of Eq. 4: the mean of the pelvis joints that move something [m], shape (3,).
        height: Of the character [m].
    """
    return float(np.linalg.norm(np.asarray(handle, float) - root) / height)


def part_purity(main: np.ndarray, weights: np.ndarray, sure: float = 0.9) -> float | None:
    """Share of the vertices of the rig's parts whose main handle is the one that most of their part have.

    A vertex is of a joint's part where the joint has more than `sure` of it. Each vertex counts the same.

    Args:
        main: Main handle of each vertex, shape (V,).
        weights: The rig's weights, shape (V, J).

    Returns:
        The share, or None where no vertex is surely of one part.
    """
    most = weights.argmax(axis=1)
    of_part = weights.max(axis=1) > sure
    if not of_part.any():
        return None
    counts = np.zeros((weights.shape[1], int(main.max()) + 1), np.int64)
    np.add.at(counts, (most[of_part], main[of_part]), 1)
    return float(counts.max(axis=1).sum() / of_part.sum())


def part_handles(
    weights: np.ndarray, areas: np.ndarray, target: np.ndarray, parts: Mapping[str, Sequence[str]] = NAMED_PARTS
) -> dict[str, int]:
    """The main handle of each named part: the one with the most weight, by area, on the part's vertices.

    A part's vertices are those of which its bones have more than half. Parts without vertices are left out.

    Args:
        weights: Of the handles that are measured, shape (V, K).
        areas: Surface of each vertex, shape (V,).
        target: What the rig's named bones have of each vertex, added up by handle, shape (V, 30).
    """
    out = {}
    for name, handles in parts.items():
        members = _members(target, handles)
        mass = areas[members] @ weights[members]
        if mass.sum() > 0:
            out[name] = int(mass.argmax())
    return out


def _members(target: np.ndarray, handles: Sequence[str]) -> np.ndarray:
    columns = [HANDLE_NAMES.index(handle) for handle in handles]
    return np.flatnonzero(target[:, columns].sum(axis=1) > 0.5)


def accepted_handles(weights: np.ndarray, areas: np.ndarray, target: np.ndarray) -> dict[str, set[int]]:
    """The handles that mean each named part on the reference body, where the same predictor looks at it.

    That is the part's main handle there. Rigs make a chest, a hand or a foot of one bone or of two, and each of these
    parts is two handles on the reference body (the lower and the upper chest, the palm and the fingers, the foot and
    the toes): for them, the main handle of either half means the part too.

    Args:
        weights: Of the predictor on the reference body, shape (V, K).
        areas: Surface of each vertex, shape (V,).
        target: The canonical weights, shape (V, 30).
    """
    out = {name: {handle} for name, handle in part_handles(weights, areas, target).items()}
    for name in out:
        halves = {half: (half,) for half in NAMED_PARTS[name]}
        out[name] |= set(part_handles(weights, areas, target, halves).values())
    return out


def part_meaning(
    weights: np.ndarray, areas: np.ndarray, target: np.ndarray, accepted: Mapping[str, set[int]]
) -> tuple[dict[str, bool], float | None]:
    """Whether the main handle of each named part is one that means it on the reference body.

    Args:
        weights, areas, target: As in `part_handles`.
        accepted: From `accepted_handles`.

    Returns:
        For each named part that the character has; and the share of its vertices whose own main handle is right,
        averaged over the parts, which is the stricter measure (None where it has no named part).
    """
    found = part_handles(weights, areas, target)
    main = main_handles(weights)
    right = {name: handle in accepted.get(name, set()) for name, handle in found.items()}
    shares = [
        float(np.isin(main[_members(target, NAMED_PARTS[name])], list(accepted.get(name, set()))).mean())
        for name in found
    ]
    return right, float(np.mean(shares)) if shares else None


def drive(
    rest: np.ndarray, posed: np.ndarray, weights: np.ndarray, rooted: bool = True, together: bool = False
) -> np.ndarray:
    """How handles follow a moving mesh: Eq. 3 without its global items, as in the Pose Loss (Eq. 14).

    Args:
        rest: Vertices [m], shape (V, 3).
        posed: The same in poses in which the root rests [m], shape (N, V, 3).
        weights: Skinning weights, shape (V, K).
        rooted: Handle 0 is the root and keeps the identity. Baselines have no root; all their parts are free to move.
        together: Fit the handles' motions to one another too (`refine_registration`), which Eq. 14 does not.

    Returns:
        Vertices [m], shape (N, V, 3), float32.
    """
    rotations, translations = register(rest, posed, weights)
    handles = part_means(rest, weights)
    if rooted:
        rotations[:, 0], translations[:, 0] = np.eye(3), 0
    offset = handle_offsets(handles, translations, rotations)
    transforms = np.concatenate([rotations, offset[..., None]], axis=-1)
    if together:
        transforms = refine_registration(rest, posed, weights, transforms, fixed=(0,) if rooted else ())
    return skin(rest, weights, transforms)


def pose_error(
    rest: np.ndarray, posed: np.ndarray, weights: np.ndarray, height: float, rooted: bool = True, together: bool = False
) -> float:
    """Mean distance between a posed mesh and what the handles make of it (`drive`), over the height."""
    return float(np.linalg.norm(drive(rest, posed, weights, rooted, together) - posed, axis=-1).mean() / height)


def weight_difference(first: np.ndarray, second: np.ndarray) -> float:
    """Mean over points of the L1 difference `sum_k |a_k - b_k|` of their weights, 0 to 2; shapes (P, K), (P, K)."""
    return float(np.abs(np.asarray(first, float) - second).sum(axis=1).mean())


def same_main_handle(first: np.ndarray, second: np.ndarray) -> float:
    """Share of vertices whose main handle is the same in two sets of weights; shapes (V, K), (V, K)."""
    return float((main_handles(first) == main_handles(second)).mean())


def truncation_error(
    vertices: np.ndarray, full: np.ndarray, cut: np.ndarray, transforms: np.ndarray, height: float
) -> float:
    """Mean distance between a mesh that plays with all its weights and with fewer, over the height.

    Args:
        vertices: Rest vertices [m], shape (V, 3).
        full, cut: The two sets of weights, shape (V, K).
        transforms: Of each handle in each frame, shape (N, K, 3, 4).
    """
    # Skinning is linear in the weights and these differ by rows that sum to 0, so one product gives the difference
    # itself.
    gap = skin(vertices, full - cut, transforms)
    return float(np.linalg.norm(gap, axis=-1).mean() / height)


def resampled(character: Character, count: int) -> Character:
    """A character with about `count` vertices: welded, then simplified by edge collapses, or long edges halved.

    Args:
        character: Any mesh.
        count: Vertices that the result should have. Loose parts may leave it with more.
    """
    clean = clean_mesh(character.vertices, character.faces)
    vertices, faces = clean.vertices, clean.faces
    if len(vertices) > count:
        vertices, faces = _fewer(vertices, faces, count)
    if len(vertices) < 0.9 * count:
        vertices, faces = _more(vertices, faces, count)
    return Character(character.name, vertices * clean.scale + clean.center, faces)


def _fewer(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    import fast_simplification

    target = int(len(faces) * count / len(vertices))
    points, triangles = vertices.astype(np.float32), faces.astype(np.int32)
    for _ in range(3):
        points, triangles = fast_simplification.simplify(points, triangles, target_count=max(target, 4))
        used = np.unique(triangles)
        if len(used) <= 1.05 * count:
            break
        target = int(target * count / len(used))
    back = np.zeros(len(points), np.int64)
    back[used] = np.arange(len(used))
    return points[used].astype(np.float64), back[triangles]


def _more(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    def grown(length: float) -> float:
        return len(vertices) + split_estimate(vertices, faces, length) / 2

    low, high = 1e-4, 2.0  # of the largest extent: a length that makes too many, one that makes too few
    points, triangles = vertices, faces
    for _ in range(4):  # the estimate is off by a constant factor, which the second bisection takes out
        factor = len(points) / grown(high) if len(points) > len(vertices) else 1.0
        least, most = low, 2.0
        for _ in range(40):
            middle = float(np.sqrt(least * most))
            least, most = (middle, most) if factor * grown(middle) > count else (least, middle)
        high = most
        points, triangles, _ = split_long_edges(vertices, faces, high, max_faces=4 * count)
        if 0.95 * count <= len(points) <= 1.1 * count:
            break
    return points, triangles


def carried(values: np.ndarray, vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values of a mesh's vertices at the points of its surface that are closest to given ones.

    Args:
        values: Shape (V, C).
        vertices: Positions [m], shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        points: Positions near the surface [m], shape (P, 3).

    Returns:
        Barycentric means, shape (P, C), float64.
    """
    import igl

    vertices = np.ascontiguousarray(vertices, np.float64)
    faces = np.ascontiguousarray(faces, np.int64)
    _, face, nearest = igl.point_mesh_squared_distance(np.ascontiguousarray(points, np.float64), vertices, faces)
    face = np.asarray(face).reshape(-1)
    a, b, c = (vertices[faces[face, corner]] for corner in range(3))
    u, v, p = b - a, c - a, nearest - a
    uu, uv, vv, pu, pv = ((x * y).sum(axis=1) for x, y in ((u, u), (u, v), (v, v), (p, u), (p, v)))
    determinant = uu * vv - uv * uv
    flat = determinant <= 1e-12 * uu * vv
    s = np.where(flat, 0, (vv * pu - uv * pv) / np.where(flat, 1, determinant))
    t = np.where(flat, 0, (uu * pv - uv * pu) / np.where(flat, 1, determinant))
    shares = np.clip(np.stack([1 - s - t, s, t], axis=1), 0, 1)
    shares /= shares.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("pi,pic->pc", shares, np.asarray(values, np.float64)[faces[face]]))


STRETCHED, FAR = 2.0, 4.0
"""Lengths, over those at rest, from which on an edge is stretched, and torn."""
STRIDE = 3  # frames from one that is measured to the next
SHORT = 1e-3  # edges shorter than this share of the height are not seen, by definition
CHUNK = 16  # frames posed at once: bounds memory


def edge_stretch(rest: np.ndarray, posed: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """The largest length of each edge over all poses, over its length at rest, shape (E,).

    Args:
        rest: Vertices [m], shape (V, 3).
        posed: The same in each pose [m], shape (N, V, 3).
        edges: Pairs of vertices, shape (E, 2).
    """
    first, second = edges.T
    length = np.maximum(np.linalg.norm(rest[first] - rest[second], axis=1), 1e-12)
    return np.asarray(np.linalg.norm(posed[:, first] - posed[:, second], axis=-1).max(axis=0) / length)


def stretch_of(character: Character, handles: Handles, motion: HandleMotion) -> dict[str, float]:
    """How far the edges of a character are stretched in a motion of its handles.

    Returns:
        `stretched_edges`: the share of the edges that are ever longer than `STRETCHED` times their length;
        `most_stretched`: the largest such ratio.
    """
    edges = unique_edges(character.faces, len(character.vertices))
    rest = character.vertices.astype(np.float64)
    lengths = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    edges = edges[lengths > SHORT * character.height]
    transforms = motion.transforms(handles.positions)[::STRIDE]
    most = np.ones(len(edges))
    for start in range(0, len(transforms), CHUNK):
        posed = skin(character.vertices, handles.weights, transforms[start : start + CHUNK])
        most = np.maximum(most, edge_stretch(rest, posed, edges))
    return {
        "stretched_edges": float((most > STRETCHED).mean()) if len(most) else 0.0,
        "most_stretched": float(most.max(initial=1.0)),
    }
