"""VRM files: motion of the humanoid as VRMA, read and written, and people written as VRM 1.0."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.avatars import VrmModel
from bunraku.core.body.layout import JOINT_NAMES, engine_names
from bunraku.core.character import Character, Handles
from bunraku.core.files import read_bounded
from bunraku.core.geometry.rotations import continuous, quaternion_from_matrix
from bunraku.core.motion import (
    HandleMotion,
    SkeletalMotion,
    Skeleton,
    checked_fps,
    line_up,
    local_rotations,
    resample_motion,
)
from bunraku.errors import CharacterError, FormatError, MotionError, OptionError
from bunraku.files.gltf.carry import clip_names, clip_number, free_name
from bunraku.files.gltf.document import Document, GltfBuilder
from bunraku.files.gltf.nodes import MAX_SECONDS, Curves, NodeTree, clip_curves, node_worlds, read_nodes
from bunraku.files.gltf.open import open_document
from bunraku.files.gltf.vrm import add_springs
from bunraku.files.gltf.write import finish_document
from bunraku.files.gltf.write_rig import plain_rig

EXTENSION = "VRMC_vrm_animation"

VRM_BONES = dict(zip(JOINT_NAMES, engine_names("vrm"), strict=False))
"""VRM's bone for each of SMPL's 22 joints."""

FPS = 30.0  # of files whose keys are not evenly spaced
MOST_ROTATIONS = 1_500_000  # ten minutes of all bones at 30 frames a second


def read_glb_motion(path: Path, data: bytes) -> HandleMotion | SkeletalMotion:
    """The motion of a GLB: that of VRM's humanoid in a VRMA, the handle motion in a GLB of Bunraku. FormatError if the
    file is broken, or holds neither; MotionError if what it holds breaks the rules of a motion.
    """
    from bunraku.files.gltf.write import read_motion

    document = open_document(path, data)
    if _extension(document) is not None:
        return _motion(document)
    return _of_nodes(document, 0, FPS) if _bare(document) else read_motion(path, data)


def load_skeleton_clip(path: str | Path, clip: int | str = 0, fps: float = FPS) -> SkeletalMotion | None:
    """A clip, by number or name, of a glTF file that holds a skeleton without a mesh, at a rate [1/s]; None of other
    files. FormatError if the file is broken; OptionError if there is no such clip.
    """
    path = Path(path)
    document = open_document(path, read_bounded(path))
    return _of_nodes(document, clip, fps) if _bare(document) else None


def _bare(document: Document) -> bool:
    """Whether a document has clips and no mesh that they could move."""
    return bool(document.items("animations")) and not document.items("meshes")


def _of_nodes(document: Document, clip: int | str, fps: float) -> SkeletalMotion:
    """A clip on the nodes of the tree that it moves most of; the rest pose is that of the nodes."""
    chosen = document.items("animations")[clip_number(document.path, clip_names(document), clip)]
    tree, curves = read_nodes(document), clip_curves(document, chosen)
    moved = {node for node, _ in curves}
    if not moved:
        document.fail("its clip moves no node; export it again with its keys baked")
    tops = tree.nearest({node: node for node in moved if not moved & set(line_up(node, tree.parents)[1:])})
    top = max(sorted(moved), key=lambda node: int((tops == tops[node]).sum()))
    order = [node for node in tree.order if tops[node] == tops[top]]
    called: dict[str, int] = {}
    for node in order:
        called[free_name(str(document.items("nodes")[node].get("name") or f"node {node}"), called)] = node
    return _sampled(document, tree, curves, called, fps, order[0])


def read_vrma(path: Path, data: bytes) -> SkeletalMotion:
    """Read a VRMA: the humanoid bones that it has under VRM's names ("hips", "leftUpperArm"), with rotations relative
    to the T-pose, at the rate of its keys, or at 30 frames a second where they are not evenly spaced. FormatError if
    the file is broken, or no VRMA; MotionError if a value is not a number.
    """
    return _motion(open_document(path, data))


def _extension(document: Document) -> dict[str, Any] | None:
    extension = document.extensions.get(EXTENSION)
    return extension if isinstance(extension, dict) else None


def _motion(document: Document) -> SkeletalMotion:
    bones = _bones(document)
    clips = document.items("animations")
    if not clips:
        document.fail("it holds no animation, so it is no VRMA; export it again")
    curves = clip_curves(document, clips[0])
    keys = np.unique(np.concatenate([times for times, _, _ in curves.values()])) if curves else np.zeros(1)
    return _sampled(document, read_nodes(document), curves, bones, _rate(keys), bones["hips"])


def _sampled(
    document: Document, tree: NodeTree, curves: Curves, bones: dict[str, int], fps: float, root: int
) -> SkeletalMotion:
    """The motion of some nodes by their names, one of which all others hang on."""
    end = max((float(times[-1]) for times, _, _ in curves.values()), default=0.0)
    if end > MAX_SECONDS or end < 0:
        document.fail(f"its clip lasts {end:.0f} s but at most {MAX_SECONDS:.0f} s are read; cut it")
    count = int(np.floor(end * fps + 1e-3)) + 1
    if count * len(bones) > MOST_ROTATIONS:
        document.fail(f"its clip has {count} frames of {len(bones)} bones, which are too many; cut it")
    nodes = [bones[name] for name in bones]
    chosen = {node: joint for joint, node in enumerate(nodes)}
    order = [node for node in tree.order if node in chosen]
    index = {node: joint for joint, node in enumerate(order)}
    found, above = tree.nearest(index), tree.parents[order]
    parents = np.where(above >= 0, found[above], -1)
    if (parents < 0).sum() != 1 or parents[0] >= 0 or order[0] != root:
        document.broken("its humanoid bones do not all hang on the hips")
    names = {node: name for name, node in bones.items()}
    moved = node_worlds(document, tree, curves, np.arange(count) / fps, order)
    rest = tree.world[order]
    try:
        world = _unscaled(moved[..., :3, :3]) @ np.linalg.inv(_unscaled(rest[:, :3, :3]))
    except np.linalg.LinAlgError:
        raise FormatError(document.path, "a bone has no extent at rest; the file is broken, export it again") from None
    local = local_rotations(world, parents)
    positions = rest[:, :3, 3]
    offsets = positions - np.where(parents[:, None] >= 0, positions[np.maximum(parents, 0)], 0)
    if not np.isfinite(local).all():
        raise MotionError("joint rotations hold values that are not numbers")
    return SkeletalMotion(
        Skeleton(tuple(names[node] for node in order), parents, offsets), local, moved[:, 0, :3, 3], fps
    )


def _bones(document: Document) -> dict[str, int]:
    """Node of each humanoid bone by VRM's name."""
    extension = _extension(document)
    humanoid = extension.get("humanoid") if extension is not None else None
    listed = humanoid.get("humanBones") if isinstance(humanoid, dict) else None
    if not isinstance(listed, dict) or "hips" not in listed:
        document.fail(
            f"it has no humanoid with hips under {EXTENSION}, so it is no VRMA; export it again as VRM Animation"
        )
    out: dict[str, int] = {}
    taken, last = set[int](), max(len(document.items("nodes")) - 1, 0)
    for name, bone in listed.items():
        if not isinstance(bone, dict):
            document.broken(f"its bone {name[:40]!r} is no object")
        node = document.integer(bone, "node", high=last)
        if node in taken:
            document.broken(f"two of its bones are node {node}")
        out[name[:100]] = node
        taken.add(node)
    return out


def _rate(keys: np.ndarray) -> float:
    """Frames a second of evenly spaced keys, or 30."""
    steps = np.diff(keys)
    if not len(steps):
        return FPS
    middle = float(np.median(steps))
    even = middle > 0 and float(np.abs(steps - middle).max()) < 0.02 * middle
    rate = 1 / middle if even else FPS
    rate = round(rate) if abs(rate - round(rate)) < 1e-3 * rate else rate
    return float(rate) if 1 <= rate <= 1000 else FPS


def _unscaled(matrices: np.ndarray) -> np.ndarray:
    """Matrices with columns of length 1: rotations without the scales that nodes may have."""
    return np.asarray(matrices / np.maximum(np.linalg.norm(matrices, axis=-2, keepdims=True), 1e-30))


def write_vrma(motion: SkeletalMotion, path: str | Path, *, fps: float | None = None, name: str | None = None) -> Path:
    """Write a motion of SMPL's 22 joints (`bunraku.anatomy.names.to_smpl` converts other skeletons) as VRMA, with the
    motion's or another rate [1/s] and the file's or another name. Players scale the path of the hips by the height of
    the hips at rest, so the skeleton is written standing on y = 0. FormatError if the file cannot be written;
    MotionError if the skeleton does not have SMPL's 22 joints; OptionError if `fps` is not a number from 1 to 1000, or
    the motion has no frame.
    """
    path = Path(path)
    if not len(motion):
        raise OptionError("a motion without frames cannot be written; give it at least one")
    if motion.skeleton.names != JOINT_NAMES:
        raise MotionError("a VRMA holds the motion of SMPL's 22 joints; convert the skeleton with to_smpl first")
    motion = resample_motion(motion, checked_fps(fps, motion.fps))
    builder = GltfBuilder()
    _add_bones(builder, motion)
    rotations = continuous(quaternion_from_matrix(motion.rotations.astype(np.float64))).astype(np.float32)
    turns = [(joint, "rotation", rotations[:, joint]) for joint in range(rotations.shape[1])]
    tracks = [(0, "translation", motion.root_translation.astype(np.float32)), *turns]
    builder.clip(str(name or path.stem), (np.arange(len(motion)) / motion.fps).astype(np.float32), tracks)
    bones = {VRM_BONES[joint]: {"node": node} for node, joint in enumerate(JOINT_NAMES)}
    builder.tree["extensions"] = {EXTENSION: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
    return finish_document(builder, path)


def _add_bones(builder: GltfBuilder, motion: SkeletalMotion) -> None:
    """One node for each joint in the T-pose, the lowest as high over the floor as that of the reference body."""
    from bunraku.core.body.reference import leg_length, reference_body

    body, skeleton = reference_body(), motion.skeleton
    offsets = skeleton.offsets.astype(float)
    positions = skeleton.positions.astype(float) - skeleton.positions[0]
    scale = leg_length(positions) / leg_length(body.joints)
    offsets[0] = [0, float(body.joints[:, 1].min()) * scale - float(positions[:, 1].min()), 0]
    builder.bones([VRM_BONES[name] for name in skeleton.names], skeleton.parents, offsets.astype(np.float32))


def write_avatar(
    character: Character, handles: Handles | None, path: Path, *, rig: bool = False, avatar: VrmModel | None = None
) -> Path:
    """Write a person as VRM, with the springs and colliders of an avatar; the arguments are those of the registry's
    writers. CharacterError if it has no rig in a T-pose with VRM's names, as `bunraku.with_skeleton(character, "vrm")`
    makes one; FormatError if the file cannot be written.
    """
    hint = "make one with --skeleton vrm, or with `bunraku.with_skeleton`"
    if character.rig is None or not rig or handles is not None:
        raise CharacterError(f"{character.name}: a VRM needs a skeleton with VRM's names; {hint}")
    builder, nodes = plain_rig(character)
    if "VRMC_vrm" not in builder.tree.get("extensions", {}):
        raise CharacterError(f"{character.name}: its rig is not that of a VRM in a T-pose; {hint}")
    if avatar is not None:
        add_springs(builder.tree, avatar, nodes)
    return finish_document(builder, path)
