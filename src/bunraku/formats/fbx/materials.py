"""Materials and textures of FBX files as glTF materials."""

from __future__ import annotations

import base64
import binascii
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.formats.fbx.scene import FbxObject, FbxScene
from bunraku.formats.mesh.mtl import beside, embeddable

__all__ = ["Materials"]

MAX_IMAGES = 256


class Materials:
    """The materials that the meshes of a file use, each once.

    A texture is taken from the file itself, from its folder, or from the `.fbm` or `textures` folder beside it; one
    that lies elsewhere or cannot be read leaves its material without it: the mesh is still good.

    Args:
        scene: The file.
    """

    def __init__(self, scene: FbxScene):
        self.scene = scene
        self.materials: list[dict[str, Any]] = []
        self.images: list[tuple[bytes, str]] = []
        self._numbers: dict[int, int] = {}
        self._textures: dict[tuple[int, str], int | None] = {}

    def number(self, material: FbxObject) -> int:
        """Index of a material, added where it is new."""
        if material.id not in self._numbers:
            self._numbers[material.id] = len(self.materials)
            self.materials.append(self._build(material))
        return self._numbers[material.id]

    def _build(self, thing: FbxObject) -> dict[str, Any]:
        color = np.clip(thing.numbers("DiffuseColor", tuple(thing.numbers("Diffuse", (0.8, 0.8, 0.8)))), 0, 1)
        color = color * np.clip(thing.number("DiffuseFactor", 1), 0, 1)
        clear = thing.number("TransparencyFactor", 0) * thing.numbers("TransparentColor", (1, 1, 1)).mean()
        alpha = float(np.clip(1 - clear, 0, 1))
        if alpha < 0.02:  # several exporters write 1 for what is solid; nobody animates what cannot be seen
            alpha = 1.0
        shader: dict[str, Any] = {"metallicFactor": 0, "roughnessFactor": 0.9}
        texture = self._diffuse(thing)
        if texture is not None:
            shader["baseColorTexture"] = {"index": texture}
            color = np.ones(3)  # in FBX the texture takes the place of the colour
        shader["baseColorFactor"] = [*color.tolist(), alpha]
        material: dict[str, Any] = {"name": thing.name or "material", "pbrMetallicRoughness": shader}
        if alpha < 1:
            material["alphaMode"] = "BLEND"
        return material

    def _diffuse(self, thing: FbxObject) -> int | None:
        for child, what in self.scene.links.get(thing.id, ()):
            texture = self.scene.objects.get(child)
            if (
                texture is not None
                and texture.kind == "Texture"
                and what in ("DiffuseColor", "Diffuse", "Maya|baseColor", "3dsMax|Parameters|base_color_map")
            ):
                return self._texture(texture)
        return None

    def _texture(self, texture: FbxObject) -> int | None:
        videos = self.scene.below(texture, "Video")
        names = [
            node.text(key)
            for node in (texture.node, *(video.node for video in videos))
            for key in ("RelativeFilename", "FileName", "Filename")
        ]
        key = (videos[0].id if videos else 0, names[0])
        if key not in self._textures:
            image = next(filter(None, map(_embedded, videos)), None) or self._file(names)
            self._textures[key] = None
            if image is not None and len(self.images) < MAX_IMAGES:
                self._textures[key] = len(self.images)
                self.images.append(image)
        return self._textures[key]

    def _file(self, names: list[str]) -> tuple[bytes, str] | None:
        path = self.scene.tree.path
        for name in filter(None, names):
            last = name.replace("\\", "/").rsplit("/", 1)[-1]
            for file in (name, last, f"{path.stem}.fbm/{last}", f"textures/{last}"):
                found: Path | None = beside(path, file)
                if found is not None:
                    return embeddable(found)
        return None


def _embedded(video: FbxObject) -> tuple[bytes, str] | None:
    node = video.node.child("Content")
    content = node.values[0] if node is not None and node.values else None
    if node is not None and isinstance(content, str):  # text files hold it as lines of base64
        try:
            content = base64.b64decode("".join(str(line) for line in node.values), validate=True)
        except (binascii.Error, ValueError):
            return None
    return embeddable(bytes(content)) if isinstance(content, memoryview | bytes) and len(content) else None
