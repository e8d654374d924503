"""Write USD: the mesh with materials, and the handles or the bones of its own rig as a UsdSkel skeleton with motion."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.core.animation import RigAnimation, bone_order
from bunraku.core.body.layout import handle_names
from bunraku.core.character import Character, top_influences
from bunraku.core.files import share_file, writing
from bunraku.core.geometry.axes import UNITS, FileFrame
from bunraku.core.geometry.rotations import continuous, quaternion_from_matrix
from bunraku.core.motion import checked_fps
from bunraku.errors import FormatError, MissingExtraError
from bunraku.files.gltf.carry import IMAGE_SUFFIXES, free_name, image_type
from bunraku.files.gltf.colors import linear_from_srgb
from bunraku.files.gltf.document import Document
from bunraku.files.gltf.read import Source
from bunraku.files.gltf.write import joint_tracks

if TYPE_CHECKING:
    from bunraku.core.animation import Animation, PointAnimation

_WRAP = {33071: "clamp", 33648: "mirror", 10497: "repeat"}


def prim_name(text: str, fallback: str = "character") -> str:
    """Text as the name of a prim."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_")[:60]
    return name if name and not name[0].isdigit() else f"{fallback}_{name}".rstrip("_")


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a character that has one material."""

    name: str  # a name for its prim
    index: np.ndarray  # the character's vertex of each of its own, shape (V,)
    faces: np.ndarray  # its triangles, shape (F, 3)
    uv: np.ndarray | None = None  # texture coordinates with v upwards, shape (V, 2), or None
    material: int | None = None  # the material's number in the document, or None


@dataclass
class Look:
    """The materials of a document that have been written so far."""

    usd: dict[str, ModuleType]  # the modules of USD
    stage: Any  # where they are written
    root: str  # path of the prim that they are under
    folder: str  # name of the folder of the textures in the file
    textures: dict[str, bytes] = field(default_factory=dict)  # images that are needed: bytes by file name
    _made: dict[tuple[int, bool], Any] = field(default_factory=dict)

    def bind(self, prim: Any, document: Document, number: int, painted: bool) -> None:
        """Give a prim a material of a document; one without a texture shows the vertex colours of a `painted` prim."""
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
            cutoff = entry.get("alphaCutoff")
            threshold = float(cutoff) if isinstance(cutoff, int | float) else 0.5
            surface.CreateInput("opacityThreshold", types.Float).Set(threshold)
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
        """A texture read by the coordinates `st`, or None where the image is missing or of a kind that USD lacks."""
        if not isinstance(info, dict):
            return None
        texture = document.item("textures", info.get("index"))
        number = texture.get("source")
        if type(number) is not int:
            return None
        data = bytes(document.image(number) or b"")
        suffix = IMAGE_SUFFIXES.get(image_type(data[:16]) or "")
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
    if not isinstance(source, Source) or not source.fits(character):
        return [Piece("Mesh", np.arange(len(character.vertices)), character.faces)]
    out: list[Piece] = []
    document = source.document
    for part, index in source.placed():
        mesh = document.item("meshes", part.mesh)
        title = str(document.item("nodes", part.node).get("name") or mesh.get("name") or "Mesh")
        primitives = mesh["primitives"]
        for group, vertices in part.split(index):
            for member, faces in zip(group.primitives, group.triangles, strict=True):
                if not len(faces):
                    continue
                used, local = np.unique(faces, return_inverse=True)
                material = primitives[member].get("material")
                uv = _coordinates(document, primitives[member], len(vertices))
                uvs = None if uv is None else np.ascontiguousarray(uv[used], np.float32)
                number = material if type(material) is int else None
                name = f"{prim_name(title, 'Mesh')}_{len(out)}"
                out.append(Piece(name, vertices[used], local.reshape(-1, 3), uvs, number))
    return out


def _coordinates(document: Document, primitive: dict[str, object], count: int) -> np.ndarray | None:
    """The texture coordinates of a primitive's base colour, with v upwards."""
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


def add_mesh(look: Look, piece: Piece, character: Character, frame: FileFrame) -> Any:
    """Add a piece of a character as a mesh below the root."""
    usd, rest = look.usd, np.ascontiguousarray(frame.points(character.vertices[piece.index]))
    array, types = usd["Vt"].Vec3fArray.FromNumpy, usd["Sdf"].ValueTypeNames
    mesh = usd["UsdGeom"].Mesh.Define(look.stage, f"{look.root}/{piece.name}")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr(array(rest))
    integers = usd["Vt"].IntArray.FromNumpy
    mesh.CreateFaceVertexCountsAttr(integers(np.full(len(piece.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(integers(np.ascontiguousarray(piece.faces.reshape(-1), np.int32)))
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


CHUNK = 32  # frames posed at once


def write_usd(
    animation: Animation | RigAnimation,
    path: Path,
    *,
    fps: float | None = None,
    up: str = "+y",
    unit: str = "m",
    points: bool = False,
) -> Path:
    """Write an animation as USD: .usd and .usdc are binary, .usda is text, .usdz is a package. One of a character's own
    rig has its bones in their tree, under their names. Options are those of `save`; the stage's `upAxis` and
    `metersPerUnit` state axes and unit. With `points` it holds the position of every vertex in every frame instead of a
    skeleton. FormatError if the file cannot be written; MissingExtraError if the extra `usd` is not installed;
    OptionError if an option makes no sense.
    """
    if points:
        shown = animation.animation() if isinstance(animation, RigAnimation) else animation
        return write_points(shown, path, fps=fps, up=up, unit=unit)
    frame = FileFrame.of(up, unit)
    moved = animation.at(checked_fps(fps, animation.fps))
    skin = _of_bones(moved, frame) if isinstance(moved, RigAnimation) else _of_handles(moved, frame)
    usd = _library()
    stage, name = _stage(usd, moved.fps, len(skin.translations), up, unit), prim_name(moved.character.name)
    root = usd["UsdSkel"].Root.Define(stage, f"/{name}")
    look = Look(usd, stage, f"/{name}", _texture_folder(path))
    _add_skinned(look, moved.character, skin, frame)
    stage.SetDefaultPrim(root.GetPrim())
    return _export(usd, stage, path, look)


def write_points(
    animation: Animation | PointAnimation, path: Path, *, fps: float | None = None, up: str = "+y", unit: str = "m"
) -> Path:
    """Write the position of every vertex in every frame as USD; arguments are those of `write_usd`."""
    usd, frame = _library(), FileFrame.of(up, unit)
    moved = animation.at(checked_fps(fps, animation.motion.fps))
    stage, name = _stage(usd, moved.motion.fps, len(moved.motion), up, unit), prim_name(animation.character.name)
    root = usd["UsdGeom"].Xform.Define(stage, f"/{name}")
    look, array = Look(usd, stage, f"/{name}", _texture_folder(path)), usd["Vt"].Vec3fArray.FromNumpy
    meshes = []
    for piece in pieces(animation.character):
        mesh = add_mesh(look, piece, animation.character, frame)
        meshes.append((piece, mesh.GetPointsAttr(), mesh.GetExtentAttr()))
    for start in range(0, len(moved.motion), CHUNK):
        for number, posed in enumerate(moved.vertices(slice(start, start + CHUNK)), start):
            positions = np.ascontiguousarray(frame.points(posed), np.float32)
            for piece, points, extent in meshes:
                own = np.ascontiguousarray(positions[piece.index])
                points.Set(array(own), number)
                extent.Set(array(np.stack([own.min(axis=0), own.max(axis=0)])), number)
    stage.SetDefaultPrim(root.GetPrim())
    return _export(usd, stage, path, look)


def check_available() -> None:
    """Raise MissingExtraError unless USD is installed."""
    _library()


def _library() -> dict[str, ModuleType]:
    names = ("Gf", "Sdf", "Usd", "UsdGeom", "UsdShade", "UsdSkel", "UsdUtils", "Vt")
    try:
        return {name: import_module(f"pxr.{name}") for name in names}
    except ImportError as error:
        raise MissingExtraError("usd-core", "usd", "writing USD") from error


def _stage(usd: dict[str, ModuleType], fps: float, frames: int, up: str, unit: str) -> Any:
    stage = usd["Usd"].Stage.CreateInMemory()
    usd["UsdGeom"].SetStageUpAxis(stage, up[1:].upper())
    usd["UsdGeom"].SetStageMetersPerUnit(stage, UNITS[unit])
    stage.SetTimeCodesPerSecond(fps)
    stage.SetFramesPerSecond(fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(frames - 1)
    stage.GetRootLayer().documentation = "bunraku"
    return stage


@dataclass(frozen=True, eq=False)
class _Skin:
    """A skeleton of J joints in the file's frame, none rotated at rest, its motion in N frames, and its weights."""

    joints: list[str]  # paths of the joints, every parent before its children
    # bind, local: their rest positions, in the world and from their parents, shape (J, 3)
    bind: np.ndarray
    local: np.ndarray
    # translations, rotations: of each in its parent's frame, shapes (N, J, 3) and (N, J, 4), xyzw, float32
    translations: np.ndarray
    rotations: np.ndarray
    # indices, weights: joints of each vertex and their shares, shape (V, M)
    indices: np.ndarray
    weights: np.ndarray


def _of_handles(animation: Animation, frame: FileFrame) -> _Skin:
    handles = animation.handles
    names = [prim_name(name) for name in handle_names(handles.played)]
    h = frame.points(handles.positions.astype(np.float64))
    joints = [names[0], *(f"{names[0]}/{name}" for name in names[1:])]
    moves, turns = joint_tracks(handles.positions, animation.motion)
    turns[..., :3] = turns[..., :3] @ frame.turn.T
    moves, turns = (np.ascontiguousarray(track, np.float32) for track in (frame.points(moves), turns))
    return _Skin(joints, h, np.concatenate([h[:1], h[1:] - h[0]]), moves, turns, *_influences(handles.weights))


def _of_bones(animation: RigAnimation, frame: FileFrame) -> _Skin:
    rig = animation.rig
    order = bone_order(rig.parents)
    place = {bone: number for number, bone in enumerate(order)}
    joints: list[str] = []
    local = rig.positions.astype(np.float64).copy()
    for bone in order:
        parent = int(rig.parents[bone])
        above = f"{joints[place[parent]]}/" if parent >= 0 else ""
        joints.append(free_name(above + prim_name(rig.names[bone]), joints, "_"))
        if parent >= 0:
            local[bone] -= rig.positions[parent]
    translations = (local + animation.translations)[:, order]
    matrices = frame.turn @ animation.rotations[:, order].astype(float) @ frame.turn.T
    return _Skin(
        joints,
        frame.points(rig.positions[order].astype(np.float64)),
        frame.points(local[order]),
        np.ascontiguousarray(frame.points(translations), np.float32),
        np.ascontiguousarray(continuous(quaternion_from_matrix(matrices)), np.float32),
        *_influences(rig.dense_weights()[:, order]),
    )


def _add_skinned(look: Look, character: Character, skin: _Skin, frame: FileFrame) -> None:
    Gf, UsdSkel, Vt = look.usd["Gf"], look.usd["UsdSkel"], look.usd["Vt"]
    joints = skin.joints
    skeleton = UsdSkel.Skeleton.Define(look.stage, f"{look.root}/Skeleton")
    skeleton.CreateJointsAttr(joints)
    for make, positions in (
        (skeleton.CreateBindTransformsAttr, skin.bind),
        (skeleton.CreateRestTransformsAttr, skin.local),
    ):
        make(Vt.Matrix4dArray([Gf.Matrix4d(1).SetTranslate(Gf.Vec3d(*matrix)) for matrix in positions.tolist()]))
    clip = UsdSkel.Animation.Define(look.stage, f"{look.root}/Skeleton/Animation")
    clip.CreateJointsAttr(joints)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([clip.GetPath()])
    clip.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)] * len(joints)))
    moved, turned = clip.CreateTranslationsAttr(), clip.CreateRotationsAttr()
    for number in range(len(skin.translations)):
        moved.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(skin.translations[number])), number)
        turned.Set(Vt.QuatfArray.FromNumpy(np.ascontiguousarray(skin.rotations[number])), number)

    width = skin.indices.shape[1]
    for piece in pieces(character):
        binding = UsdSkel.BindingAPI.Apply(add_mesh(look, piece, character, frame).GetPrim())
        binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        indices, weights = skin.indices[piece.index].reshape(-1), skin.weights[piece.index].reshape(-1)
        binding.CreateJointIndicesPrimvar(False, width).Set(Vt.IntArray.FromNumpy(indices))
        binding.CreateJointWeightsPrimvar(False, width).Set(Vt.FloatArray.FromNumpy(weights))
        binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))


def _influences(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All weights that matter, largest first: joints (V, M) int32 and shares (V, M) float32, M as needed."""
    seen = np.where(weights > 1e-5, weights, 0)  # less moves nothing that is seen
    indices, shares = top_influences(seen, max(int((seen > 0).sum(axis=1).max()), 1))
    return np.ascontiguousarray(indices, np.int32), np.ascontiguousarray(shares, np.float32)


def _texture_folder(path: Path) -> str:
    """Folder of the textures of a file: in the package, or beside the file."""
    return "textures" if path.suffix.lower() == ".usdz" else f"{prim_name(path.stem, 'usd')}_textures"


def _check_textures(path: Path, look: Look) -> None:
    """Raise FormatError where the folder for the textures holds anything but earlier ones."""
    folder = path.parent / look.folder
    if path.suffix.lower() == ".usdz" or not look.textures or not folder.exists():
        return
    if not folder.is_dir() or any(not re.fullmatch(r"image_\d+\.(png|jpg)", entry.name) for entry in folder.iterdir()):
        raise FormatError(path, f"{folder} exists and holds other files; choose another name for the USD file")


def _done(write: Callable[..., object], *arguments: str) -> bool:
    """Whether USD wrote something; it also says by an exception that the disk is full."""
    try:
        return bool(write(*arguments))
    except RuntimeError:  # pxr.Tf.ErrorException
        return False


def _export(usd: dict[str, ModuleType], stage: Any, path: Path, look: Look) -> Path:
    """Write the stage and its textures to a folder beside the target, and move them when they are complete."""
    _check_textures(path, look)
    suffix = path.suffix.lower()
    with (
        writing(path),
        tempfile.TemporaryDirectory(prefix=f".{path.stem[:100]}.", suffix=".tmp", dir=path.parent) as folder,
    ):
        layer = Path(folder, prim_name(path.stem) + (".usda" if suffix == ".usda" else ".usdc"))
        images = Path(folder, look.folder)
        written = _done(stage.GetRootLayer().Export, str(layer))
        if look.textures:
            images.mkdir()
            for name, data in look.textures.items():
                (images / name).write_bytes(data)
        if written and suffix == ".usdz":
            package = layer.with_suffix(".usdz")
            written = _done(usd["UsdUtils"].CreateNewUsdzPackage, str(layer), str(package))
            layer = package
        if not written:
            raise FormatError(path, "USD cannot write the file; choose another folder or free some space")
        share_file(layer)
        if look.textures and suffix != ".usdz":
            shutil.rmtree(path.parent / look.folder, ignore_errors=True)
            os.replace(images, path.parent / look.folder)
        os.replace(layer, path)
    return path
