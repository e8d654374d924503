"""Write animations of a rig as GLB: the file's own nodes, skins, materials and clips, and the new clips beside them."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.avatars import VrmModel
from bunraku.core.body.layout import BESIDE, handle_names
from bunraku.core.character import Character, Handles, Rig, top_influences, written_rig
from bunraku.core.geometry.rotations import Resampling, continuous, nearest_rotation, quaternion_from_matrix
from bunraku.core.motion import checked_fps
from bunraku.files.gltf.carry import MeshCarrier, carry_clips, carry_images, carry_tree
from bunraku.files.gltf.document import ARRAY_BUFFER, GltfBuilder
from bunraku.files.gltf.mesh import MeshPart
from bunraku.files.gltf.nodes import front_matrix, read_nodes
from bunraku.files.gltf.read import Source
from bunraku.files.gltf.vrm import add_humanoid, add_spring_extras
from bunraku.files.gltf.write import build_document, document_of, drop_clip, finish_document, writable

SMALL = 1e-6  # what changes less, over the size of the rig or as a quaternion, stands still; some roundings of float32


def add_bone_clip(
    builder: GltfBuilder, joints: list[int], local: np.ndarray, have: float, want: float, name: str
) -> None:
    """Add an animation of the nodes of bones: channels where a node leaves what its entry says, one key where it stays
    there. `local` are their transforms in their parents, shape (N, J, 4, 4), at a rate `have`; the channels get the
    rate `want` [1/s].
    """
    nodes = builder.tree["nodes"]
    scale = np.linalg.norm(local[..., :3, :3], axis=-2)
    between = Resampling.of(len(local), have, want)
    turned = between.quaternions(continuous(bone_tracks(local)[1]))
    size = max(float(np.abs(local[..., :3, 3]).max()), 1e-9)
    every = builder.array((np.arange(len(between)) / want).astype(np.float32)[:, None], bounds=True)
    once = builder.array(np.zeros((1, 1), np.float32), bounds=True)
    tracks = (
        ("translation", between.linear(local[..., :3, 3]), SMALL * size),
        ("rotation", turned, SMALL),
        ("scale", between.linear(scale), None),
    )
    clip: dict[str, Any] = {"name": name, "channels": [], "samplers": []}
    for joint, node in enumerate(joints):
        rest = placed(nodes[node])
        for kind, values, small in tracks:
            track = values[:, joint].astype(np.float32)
            limit = small if small is not None else 1e-4 * float(np.abs(rest["scale"]).max())
            moves = float(np.ptp(track, axis=0).max()) > limit
            if not moves and kind != "rotation" and np.abs(track[0] - rest[kind]).max() <= limit:
                continue
            if kind == "scale":
                track, moves = track[:1], False  # bones are stiff
            data = builder.array(np.ascontiguousarray(track if moves else track[:1]))
            builder.channel(clip, node, kind, every if moves else once, data)
    if not any(sampler["input"] == every for sampler in clip["samplers"]):
        # One channel keeps the length of a motion that stands still.
        first = next(channel["sampler"] for channel in clip["channels"] if channel["target"]["path"] == "rotation")
        still = np.repeat(turned[:1, 0].astype(np.float32), len(between), axis=0)
        clip["samplers"][first] |= {"input": every, "output": builder.array(still)}
    builder.add("animations", clip)


def bone_tracks(local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Translations [m] (N, J, 3) and rotations (N, J, 4), quaternions xyzw, of transforms of shape (N, J, 4, 4)."""
    linear = local[..., :3, :3]
    scale = np.linalg.norm(linear, axis=-2)
    return local[..., :3, 3], quaternion_from_matrix(nearest_rotation(linear / np.maximum(scale, 1e-12)[..., None, :]))


def placed(node: dict[str, object]) -> dict[str, np.ndarray]:
    """Translation, rotation and scale of a node's entry, which loses its matrix, since animated nodes may have none."""
    if "matrix" in node:
        matrix = np.array(node.pop("matrix"), float).reshape(4, 4).T
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        rotation = quaternion_from_matrix(nearest_rotation(matrix[:3, :3] / np.maximum(scale, 1e-12)))
        node |= {"translation": matrix[:3, 3].tolist(), "rotation": rotation.tolist(), "scale": scale.tolist()}
    defaults = {"translation": (0, 0, 0), "rotation": (0, 0, 0, 1), "scale": (1, 1, 1)}
    return {key: np.array(node.get(key, value), float) for key, value in defaults.items()}


_KEPT = ("asset", "nodes", "scene", "scenes", "cameras", "extensions", "extras", "extensionsUsed", "extensionsRequired")


@dataclass(frozen=True, eq=False)
class RigDocument:
    """A document with the bones of a character, to which clips are added."""

    builder: GltfBuilder  # the document
    nodes: list[int]  # node of each bone, length J
    source: Source | None  # the character's document where its own nodes are kept
    above: np.ndarray  # from the space of that document's scene to ours, shape (4, 4)

    @classmethod
    def of(cls, character: Character) -> RigDocument:
        """That of a character with a rig."""
        source, bones = character.source, len(written_rig(character).names)
        if not isinstance(source, Source) or source.moved is not None or len(source.skins.nodes) != bones:
            source = None
        if source is None or not source.fits(character):
            return cls(*plain_rig(character), None, np.eye(4))
        builder, nodes = _own_rig(source)
        return cls(builder, nodes, source, _above_all(source, builder))

    def local(self, animation: RigAnimation) -> np.ndarray:
        """Transform of each bone's node in its parent, shape (N, J, 4, 4)."""
        return _plain_local(animation) if self.source is None else _local(self.source, animation, self.above)


def with_still(animation: Animation) -> Animation | RigAnimation:
    """The animation on joints where something stands still beside the body: one for that, and below it the handles."""
    character, handles, motion = animation.character, animation.handles, animation.motion
    beside = character.beside
    if beside is None or not beside.any():
        return animation
    count = len(handles.positions)
    weights = np.concatenate([beside[:, None], handles.weights * ~beside[:, None]], axis=1)
    transforms = np.tile(np.eye(4), (count + 1, 1, 1))
    transforms[1:, :3, 3] = handles.positions
    parents = np.array([-1, 0, *[1] * (count - 1)])
    rig = Rig((BESIDE, *handle_names(handles.played)), parents, transforms, *top_influences(weights, 4))
    rotations = np.tile(np.eye(3), (len(motion), count + 1, 1, 1))
    translations = np.zeros((len(motion), count + 1, 3))
    rotations[:, 2:], translations[:, 2:] = motion.rotations[:, 1:], motion.translations[:, 1:]
    rotations[:, 1], translations[:, 1] = motion.root_rotation, motion.root_translation
    moved = replace(character, rig=rig, beside=None)
    return RigAnimation(moved, rotations, translations, motion.fps, animation.reference)


def save_rig_animation(
    animation: RigAnimation, path: str | Path, *, fps: float | None = None, name: str | None = None
) -> Path:
    """Write an animation of a rig as GLB, the clip named as the file or otherwise; options as of `save_rig_clips`."""
    path = Path(path)
    return save_rig_clips({str(name) if name else path.stem: animation}, path, fps=fps)


def save_rig_clips(clips: Mapping[str, RigAnimation], path: Path, *, fps: float | None = None) -> Path:
    """Write several animations of one character as GLB, each as a clip of its name, and the file's own clips after
    them; channels have `fps` [1/s] or each motion's rate. FormatError if the file cannot be written; OptionError if
    `fps` is not a number from 1 to 1000.
    """
    animation = next(iter(clips.values()))
    rates = {name: checked_fps(fps, clip.fps) for name, clip in clips.items()}
    with writable(path, animation.character.name):
        written = RigDocument.of(animation.character)
        builder, source = written.builder, written.source
        for name, clip in clips.items():
            add_bone_clip(builder, written.nodes, written.local(clip), clip.fps, rates[name], name)
        if source:
            carry_clips(source.document, builder, {node: node for node in range(len(source.document.items("nodes")))})
    return finish_document(builder, path)


def write_character(
    character: Character, handles: Handles | None, path: Path, *, rig: bool = False, avatar: VrmModel | None = None
) -> Path:
    """Write a character as GLB, with its handles or its own rig as a skin where there are some; with a rig also springs
    of its bones, in the document's extras. FormatError if the file cannot be written; CharacterError if the handles
    weigh another number of vertices, or there is no rig to write.
    """
    if rig:
        written_rig(character)
        builder, nodes = plain_rig(character)
        if avatar is not None:
            add_spring_extras(builder.tree, avatar, nodes)
        return finish_document(builder, path)
    if handles is not None:
        handles.check_vertices(len(character.vertices), character.name)
    return finish_document(build_document(character, handles, path)[0], path)


def _own_rig(source: Source) -> tuple[GltfBuilder, list[int]]:
    """The document with its own nodes and without clips; also the nodes of the bones."""
    document = source.document
    tree = carry_tree(document)
    tree.update({key: copy.deepcopy(document.tree[key]) for key in _KEPT if key in document.tree})
    tree["asset"] = {**tree["asset"], "version": "2.0", "generator": "bunraku"}
    builder = GltfBuilder(drop_clip(tree))
    carry_images(document, builder)
    carrier = MeshCarrier(source, builder)
    parts = {part.mesh: part for part in reversed(source.parts)}
    tree.pop("meshes", None)
    for number in range(len(document.items("meshes"))):
        builder.add("meshes", _mesh(carrier, number, parts.get(number)))
    for skin, matrices in zip(document.items("skins"), source.skins.inverse, strict=True):
        entry: dict[str, Any] = {
            key: copy.deepcopy(skin[key]) for key in ("name", "joints", "skeleton", "extras") if key in skin
        }
        if "inverseBindMatrices" in skin:
            entry["inverseBindMatrices"] = builder.matrices(matrices)
        builder.add("skins", entry)
    for node in tree.get("nodes", []):
        if isinstance(node.get("extensions"), dict):
            node["extensions"].pop("EXT_mesh_gpu_instancing", None)  # it names accessors
            if not node["extensions"]:
                del node["extensions"]
    _lift_skinned(builder)
    return builder, source.skins.nodes


def _lift_skinned(builder: GltfBuilder) -> None:
    """Put nodes with a skinned mesh on top of the scene, without a transform: in glTF no transform above moves them."""
    nodes = builder.tree.get("nodes", [])
    lifted = {
        number for number, node in enumerate(nodes) if "mesh" in node and "skin" in node and not node.get("children")
    }
    above = {int(child): node for node in nodes for child in node.get("children", [])}
    for scene in builder.tree.get("scenes", []):
        stack, shown = list(scene.get("nodes", [])), set()
        while stack:
            number = stack.pop()
            if number not in shown:
                shown.add(number)
                stack.extend(nodes[number].get("children", []))
        listed = scene.get("nodes", []) + sorted(number for number in lifted & shown if number in above)
        if listed:  # a list may not be empty
            scene["nodes"] = listed
    for number in lifted:
        for key in ("matrix", "translation", "rotation", "scale"):
            nodes[number].pop(key, None)
        if number in above:
            above[number]["children"].remove(number)
            if not above[number]["children"]:
                del above[number]["children"]


def _above_all(source: Source, builder: GltfBuilder) -> np.ndarray:
    """From the space of the file's scene to ours, shape (4, 4). A character turned upright gets a node above all."""
    file = read_nodes(source.document)  # turned to the front where the file is a VRM 0.x
    roots = np.flatnonzero(source.tree.parents < 0)
    turn = source.tree.local[roots[0]] @ np.linalg.inv(file.local[roots[0]]) if len(roots) else np.eye(4)
    turn = np.round(turn) if np.allclose(turn, np.round(turn), atol=1e-6) else np.eye(4)
    if not np.array_equal(turn, np.eye(4)):
        nodes = builder.tree["nodes"]
        for scene in builder.tree.get("scenes", []):
            listed = scene.get("nodes", [])
            free = [node for node in listed if "skin" in nodes[node] and not nodes[node].get("children")]
            below = [node for node in listed if node not in free]
            if below:
                entry: dict[str, Any] = {"name": "upright", "matrix": turn.T.reshape(-1).tolist(), "children": below}
                scene["nodes"] = [*free, builder.add("nodes", entry)]
    return np.asarray(turn @ front_matrix(source.document))


def _local(source: Source, animation: RigAnimation, above_all: np.ndarray) -> np.ndarray:
    """Transform of each bone's node in its parent, shape (N, J, 4, 4)."""
    rig = animation.rig
    moved = animation.transforms().astype(np.float64)
    bones = {node: bone for bone, node in enumerate(source.skins.nodes)}
    frames = len(moved)
    world: dict[int, np.ndarray] = {}
    out = np.empty((frames, len(bones), 4, 4))
    for node in source.tree.order:
        parent = int(source.tree.parents[node])
        above = world[parent] if parent >= 0 else above_all
        bone = bones.get(node)
        if bone is None:
            world[node] = world[parent] @ source.tree.local[node] if parent >= 0 else source.tree.local[node]
            continue
        here = np.zeros((frames, 4, 4))
        here[:, :3] = moved[:, bone, :, :3] @ rig.transforms[bone][:3]
        here[:, :3, 3] += moved[:, bone, :, 3]
        here[:, 3, 3] = 1
        world[node], out[:, bone] = here, np.linalg.pinv(above) @ here
    return out


def _mesh(carrier: MeshCarrier, number: int, part: MeshPart | None) -> dict[str, Any]:
    document, builder = carrier.document, carrier.builder
    old = document.item("meshes", number)
    if part is None:  # in no scene: kept without vertices of its own skin
        part = MeshPart(-1, number, np.eye(4), False, ())
    mesh: dict[str, Any] = {key: copy.deepcopy(old[key]) for key in ("name", "extras") if key in old}
    slots = _slots(carrier.source, part)
    primitives: list[dict[str, Any]] = []
    influences: dict[int, dict[str, int]] = {}
    for group in part.groups:
        if slots is not None:
            influences |= dict.fromkeys(group.primitives, _influences(builder, group.joints, group.weights, slots))
    for index, primitive in enumerate(document.objects(old, "primitives")):
        entry = carrier.primitive(primitive, document.count(primitive["attributes"]["POSITION"]))
        entry["attributes"].update(influences.get(index, {}))
        primitives.append(entry)
    mesh["primitives"] = primitives
    if "weights" in old and all("targets" in primitive for primitive in primitives):
        mesh["weights"] = copy.deepcopy(old["weights"])
    return mesh


def _slots(source: Source, part: MeshPart) -> np.ndarray | None:
    """Slot in the skin of a mesh of each joint of all skins, -1 for none; None where the mesh has no skin."""
    skin = source.document.item("nodes", part.node).get("skin") if part.node >= 0 else None
    if type(skin) is not int or not 0 <= skin < len(source.skins.slots):
        return None
    out = np.full(len(source.skins.nodes), -1)
    slots = source.skins.slots[skin]
    out[slots[::-1]] = np.arange(len(slots))[::-1]
    return out


def _influences(builder: GltfBuilder, joints: np.ndarray, weights: np.ndarray, slots: np.ndarray) -> dict[str, int]:
    if not len(joints):
        return {}
    width = -(-joints.shape[1] // 4) * 4
    where, shares = np.zeros((len(joints), width), np.int64), np.zeros((len(joints), width))
    where[:, : joints.shape[1]], shares[:, : joints.shape[1]] = slots[joints], weights
    shares[where < 0] = 0
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), 1e-12)
    stored = np.where(shares > 1e-7, shares, 0).astype(np.float32)
    first = stored.argmax(axis=1)
    rows = np.arange(len(stored))
    stored[rows, first] += (1 - stored.sum(axis=1, dtype=np.float64)).astype(np.float32)
    where[stored <= 0] = 0
    kind = np.uint8 if len(slots) <= 256 else "<u2"
    out = {}
    for number in range(width // 4):
        cut = slice(4 * number, 4 * number + 4)
        if number and not stored[:, cut].any():
            break
        out[f"JOINTS_{number}"] = builder.array(where[:, cut].astype(kind), ARRAY_BUFFER)
        out[f"WEIGHTS_{number}"] = builder.array(np.ascontiguousarray(stored[:, cut]), ARRAY_BUFFER)
    return out


def plain_rig(character: Character) -> tuple[GltfBuilder, list[int]]:
    """The meshes with one skin of the rig, whose bones rotate in the world's axes at rest; and the bones' nodes."""
    rig, source = written_rig(character), document_of(character)
    builder = GltfBuilder(drop_clip(carry_tree(source.document)))
    carry_images(source.document, builder)
    rest = rig.positions
    offsets = rest - np.where(rig.parents[:, None] >= 0, rest[rig.parents], 0)
    nodes = builder.bones(rig.names, rig.parents, offsets.astype(np.float32))
    inverse = np.tile(np.eye(4), (len(rest), 1, 1))
    inverse[:, :3, 3] = -rest
    skin = builder.add("skins", {"joints": nodes, "inverseBindMatrices": builder.matrices(inverse)})
    carrier = MeshCarrier(source, builder)
    roots = [bone for bone in nodes if rig.parents[bone] < 0]
    slots = np.arange(len(rest))
    for part, index in source.placed():
        mesh = carrier.mesh(part, character.vertices[index], index)
        for group, vertices in part.split(index):
            added = _influences(builder, rig.indices[vertices], rig.weights[vertices], slots)
            for member in group.primitives:
                mesh["primitives"][member]["attributes"].update(added)
        label = str(source.document.item("nodes", part.node).get("name") or f"mesh_{part.mesh}")
        roots.append(builder.add("nodes", {"name": label, "mesh": builder.add("meshes", mesh), "skin": skin}))
    builder.tree["scenes"][0]["nodes"] = roots
    add_humanoid(builder.tree, rig, nodes, character.name)
    return builder, nodes


def _plain_local(animation: RigAnimation) -> np.ndarray:
    """Transform of each bone in its parent, shape (N, J, 4, 4)."""
    rig = animation.rig
    rest = rig.positions
    local = np.tile(np.eye(4), (len(animation), len(rest), 1, 1))
    local[..., :3, :3] = animation.rotations
    local[..., :3, 3] = rest - np.where(rig.parents[:, None] >= 0, rest[rig.parents], 0) + animation.translations
    return local
