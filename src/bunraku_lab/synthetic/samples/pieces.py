"""Pieces of sample characters: meshes with crisp borders between colours, skeletons with weights, and faces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.core.character import Character, Rig, top_influences
from bunraku_lab.synthetic.fields import Field, field_mesh, neighbour_average
from bunraku_lab.synthetic.surfaces import ball_mesh, tube_mesh

__all__ = [
    "Bones", "Paint", "Piece", "Region", "assemble", "both", "bump", "button", "clay", "either", "eye", "mirror_bones",
    "mirror_piece", "onto_surface", "paint_mesh", "rgb", "slab", "solid", "stroke",
]  # fmt: skip

Region = Callable[[np.ndarray], np.ndarray]
Project = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Paint:
    """A colour for the part of a surface where `region` is positive.

    Args:
        color: sRGB as "#rrggbb".
        region: Maps points (M, 3) to about the depth inside the region [m], shape (M,).
    """

    color: str
    region: Region


def rgb(color: str) -> tuple[int, int, int]:
    """The three bytes of "#rrggbb"."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def slab(
    axis: int, low: float = -np.inf, high: float = np.inf, *, both_sides: bool = False,
    tilt: Sequence[float] = (0, 0, 0),
) -> Region:  # fmt: skip
    """Points between two values of a coordinate [m], or of its absolute value; `tilt` leans the planes."""
    lean = np.asarray(tilt, float)

    def region(points: np.ndarray) -> np.ndarray:
        value = np.abs(points[:, axis]) if both_sides else points[:, axis]
        value = value + points @ lean
        return np.minimum(np.minimum(value - low, high - value), 10.0)

    return region


def bump(centre: Sequence[float] | np.ndarray, radii: float | Sequence[float], *, both_sides: bool = False) -> Region:
    """Points in an ellipsoid; `both_sides` also in its mirror image."""
    middle, size = np.asarray(centre, float), np.broadcast_to(np.asarray(radii, float), (3,))

    def region(points: np.ndarray) -> np.ndarray:
        at = np.abs(points) * [1, 0, 0] + points * [0, 1, 1] if both_sides else points
        return (1 - np.linalg.norm((at - middle) / size, axis=1)) * float(size.min())

    return region


def both(*regions: Region) -> Region:
    """Points in every region."""
    return lambda points: np.min([region(points) for region in regions], axis=0)


def either(*regions: Region) -> Region:
    """Points in any region."""
    return lambda points: np.max([region(points) for region in regions], axis=0)


def paint_mesh(
    vertices: np.ndarray, faces: np.ndarray, base: str, paints: Sequence[Paint], project: Project | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut a mesh along the borders of its paints and colour it; later paints cover earlier ones.

    Vertices on a border are doubled, one for each colour, as in files from artists: welded, the mesh is closed.

    Args:
        vertices: Positions [m], shape (V, 3).
        faces: Triangles, shape (F, 3).
        base: Colour where no paint is.
        paints: The paints.
        project: Pulls points (M, 3) back onto the surface.

    Returns:
        Vertices (V', 3), faces (F', 3) and colours (V', 3) uint8.
    """
    for paint in paints:
        vertices, faces = _cut(vertices, faces, paint.region, project)
    palette = [base, *(paint.color for paint in paints)]
    centres = vertices[faces].mean(axis=1)
    color = np.zeros(len(faces), np.int64)
    for index, paint in enumerate(paints):
        color[paint.region(centres) > 0] = index + 1
    names = {c: i for i, c in enumerate(dict.fromkeys(palette))}
    color = np.array([names[c] for c in palette])[color]
    bytes_of = np.array([rgb(c) for c in names], np.uint8)
    pairs, faces = np.unique(faces * len(names) + color[:, None], return_inverse=True)
    return vertices[pairs // len(names)], faces.reshape(-1, 3), bytes_of[pairs % len(names)]


def _cut(
    vertices: np.ndarray, faces: np.ndarray, region: Region, project: Project | None
) -> tuple[np.ndarray, np.ndarray]:
    """Insert the border of a region into the mesh as edges."""
    value = region(vertices)
    sign = np.sign(value)
    crossed = (sign[faces].min(axis=1) < 0) & (sign[faces].max(axis=1) > 0)
    if not crossed.any():
        return vertices, faces
    vertices, zero = _snap(vertices, faces, crossed, region, value, project)
    value = np.where(zero, 0.0, region(vertices))
    value = np.where(~zero & (value == 0), 1e-9, value)
    sign = np.sign(value)
    crossed = (sign[faces].min(axis=1) < 0) & (sign[faces].max(axis=1) > 0)
    cut, keep = faces[crossed], faces[~crossed]
    edges = np.sort(np.concatenate([cut[:, [0, 1]], cut[:, [1, 2]], cut[:, [2, 0]]]), axis=1)
    edges = np.unique(edges[sign[edges[:, 0]] * sign[edges[:, 1]] < 0], axis=0)
    share = value[edges[:, 0]] / (value[edges[:, 0]] - value[edges[:, 1]])
    new = vertices[edges[:, 0]] + share[:, None] * (vertices[edges[:, 1]] - vertices[edges[:, 0]])
    index = {(int(a), int(b)): len(vertices) + i for i, (a, b) in enumerate(edges)}
    at = lambda a, b: index[(min(a, b), max(a, b))]  # noqa: E731
    out = []
    for face in cut.tolist():
        signs = [int(sign[v]) for v in face]
        # turn the face until its lone vertex, or its vertex on the border, is first
        first = (
            signs.index(0)
            if 0 in signs
            else next(i for i in range(3) if signs[i] != signs[i - 1] and signs[i] != signs[i - 2])
        )
        a, b, c = face[first], face[first - 2], face[first - 1]
        if 0 in signs:
            m = at(b, c)
            out += [(a, b, m), (a, m, c)]
        else:
            m, n = at(a, b), at(c, a)
            out += [(a, m, n), (m, b, c), (m, c, n)]
    return np.concatenate([vertices, new if project is None else project(new)]), np.concatenate(
        [keep, np.array(out, np.int64).reshape(-1, 3)]
    )


def _snap(vertices: np.ndarray, faces: np.ndarray, crossed: np.ndarray, region: Region, value: np.ndarray,
          project: Project | None) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Move the vertices that are nearly on the border onto it, so that the cut leaves no slivers."""
    ring = np.unique(faces[crossed])
    ends = np.concatenate([faces[crossed][:, [0, 1]], faces[crossed][:, [1, 2]], faces[crossed][:, [2, 0]]])
    length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    shortest = np.full(len(vertices), np.inf)
    np.minimum.at(shortest, ends.ravel(), np.repeat(length, 2))
    points = vertices[ring].copy()
    for _ in range(3):
        level = region(points)
        slope = np.stack(
            [(region(points + 1e-4 * axis) - region(points - 1e-4 * axis)) / 2e-4 for axis in np.eye(3)], axis=1
        )
        points = points - (level / np.maximum((slope * slope).sum(axis=1), 1e-2))[:, None] * slope
        if project is not None:
            points = project(points)
    moved = np.linalg.norm(points - vertices[ring], axis=1)
    good = (moved < 0.35 * shortest[ring]) & (np.abs(region(points)) < 0.03 * shortest[ring])
    out, zero = vertices.copy(), np.zeros(len(vertices), bool)
    out[ring[good]] = points[good]
    zero[ring[good]] = True
    return out, zero


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
    """Skin weights: a joint counts by the distance of its lumps, on its own lumps and its neighbours' only."""
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


def onto_surface(field: Field, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest points on a surface, found by Newton's method.

    Args:
        field: The shape.
        points: Points near its surface [m], shape (M, 3).

    Returns:
        Positions on the surface [m], shape (M, 3), and outward unit normals, shape (M, 3).
    """
    points = np.array(points, float)
    for _ in range(6):
        slope = field.gradient(points)
        points -= (field.values(points) / np.maximum((slope * slope).sum(axis=1), 0.05))[:, None] * slope
    slope = field.gradient(points)
    return points, slope / np.linalg.norm(slope, axis=1, keepdims=True)


def button(field: Field, position: Sequence[float] | np.ndarray, radii: Sequence[float], color: str, joint: str, *,
           lift: float = 0.0, level: int = 2) -> Piece:  # fmt: skip
    """An ellipsoid half sunk into the surface: radii are its half width, half height and depth along the normal [m]."""
    centre, normal = onto_surface(field, np.array([position]))
    side = np.cross([0.0, 1.0, 0.0], normal[0])
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(normal[0], side), normal[0]], axis=1)
    return solid(ball_mesh(centre[0] + lift * normal[0], radii, level, turn), color, joint)


def eye(
    field: Field, position: Sequence[float], size: tuple[float, float], color: str, joint: str, white: str | None = None
) -> list[Piece]:
    """An eye with a glint, and with its white where a colour is given; `size` is half width and half height [m]."""
    width, height = size
    pieces, lift = [], 0.0
    if white is not None:
        pieces.append(button(field, position, (1.7 * width, 1.4 * height, 0.8 * width), white, joint))
        lift = 0.45 * width
    pieces.append(button(field, position, (width, height, 0.55 * width), color, joint, lift=lift))
    glint = np.add(position, (0.13 * width, 0.38 * height, 0.0))
    pieces.append(button(
        field, glint, (0.33 * width, 0.28 * height, 0.2 * width), "#ffffff", joint, lift=lift + 0.46 * width, level=1,
    ))  # fmt: skip
    return pieces


def stroke(field: Field, curve: np.ndarray, radii: np.ndarray | Sequence[float], color: str, joint: str) -> Piece:
    """A line drawn on the surface as a thin tube, along points near it [m], shape (P, 3)."""
    positions, normals = onto_surface(field, curve)
    return solid(tube_mesh(positions + 0.25 * np.max(radii) * normals, radii, 6), color, joint)
