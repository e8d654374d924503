"""Wavefront OBJ with its MTL and textures, and animations as one mesh file per frame."""

from __future__ import annotations

import io
import os
import re
import shutil
import tempfile
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.core.character import Character
from bunraku.core.files import check_text, path_inside, read_bounded, share_file, writing
from bunraku.core.geometry.axes import FileFrame
from bunraku.core.geometry.surface import unit_normals
from bunraku.core.motion import checked_fps
from bunraku.errors import FormatError
from bunraku.files.gltf.carry import image_type
from bunraku.files.gltf.colors import MAX_PIXELS, linear_from_srgb
from bunraku.files.gltf.document import matte_material, mesh_document
from bunraku.files.gltf.read import character_from_document

if TYPE_CHECKING:
    from bunraku.core.animation import Animation, PointAnimation


def split_corners(corners: np.ndarray, vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions of different corners (C, columns), their vertex in column 0, among the vertices of the document of a
    file of V vertices.

    Returns:
        Document vertex of each corner (C,), file vertex of each document vertex (U,), and the corner that each document
            vertex shows, -1 for none (U,).
    """
    unique, first = np.unique(corners[:, 0], return_index=True)
    slots = np.full(len(corners), -1, np.int64)
    slots[first] = unique
    extra = np.flatnonzero(slots < 0)
    slots[extra] = vertices + np.arange(len(extra))
    index = np.concatenate([np.arange(vertices), corners[extra, 0]])
    corner_of = np.full(vertices + len(extra), -1, np.int64)
    corner_of[slots] = np.arange(len(corners))
    return slots, index, corner_of


def fans(corners: np.ndarray, sizes: np.ndarray, materials: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of polygons and the material of each: corner 0 with each further edge. Vertices of the corners stand
    polygon after polygon, shape (sum of sizes,); sizes and materials are of each polygon, shape (F,).
    """
    counts = np.maximum(sizes - 2, 0)
    face = np.repeat(np.arange(len(sizes)), counts)
    starts = (np.cumsum(sizes) - sizes)[face]
    step = np.arange(len(face)) - (np.cumsum(counts) - counts)[face]
    out = np.stack([corners[starts], corners[starts + step + 1], corners[starts + step + 2]], axis=1)
    return out.reshape(-1, 3), materials[face]


_OPTION_ARGUMENTS = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2} | dict.fromkeys(
    ["-blendu", "-blendv", "-clamp", "-cc", "-bm", "-boost", "-texres", "-imfchan", "-type"], 1
)


def read_materials(
    path: Path, libraries: list[str], wanted: list[str]
) -> tuple[dict[str, int], list[dict[str, Any]], list[tuple[bytes, str]]]:
    """The materials that an OBJ file uses ("" for none), from what its `mtllib` lines name. A library or texture that
    is missing or lies outside the file's folder leaves its material without it, since the mesh is still good.

    Returns:
        Index of each material, glTF materials, and images as bytes with their MIME type.
    """
    found: dict[str, dict[str, str]] = {}
    for names in libraries:
        for library in dict.fromkeys([names, *names.split()]):
            target = beside(path, library)
            if target is not None:
                _parse(read_bounded(target), found)
    numbers: dict[str, int] = {}
    materials: list[dict[str, Any]] = []
    images: list[tuple[bytes, str]] = []
    textures: dict[Path, int | None] = {}
    for name in wanted:
        if not name:
            continue
        numbers[name] = len(materials)
        materials.append(_material(path, name, found.get(name, {}), images, textures))
    return numbers, materials, images


def _material(
    path: Path, name: str, lines: dict[str, str], images: list[tuple[bytes, str]], textures: dict[Path, int | None]
) -> dict[str, Any]:
    color = linear_from_srgb(np.clip(_floats(lines.get("kd", ""), 3, 1.0 if "map_kd" in lines else 0.8), 0, 1))
    alpha = 1 - _floats(lines["tr"], 1, 0.0)[0] if "tr" in lines else _floats(lines.get("d", ""), 1, 1.0)[0]
    alpha = float(np.clip(alpha, 0, 1))
    texture = _texture(path, lines["map_kd"], images, textures) if "map_kd" in lines else None
    if texture is not None and not color.any():
        color = np.ones(3)  # exporters that leave Kd black beside a texture mean the texture
    return matte_material(name, [*color, alpha], texture)


def _floats(text: str, count: int, default: float) -> np.ndarray:
    try:
        values = [float(word) for word in text.split()[:count]]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        return np.full(count, default)
    return np.array(values)


def _texture(path: Path, text: str, images: list[tuple[bytes, str]], textures: dict[Path, int | None]) -> int | None:
    words = text.split()
    while words and words[0] in _OPTION_ARGUMENTS:
        words = words[1 + _OPTION_ARGUMENTS[words[0]] :]
    target = beside(path, " ".join(words))
    if target is None:
        return None
    if target not in textures:
        image = embeddable(target)
        textures[target] = None if image is None else len(images)
        if image is not None:
            images.append(image)
    return textures[target]


def beside(path: Path, name: str) -> Path | None:
    """The file of this name, or of its last part if the path is one of another machine, in the folder of the OBJ."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    for candidate in (name, last):
        target = path_inside(path.parent, candidate)
        if target is not None and os.path.isfile(target):
            return target
    return None


def _parse(data: bytes, found: dict[str, dict[str, str]]) -> None:
    current: dict[str, str] = {}
    for line in data.decode("utf-8", "replace").splitlines():
        word, _, rest = line.strip().replace("\t", " ").partition(" ")
        if word.lower() == "newmtl":
            current = found.setdefault(rest.strip(), {})
        elif word.lower() in ("kd", "d", "tr", "map_kd"):
            current[word.lower()] = rest.strip()


def embeddable(image: Path | bytes) -> tuple[bytes, str] | None:
    """An image as glTF may embed it, PNG or JPEG, and its MIME type; others are converted. None if unreadable."""
    try:
        data = image if isinstance(image, bytes) else read_bounded(image)
    except FormatError:
        return None
    mime = image_type(data[:16])
    if mime in ("image/png", "image/jpeg"):
        return data, mime
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=["BMP", "TGA", "TIFF", "WEBP", "GIF"]) as picture:
                if picture.width * picture.height > MAX_PIXELS:
                    return None
                packed = io.BytesIO()
                picture.convert("RGBA" if "A" in picture.getbands() else "RGB").save(packed, "PNG")
    except Exception:  # a texture that cannot be decoded is not a reason to refuse the mesh
        return None
    return packed.getvalue(), "image/png"


BROKEN = "the file is truncated or broken, export it again"


def read_obj(path: Path, data: bytes) -> Character:
    """Read an OBJ file; polygons become fans of triangles. Materials and textures are looked for in its folder only.
    FormatError if a line cannot be understood, or a face uses a vertex that does not exist; CharacterError if what it
    holds is no character.
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
    for column, kind, have in (
        (0, "vertex", len(positions)),
        (1, "texture coordinate", len(uvs)),
        (2, "normal", len(normals)),
    ):
        low = 0 if column == 0 else -1
        if len(corners) and not low <= int(corners[:, column].min()) <= int(corners[:, column].max()) < have:
            worst = int(corners[:, column].max()) + 1
            raise FormatError(path, f"a face uses {kind} {worst} but there are {have}; {BROKEN}")
    slots, index, corner_of = split_corners(corners, len(positions))
    triangles, material = fans(slots[of_face], sizes, face_material)
    names, materials, images = read_materials(path, lines.libraries, lines.materials)
    groups = [(triangles[material == number], names.get(name)) for number, name in enumerate(lines.materials)]
    document = mesh_document(
        path, positions[index], groups, normals=_corner_normals(normals, corners, corner_of),
        uvs=_corner_uvs(uvs, corners, corner_of), colors=None if colors is None else colors[index],
        materials=materials, images=images,
    )  # fmt: skip
    return character_from_document(document, path.stem, index if len(positions) else None, ".obj")


class _Lines:
    """The lines of an OBJ file by their kind."""

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
        materials, current = {"": 0}, 0
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
                current = materials.setdefault(name, len(materials))
                if current == len(self.materials):
                    self.materials.append(name)
            elif word == b"mtllib":
                self.libraries.append(rest.strip().decode("utf-8", "replace"))
            elif word[:1] not in (b"", b"#") and b"\0" in line:
                raise FormatError(path, "this is not an OBJ file, it holds binary data; check its suffix")

    def corners(self, vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Different corners as (vertex, UV, normal), -1 for none, shape (C, 3); the corner of each face corner; sizes
        and materials of faces.
        """
        faces = self.faces
        if any(b"#" in face for face in faces):
            faces = [face.split(b"#")[0] for face in faces]
        if self.counts:
            pairs = zip(faces, self.counts, strict=True)
            faces = [b" ".join(self._absolute(corner, counts) for corner in face.split()) for face, counts in pairs]
        sizes = np.fromiter((len(face.split()) for face in faces), np.int64, len(faces))
        flat = b" ".join(faces).split()
        numbers = {corner: number for number, corner in enumerate(dict.fromkeys(flat))}
        of_face = np.fromiter(map(numbers.__getitem__, flat), np.int64, len(flat))
        table = np.full((len(numbers), 3), -1, np.int64)
        try:
            for corner, number in numbers.items():
                for column, part in enumerate(corner.split(b"/")[:3]):
                    if part:
                        table[number, column] = int(part) - 1
        except (ValueError, OverflowError):
            shown = corner[:30].decode("utf-8", "replace")
            raise FormatError(self.path, f"a face has the corner {shown!r}, which is not a vertex; {BROKEN}") from None
        if len(table) and (table[:, 0] < 0).any():
            raise FormatError(self.path, f"a face uses a vertex that does not exist, there are {vertices}; {BROKEN}")
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
    """Numbers of words, float64. A very long word is refused, since it would blow up the array of all. ValueError if a
    word is not a number.
    """
    if max(map(len, words), default=0) > 64:
        raise ValueError("a word is too long for a number")
    return np.array(words, dtype="S").astype(np.float64) if words else np.zeros(0)


def _numbers(path: Path, lines: list[bytes], widths: tuple[int, ...], what: str) -> np.ndarray:
    """Numbers of lines that all have as many, shape (lines, width)."""
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
            raise FormatError(path, f"{what} holds something that is not a number; {BROKEN}") from None
        if width < min(widths):
            raise FormatError(path, f"{what} has only {width} numbers; {BROKEN}")
    return values.reshape(len(lines), width)


def _corner_uvs(uvs: np.ndarray, corners: np.ndarray, corner_of: np.ndarray) -> np.ndarray | None:
    if not len(uvs) or uvs.shape[1] < 2 or not len(corners) or (corners[:, 1] < 0).all():
        return None
    out = np.zeros((len(corner_of), 2))
    has = (corner_of >= 0) & (corners[corner_of, 1] >= 0)
    out[has] = np.nan_to_num(uvs[corners[corner_of[has], 1], :2])
    out[has, 1] = 1 - out[has, 1]  # OBJ counts v upwards, glTF downwards
    return out


def _corner_normals(normals: np.ndarray, corners: np.ndarray, corner_of: np.ndarray) -> np.ndarray | None:
    if not len(normals) or not len(corners) or (corners[:, 2] < 0).any():
        return None
    out: np.ndarray[Any, Any] = np.tile([0.0, 1, 0], (len(corner_of), 1))
    has = corner_of >= 0
    out[has] = unit_normals(normals[corners[corner_of[has], 2]])
    return out


Frame = Callable[[np.ndarray], bytes]


def write_obj_sequence(
    animation: Animation | PointAnimation, path: Path, *, fps: float | None = None, up: str = "+y", unit: str = "m"
) -> Path:
    """Write `walk.obj` as a folder `walk` with `walk_0000.obj`, `walk_0001.obj` and so on, positions and triangles, and
    return the folder. Options are those of `save`. FormatError if the folder cannot be written, or holds other files;
    OptionError if `fps` is not a number from 1 to 1000, or there is no such axis or unit.
    """
    return _write(animation, path, fps, FileFrame.of(up, unit), obj_frame(animation.character))


def write_ply_sequence(
    animation: Animation | PointAnimation, path: Path, *, fps: float | None = None, up: str = "+y", unit: str = "m"
) -> Path:
    """Write `walk.ply` as a folder `walk` of binary PLY files, with vertex colours (see `write_obj_sequence`)."""
    return _write(animation, path, fps, FileFrame.of(up, unit), _ply_frame(animation.character))


def obj_frame(character: Character) -> Frame:
    """What writes a frame of a character as OBJ, without colours."""
    faces = character.faces + 1
    tail = (("f %d %d %d\n" * len(faces)) % tuple(faces.reshape(-1).tolist())).encode()
    pattern = "v %.9g %.9g %.9g\n" * len(character.vertices)
    return lambda vertices: (pattern % tuple(vertices.reshape(-1).tolist())).encode() + tail


def _ply_frame(character: Character) -> Frame:
    colors = character.colors
    fields: list[tuple] = [("position", "<f4", 3)] + ([("color", "u1", 3)] if colors is not None else [])
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    if colors is not None:
        properties += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    count, faces = len(character.vertices), len(character.faces)
    head = f"ply\nformat binary_little_endian 1.0\ncomment bunraku\nelement vertex {count}\n{properties}"
    head += f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.empty(count, fields)
    if colors is not None:
        rows["color"] = colors
    triangles = np.empty(faces, [("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, character.faces
    tail = triangles.tobytes()

    def frame(vertices: np.ndarray) -> bytes:
        rows["position"] = vertices
        return head.encode() + rows.tobytes() + tail

    return frame


def _write(animation: Animation | PointAnimation, path: Path, fps: float | None, axes: FileFrame, frame: Frame) -> Path:
    moved = animation.at(checked_fps(fps, animation.motion.fps))
    frames = len(moved.motion)
    folder = check_sequence(path)
    temporary = ""
    with writing(path, "files"):
        try:
            temporary = tempfile.mkdtemp(prefix=f".{path.stem[:100]}.", suffix=".tmp", dir=path.parent)
            digits = max(4, len(str(frames - 1)))
            for start in range(0, frames, 16):
                for number, vertices in enumerate(moved.vertices(slice(start, start + 16)), start):
                    file = Path(temporary, f"{path.stem}_{number:0{digits}d}{path.suffix}")
                    file.write_bytes(frame(np.ascontiguousarray(axes.points(vertices))))
            share_file(Path(temporary), 0o777)
            if folder.exists():
                shutil.rmtree(folder)
            os.replace(temporary, folder)
        finally:
            if temporary:
                with suppress(OSError):
                    shutil.rmtree(temporary)
    return folder


def check_sequence(path: Path) -> Path:
    """The folder that a sequence of this name goes to. FormatError if it holds anything but an earlier sequence of this
    name, which is all that is replaced.
    """
    folder = path.with_suffix("")
    if not folder.exists():
        return folder
    pattern = re.compile(re.escape(path.stem) + r"_\d{4,}" + re.escape(path.suffix))
    if not folder.is_dir() or not all(pattern.fullmatch(each.name) and each.is_file() for each in folder.iterdir()):
        raise FormatError(path, f"{folder} exists and holds other files; choose another name for the sequence")
    return folder
