"""Read Wavefront OBJ with its MTL and textures, keeping the order of its vertices.

glTF has one UV and one normal a vertex where OBJ has one a corner. The first corner of a vertex keeps its place, each
further one with another UV or normal is appended, and the map back makes the character see only the vertices of the
file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.character import Character
from bunraku.errors import FormatError
from bunraku.formats.files import check_text
from bunraku.formats.gltf.builder import mesh_document
from bunraku.formats.gltf.read import character_from_document
from bunraku.formats.gltf.scene.colors import linear_from_srgb
from bunraku.formats.mesh.mtl import read_materials
from bunraku.formats.mesh.polygons import fans, split_corners

__all__ = ["parse_numbers", "read_obj"]

_BROKEN = "the file is truncated or broken, export it again"


def read_obj(path: Path, data: bytes) -> Character:
    """Read an OBJ file; polygons become fans of triangles.

    Args:
        path: The file; its materials and textures are looked for in its folder only.
        data: Its bytes.

    Raises:
        FormatError: A line cannot be understood, or a face uses a vertex that does not exist.
        CharacterError: What it holds is no character.
    """
    check_text(path, data)
    lines = _Lines(path, data)
    rows = _numbers(path, lines.positions, (3, 4, 6, 7, 8), "a vertex (v)")
    positions = rows[:, :3]
    # Three numbers after the position are a colour; four or five are a weight and a colour, or a colour and an alpha:
    # take the first three.
    colors = linear_from_srgb(np.clip(np.nan_to_num(rows[:, 3:6]), 0, 1)) if rows.shape[1] >= 6 else None
    corners, of_face, sizes, face_material = lines.corners(len(positions))
    uvs = _numbers(path, lines.uvs, (2, 3, 1), "a texture coordinate (vt)")
    normals = _numbers(path, lines.normals, (3,), "a normal (vn)")
    for column, what, have in (
        (0, "vertex", len(positions)),
        (1, "texture coordinate", len(uvs)),
        (2, "normal", len(normals)),
    ):
        low = 0 if column == 0 else -1
        if len(corners) and not low <= int(corners[:, column].min()) <= int(corners[:, column].max()) < have:
            raise FormatError(
                path, f"a face uses {what} {int(corners[:, column].max()) + 1} but there are {have}; {_BROKEN}"
            )
    slots, index, corner_of = split_corners(corners, len(positions))
    triangles, material = fans(slots[of_face], sizes, face_material)
    names, materials, images = read_materials(path, lines.libraries, lines.materials)
    groups = [(triangles[material == number], names.get(name)) for number, name in enumerate(lines.materials)]
    document = mesh_document(
        path,
        positions[index],
        groups,
        normals=_unit_normals(normals, corners, corner_of),
        uvs=_corner_uvs(uvs, corners, corner_of),
        colors=None if colors is None else colors[index],
        materials=materials,
        images=images,
    )
    return character_from_document(document, path.stem, index if len(positions) else None, ".obj")


class _Lines:
    """The lines of an OBJ file, sorted by what they say."""

    def __init__(self, path: Path, data: bytes):
        self.path = path
        self.positions: list[bytes] = []
        self.uvs: list[bytes] = []
        self.normals: list[bytes] = []
        self.faces: list[bytes] = []
        self.counts: list[tuple[int, int, int]] = []
        self.libraries: list[str] = []
        self.materials: list[str] = [""]
        self.face_materials: list[int] = []
        relative = b"-" in b"".join(line for line in data.splitlines() if line[:2] == b"f ")
        known, current = {"": 0}, 0
        for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
            if line[:2] == b"v ":
                self.positions.append(line[2:])
                continue
            word, _, rest = line.partition(b" ")
            if word != b"f" and (line[:1].isspace() or b"\t" in word):
                word, _, rest = line.strip().replace(b"\t", b" ").partition(b" ")
            if word == b"v":
                self.positions.append(rest)
            elif word == b"f":
                self.faces.append(rest)
                self.face_materials.append(current)
                if relative:
                    self.counts.append((len(self.positions), len(self.uvs), len(self.normals)))
            elif word == b"vt":
                self.uvs.append(rest)
            elif word == b"vn":
                self.normals.append(rest)
            elif word == b"usemtl":
                name = rest.strip().decode("utf-8", "replace")
                current = known.setdefault(name, len(known))
                if current == len(self.materials):
                    self.materials.append(name)
            elif word == b"mtllib":
                self.libraries.append(rest.strip().decode("utf-8", "replace"))
            elif word[:1] not in (b"", b"#") and b"\0" in line:
                raise FormatError(path, "this is not an OBJ file, it holds binary data; check its suffix")

    def corners(self, vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Different corners as (vertex, UV, normal), -1 for none, shape (C, 3); the corner of each face corner; face
        sizes; face materials.
        """
        faces = self.faces
        if any(b"#" in face for face in faces):
            faces = [face.split(b"#")[0] for face in faces]
        if self.counts:
            faces = [
                b" ".join(self._absolute(c, counts) for c in face.split())
                for face, counts in zip(faces, self.counts, strict=True)
            ]
        sizes = np.fromiter((len(face.split()) for face in faces), np.int64, len(faces))
        flat = b" ".join(faces).split()
        known = {corner: number for number, corner in enumerate(dict.fromkeys(flat))}
        of_face = np.fromiter(map(known.__getitem__, flat), np.int64, len(flat))
        table = np.full((len(known), 3), -1, np.int64)
        try:
            for corner, number in known.items():
                for column, part in enumerate(corner.split(b"/")[:3]):
                    if part:
                        table[number, column] = int(part) - 1
        except (ValueError, OverflowError):
            shown = corner[:30].decode("utf-8", "replace")
            raise FormatError(self.path, f"a face has the corner {shown!r}, which is not a vertex; {_BROKEN}") from None
        if len(table) and (table[:, 0] < 0).any():
            raise FormatError(self.path, f"a face uses a vertex that does not exist, there are {vertices}; {_BROKEN}")
        return table, of_face, sizes, np.array(self.face_materials, np.int64)

    def _absolute(self, corner: bytes, counts: tuple[int, int, int]) -> bytes:
        try:
            parts = [
                b"%d" % (int(part) + count + 1) if part[:1] == b"-" else part
                for part, count in zip(corner.split(b"/"), counts, strict=False)
            ]
        except ValueError:
            parts = [corner]
        return b"/".join(parts)


def parse_numbers(words: list[bytes]) -> np.ndarray:
    """Numbers of words, float64.

    Raises:
        ValueError: A word is not a number. One that is very long never is, and would blow up the array of all.
    """
    if max(map(len, words), default=0) > 64:
        raise ValueError("a word is too long for a number")
    return np.array(words, dtype="S").astype(np.float64) if words else np.zeros(0)


def _numbers(path: Path, lines: list[bytes], widths: tuple[int, ...], what: str) -> np.ndarray:
    """Numbers of lines that all have as many; shape (lines, width)."""
    if not lines:
        return np.zeros((0, widths[0]))
    width = len(lines[0].split(b"#")[0].split())
    try:
        values = parse_numbers(b" ".join(lines).split())
    except ValueError:
        values = np.zeros(0)
    if len(values) != width * len(lines) or width not in widths:
        rows = [line.split(b"#")[0].split() for line in lines]
        width = min(map(len, rows))
        try:
            values = np.array([[float(number) for number in row[:width]] for row in rows]).reshape(-1)
        except ValueError:
            raise FormatError(path, f"{what} holds something that is not a number; {_BROKEN}") from None
        if width < min(widths):
            raise FormatError(path, f"{what} has only {width} numbers; {_BROKEN}")
    return values.reshape(len(lines), width)


def _corner_uvs(uvs: np.ndarray, corners: np.ndarray, corner_of: np.ndarray) -> np.ndarray | None:
    if not len(uvs) or uvs.shape[1] < 2 or not len(corners) or (corners[:, 1] < 0).all():
        return None
    out = np.zeros((len(corner_of), 2))
    has = (corner_of >= 0) & (corners[corner_of, 1] >= 0)
    out[has] = np.nan_to_num(uvs[corners[corner_of[has], 1], :2])
    out[has, 1] = 1 - out[has, 1]  # OBJ counts v upwards, glTF downwards
    return out


def _unit_normals(normals: np.ndarray, corners: np.ndarray, corner_of: np.ndarray) -> np.ndarray | None:
    if not len(normals) or not len(corners) or (corners[:, 2] < 0).any():
        return None
    out: np.ndarray[Any, Any] = np.tile([0.0, 1, 0], (len(corner_of), 1))
    has = corner_of >= 0
    found = np.nan_to_num(normals[corners[corner_of[has], 2]])
    length = np.linalg.norm(found, axis=1, keepdims=True)
    out[has] = np.where(length > 1e-12, found / np.where(length > 1e-12, length, 1), [0, 1, 0])
    return out
