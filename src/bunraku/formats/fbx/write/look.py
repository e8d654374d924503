"""Materials and textures as FBX: base colour, normal map, what glows, and what can be seen through."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bunraku.formats.fbx.write.encode import element, prop, properties
from bunraku.formats.fbx.write.objects import Objects
from bunraku.formats.gltf.carry import image_type
from bunraku.formats.gltf.container.document import Document

__all__ = ["Look", "uv_name"]

_SUFFIX = {"image/png": ".png", "image/jpeg": ".jpg"}
_CLAMP = 33071


def uv_name(number: int) -> str:
    """The name of a set of texture coordinates."""
    return "UVMap" if number == 0 else f"UVMap{number}"


@dataclass
class Look:
    """The materials of a document as what is written uses them, each once, with its textures inside the file.

    Args:
        objects: Where they go.
        document: Where they come from.
    """

    objects: Objects
    document: Document
    _materials: dict[int, int] = field(default_factory=dict)
    _textures: dict[tuple[int, int], int | None] = field(default_factory=dict)

    def material(self, index: int) -> int:
        """The number of a material; -1 stands for that of meshes without one."""
        if index not in self._materials:
            self._materials[index] = self._add(index)
        return self._materials[index]

    def _add(self, index: int) -> int:
        entry: dict[str, Any] = {"name": "default"} if index < 0 else self.document.item("materials", index)
        rough = entry.get("pbrMetallicRoughness")
        rough = rough if isinstance(rough, dict) else {}
        factor = np.clip(self.document.numbers(rough, "baseColorFactor", [1.0] * 4), 0, 1).tolist()
        glow = np.clip(self.document.numbers(entry, "emissiveFactor", [0.0] * 3), 0, 1).tolist()
        metallic, roughness = (
            float(np.clip(self.document.numbers({key: [rough.get(key, 1.0)]}, key, [1.0])[0], 0, 1))
            for key in ("metallicFactor", "roughnessFactor")
        )
        seen_through = entry.get("alphaMode") in ("MASK", "BLEND")
        clear = 1 - factor[3] if seen_through else 0.0
        name = self.objects.free_name(str(entry.get("name") or f"material_{index}"), "materials")
        number = self.objects.add(
            "Material", name, "", element("Version", 102), element("ShadingModel", "Phong"), element("MultiLayer", 0),
            properties(
                prop("ShadingModel", "string", "Phong"),
                prop("DiffuseColor", "color", *factor[:3]), prop("DiffuseFactor", "number", 1.0),
                prop("AmbientColor", "color", 0.0, 0.0, 0.0), prop("EmissiveColor", "color", *glow),
                prop("EmissiveFactor", "number", 1.0),
                prop("TransparentColor", "color", 1.0, 1.0, 1.0), prop("TransparencyFactor", "number", clear),
                prop("Opacity", "number", 1 - clear),
                prop("SpecularColor", "color", 0.2, 0.2, 0.2), prop("SpecularFactor", "number", 0.25),
                prop("ShininessExponent", "number", (10 * (1 - roughness)) ** 2),
                prop("Shininess", "number", (10 * (1 - roughness)) ** 2),
                prop("ReflectionColor", "color", 1.0, 1.0, 1.0), prop("ReflectionFactor", "number", metallic),
            ),
        )  # fmt: skip
        base = self._texture(rough.get("baseColorTexture"))
        self._bind(base, number, "DiffuseColor")
        if seen_through:
            self._bind(base, number, "TransparentColor")
        self._bind(self._texture(entry.get("normalTexture")), number, "NormalMap")
        if any(glow):
            self._bind(self._texture(entry.get("emissiveTexture")), number, "EmissiveColor")
        return number

    def _bind(self, texture: int | None, material: int, slot: str) -> None:
        if texture is not None:
            self.objects.link(texture, material, slot)

    def _texture(self, info: Any) -> int | None:
        """The number of a texture, None where there is none that can be written."""
        if not isinstance(info, dict) or type(info.get("index")) is not int:
            return None
        coordinates = info.get("texCoord", 0)
        key = info["index"], coordinates if type(coordinates) is int else 0
        if key not in self._textures:
            self._textures[key] = self._add_texture(*key)
        return self._textures[key]

    def _add_texture(self, index: int, coordinates: int) -> int | None:
        entry = self.document.item("textures", index)
        found = _picture(self.document, entry)
        if found is None:
            return None
        image, data, suffix = found
        file = f"image_{image}{suffix}"
        sampler = self.document.item("samplers", entry["sampler"]) if "sampler" in entry else {}
        wrap = [1 if sampler.get(f"wrap{axis}") == _CLAMP else 0 for axis in "ST"]
        name = f"image_{image}"
        video = self.objects.add(
            "Video", name, "Clip", element("Type", "Clip"),
            properties(prop("Path", "url", file)), element("UseMipMap", 0),
            element("Filename", file), element("RelativeFilename", file), element("Content", data),
        )  # fmt: skip
        texture = self.objects.add(
            "Texture", name, "", element("Type", "TextureVideoClip"), element("Version", 202),
            element("TextureName", f"{name}\x00\x01Texture"), element("Media", f"{name}\x00\x01Video"),
            element("FileName", file), element("RelativeFilename", file),
            element("ModelUVTranslation", 0.0, 0.0), element("ModelUVScaling", 1.0, 1.0),
            element("Texture_Alpha_Source", "Alpha_Black" if suffix == ".png" else "None"),
            element("Cropping", 0, 0, 0, 0),
            properties(
                prop("UseMaterial", "bool", 1), prop("AlphaSource", "enum", 2),
                prop("UVSet", "string", uv_name(coordinates)),
                prop("WrapModeU", "enum", wrap[0]), prop("WrapModeV", "enum", wrap[1]),
            ),
        )  # fmt: skip
        self.objects.link(video, texture)
        return texture


def _picture(document: Document, texture: dict[str, Any]) -> tuple[int, bytes, str] | None:
    """The image of a texture: its index, its bytes as PNG or JPEG, and their suffix."""
    number = texture.get("source")
    webp = texture.get("extensions", {})
    if isinstance(webp, dict) and isinstance(webp.get("EXT_texture_webp"), dict):
        number = webp["EXT_texture_webp"].get("source", number)
    if type(number) is not int:
        return None
    found = document.image(number)
    if not found:
        return None
    data = bytes(found)
    kind = image_type(data[:16])
    if kind == "image/webp":
        png = _as_png(data)
        return None if png is None else (number, png, ".png")
    suffix = _SUFFIX.get(kind or "")
    return None if suffix is None else (number, data, suffix)


def _as_png(data: bytes) -> bytes | None:
    """An image of a kind that FBX's readers lack, None where it is broken."""
    from PIL import Image

    out = io.BytesIO()
    try:
        with Image.open(io.BytesIO(data), formats=("WEBP",)) as image:
            image.save(out, "PNG")
    except (OSError, ValueError, Image.DecompressionBombError):
        return None
    return out.getvalue()
