"""Read MakeHuman's clothes: a `.mhclo` file binds each vertex of an OBJ to three vertices of the MakeHuman base mesh.

A clothes vertex is the weighted mean of its three base vertices plus an offset, and the offset grows with the body:
along each axis it is multiplied by the distance of two base vertices over their distance on the body that the clothes
were made on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.errors import CharacterError, FormatError
from bunraku.formats.files import inside, read_bounded
from bunraku.formats.mesh.obj import read_obj

__all__ = ["Clothes", "fit", "fit_weights", "read_mhclo"]

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
        FormatError: A file is missing or too large, a line cannot be understood, the OBJ lies elsewhere, or the two do
        not fit.
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
    obj = inside(path.parent, lines.obj)
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
