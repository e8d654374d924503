"""Meshes as USD: one prim for each piece of one material, with UVs, vertex colours, and the base colour of its
material.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np

from bunraku.core.character import Character
from bunraku.formats.gltf.carry import image_type
from bunraku.formats.gltf.container.document import Document
from bunraku.formats.gltf.read import Source
from bunraku.formats.gltf.scene.colors import linear_from_srgb

__all__ = ["Look", "Piece", "add_mesh", "pieces", "prim_name"]

_WRAP = {33071: "clamp", 33648: "mirror", 10497: "repeat"}
_SUFFIX = {"image/png": ".png", "image/jpeg": ".jpg"}


def prim_name(text: str, fallback: str = "character") -> str:
    """Text as the name of a prim."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_")[:60]
    return name if name and not name[0].isdigit() else f"{fallback}_{name}".rstrip("_")


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a character that has one material.

    Args:
        name: A name for its prim.
        index: The character's vertex behind each of its own, shape (V,).
        faces: Its triangles, shape (F, 3).
        uv: Texture coordinates with v upwards, shape (V, 2), or None.
        material: The material's number in the document, or None.
    """

    name: str
    index: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None = None
    material: int | None = None


@dataclass
class Look:
    """The materials of a document as they are used by what has been written so far.

    Args:
        usd: The modules of USD.
        stage: Where they are written.
        root: Path of the prim that they are under.
        folder: Name of the folder of the textures, as the file says it.
        textures: Images that are needed: bytes by file name.
    """

    usd: dict[str, ModuleType]
    stage: Any
    root: str
    folder: str
    textures: dict[str, bytes] = field(default_factory=dict)
    _made: dict[tuple[int, bool], Any] = field(default_factory=dict)

    def bind(self, prim: Any, document: Document, number: int, painted: bool) -> None:
        """Give a prim a material of a document; where it has no texture, one that shows the vertex colours of what is
        painted with them.
        """
        key = number, painted
        if key not in self._made:
            self._made[key] = self._material(document, number, painted)
        shade = self.usd["UsdShade"]
        shade.MaterialBindingAPI.Apply(prim).Bind(self._made[key])

    def _material(self, document: Document, number: int, painted: bool) -> Any:
        shade, types = self.usd["UsdShade"], self.usd["Sdf"].ValueTypeNames
        entry = document.item("materials", number)
        rough = entry.get("pbrMetallicRoughness")
        rough = rough if isinstance(rough, dict) else {}
        factor = np.clip(document.numbers(rough, "baseColorFactor", [1.0] * 4), 0, 1).tolist()
        material = shade.Material.Define(self.stage, f"{self.root}/Materials/material_{number}{'_painted' * painted}")
        path = str(material.GetPath())
        surface = shade.Shader.Define(self.stage, f"{path}/Surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        for name, key in (("roughness", "roughnessFactor"), ("metallic", "metallicFactor")):
            value = float(document.numbers({key: [rough.get(key, 1.0)]}, key, [1.0])[0])
            surface.CreateInput(name, types.Float).Set(min(max(value, 0.0), 1.0))
        material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
        opacity, color = surface.CreateInput("opacity", types.Float), surface.CreateInput("diffuseColor", types.Color3f)
        seen = entry.get("alphaMode") in ("MASK", "BLEND")
        if entry.get("alphaMode") == "MASK":
            cutoff = entry.get("alphaCutoff", 0.5)
            surface.CreateInput("opacityThreshold", types.Float).Set(
                float(cutoff) if isinstance(cutoff, int | float) else 0.5
            )
        texture = self._texture(document, rough.get("baseColorTexture"), path, factor)
        if texture is None:
            color.Set(self.usd["Gf"].Vec3f(*factor[:3]))
            if painted:
                reader = shade.Shader.Define(self.stage, f"{path}/VertexColors")
                reader.CreateIdAttr("UsdPrimvarReader_float3")
                reader.CreateInput("varname", types.String).Set("displayColor")
                reader.CreateOutput("result", types.Float3)
                color.ConnectToSource(reader.ConnectableAPI(), "result")
            opacity.Set(factor[3] if seen else 1.0)
        else:
            color.ConnectToSource(texture.ConnectableAPI(), "rgb")
            if seen:
                opacity.ConnectToSource(texture.ConnectableAPI(), "a")
        return material

    def _texture(self, document: Document, info: Any, path: str, factor: list[float]) -> Any:
        """A texture that is read by the coordinates `st`, or None where the image is missing or of a kind that USD does
        not have.
        """
        if not isinstance(info, dict):
            return None
        texture = document.item("textures", info.get("index"))
        number = texture.get("source")
        if type(number) is not int:
            return None
        data = bytes(document.image(number) or b"")
        suffix = _SUFFIX.get(image_type(data[:16]) or "")
        if suffix is None:
            return None
        name = f"image_{number}{suffix}"
        self.textures[name] = data
        shade, types = self.usd["UsdShade"], self.usd["Sdf"].ValueTypeNames
        reader = shade.Shader.Define(self.stage, f"{path}/Coordinates")
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", types.String).Set("st")
        reader.CreateOutput("result", types.Float2)
        out = shade.Shader.Define(self.stage, f"{path}/BaseColor")
        out.CreateIdAttr("UsdUVTexture")
        out.CreateInput("file", types.Asset).Set(self.usd["Sdf"].AssetPath(f"./{self.folder}/{name}"))
        out.CreateInput("sourceColorSpace", types.Token).Set("sRGB")
        out.CreateInput("scale", types.Float4).Set(self.usd["Gf"].Vec4f(*factor))
        out.CreateInput("st", types.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        sampler = texture.get("sampler")
        wrap = document.item("samplers", sampler) if sampler is not None else {}
        for axis in "ST":
            out.CreateInput(f"wrap{axis}", types.Token).Set(_WRAP.get(wrap.get(f"wrap{axis}", 10497), "repeat"))
        out.CreateOutput("rgb", types.Float3)
        out.CreateOutput("a", types.Float)
        return out


def pieces(character: Character) -> list[Piece]:
    """The pieces of a character: those of its document where it has one, itself otherwise."""
    source = character.source
    if (
        not isinstance(source, Source)
        or not len(source.index)
        or int(source.index.max()) + 1 != len(character.vertices)
    ):
        return [Piece("Mesh", np.arange(len(character.vertices)), character.faces)]
    out: list[Piece] = []
    start, document = 0, source.document
    for part in source.parts:
        title = (
            document.item("nodes", part.node).get("name") or document.item("meshes", part.mesh).get("name") or "Mesh"
        )
        primitives = document.item("meshes", part.mesh)["primitives"]
        for group in part.groups:
            index = source.index[start : start + len(group.vertices)]
            start += len(group.vertices)
            for member, faces in zip(group.primitives, group.triangles, strict=True):
                if not len(faces):
                    continue
                used, local = np.unique(faces, return_inverse=True)
                material = primitives[member].get("material")
                uv = _coordinates(document, primitives[member], len(group.vertices))
                own = None if uv is None else np.ascontiguousarray(uv[used], np.float32)
                number = material if type(material) is int else None
                out.append(
                    Piece(f"{prim_name(str(title), 'Mesh')}_{len(out)}", index[used], local.reshape(-1, 3), own, number)
                )
    return out


def _coordinates(document: Document, primitive: dict[str, object], count: int) -> np.ndarray | None:
    """The texture coordinates that the base colour of a primitive is read by, with v upwards."""
    texture = None
    if type(primitive.get("material")) is int:
        rough = document.item("materials", primitive["material"]).get("pbrMetallicRoughness")
        texture = rough.get("baseColorTexture") if isinstance(rough, dict) else None
    number = texture.get("texCoord", 0) if isinstance(texture, dict) else 0
    accessor = document.entry(primitive, "attributes").get(f"TEXCOORD_{number}")
    if accessor is None or document.count(accessor) != count:
        return None
    uv = np.nan_to_num(document.accessor(accessor, ("VEC2",)).astype(np.float32), posinf=0.0, neginf=0.0)
    return np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1)


def add_mesh(
    usd: dict[str, ModuleType], stage: Any, path: str, piece: Piece, character: Character, rest: np.ndarray, look: Look
) -> Any:
    """Add a piece as a mesh and return it.

    Args:
        usd: The modules of USD.
        stage: The stage.
        path: Path of the prim.
        piece: The piece.
        character: What it is of.
        rest: Its rest positions in the file's frame, shape (V, 3), float32.
        look: Where its material goes.
    """
    array, types = usd["Vt"].Vec3fArray.FromNumpy, usd["Sdf"].ValueTypeNames
    mesh = usd["UsdGeom"].Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr(array(rest))
    mesh.CreateFaceVertexCountsAttr(usd["Vt"].IntArray.FromNumpy(np.full(len(piece.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(
        usd["Vt"].IntArray.FromNumpy(np.ascontiguousarray(piece.faces.reshape(-1), np.int32))
    )
    mesh.CreateExtentAttr(array(np.stack([rest.min(axis=0), rest.max(axis=0)])))
    mesh.CreateDoubleSidedAttr(True)
    primvars = usd["UsdGeom"].PrimvarsAPI(mesh)
    if character.colors is not None:
        colors = np.ascontiguousarray(linear_from_srgb(character.colors[piece.index] / 255.0), np.float32)
        primvars.CreatePrimvar("displayColor", types.Color3fArray, "vertex").Set(array(colors))
    if piece.uv is not None:
        primvars.CreatePrimvar("st", types.TexCoord2fArray, "vertex").Set(usd["Vt"].Vec2fArray.FromNumpy(piece.uv))
    if piece.material is not None and isinstance(character.source, Source):
        painted = character.colors is not None and int(np.ptp(character.colors[piece.index], axis=0).max(initial=0)) > 2
        look.bind(mesh.GetPrim(), character.source.document, piece.material, painted)
    return mesh
