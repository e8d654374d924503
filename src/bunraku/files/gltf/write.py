"""Write GLB: the user's own mesh and materials, the handles as a skin, their motion as channels and as it is."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.core.body.layout import HANDLE_NAMES, handle_names
from bunraku.core.character import Character, Handles, top_influences
from bunraku.core.files import atomic_write
from bunraku.core.geometry.rotations import continuous, quaternion_from_matrix
from bunraku.core.motion import HandleMotion, checked_fps, resample
from bunraku.errors import FormatError
from bunraku.files.gltf.carry import MeshCarrier, carry_images, carry_tree, used_extensions
from bunraku.files.gltf.colors import linear_from_srgb
from bunraku.files.gltf.document import ARRAY_BUFFER, GltfBuilder, matte_material, mesh_document
from bunraku.files.gltf.mesh import MeshPart, PrimitiveData
from bunraku.files.gltf.open import open_document
from bunraku.files.gltf.read import Source, character_from_document
from bunraku.files.motions.arrays import pack_animation
from bunraku.files.motions.arrays import read_npz_motion as read_npz

if TYPE_CHECKING:
    from bunraku.core.animation import Animation

KEY = "bunraku_motion"
RIGID = "bunraku_rigid"
"""Mark of the root joint of a figure whose blocks do not bend."""


def add_clip(builder: GltfBuilder, animation: Animation) -> None:
    """Put the handle motion of an animation into a document."""
    asset, view = builder.tree["asset"], builder.view(pack_animation(animation))
    asset["extras"] = {**(asset["extras"] if isinstance(asset.get("extras"), dict) else {}), KEY: view}


def drop_clip(tree: dict[str, object]) -> dict[str, Any]:
    """The tree without the mark of a motion that may have been carried over."""
    asset = tree["asset"]
    extras = asset.get("extras") if isinstance(asset, dict) else None
    if isinstance(asset, dict) and isinstance(extras, dict) and KEY in extras:
        del extras[KEY]
        if not extras:
            del asset["extras"]
    return tree


def read_motion(path: Path, data: bytes) -> HandleMotion:
    """The handle motion of a GLB that Bunraku wrote, in the frame of its character. FormatError if the file is broken,
    or holds none; MotionError if what it holds breaks the rules of a motion.
    """
    return read_npz(path, packed_motion(path, data))


def packed_motion(path: Path, data: bytes) -> bytes:
    """The NPZ in a GLB that Bunraku wrote. FormatError if the file is broken, or holds none."""
    document = open_document(path, data)
    extras = document.tree["asset"].get("extras")
    view = extras.get(KEY) if isinstance(extras, dict) else None
    if view is None:
        raise FormatError(path, "it holds no handle motion of Bunraku; make one with `bunraku animate`")
    return bytes(document.view(view))


def clip_handles(path: Path, character: Character) -> Handles:
    """The handles that a file of `Animation.save` or `bunraku rig` has for joints, up to rounding. FormatError if the
    joints are others.
    """
    rig = character.rig
    parts = [_role(name) for name in rig.names] if rig is not None else []
    if rig is None or len(rig.names) != len(HANDLE_NAMES) or None in parts:
        count = len(HANDLE_NAMES)
        raise FormatError(path, f"its joints are not the {count} handles of Bunraku; animate the character anew")
    # -1 plays the part of another.
    handles = [HANDLE_NAMES.index(name) if name in HANDLE_NAMES else -1 for name in rig.names]
    free = iter(sorted(set(range(len(handles))) - set(handles)))
    order = np.argsort([next(free) if slot < 0 else slot for slot in handles])
    weights = rig.dense_weights()[:, order]
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
    played = np.array(parts, np.int64)[order]
    rigid = _rigid(character) and weights.max(axis=1).min() > 0.999
    roles = None if np.array_equal(played, np.arange(len(played))) else played
    return Handles(rig.positions[order], weights, roles=roles, rigid=bool(rigid))


def _rigid(character: Character) -> bool:
    """Whether a joint of the file is marked as the root of blocks that do not bend."""
    document = getattr(character.source, "document", None)
    nodes = [] if document is None else document.items("nodes")
    marks = (node.get("extras") for node in nodes if node.get("name") == HANDLE_NAMES[0])
    return any(isinstance(mark, dict) and mark.get(RIGID) is True for mark in marks)


def _role(name: str) -> int | None:
    """The handle whose part a joint of this name plays, or None: left_hip_2 is the second left hip."""
    plain, _, number = name.rpartition("_")
    if name in HANDLE_NAMES:
        return HANDLE_NAMES.index(name)
    return HANDLE_NAMES.index(plain) if number.isdecimal() and plain in HANDLE_NAMES else None


def add_joints(builder: GltfBuilder, handles: Handles) -> list[int]:
    """Add one node for each handle, handle 0 above the others, and return the nodes."""
    h = handles.positions.astype(np.float64)
    names = handle_names(handles.played)
    first = len(builder.tree.get("nodes", []))
    offsets = np.concatenate([h[:1], h[1:] - h[0]]).astype(np.float32).tolist()
    nodes = [{"name": name, "translation": offset} for name, offset in zip(names, offsets, strict=True)]
    builder.tree.setdefault("nodes", []).extend(nodes)
    if handles.rigid:
        builder.tree["nodes"][first]["extras"] = {RIGID: True}
    if len(h) > 1:
        builder.tree["nodes"][first]["children"] = list(range(first + 1, first + len(h)))
    return list(range(first, first + len(h)))


def joint_tracks(positions: np.ndarray, motion: HandleMotion) -> tuple[np.ndarray, np.ndarray]:
    """The motion of the nodes of `add_joints`, of handles h at rest [m] (K, 3): translations [m] (N, K, 3) and
    rotations (N, K, 4), quaternions xyzw, float64.

    The root node gets translation h_0 + t_g and rotation R_g; joint k, its child, gets h_k + t_k - h_0 and R_k (Eq. 3).
    """
    h = positions.astype(np.float64)
    translations = h + motion.translations
    translations[:, 1:] -= h[0]
    translations[:, 0] = h[0] + motion.root_translation
    rotations = quaternion_from_matrix(motion.rotations.astype(np.float64))
    rotations[:, 0] = quaternion_from_matrix(motion.root_rotation.astype(np.float64))
    return translations, continuous(rotations)


def add_motion(builder: GltfBuilder, joints: list[int], positions: np.ndarray, motion: HandleMotion, name: str) -> None:
    """Add an animation: a translation and a rotation channel for each joint, constant ones as one key."""
    translations, rotations = joint_tracks(positions, motion)
    h = positions.astype(np.float64)
    extent = max(float(np.ptp(h, axis=0).max()), 1e-9)
    parts = (("translation", translations, 1e-7 * extent), ("rotation", rotations, 1e-7))
    moving = {
        (path, k): np.ptp(values[:, k], axis=0).max() > small for path, values, small in parts for k in range(len(h))
    }
    if not any(moving.values()):
        moving["translation", 0] = True  # one channel keeps the length of a motion that stands still
    tracks = [
        (node, path, values[: None if moving[path, joint] else 1, joint].astype(np.float32))
        for joint, node in enumerate(joints)
        for path, values, _ in parts
    ]
    builder.clip(name, (np.arange(len(motion)) / motion.fps).astype(np.float32), tracks)


def write_animation(animation: Animation, path: Path, *, fps: float | None = None, name: str | None = None) -> Path:
    """Write an animation as GLB, with a clip of the file's or another name; channels have `fps` [1/s] or the motion's
    rate. FormatError if the file cannot be written; OptionError if `fps` is not a number from 1 to 1000.
    """
    return write_clips({str(name) if name else path.stem: animation}, path, fps=fps)


def write_clips(clips: Mapping[str, Animation], path: Path, *, fps: float | None = None) -> Path:
    """Write several animations of one character by the same handles as GLB, each as a clip of its name. The motion that
    Bunraku reads back is that of the first. Errors are those of `write_animation`.
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
    float32. The weights of a vertex sum to 1 as closely as float32 can say; unused slots name joint 0.
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
    if isinstance(source, Source) and source.fits(character):
        return source
    colors = None if character.colors is None else linear_from_srgb(character.colors / 255.0)
    material = matte_material(character.name, doubleSided=True)
    document = mesh_document(
        Path(character.name), character.vertices, [(character.faces, 0)], colors=colors, materials=[material]
    )
    made = character_from_document(document, character.name).source
    assert isinstance(made, Source)
    return made


@contextmanager
def writable(path: Path, what: object) -> Iterator[None]:
    """Turn what goes wrong with a character that is too broken to be written into a FormatError about the output."""
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        reason = f"{type(error).__name__}: {str(error)[:80]}"
        raise FormatError(path, f"{what} is too broken to be written ({reason}); export it again") from error


def build_document(character: Character, handles: Handles | None, path: Path) -> tuple[GltfBuilder, list[int]]:
    """The character's meshes and materials, skinned to handles where there are some, and the nodes of the handles. The
    scene's nodes are that of handle 0, where there are handles, and one for each part of the source that has vertices.
    """
    source = document_of(character)
    with writable(path, source.document.path):
        builder = GltfBuilder(drop_clip(carry_tree(source.document)))
        carry_images(source.document, builder)
        joints = add_joints(builder, handles) if handles is not None else []
        carrier, roots = MeshCarrier(source, builder), joints[:1]
        skins: dict[bytes, int] = {}
        for part, index in source.placed():
            roots.append(_add_part(builder, carrier, character, handles, joints, part, index, skins))
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
    for group, vertices in part.split(index):
        _add_influences(builder, mesh["primitives"], group, handles.weights[vertices])
    inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    inverse[:, :3, 3] = -handles.positions.astype(np.float64)
    stored = (inverse @ transform).transpose(0, 2, 1).reshape(-1, 16).astype(np.float32)
    key = stored.tobytes()
    if key not in skins:
        skin = {"name": "handles", "joints": joints, "skeleton": joints[0]}
        skins[key] = builder.add("skins", {**skin, "inverseBindMatrices": builder.array(stored)})
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
    """Whether a mesh's raw positions can stay: one matrix takes them to the character's vertices, without mirroring."""
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
