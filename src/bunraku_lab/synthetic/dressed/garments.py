"""Garments of dressed characters: MakeHuman's clothes (`.mhclo`), and garments cut from the helper surfaces."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, JOINT_COUNT
from bunraku.core.files import path_inside, read_bounded
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.graph import mesh_parts, unique_edges
from bunraku.core.geometry.surface import vertex_normals
from bunraku.errors import CharacterError, FormatError
from bunraku.files import read_obj
from bunraku_lab.synthetic.makehuman import MakeHumanBody

MAX_TEXT = 64 << 20
"""Largest `.mhclo` or OBJ that is read [bytes]; the clothes of MakeHuman have 1 MiB."""

MAX_VERTICES = 500_000
"""Most vertices of a garment, and of the base mesh it is bound to."""

_AXES = ("x_scale", "y_scale", "z_scale")
_BROKEN = "the file is truncated or broken, download it again"


@dataclass(frozen=True, eq=False)
class Clothes:
    """A garment, a hat or hair, bound to the base mesh.

    Args:
        name: Its name, or that of its file.
        tags: What it was tagged with ("Female", "Hats", ...).
        faces: Triangles, shape (F, 3).
        base: Base vertices that each vertex follows, shape (V, 3).
        shares: Their weights, shape (V, 3); rows sum to 1, single weights may be negative.
        offsets: Offset from the weighted mean, in units of the base mesh (decimetres) before scaling, shape (V, 3).
        scale_vertices: Two base vertices for each axis, shape (3, 2); -1 where the file names none.
        scale_lengths: Their distance along the axis on the body that the clothes were made on, shape (3,).
        deleted: Base vertices that the garment hides, sorted, shape (D,).
    """

    name: str
    tags: tuple[str, ...]
    faces: np.ndarray
    base: np.ndarray
    shares: np.ndarray
    offsets: np.ndarray
    scale_vertices: np.ndarray
    scale_lengths: np.ndarray
    deleted: np.ndarray

    def __len__(self) -> int:
        return len(self.base)


def read_mhclo(path: str | Path) -> Clothes:
    """Read a `.mhclo` file and the OBJ that it names, which must lie in its folder or below.

    Raises:
        FormatError: A file is missing, too large or not understood, or the two do not fit.
    """
    path = Path(path)
    data = _text(path)
    lines = _Lines(path)
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        lines.take(number, line.split("#")[0].split())
    if not lines.rows:
        raise FormatError(
            path,
            "this binds no vertices (no lines after 'verts'); it is not a MakeHuman clothes file, or it is truncated",
        )
    obj = path_inside(path.parent, lines.obj)
    if obj is None:
        raise FormatError(
            path,
            f"its mesh {lines.obj[:80]!r} is no file in its folder; put the .obj beside it and name it in obj_file",
        )
    rows = np.array(lines.rows)
    faces = _faces(path, obj, len(rows))
    shares = rows[:, 3:6]
    total = shares.sum(axis=1, keepdims=True)
    if not (np.isfinite(rows).all() and (np.abs(total - 1) < 0.1).all()):
        raise FormatError(path, f"the weights of a vertex are not numbers that sum to 1; {_BROKEN}")
    return Clothes(
        lines.name or path.stem, tuple(lines.tags), faces, rows[:, :3].astype(np.int64), shares / total, rows[:, 6:],
        np.array([lines.scales[axis][0] for axis in _AXES]), np.array([lines.scales[axis][1] for axis in _AXES]),
        lines.deleted(),
    )  # fmt: skip


def fit(clothes: Clothes, base_vertices: np.ndarray, unit: float = 0.1) -> np.ndarray:
    """The clothes' vertices on a body.

    Args:
        clothes: From `read_mhclo`.
        base_vertices: All vertices of the base mesh in the shape of the body, helpers included, shape (B, 3).
        unit: The base mesh's unit in that of `base_vertices`, for axes without a scale reference; 0.1 for metres.

    Returns:
        Positions in the unit of `base_vertices`, shape (V, 3), float64.

    Raises:
        CharacterError: The body has fewer vertices than the clothes are bound to.
    """
    body = np.asarray(base_vertices, np.float64)
    most = max(int(clothes.base.max()), int(clothes.scale_vertices.max()))
    if most >= len(body):
        raise CharacterError(
            f"{clothes.name}: the clothes are bound to vertex {most} but the body has {len(body)}; give the whole "
            "base mesh"
        )
    first, second = body[clothes.scale_vertices[:, 0]], body[clothes.scale_vertices[:, 1]]
    scale = np.abs(np.diagonal(first - second)) / clothes.scale_lengths
    scale = np.where(clothes.scale_vertices[:, 0] >= 0, scale, unit)
    return np.asarray(np.einsum("vc,vca->va", clothes.shares, body[clothes.base]) + clothes.offsets * scale)


def fit_weights(clothes: Clothes, base_weights: np.ndarray) -> np.ndarray:
    """Skin weights of the base mesh at the clothes' vertices, shape (B, J) -> (V, J); not negative, rows sum to 1."""
    shares = np.maximum(clothes.shares, 0)
    out = np.einsum(
        "vc,vcj->vj", shares / shares.sum(axis=1, keepdims=True), np.asarray(base_weights, np.float64)[clothes.base]
    )
    return np.asarray(out / np.maximum(out.sum(axis=1, keepdims=True), 1e-12))


class _Lines:
    """What the lines of a `.mhclo` file say."""

    def __init__(self, path: Path):
        self.path = path
        self.name, self.obj = "", f"{path.stem}.obj"
        self.tags: list[str] = []
        self.rows: list[list[float]] = []
        self._spans: list[tuple[int, int]] = []
        self.scales: dict[str, tuple[tuple[int, int], float]] = dict.fromkeys(_AXES, ((-1, -1), 1.0))
        self._section = ""

    def take(self, number: int, words: list[str]) -> None:
        if not words:
            return
        key, rest = words[0], words[1:]
        if key[0].isdigit() or key[0] in "-+.":
            self._numbers(number, words)
            return
        if key in ("verts", "delete_verts"):  # other lines may stand between these and their numbers
            self._section = key
        if key == "name":
            self.name = " ".join(rest)[:200]
        elif key == "tag":
            self.tags.append(" ".join(rest)[:200])
        elif key == "obj_file":
            self.obj = " ".join(rest)
        elif key in self.scales:
            try:
                pair, length = (self._vertex(rest[0]), self._vertex(rest[1])), float(rest[2])
            except (ValueError, IndexError):
                raise self._error(number, f"{key} needs two vertices and a length") from None
            if not (math.isfinite(length) and length > 0):
                raise self._error(number, f"the length of {key} must be greater than 0")
            self.scales[key] = (pair, length)

    def _numbers(self, number: int, words: list[str]) -> None:
        try:
            if self._section == "verts":
                if len(self.rows) == MAX_VERTICES:
                    raise FormatError(
                        self.path, f"this binds more than {MAX_VERTICES} vertices; simplify the garment first"
                    )
                if len(words) == 1:
                    self.rows.append([self._vertex(words[0])] * 3 + [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
                elif len(words) in (6, 9):
                    self.rows.append(
                        [self._vertex(word) for word in words[:3]]
                        + [float(word) for word in words[3:]]
                        + [0.0] * (9 - len(words))
                    )
                else:
                    raise ValueError
            elif self._section == "delete_verts":
                self._delete(words)
        except ValueError:
            raise self._error(number, "the numbers cannot be understood") from None

    def _delete(self, words: list[str]) -> None:
        position = 0
        while position < len(words):
            first = last = self._vertex(words[position])
            position += 1
            if position + 1 < len(words) and words[position] == "-":
                last = self._vertex(words[position + 1])
                position += 2
            self._spans.append((first, last))

    def deleted(self) -> np.ndarray:
        """The vertices of all spans, sorted. Spans are added up, so that many long ones cost no more than a few."""
        change = np.zeros(MAX_VERTICES + 2, np.int64)
        for first, last in self._spans:
            if first <= last:
                change[first] += 1
                change[last + 1] -= 1
        return np.flatnonzero(np.cumsum(change) > 0)

    def _vertex(self, word: str) -> int:
        index = int(word)
        if not 0 <= index <= MAX_VERTICES:
            raise ValueError
        return index

    def _error(self, number: int, problem: str) -> FormatError:
        return FormatError(self.path, f"line {number}: {problem}; {_BROKEN}")


def _text(path: Path) -> bytes:
    data = read_bounded(path)
    if len(data) > MAX_TEXT:
        raise FormatError(
            path, f"{len(data) >> 20} MiB are too many for a garment, at most {MAX_TEXT >> 20} are read; check the file"
        )
    return data


def _faces(path: Path, obj: Path, count: int) -> np.ndarray:
    mesh = read_obj(obj, _text(obj))
    if len(mesh.vertices) != count:
        raise FormatError(
            path,
            f"{count} vertices are bound but {obj.name} has {len(mesh.vertices)}; the two files do not belong together",
        )
    return mesh.faces


_LEGS = [1, 2, 4, 5, 7, 8, 10, 11]
_HEAD, _TOP = HANDLE_NAMES.index("head"), HANDLE_NAMES.index("head_top")


@dataclass(frozen=True, eq=False)
class Piece:
    """A surface with weights. Positions are those of one body in its own pose [m].

    Args:
        points: Shape (V, 3).
        faces: Shape (F, 3).
        joints: Weights of the 22 joints, shape (V, 22).
        handles: Weights of the 30 handles, shape (V, 30).
    """

    points: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    handles: np.ndarray

    def cut(self, keep: np.ndarray) -> Piece:
        """Only the faces of which all corners are kept, shape (V,) bool."""
        faces = self.faces[keep[self.faces].all(axis=1)]
        used, faces = np.unique(faces, return_inverse=True)
        return Piece(self.points[used], faces.reshape(-1, 3), self.joints[used], self.handles[used])

    def puffed(self, thickness: np.ndarray | float) -> Piece:
        """Moved outwards along the normals [m]."""
        normals = vertex_normals(self.points, self.faces)
        return Piece(self.points + normals * np.reshape(thickness, (-1, 1)), self.faces, self.joints, self.handles)


@dataclass(frozen=True, eq=False)
class BodyShape:
    """A body shape that can be dressed.

    Args:
        vertices: Of the base mesh, in its own pose [m], shape (B, 3).
        joints: Shape (22, 3).
    """

    vertices: np.ndarray
    joints: np.ndarray


def joined(pieces: list[Piece]) -> Piece:
    """Many pieces as one mesh of loose parts."""
    starts = np.cumsum([0, *(len(piece.points) for piece in pieces)])
    return Piece(
        np.concatenate([piece.points for piece in pieces]),
        np.concatenate([piece.faces + start for piece, start in zip(pieces, starts, strict=False)]),
        np.concatenate([piece.joints for piece in pieces]),
        np.concatenate([piece.handles for piece in pieces]),
    )


def skirt_weights(points: np.ndarray, joints: np.ndarray, carried: np.ndarray) -> np.ndarray:
    """Weights of a skirt as game rigs have them: the pelvis at the waist, the thighs further down.

    Args:
        points: Shape (V, 3).
        joints: Of the body, shape (22, 3).
        carried: Weights that hold above the hips, of joints or handles, shape (V, K).
    """
    hip, knee, ankle = (float(joints[pair, 1].mean()) for pair in ([1, 2], [4, 5], [7, 8]))
    waist, wide = float(joints[3, 1]), 1.3 * float(abs(joints[1, 0]))
    thigh = 0.9 * smooth_step(points[:, 1], hip, knee + 0.35 * (hip - knee))
    shin = 0.6 * smooth_step(points[:, 1], knee, ankle + 0.4 * (knee - ankle)) * thigh
    left = smooth_step(points[:, 0], -wide, wide)
    own = np.zeros_like(carried)
    own[:, 0] = 1 - thigh
    for column, side in ((1, left), (2, 1 - left)):
        own[:, column] = (thigh - shin) * side
        own[:, column + 3] = shin * side
    share = smooth_step(points[:, 1], waist, hip)[:, None]
    return np.asarray(share * own + (1 - share) * carried)


@dataclass(frozen=True, eq=False)
class Garment:
    """One garment of an archive file: which vertices (shape (V,) bool) it has, and whether it hangs as a skirt."""

    clothes: Clothes
    vertices: np.ndarray
    skirt: bool


class Wardrobe:
    """All pieces of a folder of MakeHuman clothes (`.mhclo`), and those that are cut from the base mesh.

    Raises:
        FormatError: There are no clothes under the folder, or a file is damaged.
    """

    def __init__(self, body: MakeHumanBody, folder: str | Path):
        self.body = body
        plain = body.shape({})
        self._plain = BodyShape(plain, body.joints(plain))
        self.whole: dict[str, Garment] = {}
        self.upper: dict[str, Garment] = {}
        self.lower: dict[str, Garment] = {}
        self.shoes: dict[str, Garment] = {}
        self.hair: dict[str, Garment] = {}
        self.hats: dict[str, Garment] = {}
        files = sorted(Path(folder).rglob("*.mhclo"))
        for file in files:
            self._sort(file.stem, read_mhclo(file))
        if not (self.upper and self.lower):
            raise FormatError(
                folder,
                "there are no MakeHuman clothes (.mhclo) for the upper and the lower body here; name the unpacked "
                "folder",
            )

    def _sort(self, name: str, clothes: Clothes) -> None:
        weights = fit_weights(clothes, self.body.joint_weights)
        everything = np.ones(len(clothes), bool)
        tags = {tag.lower() for tag in clothes.tags}
        if "hats" in tags:
            self.hats[name] = Garment(clothes, everything, False)
            return
        if "shoes" in tags:
            self.shoes[name] = Garment(clothes, everything, False)
            return
        helper = np.isin(clothes.base, self.body.groups["helper-hair"]).mean()
        if weights[:, [9, 12, 13, 14, _HEAD]].sum(axis=1).mean() > 0.9 or helper > 0.5:
            self.hair[name] = Garment(clothes, everything, False)
            return
        parts = mesh_parts(unique_edges(clothes.faces, len(clothes)), len(clothes))
        size = np.bincount(parts)
        legs = np.bincount(parts, weights[:, [0, *_LEGS]].sum(axis=1)) / size
        if ((legs > 0.25) & (legs < 0.7) & (size > 500)).any():
            self.whole[name] = Garment(clothes, everything, False)
            return
        for shelf, kind in ((self.lower, legs[parts] > 0.5), (self.upper, legs[parts] <= 0.5)):
            if kind.sum() > 50:
                shelf[name] = Garment(
                    clothes, kind, _hangs(fit(clothes, self._plain.vertices), self._plain.joints, clothes.faces, kind)
                )

    def wear(self, garment: Garment, figure: BodyShape) -> Piece:
        """A garment of the archive on a body."""
        clothes, points = garment.clothes, fit(garment.clothes, figure.vertices)
        joints, handles = fit_weights(clothes, self.body.joint_weights), fit_weights(clothes, self.body.handle_weights)
        if garment.skirt:
            joints, handles = (skirt_weights(points, figure.joints, weights) for weights in (joints, handles))
        return Piece(points, clothes.faces, joints, handles).cut(garment.vertices)

    def wear_on_head(self, garment: Garment, figure: BodyShape) -> Piece:
        """Hair or a hat on a body: all of it moves with the head, as `head_top`."""
        points = fit(garment.clothes, figure.vertices)
        joints, handles = np.zeros((len(points), JOINT_COUNT)), np.zeros((len(points), HANDLE_COUNT))
        joints[:, _HEAD], handles[:, _TOP] = 1, 1
        return Piece(points, garment.clothes.faces, joints, handles)

    def part(self, figure: BodyShape, *groups: str, keep: np.ndarray | None = None) -> Piece:
        """Parts of the base mesh itself ("body", "helper-tights", ...), or what is kept of them, shape (B,), bool."""
        wanted = np.zeros(len(figure.vertices), bool)
        for group in groups:
            wanted[self.body.groups[group]] = True
        keep = wanted if keep is None else wanted & keep
        return Piece(figure.vertices, self.body.faces, self.body.joint_weights, self.body.handle_weights).cut(keep)

    def skirt(self, figure: BodyShape, length: float, flare: float) -> Piece:
        """A skirt from the waist down.

        Args:
            figure: The body.
            length: 0 ends at the hips, 1 at the knees, 2 at the ankles.
            flare: How much wider the hem is than the helper surface, as a share of its width.
        """
        piece = self.part(figure, "helper-skirt")
        hip, knee, ankle = (float(figure.joints[pair, 1].mean()) for pair in ([1, 2], [4, 5], [7, 8]))
        hem = float(np.interp(length, [0, 1, 2], [hip, knee, ankle]))
        points = piece.points.copy()
        down = smooth_step(points[:, 1], hip + 0.1, ankle)
        points[:, [0, 2]] = figure.joints[0, [0, 2]] + (points[:, [0, 2]] - figure.joints[0, [0, 2]]) * (
            1 + flare * down[:, None]
        )
        piece = Piece(
            points,
            piece.faces,
            *(skirt_weights(points, figure.joints, weights) for weights in (piece.joints, piece.handles)),
        )
        return piece.cut(points[:, 1] >= min(hem, hip - 0.1))


def _hangs(points: np.ndarray, joints: np.ndarray, faces: np.ndarray, kind: np.ndarray) -> bool:
    """Whether a garment spans the gap between the thighs well below the crotch."""
    edges = unique_edges(faces, len(points))
    ends = points[edges[kind[edges].all(axis=1)]]
    below = ends[..., 1].mean(axis=1) < joints[1, 1] - 0.22
    return bool((below & (ends[:, 0, 0] * ends[:, 1, 0] <= 1e-9)).sum() > 4)
