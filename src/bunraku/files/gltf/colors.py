"""A colour for each vertex, for previews: base colour factor, base colour texture and vertex colour, multiplied."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np

from bunraku.files.gltf.document import Document
from bunraku.files.gltf.mesh import MeshPart

MAX_PIXELS, MAX_IMAGES, PREVIEW_SIZE = 70_000_000, 256, 2048
MAX_ALL_PIXELS = 600_000_000  # of all images: some seconds of decoding
MAX_KEPT = 64 << 20  # of all previews [bytes]
MAX_SCANS = 64  # of a progressive JPEG, which goes over all its pixels for each; programs write some ten


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
                alone = len(group.primitives) == 1
                used = np.arange(stop - start) if alone else np.unique(triangles)
                if len(used):
                    colors[start + used] = _primitive_colors(document, primitives[member], stop - start, used, images)
            start = stop
    return colors


def _primitive_colors(
    document: Document, primitive: dict[str, object], count: int, used: np.ndarray, images: dict[int, np.ndarray | None]
) -> np.ndarray:
    """Colours of those of a primitive's vertices that its triangles use, sRGB, shape (U, 3), uint8."""
    material = document.item("materials", primitive["material"]) if "material" in primitive else {}
    texture, factor = _base_color(document, material)
    texels = _sample(document, primitive, texture, count, used, images) if texture is not None else None
    shade = None
    attributes = document.entry(primitive, "attributes")
    if "COLOR_0" in attributes and document.count(attributes["COLOR_0"]) == count:
        stored = document.accessor(attributes["COLOR_0"], ("VEC3", "VEC4"))
        shade = np.nan_to_num(stored[used, :3].astype(np.float32))
    if texels is not None and shade is None and (factor == 1).all():
        return texels
    linear = np.broadcast_to(factor.astype(np.float32), (1 if texels is None and shade is None else len(used), 3))
    if texels is not None:
        linear = linear * _LINEAR[texels]
    if shade is not None:
        linear = linear * shade
    return np.broadcast_to(np.round(255 * srgb_from_linear(linear)).astype(np.uint8), (len(used), 3))


def _base_color(document: Document, material: dict[str, object]) -> tuple[dict[str, Any] | None, np.ndarray]:
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
    primitive: dict[str, object],
    info: dict[str, object],
    count: int,
    used: np.ndarray,
    images: dict[int, np.ndarray | None],
) -> np.ndarray | None:
    """Texels at the UVs of some vertices of a primitive, nearest neighbour, sRGB, shape (U, 3), uint8."""
    transform = _extension(info, "KHR_texture_transform")
    attributes = document.entry(primitive, "attributes")
    name = f"TEXCOORD_{transform.get('texCoord', info.get('texCoord', 0))}"
    texture = document.item("textures", info.get("index"))
    image = _image_of(texture)
    if name not in attributes or image is None:
        return None
    document.item("images", image)
    accessor, pixels = attributes[name], images.get(image)
    if pixels is None or document.count(accessor) != count:
        return None
    uv = np.nan_to_num(document.accessor(accessor, ("VEC2",))[used].astype(np.float64), posinf=0, neginf=0)
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


def _image_of(texture: dict[str, object]) -> Any:
    return texture.get("source", _extension(texture, "EXT_texture_webp").get("source"))


def _extension(owner: dict[str, object], name: str) -> dict[str, Any]:
    """The data of an extension of an object, empty where it is not there."""
    extensions = owner.get("extensions") or {}
    extension = extensions.get(name) if isinstance(extensions, dict) else None
    return extension if isinstance(extension, dict) else {}


def _decode_all(document: Document, parts: tuple[MeshPart, ...]) -> dict[int, np.ndarray | None]:
    """The base colour images of all meshes, decoded in parallel, which takes most of the time of a textured file."""
    wanted: set[int] = set()
    for mesh in {part.mesh for part in parts}:
        for primitive in document.objects(document.item("meshes", mesh), "primitives"):
            material = document.item("materials", primitive["material"]) if "material" in primitive else {}
            texture = _base_color(document, material)[0]
            image = _image_of(document.item("textures", texture.get("index"))) if texture is not None else None
            if image is not None:
                document.item("images", image)
                wanted.add(image)
    sources = {image: document.image(image) or b"" for image in sorted(wanted)[:MAX_IMAGES]}
    first: dict[Any, int] = {}  # images that are the same bytes are decoded once
    same = {image: first.setdefault(_place(data), image) for image, data in sources.items()}
    sizes = {image: _size(sources[image]) for image in first.values()}
    chosen: list[int] = []
    total = 0
    for image, (pixels, needed) in sizes.items():
        total += pixels
        if 0 < pixels <= MAX_PIXELS and total <= MAX_ALL_PIXELS and document.has_room(MAX_KEPT + needed):
            chosen.append(image)
    kept = PREVIEW_SIZE
    while kept > 64 and 3 * kept**2 * len(chosen) > MAX_KEPT:
        kept //= 2
    largest = max((sizes[image][1] for image in chosen), default=0)
    side_by_side = next((n for n in range(min(4, len(chosen)), 1, -1) if document.has_room(MAX_KEPT + n * largest)), 1)
    if side_by_side < 2:
        decoded = {image: _decode(sources[image], kept) for image in chosen}
    else:
        from concurrent.futures import ThreadPoolExecutor

        with ThreadPoolExecutor(side_by_side) as pool:
            decoded = dict(zip(chosen, pool.map(lambda image: _decode(sources[image], kept), chosen), strict=True))
    return {image: decoded.get(like) for image, like in same.items()}


def _place(data: Any) -> tuple[int, int]:
    """Address and length of bytes: the same for all images that are one view, or one file."""
    array = np.frombuffer(data, np.uint8)
    return array.__array_interface__["data"][0], len(array)


def _opened(data: Any) -> Any:
    from PIL import Image

    image = Image.open(io.BytesIO(data), formats=["PNG", "JPEG", "WEBP"])
    if image.width * image.height <= MAX_PIXELS:
        image.draft("RGB", (1024, 1024))  # JPEG decodes faster at a smaller size, and this is a preview
    return image


def _size(data: Any) -> tuple[int, int]:
    """Number of pixels of an image, 0 where it cannot be decoded, and the bytes that decoding takes."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with _opened(data) as image:
                if image.format == "JPEG" and bytes(data).count(b"\xff\xda") > MAX_SCANS:
                    return 0, 0
                pixels = image.width * image.height
                if image.format == "JPEG" and image.info.get("progressive"):  # all its coefficients are held
                    with Image.open(io.BytesIO(data), formats=["JPEG"]) as whole:
                        return whole.width * whole.height, 6 * whole.width * whole.height + 4 * pixels
                each = {"1": 1, "L": 1, "P": 1}.get(image.mode, 4)
                return pixels, pixels * each * (2 if image.format == "WEBP" else 1)
    except Exception:  # an image that cannot be decoded is not a reason to refuse the character
        return 0, 0


def _decode(data: Any, size: int) -> np.ndarray | None:
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with _opened(data) as image:
                image.thumbnail((size, size), Image.Resampling.NEAREST)
                return np.asarray(image.convert("RGB"))
    except Exception:  # as in `_size`
        return None
