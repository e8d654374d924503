"""Write GLB: the user's own meshes, materials, textures and UVs, with the handles as a skin and their motion as
channels.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.core.character import Character, Handles, top_influences
from bunraku.core.resample import checked_fps, resample
from bunraku.errors import FormatError
from bunraku.formats.files import atomic_write
from bunraku.formats.gltf.builder import ARRAY_BUFFER, GltfBuilder, mesh_document
from bunraku.formats.gltf.bunraku_clip import add_clip, add_joints, add_motion, drop_clip
from bunraku.formats.gltf.carry import MeshCarrier, carry_images, carry_tree, used_extensions
from bunraku.formats.gltf.read import Source, character_from_document
from bunraku.formats.gltf.scene.colors import linear_from_srgb
from bunraku.formats.gltf.scene.mesh import MeshPart, PrimitiveData

if TYPE_CHECKING:
    from bunraku.core.animation import Animation

__all__ = [
    "build_document",
    "document_of",
    "finish_document",
    "joint_attributes",
    "keeps_positions",
    "write_animation",
    "write_clips",
]


def write_animation(animation: Animation, path: Path, *, fps: float | None = None, name: str | None = None) -> Path:
    """Write an animation as GLB.

    Args:
        animation: The animation.
        path: The file.
        fps: Frames a second of the channels [1/s]; those of the motion by default.
        name: The clip's name; the file's by default.

    Raises:
        FormatError: The file cannot be written.
        OptionError: `fps` is no number from 1 to 1000.
    """
    return write_clips({str(name) if name else path.stem: animation}, path, fps=fps)


def write_clips(clips: Mapping[str, Animation], path: Path, *, fps: float | None = None) -> Path:
    """Write several animations of one character by the same handles as GLB, each as a clip of its name. The motion that
    Bunraku reads back is that of the first.

    Args:
        clips: At least one.
        path: The file.
        fps: Frames a second of the channels [1/s]; those of each motion by default.

    Raises:
        FormatError: The file cannot be written.
        OptionError: `fps` is no number from 1 to 1000.
    """
    first = next(iter(clips.values()))
    motions = {name: resample(clip.motion, checked_fps(fps, clip.motion.fps)) for name, clip in clips.items()}
    builder, joints = build_document(first.character, first.handles, path)
    for name, motion in motions.items():
        add_motion(builder, joints, first.handles.positions, motion, name)
    add_clip(builder, first)
    return finish_document(builder, path)


def joint_attributes(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The four largest weights of each vertex as glTF stores them: joints (V, 4) uint8 or uint16, weights (V, 4)
    float32.

    The float32 weights of a vertex sum to 1 as closely as float32 can say; unused places name joint 0.
    """
    indices, shares = top_influences(weights, 4)
    stored = np.zeros((len(weights), 4), np.float32)
    joints = np.zeros((len(weights), 4), np.uint8 if weights.shape[1] <= 256 else "<u2")
    columns = shares.shape[1]
    stored[:, :columns] = np.where(shares > 1e-7, shares, 0)
    stored[:, 0] = 1 - stored[:, 1:].sum(axis=1, dtype=np.float64)
    joints[:, :columns] = np.where(stored[:, :columns] > 0, indices, 0)
    return joints, stored


def document_of(character: Character) -> Source:
    """The character's document, or one made of its arrays where it has none that fits."""
    source = character.source
    if isinstance(source, Source) and len(source.index) and int(source.index.max()) + 1 == len(character.vertices):
        return source
    colors = None if character.colors is None else linear_from_srgb(character.colors / 255.0)
    material = {
        "name": character.name,
        "doubleSided": True,
        "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.9},
    }
    document = mesh_document(
        Path(character.name), character.vertices, [(character.faces, 0)], colors=colors, materials=[material]
    )
    made = character_from_document(document, character.name).source
    assert isinstance(made, Source)
    return made


def build_document(character: Character, handles: Handles | None, path: Path) -> tuple[GltfBuilder, list[int]]:
    """The character's meshes and materials, skinned to handles where there are some, and the nodes of the handles.

    The scene's nodes are that of handle 0, where there are handles, and then one for each of the source's parts that
    has vertices.
    """
    source = document_of(character)
    try:
        builder = GltfBuilder(drop_clip(carry_tree(source.document)))
        carry_images(source.document, builder)
        joints = add_joints(builder, handles) if handles is not None else []
        carrier, start, roots = MeshCarrier(source, builder), 0, joints[:1]
        skins: dict[bytes, int] = {}
        for part in source.parts:
            stop = start + sum(len(group.vertices) for group in part.groups)
            if stop > start:
                roots.append(
                    _add_part(builder, carrier, character, handles, joints, part, source.index[start:stop], skins)
                )
            start = stop
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        reason = f"{type(error).__name__}: {str(error)[:80]}"
        raise FormatError(
            path, f"{source.document.path} is too broken to be written ({reason}); export it again"
        ) from error
    builder.tree["scenes"][0]["nodes"] = roots
    return builder, joints


def _add_part(
    builder: GltfBuilder,
    carrier: MeshCarrier,
    character: Character,
    handles: Handles | None,
    joints: list[int],
    part: MeshPart,
    index: np.ndarray,
    skins: dict[bytes, int],
) -> int:
    """Add a mesh with its node, and its skin where there are handles; return the node."""
    rest = character.vertices[index]
    kept = keeps_positions(part, rest, character)
    mesh = carrier.mesh(part, None if kept else rest, index)
    transform = part.transform if kept and part.transform is not None else np.eye(4)
    old = carrier.document.item("nodes", part.node)
    node: dict[str, Any] = {"name": str(old.get("name") or f"mesh_{part.mesh}"), "mesh": builder.add("meshes", mesh)}
    if isinstance(old.get("extras"), dict):
        node["extras"] = copy.deepcopy(old["extras"])
    if handles is None:
        if not np.array_equal(transform, np.eye(4)):
            node["matrix"] = transform.T.reshape(-1).tolist()
        return builder.add("nodes", node)
    start = 0
    for group in part.groups:
        _add_influences(builder, mesh["primitives"], group, handles.weights[index[start : start + len(group.vertices)]])
        start += len(group.vertices)
    inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    inverse[:, :3, 3] = -handles.positions.astype(np.float64)
    stored = (inverse @ transform).transpose(0, 2, 1).reshape(-1, 16).astype(np.float32)
    key = stored.tobytes()
    if key not in skins:
        skins[key] = builder.add(
            "skins",
            {"name": "handles", "joints": joints, "skeleton": joints[0], "inverseBindMatrices": builder.array(stored)},
        )
    node["skin"] = skins[key]
    return builder.add("nodes", node)


def _add_influences(
    builder: GltfBuilder, primitives: list[dict[str, Any]], group: PrimitiveData, weights: np.ndarray
) -> None:
    if not len(weights):
        return
    joints, shares = joint_attributes(weights)
    added = {"JOINTS_0": builder.array(joints, ARRAY_BUFFER), "WEIGHTS_0": builder.array(shares, ARRAY_BUFFER)}
    for member in group.primitives:
        primitives[member]["attributes"].update(added)


def keeps_positions(part: MeshPart, rest: np.ndarray, character: Character) -> bool:
    """Whether the raw positions of a mesh can stay: one matrix takes them to the character's vertices, without
    mirroring.
    """
    if part.transform is None or part.mirrored or np.linalg.det(part.transform[:3, :3]) <= 0:
        return False
    vertices = np.concatenate([group.vertices for group in part.groups])
    return bool(
        np.abs(vertices - rest).max() <= 1e-5 * np.ptp(character.vertices, axis=0).max() + 1e-6 * np.abs(vertices).max()
    )


def finish_document(builder: GltfBuilder, path: Path) -> Path:
    """Write a document as GLB and return the path."""
    used_extensions(builder.tree)
    with atomic_write(path) as file:
        try:
            builder.write(file)
        except ValueError as error:
            raise FormatError(path, f"the GLB cannot be written ({error}); simplify the mesh first") from None
    return path
