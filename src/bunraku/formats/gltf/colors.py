"""A colour for each vertex, for previews: base colour factor, base colour texture at the UV, and vertex colour,
multiplied.
"""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np

from bunraku.errors import FormatError
from bunraku.formats.gltf.document import Document
from bunraku.formats.gltf.mesh import MeshPart

__all__ = ["linear_from_srgb", "srgb_from_linear", "vertex_colors"]

MAX_PIXELS, MAX_IMAGES, PREVIEW_SIZE = 70_000_000, 256, 2048


def linear_from_srgb(values: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values from 0 to 1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(values: np.ndarray) -> np.ndarray:
    """sRGB values from 0 to 1 of linear light."""
    values = np.clip(values, 0, 1)
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * values ** (1 / 2.4) - 0.055)


_LINEAR = linear_from_srgb(np.arange(256) / 255.0).astype(np.float32)


def vertex_colors(document: Document, parts: tuple[MeshPart, ...], count: int) -> np.ndarray:
    """Preview colours of all vertices, sRGB, shape (V, 3), uint8. What cannot be read counts as white."""
    colors = np.full((count, 3), 204, np.uint8)
    images = _decode_all(document, parts)
    start = 0
    for part in parts:
        primitives = document.objects(document.item("meshes", part.mesh), "primitives")
        for group in part.groups:
            stop = start + len(group.vertices)
            for member, triangles in zip(group.primitives, group.triangles, strict=True):
                shades = _primitive_colors(document, primitives[member], stop - start, images)
                if len(group.primitives) == 1:
                    colors[start:stop] = shades
                else:
                    used = np.unique(triangles)
                    colors[start + used] = shades[used]
            start = stop
    return colors


def _primitive_colors(
    document: Document, primitive: dict[str, Any], count: int, images: dict[int, np.ndarray | None]
) -> np.ndarray:
    material = document.item("materials", primitive["material"]) if "material" in primitive else {}
    texture, factor = _base_color(document, material)
    texels = _sample(document, primitive, texture, count, images) if texture is not None else None
    shade = None
    attributes = primitive["attributes"]
    if "COLOR_0" in attributes and document.count(attributes["COLOR_0"]) == count:
        shade = np.nan_to_num(document.accessor(attributes["COLOR_0"], ("VEC3", "VEC4"))[:, :3].astype(np.float32))
    if texels is not None and shade is None and (factor == 1).all():
        return texels
    linear = np.broadcast_to(factor.astype(np.float32), (1 if texels is None and shade is None else count, 3))
    if texels is not None:
        linear = linear * _LINEAR[texels]
    if shade is not None:
        linear = linear * shade
    return np.broadcast_to(np.round(255 * srgb_from_linear(linear)).astype(np.uint8), (count, 3))


def _base_color(document: Document, material: dict[str, Any]) -> tuple[dict[str, Any] | None, np.ndarray]:
    shader, texture, factor = material.get("pbrMetallicRoughness", {}), "baseColorTexture", "baseColorFactor"
    extensions = material.get("extensions")
    if isinstance(extensions, dict) and isinstance(extensions.get("KHR_materials_pbrSpecularGlossiness"), dict):
        shader, texture, factor = extensions["KHR_materials_pbrSpecularGlossiness"], "diffuseTexture", "diffuseFactor"
    if not isinstance(shader, dict):
        return None, np.ones(3)
    info = shader.get(texture)
    return info if isinstance(info, dict) else None, document.numbers(shader, factor, [1.0] * 4)[:3]


def _sample(
    document: Document,
    primitive: dict[str, Any],
    info: dict[str, Any],
    count: int,
    images: dict[int, np.ndarray | None],
) -> np.ndarray | None:
    """Texels at the UVs of a primitive, nearest neighbour, sRGB, shape (V, 3), uint8."""
    transform = (info.get("extensions") or {}).get("KHR_texture_transform") or {}
    name = f"TEXCOORD_{transform.get('texCoord', info.get('texCoord', 0))}"
    texture = document.item("textures", info.get("index"))
    image = _image_of(texture)
    if name not in primitive["attributes"] or image is None:
        return None
    document.item("images", image)
    accessor, pixels = primitive["attributes"][name], images.get(image)
    if pixels is None or document.count(accessor) != count:
        return None
    uv = np.nan_to_num(document.accessor(accessor, ("VEC2",)).astype(np.float64), posinf=0, neginf=0)
    if transform:
        turn = document.numbers({"r": [transform.get("rotation", 0)]}, "r", [0])[0]
        scaled = uv * document.numbers(transform, "scale", [1, 1])
        cos, sin = np.cos(turn), np.sin(turn)
        uv = np.stack([cos * scaled[:, 0] + sin * scaled[:, 1], cos * scaled[:, 1] - sin * scaled[:, 0]], 1)
        uv += document.numbers(transform, "offset", [0, 0])
    sampler = document.item("samplers", texture["sampler"]) if "sampler" in texture else {}
    texel = []
    for axis, (wrap, size) in enumerate((("wrapS", pixels.shape[1]), ("wrapT", pixels.shape[0]))):
        at, mode = np.clip(uv[:, axis], -1e6, 1e6), sampler.get(wrap, 10497)
        if mode == 33071:
            at = np.clip(at, 0, 1)
        elif mode == 33648:
            at = 1 - np.abs(np.mod(at, 2) - 1)
        else:
            at = np.where((at < 0) | (at > 1), np.mod(at, 1), at)
        texel.append(np.minimum((at * size).astype(np.int64), size - 1))
    return pixels[texel[1], texel[0]]


def _image_of(texture: dict[str, Any]) -> Any:
    return texture.get("source", ((texture.get("extensions") or {}).get("EXT_texture_webp") or {}).get("source"))


def _decode_all(document: Document, parts: tuple[MeshPart, ...]) -> dict[int, np.ndarray | None]:
    """The base colour images of all meshes, decoded side by side: that is most of the time that a textured file
    takes.
    """
    wanted: set[int] = set()
    for mesh in {part.mesh for part in parts}:
        for primitive in document.objects(document.item("meshes", mesh), "primitives"):
            material = document.item("materials", primitive["material"]) if "material" in primitive else {}
            texture = _base_color(document, material)[0]
            image = _image_of(document.item("textures", texture.get("index"))) if texture is not None else None
            if image is not None:
                document.item("images", image)
                wanted.add(image)
    wanted = set(sorted(wanted)[:MAX_IMAGES])
    if len(wanted) < 2:
        return {image: _decode(document, image) for image in wanted}
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(min(4, len(wanted))) as pool:
        return dict(zip(wanted, pool.map(lambda image: _decode(document, image), wanted), strict=True))


def _decode(document: Document, index: int) -> np.ndarray | None:
    from PIL import Image

    entry = document.item("images", index)
    data: Any = document.images.get(index)
    try:
        if data is None:
            data = document.view(entry["bufferView"]) if "bufferView" in entry else None
        if data is None:
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=["PNG", "JPEG", "WEBP"]) as image:
                if image.width * image.height > MAX_PIXELS:
                    return None
                image.draft("RGB", (1024, 1024))  # JPEG decodes faster at a smaller size, and this is a preview
                image.thumbnail((PREVIEW_SIZE, PREVIEW_SIZE), Image.Resampling.NEAREST)
                return np.asarray(image.convert("RGB"))
    except FormatError:
        raise
    except Exception:  # an image that cannot be decoded is no reason to refuse the character
        return None
