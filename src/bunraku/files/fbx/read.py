"""Read FBX (Mixamo, Blender, Maya, 3ds Max) as a glTF document and as a character."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.character import Character
from bunraku.core.geometry.rotations import continuous, matrix_from_quaternion, nearest_rotation, quaternion_from_matrix
from bunraku.files.fbx.clips import read_clips, sample_clip
from bunraku.files.fbx.mesh import BONES, FbxMesh, FbxSkin, Materials, bind_matrices, inverses, read_mesh, read_skin
from bunraku.files.fbx.nodes import read_tree
from bunraku.files.fbx.scene import FbxObject, FbxScene, default_world, geometric_matrix, read_scene, world_matrices
from bunraku.files.gltf.colors import linear_from_srgb
from bunraku.files.gltf.document import ARRAY_BUFFER, Document, GltfBuilder, triangle_primitives, vertex_attributes
from bunraku.files.gltf.mesh import MAX_VERTICES
from bunraku.files.gltf.read import character_from_document


@dataclass(frozen=True, eq=False)
class _Placed:
    """A mesh where a model places it."""

    model: int
    geometry: FbxObject
    mesh: FbxMesh
    skin: FbxSkin | None


def scene_document(scene: FbxScene, fps: float | None = None) -> tuple[Document, np.ndarray]:
    """The meshes, skins, materials and, with `fps` [1/s], the clips of an FBX file. FormatError if something in the
    file is broken, or it holds no mesh.

    Returns:
        The document in its default pose, and the file's vertex (of all its meshes, one after another) of each document
            vertex, shape (U,).
    """
    return _Builder(scene).build(fps)


class _Builder:
    def __init__(self, scene: FbxScene):
        self.scene, self.frame = scene, scene.frame
        self.world = default_world(scene)
        self.placed = _placed_meshes(scene)
        clusters = [cluster for placed in self.placed if placed.skin for cluster in placed.skin.clusters]
        self.binds = bind_matrices(scene, self.world, clusters)
        self.materials = Materials(scene)
        path = scene.tree.path
        self.builder = GltfBuilder()
        self.builder.tree["scenes"] = [{"name": path.stem}]
        self.nodes: dict[int, int] = {}
        self.normalise: dict[int, np.ndarray] = {}

    def build(self, fps: float | None) -> tuple[Document, np.ndarray]:
        self._add_models()
        roots = [node for model, node in self.nodes.items() if self.scene.above(model, self.nodes) < 0]
        index, start, shared = [], 0, [joint for joint in self.binds if self.scene.models[joint].subtype in BONES]
        for placed in self.placed:
            node = self._add_mesh(placed, shared)
            if placed.skin is not None or placed.model not in self.nodes:
                roots.append(node)
            else:
                self._adopt(self.nodes[placed.model], node)
            if placed.skin is not None:
                shared = []  # the joints that no mesh is bound to are listed once
            index.append(placed.mesh.index + start)
            start += len(placed.mesh.points)
        if shared:  # no skin, but a skeleton that carries rigid pieces
            inverse = inverses(np.stack([self._world_of(joint) for joint in shared]))
            self._add_skin([self.nodes[joint] for joint in shared], inverse)
        tree = self.builder.tree
        tree["scenes"][0]["nodes"] = roots
        for data, mime in self.materials.images:
            self.builder.add("textures", {"source": self.builder.image(data, mime)})
        if self.materials.materials:
            tree["materials"] = self.materials.materials
        if fps is not None:
            self._add_clips(fps)
        return self.builder.document(self.scene.tree.path), np.concatenate(index)

    def _adopt(self, parent: int, child: int) -> None:
        self.builder.tree["nodes"][parent].setdefault("children", []).append(child)

    def _world_of(self, model: int) -> np.ndarray:
        return self.frame.world(self.world[model]) @ self.normalise[model]

    def _add_models(self) -> None:
        """Add a node for each joint, each model that carries an unskinned mesh, and all above them."""
        rigid = {placed.model for placed in self.placed if placed.skin is None}
        wanted = set()
        for model in {*rigid, *self.binds}:
            while model >= 0 and model not in wanted:
                wanted.add(model)
                model = int(self.scene.parents[model])
        for model in sorted(wanted):
            linear = self.frame.world(self.binds.get(model, self.world[model]))[:3, :3]
            self.normalise[model] = np.eye(4) if model in rigid else _unscaled(linear)
            local, above = self._world_of(model), self.scene.above(model, self.nodes)
            if above >= 0:
                local = inverses(self._world_of(above)[None])[0] @ local
            node = {"name": self.scene.models[model].name, **_node_transform(local)}
            self.nodes[model] = self.builder.add("nodes", node)
            if above >= 0:
                self._adopt(self.nodes[above], self.nodes[model])

    def _add_mesh(self, placed: _Placed, shared: list[int]) -> int:
        """Add a mesh with its node, and its skin; return the node."""
        model, mesh, skin = self.scene.models[placed.model], placed.mesh, placed.skin
        geometric = geometric_matrix(model)
        if skin is None:
            matrix = np.eye(4)
            matrix[:3, :3] = self.frame.hand
            matrix[:3] = matrix[:3] @ geometric
        else:
            bound = skin.clusters[0].bind @ skin.clusters[0].transform  # where the mesh stood when it was bound
            matrix = np.eye(4)
            matrix[:3, :3] = self.frame.axes
            matrix = matrix @ bound @ geometric
        linear = matrix[:3, :3]
        positions = self.frame.metres * (mesh.points @ linear.T + matrix[:3, 3])
        normals = None
        if mesh.normals is not None and abs(np.linalg.det(linear)) > 1e-30:
            normals = mesh.normals @ np.linalg.inv(linear)
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        uvs = None if mesh.uvs is None else mesh.uvs * [1, -1] + [0, 1]
        colors = None if mesh.colors is None else linear_from_srgb(np.clip(mesh.colors, 0, 1))
        attributes = vertex_attributes(self.builder, positions[mesh.index], normals, uvs, colors)
        node: dict[str, Any] = {"name": placed.geometry.name or model.name}
        if skin is not None:
            self._add_weights(attributes, skin, mesh.index)
            flat = abs(np.linalg.det(geometric)) <= 1e-30
            node["skin"] = self._bind(skin, matrix if flat else matrix @ np.linalg.inv(geometric), shared)
            node["name"] = model.name
        materials = self.scene.below(model, "Material")
        triangles = mesh.triangles[:, [0, 2, 1]] if np.linalg.det(linear) < 0 else mesh.triangles
        parts = (
            (triangles[mesh.materials == slot],
             self.materials.number(materials[slot]) if 0 <= slot < len(materials) else None)
            for slot in np.unique(mesh.materials)
        )  # fmt: skip
        primitives = triangle_primitives(self.builder, attributes, len(mesh.index), parts)
        node["mesh"] = self.builder.add("meshes", {"name": node["name"], "primitives": primitives})
        return self.builder.add("nodes", node)

    def _add_weights(self, attributes: dict[str, int], skin: FbxSkin, index: np.ndarray) -> None:
        width = -(-skin.indices.shape[1] // 4)
        more = (0, 0), (0, 4 * width - skin.indices.shape[1])
        joints = np.pad(skin.indices[index], more).astype("<u2")
        shares = np.pad(skin.weights[index], more).astype(np.float32)
        for part in range(width):
            columns = slice(4 * part, 4 * part + 4)
            attributes[f"JOINTS_{part}"] = self.builder.array(np.ascontiguousarray(joints[:, columns]), ARRAY_BUFFER)
            attributes[f"WEIGHTS_{part}"] = self.builder.array(np.ascontiguousarray(shares[:, columns]), ARRAY_BUFFER)

    def _bind(self, skin: FbxSkin, index: np.ndarray, shared: list[int]) -> int:
        """Add a mesh's skin with this placement; joints that nothing is bound to come after those of the clusters."""
        indices = [self.scene.indices[cluster.joint.id] for cluster in skin.clusters]
        extra = [joint for joint in shared if joint not in indices]
        scale = np.diag([*3 * [self.frame.metres], 1.0])
        hand = np.eye(4)
        hand[:3, :3] = self.frame.hand
        back = np.linalg.inv(scale @ index)
        into = scale @ hand
        inverse = [
            inverses(self.normalise[index][None])[0] @ into @ cluster.transform @ back
            for index, cluster in zip(indices, skin.clusters, strict=True)
        ]
        inverse += [inverses((self.frame.world(self.binds[joint]) @ self.normalise[joint])[None])[0] for joint in extra]
        return self._add_skin([self.nodes[joint] for joint in indices + extra], np.stack(inverse))

    def _add_skin(self, joints: list[int], inverse: np.ndarray) -> int:
        return self.builder.add("skins", {"joints": joints, "inverseBindMatrices": self.builder.matrices(inverse)})

    def _add_clips(self, fps: float) -> None:
        models = list(self.nodes)
        for clip in read_clips(self.scene):
            values, count = sample_clip(self.scene, clip, fps)
            raw = world_matrices(self.scene, values, models)
            pairs = zip(models, raw, strict=True)
            world = {model: self.frame.world(some) @ self.normalise[model] for model, some in pairs}
            clock = self.builder.array((np.arange(count) / fps).astype(np.float32)[:, None], bounds=True)
            entry: dict[str, Any] = {"name": clip.name, "channels": [], "samplers": []}
            for model in models:
                above = self.scene.above(model, self.nodes)
                if len(world[model]) == 1:
                    continue
                local = world[model] if above < 0 else inverses(world[above]) @ world[model]
                for path, track in zip(("translation", "rotation", "scale"), _decompose(local), strict=True):
                    keys = self.builder.array(track.astype(np.float32))
                    self.builder.channel(entry, self.nodes[model], path, clock, keys)
            if entry["channels"]:
                self.builder.add("animations", entry)


def _placed_meshes(scene: FbxScene) -> list[_Placed]:
    """All meshes with faces that are not hidden, wherever models place them."""
    placed: list[tuple[int, FbxObject]] = []
    for index, model in enumerate(scene.models):
        placed += [(index, geometry) for geometry in scene.below(model, "Geometry", "Mesh")]
    shown = [(index, geometry) for index, geometry in placed if scene.models[index].number("Visibility", 1) > 0]
    read: dict[int, tuple[FbxMesh, FbxSkin | None]] = {}
    out, total = [], 0
    for index, geometry in shown or placed:
        if geometry.id not in read:
            mesh = read_mesh(scene, geometry)
            read[geometry.id] = mesh, read_skin(scene, geometry, len(mesh.points))
        mesh, skin = read[geometry.id]
        total += len(mesh.index)
        if total > MAX_VERTICES:
            scene.tree.fail(f"it has more than {MAX_VERTICES:,} vertices; simplify the mesh first")
        if len(mesh.triangles):
            out.append(_Placed(index, geometry, mesh, skin))
    if not out:
        scene.tree.fail("it holds no mesh with faces; export the character with its mesh")
    return out


def _unscaled(linear: np.ndarray) -> np.ndarray:
    """N that makes a linear map the rotation nearest to it, shape (4, 4); the identity where it is flat."""
    out = np.eye(4)
    if abs(np.linalg.det(linear)) > 1e-30:
        out[:3, :3] = np.linalg.inv(linear) @ nearest_rotation(linear)
    return out


def _decompose(local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Translation, rotation as a quaternion whose sign never jumps, and scale (N, 3), (N, 4), (N, 3), without shear."""
    linear = local[:, :3, :3]
    scale = np.linalg.norm(linear, axis=1)
    scale[:, 0] *= np.where(np.linalg.det(linear) < 0, -1, 1)
    unit = linear / np.where(np.abs(scale) > 1e-12, scale, 1)[:, None, :]
    return local[:, :3, 3], continuous(quaternion_from_matrix(nearest_rotation(unit))), scale


def _node_transform(local: np.ndarray) -> dict[str, Any]:
    """A transform as a glTF node holds it: three parts where they suffice, a matrix otherwise."""
    translation, quaternion, scale = (part[0] for part in _decompose(local[None]))
    if np.abs(matrix_from_quaternion(quaternion) * scale - local[:3, :3]).max() <= 1e-6 * np.abs(local[:3, :3]).max():
        return {"translation": translation.tolist(), "rotation": quaternion.tolist(), "scale": scale.tolist()}
    return {"matrix": local.T.reshape(-1).tolist()}


def read_fbx(path: Path, data: bytes, *, rest: str = "bind", clip_fps: float | None = None) -> Character:
    """Read an FBX file of version 7.1 to 7.7, binary or text. The vertices are the control points of all meshes in the
    order of the file, in our frame and unit; hidden meshes are left out where others are not, and blend shapes are not
    read. The character rests as in `load_character`; with `clip_fps` [1/s] its document has the file's clips.
    FormatError if the file is broken, of a version that is not read, or holds no mesh; CharacterError if what it holds
    is no character.
    """
    document, index = scene_document(read_scene(read_tree(path, data)), clip_fps)
    return character_from_document(document, path.stem, index, ".fbx", rest=rest)


def fbx_facts(path: Path, data: bytes) -> dict[str, Any]:
    """Facts about an FBX file: version, program, clips, unit and axes. FormatError if the file is broken, or of a
    version that is not read.
    """
    tree = read_tree(path, data)
    scene = read_scene(tree)
    frame = scene.frame
    clips = [
        {"name": clip.name, "seconds": round(clip.seconds, 3), "channels": len(clip.curves)}
        for clip in read_clips(scene)
    ]
    return {
        "generator": tree.root.text("Creator") or tree.section("FBXHeaderExtension").text("Creator"),
        "fbx_version": f"{tree.version / 1000:.1f}",
        "file_unit": f"{frame.metres:.6g} m",
        "meshes": len([thing for thing in scene.of_kind("Geometry") if thing.subtype == "Mesh"]),
        "file_axes": f"up {frame.up}, front {frame.front}",
        "animations": clips,
    }
