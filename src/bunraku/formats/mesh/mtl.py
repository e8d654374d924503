"""Materials and textures of OBJ files as glTF materials."""

from __future__ import annotations

import io
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.errors import FormatError
from bunraku.formats.files import inside, read_bounded
from bunraku.formats.gltf.carry import image_type
from bunraku.formats.gltf.scene.colors import MAX_PIXELS, linear_from_srgb

__all__ = ["beside", "embeddable", "read_materials"]

_OPTION_ARGUMENTS = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2} | dict.fromkeys(
    ["-blendu", "-blendv", "-clamp", "-cc", "-bm", "-boost", "-texres", "-imfchan", "-type"], 1
)


def read_materials(
    path: Path, libraries: list[str], wanted: list[str]
) -> tuple[dict[str, int], list[dict[str, Any]], list[tuple[bytes, str]]]:
    """The materials that an OBJ file uses.

    A library or texture that is missing, or lies outside the file's folder, leaves its material without it: the mesh is
    still good.

    Args:
        path: The OBJ file.
        libraries: What its `mtllib` lines name.
        wanted: Materials in use, "" for none.

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
    shader: dict[str, Any] = {"metallicFactor": 0, "roughnessFactor": 0.9}
    material: dict[str, Any] = {"name": name, "pbrMetallicRoughness": shader}
    color = linear_from_srgb(np.clip(_floats(lines.get("kd", ""), 3, 1.0 if "map_kd" in lines else 0.8), 0, 1))
    alpha = 1 - _floats(lines["tr"], 1, 0.0)[0] if "tr" in lines else _floats(lines.get("d", ""), 1, 1.0)[0]
    alpha = float(np.clip(alpha, 0, 1))
    texture = _texture(path, lines["map_kd"], images, textures) if "map_kd" in lines else None
    if texture is not None:
        shader["baseColorTexture"] = {"index": texture}
        if not color.any():
            color = np.ones(3)  # exporters that leave Kd black beside a texture mean the texture
    shader["baseColorFactor"] = [*color.tolist(), alpha]
    if alpha < 1:
        material["alphaMode"] = "BLEND"
    return material


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
    """The file of this name in the folder of the OBJ, or of its last part where the name is of another machine."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    for candidate in (name, last):
        target = inside(path.parent, candidate)
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
    """Bytes of an image as glTF may embed it, PNG or JPEG, with their MIME type; other kinds are converted. None if it
    cannot be read.

    Args:
        image: A file, or its bytes.
    """
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
    except Exception:  # a texture that cannot be decoded is no reason to refuse the mesh
        return None
    return packed.getvalue(), "image/png"
