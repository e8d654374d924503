"""Copy meshes, materials, images and clips of one glTF document to another, with their values as they are."""

from __future__ import annotations

import base64
import copy
from collections.abc import Collection, Container, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.errors import FormatError, OptionError
from bunraku.files.gltf.document import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Document, GltfBuilder
from bunraku.files.gltf.mesh import MeshPart, skin_matrices
from bunraku.files.gltf.read import Source

_WHITE_PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAIAAACQd1PeAAAADElEQVR4nGP4//8/AAX+Av4N70a4AAAAAElFTkSuQmCC"
)
_PRIMITIVE_EXTENSIONS = ("KHR_materials_variants", "FB_ngon_encoding")
_ROOT_EXTENSIONS = ("KHR_materials_variants", "KHR_xmp_json_ld")


def carry_tree(document: Document) -> dict[str, Any]:
    """A new tree with the asset, materials, textures and samplers of a document, and one empty scene."""
    old = document.tree
    asset = {key: copy.deepcopy(old["asset"][key]) for key in ("copyright", "extras") if key in old["asset"]}
    tree: dict[str, Any] = {"asset": {"version": "2.0", "generator": "bunraku", **asset}, "scene": 0, "scenes": [{}]}
    scenes, scene = document.items("scenes"), old.get("scene", 0)
    if scenes and isinstance(scene, int) and scene < len(scenes):
        tree["scenes"][0].update(
            {key: copy.deepcopy(scenes[scene][key]) for key in ("name", "extras") if key in scenes[scene]}
        )
    for key in ("materials", "textures", "samplers"):
        if document.items(key):
            tree[key] = copy.deepcopy(document.items(key))
    extensions = document.extensions
    kept = {name: copy.deepcopy(extensions[name]) for name in _ROOT_EXTENSIONS if name in extensions}
    if kept:
        tree["extensions"] = kept
    if "extras" in old:
        tree["extras"] = copy.deepcopy(old["extras"])
    for key in ("extensionsUsed", "extensionsRequired"):
        if isinstance(old.get(key), list):
            tree[key] = [name for name in old[key] if isinstance(name, str)]
    return tree


def carry_images(document: Document, builder: GltfBuilder) -> None:
    """Embed the images of a document; one whose file is missing becomes white."""
    for index, image in enumerate(document.items("images")):
        data = document.image(index)
        mime = image_type(bytes(data[:16])) if data is not None else None
        if data is not None and mime is None and isinstance(image.get("mimeType"), str):
            mime = image["mimeType"]  # a kind that an extension brings, such as image/ktx2
        if data is None or mime is None:
            data, mime = _WHITE_PNG, "image/png"
        builder.image(data, mime, **{key: copy.deepcopy(image[key]) for key in ("name", "extras") if key in image})


def image_type(start: bytes) -> str | None:
    """MIME type of an image by its first bytes."""
    if start.startswith(b"\x89PNG"):
        return "image/png"
    if start.startswith(b"\xff\xd8\xff"):
        return "image/jpeg"
    return "image/webp" if start[:4] == b"RIFF" and start[8:12] == b"WEBP" else None


IMAGE_SUFFIXES = {"image/png": ".png", "image/jpeg": ".jpg"}
"""Suffixes of the images that other formats than glTF can hold."""


def used_extensions(tree: dict[str, object]) -> None:
    """Make the lists of extensions name those that the tree still uses, and no others."""
    extensions: set[str] = set()
    stack: list[Any] = [tree]
    while stack:
        item = stack.pop()
        if isinstance(item, dict):
            if isinstance(item.get("extensions"), dict):
                extensions.update(item["extensions"])
            stack += {**item, "extras": None}.values()
        elif isinstance(item, list):
            stack.extend(item)
    used, needed = (tree.pop(key, []) for key in ("extensionsUsed", "extensionsRequired"))
    if isinstance(used, list) and "KHR_mesh_quantization" in used:
        extensions.add("KHR_mesh_quantization")
    required = [name for name in needed if name in extensions] if isinstance(needed, list) else []
    if extensions:
        tree["extensionsUsed"] = sorted(extensions)
    if required:
        tree["extensionsRequired"] = required


class MeshCarrier:
    """Carries meshes of a source into a builder, each accessor once."""

    def __init__(self, source: Source, builder: GltfBuilder):
        self.source, self.document, self.builder = source, source.document, builder
        self._carried: dict[tuple[int, str], int] = {}

    def mesh(self, part: MeshPart, rest: np.ndarray | None, index: np.ndarray) -> dict[str, Any]:
        """A mesh entry without joints and weights, of a part whose vertices are these of the character, shape (V,).
        Positions `rest` [m], shape (V, 3) over its groups, replace the raw ones, and normals, tangents and morph
        targets are bent as its skin bends them; None keeps everything as it is.
        """
        old = self.document.item("meshes", part.mesh)
        mesh: dict[str, Any] = {key: copy.deepcopy(old[key]) for key in ("name", "extras") if key in old}
        weights = self.document.item("nodes", part.node).get("weights", old.get("weights"))
        primitives: list[dict[str, Any]] = [{} for _ in self.document.objects(old, "primitives")]
        start = 0
        for number, group in enumerate(part.groups):
            stop = start + len(group.vertices)
            bend = None
            if rest is not None:
                matrices = skin_matrices(self.document, self.source.tree, self.source.skins, part, number)
                posed = self.source.moved
                if posed is not None:
                    matrices = posed[index[start:stop]] @ matrices
                bend = _Bend(rest[start:stop], group.vertices, matrices, posed is not None)
            first = old["primitives"][group.primitives[0]]
            shared = self._vertex_data(first, stop - start, bend)
            for member, triangles in zip(group.primitives, group.triangles, strict=True):
                own = old["primitives"][member]
                alike = own["attributes"] == first["attributes"]
                data = shared if alike else self._vertex_data(own, stop - start, bend)
                data = {**data, "attributes": dict(data["attributes"])}
                primitives[member] = self._primitive(own, data, triangles if part.mirrored else None)
            start = stop
        mesh["primitives"] = [primitive for primitive in primitives if primitive]
        if weights and all("targets" in primitive for primitive in mesh["primitives"]):
            mesh["weights"] = copy.deepcopy(weights)
        return mesh

    def primitive(self, old: dict[str, object], count: int) -> dict[str, Any]:
        """A primitive of the source with `count` vertices as it is, without joints and weights."""
        return self._primitive(old, self._vertex_data(old, count, None), None)

    def _primitive(
        self, old: dict[str, object], data: dict[str, object], triangles: np.ndarray | None
    ) -> dict[str, Any]:
        primitive = {**data}
        primitive.update((key, copy.deepcopy(old[key])) for key in ("material", "mode", "extras") if key in old)
        if triangles is not None and len(triangles):
            primitive.pop("mode", None)
            primitive["indices"] = self.builder.array(triangles.reshape(-1, 1).astype("<u4"), ELEMENT_ARRAY_BUFFER)
        elif "indices" in old:
            primitive["indices"] = self._carry(old["indices"], "INDEX")
        extensions = old.get("extensions")
        if isinstance(extensions, dict) and triangles is None:
            kept = {name: copy.deepcopy(extensions[name]) for name in _PRIMITIVE_EXTENSIONS if name in extensions}
            if kept:
                primitive["extensions"] = kept
        return primitive

    def _vertex_data(self, old: dict[str, object], count: int, bend: _Bend | None) -> dict[str, Any]:
        attributes = {}
        for name, accessor in self.document.entry(old, "attributes").items():
            if name.startswith(("JOINTS_", "WEIGHTS_")) or self.document.count(accessor) != count or not count:
                continue
            if str(self.document.item("accessors", accessor).get("type")).startswith("MAT"):
                continue  # glTF gives no meaning to matrices a vertex
            if bend is not None and name in ("POSITION", "NORMAL", "TANGENT"):
                values = self.document.accessor(accessor, ("VEC4",) if name == "TANGENT" else ("VEC3",))
                bent = bend.attribute(name, values.astype(np.float64), keep_base="targets" in old)
                repaired = _repaired(name, bent.astype(np.float32))
                attributes[name] = self.builder.array(repaired, ARRAY_BUFFER, bounds=name == "POSITION")
            else:
                attributes[name] = self._carry(accessor, name)
        data: dict[str, Any] = {"attributes": attributes}
        targets = self.document.objects(old, "targets")
        if targets and (bend is None or bend.faithful):
            data["targets"] = [self._target(target, count, bend) for target in targets]
        return data

    def _target(self, target: dict[str, object], count: int, bend: _Bend | None) -> dict[str, int]:
        out = {}
        for name, accessor in target.items():
            if self.document.count(accessor) != count:
                continue
            if bend is not None and name in ("POSITION", "NORMAL", "TANGENT"):
                bent = bend.offset(name, self.document.accessor(accessor, ("VEC3",)).astype(np.float64))
                stored = np.nan_to_num(bent.astype(np.float32))
                out[name] = self.builder.array(stored, ARRAY_BUFFER, bounds=name == "POSITION")
            else:
                out[name] = self._carry(accessor, f"target {name}")
        return out

    def _carry(self, index: Any, role: str) -> int:
        key = (index, role)
        if key not in self._carried:
            self._carried[key] = self._copy(index, role)
        return self._carried[key]

    def _copy(self, index: int, role: str) -> int:
        old = self.document.item("accessors", index)
        extra: dict[str, Any] = {
            name: copy.deepcopy(old[name]) for name in ("name", "normalized", "extras") if name in old
        }
        kinds = ("SCALAR",) if role == "INDEX" else ("SCALAR", "VEC2", "VEC3", "VEC4")
        bounds = role in ("POSITION", "target POSITION")
        if not {"bufferView", "sparse"} & old.keys() and not role.endswith(("INDEX", "POSITION", "NORMAL", "TANGENT")):
            return self.builder.zeros({**extra, **{name: old[name] for name in ("componentType", "count", "type")}})
        values = self.document.accessor(index, kinds, raw=True)
        if role == "INDEX":
            if len(values) and values.itemsize < 4 and int(values.max()) == np.iinfo(values.dtype).max:
                values = values.astype("<u2" if values.itemsize == 1 else "<u4")  # the largest index means restart
            return self.builder.array(values, ELEMENT_ARRAY_BUFFER, **extra)
        return self.builder.array(_repaired(role, values), ARRAY_BUFFER, bounds=bounds, **extra)


class _Bend:
    """How a skin, or a mirroring node, bends the vertex data of a mesh into its rest pose."""

    def __init__(self, rest: np.ndarray, vertices: np.ndarray, matrices: np.ndarray, posed: bool = False):
        self.rest, self.matrices = rest, matrices
        self.linear = matrices[:, :3, :3]
        a, b, c = self.linear[:, :, 0], self.linear[:, :, 1], self.linear[:, :, 2]
        cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
        self.sign = np.where((a * cofactors[:, :, 0]).sum(axis=1) < 0, -1.0, 1.0)
        self.normal = cofactors * self.sign[:, None, None]
        size = float(np.ptp(vertices, axis=0).max(initial=0))
        self.faithful = posed or bool(
            np.abs(vertices - rest).max(initial=0) <= 1e-5 * size + 1e-6 * np.abs(vertices).max(initial=0)
        )

    def attribute(self, name: str, values: np.ndarray, keep_base: bool) -> np.ndarray:
        if name == "POSITION":
            if keep_base and self.faithful:  # morph targets come on top of it
                return self._apply(self.linear, values) + self.matrices[:, :3, 3]
            return self.rest
        out = values.copy()
        bent = self._apply(self.normal if name == "NORMAL" else self.linear, values[:, :3])
        length = np.linalg.norm(bent, axis=1, keepdims=True)
        out[:, :3] = bent / np.where(length > 1e-30, length, 1)
        if name == "TANGENT":
            out[:, 3] *= self.sign
        return out

    def offset(self, name: str, values: np.ndarray) -> np.ndarray:
        if name == "POSITION":
            return self._apply(self.linear, values)
        scale = np.cbrt(np.abs(np.linalg.det(self.linear)))[:, None]
        return self._apply(self.linear, values) / np.where(scale > 1e-12, scale, 1)

    @staticmethod
    def _apply(matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
        out: np.ndarray = np.einsum("vij,vj->vi", matrices, values)
        return out


def _repaired(role: str, values: np.ndarray) -> np.ndarray:
    """Values that a file may hold: finite, unit normals, colours from 0 to 1. Good values are returned as they are."""
    if values.dtype.kind != "f":
        return values
    if not np.isfinite(values).all():
        values = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
    if role in ("NORMAL", "TANGENT"):
        length = np.linalg.norm(values[:, :3].astype(np.float64), axis=1)
        bad = np.abs(length - 1) > 0.004
        if bad.any():
            values = values.copy()
            values[bad, :3] /= np.where(length[bad] > 1e-30, length[bad], 1)[:, None]
            values[length <= 1e-30, :3] = (0, 1, 0) if role == "NORMAL" else (1, 0, 0)
        if role == "TANGENT" and (np.abs(values[:, 3]) != 1).any():
            values = values.copy()
            values[:, 3] = np.where(values[:, 3] < 0, -1, 1)
    elif role.startswith("COLOR_") and (values.min(initial=0) < 0 or values.max(initial=0) > 1):
        values = np.clip(values, 0, 1)
    return values


_OUTPUTS = {"translation": ("VEC3",), "rotation": ("VEC4",), "scale": ("VEC3",), "weights": ("SCALAR",)}


def clip_names(document: Document) -> list[str]:
    """Names of the clips of a document, numbered where it gives none."""
    return [str(clip.get("name") or f"animation {number}") for number, clip in enumerate(document.items("animations"))]


def clip_number(path: Path, names: list[str], clip: int | str) -> int:
    """Number of a clip by its number or name, with or without its armature's name before a bar. OptionError if there is
    no clip of this name or number.
    """
    for known in (names, [name.rsplit("|", 1)[-1] for name in names]):  # exporters write "Armature|Walk"
        if clip in known:
            return known.index(str(clip))
    number = int(clip) if str(clip).isdecimal() else -1
    if not 0 <= number < len(names):
        raise OptionError(f"{path} has no clip {clip!r}; it has {', '.join(names[:20])}")
    return number


def free_name(name: str, taken: Container[str], between: str = "-", number: int = 2) -> str:
    """The name, with the first free number after it where it is taken."""
    out = name
    while out in taken:
        out, number = f"{name}{between}{number}", number + 1
    return out


def carry_clips(
    document: Document,
    builder: GltfBuilder,
    nodes: Mapping[int, int],
    unnamed: str | None = None,
    only: Collection[str] | None = None,
) -> list[str]:
    """Add clips of a document, all or `only` those of some names, to the builder of another, and return their names;
    names that are taken get a number, and clips without one that of `unnamed`. `nodes` has the builder's node for each
    node of the document; channels of others are left out, as are broken ones, and clips without channels.
    """
    names = [str(clip.get("name")) for clip in builder.tree.get("animations", [])]
    added: list[str] = []
    carried: dict[tuple[int, tuple[str, ...]], int] = {}

    def keys(index: int, kinds: tuple[str, ...]) -> int:
        if (index, kinds) not in carried:
            values = document.accessor(index, kinds, raw=True)
            extra = {"normalized": True} if document.item("accessors", index).get("normalized") else {}
            carried[index, kinds] = builder.array(values, bounds=kinds == ("SCALAR",), **extra)
        return carried[index, kinds]

    for clip in document.items("animations"):
        if only is not None and clip.get("name") not in only:
            continue
        samplers: list[object] = []
        channels: list[object] = []
        for channel in document.objects(clip, "channels"):
            target = channel.get("target")
            path = target.get("path") if isinstance(target, dict) else None
            node = nodes.get(target.get("node", -1)) if isinstance(target, dict) else None
            listed = document.objects(clip, "samplers")
            number = channel.get("sampler")
            if path not in _OUTPUTS or node is None or type(number) is not int or not 0 <= number < len(listed):
                continue
            old = listed[number]
            try:
                sampler = {"input": keys(old["input"], ("SCALAR",)), "output": keys(old["output"], _OUTPUTS[path])}
            except (FormatError, KeyError):
                continue
            if old.get("interpolation") in ("STEP", "CUBICSPLINE", "LINEAR"):
                sampler["interpolation"] = old["interpolation"]
            channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
            samplers.append(sampler)
        if channels:
            given = clip.get("name") or unnamed
            name = free_name(str(given), names) if given else ""
            names.append(name)
            added.append(name)
            kept = {"extras": clip["extras"]} if isinstance(clip.get("extras"), dict) else {}
            named = {"name": name} if name else {}
            builder.add("animations", {**named, **kept, "channels": channels, "samplers": samplers})
    return added
