"""Skeletal motion from the clips of FBX files, with a character in them or without."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.formats.fbx.clips import FbxClip, find_clip, read_clips, sample_clip
from bunraku.formats.fbx.mesh import read_clusters
from bunraku.formats.fbx.scene import FbxScene, read_scene
from bunraku.formats.fbx.skeleton import BONES, bind_matrices, inverses
from bunraku.formats.fbx.transforms import Values, default_world, world_matrices
from bunraku.formats.fbx.tree import read_tree
from bunraku.formats.files import read_bounded
from bunraku.geometry.rotations import nearest_rotation

__all__ = ["load_fbx_motion", "read_motion"]


def load_fbx_motion(path: str | Path, clip: int | str | None = None, fps: float = 20.0) -> SkeletalMotion:
    """Read a clip of an FBX file.

    Args:
        path: The file.
        clip: Its number or name; the first one that moves something by default.
        fps: Frames a second of the result [1/s].

    Raises:
        FormatError: The file cannot be read, or has no clip that moves a skeleton.
        OptionError: It has no clip of this name or number.
    """
    path = Path(path)
    return read_motion(path, read_bounded(path), clip=clip, fps=fps)


def read_motion(path: Path, data: bytes, *, clip: int | str | None = None, fps: float = 20.0) -> SkeletalMotion:
    """Read a clip of an FBX file from its bytes.

    A joint's rotation is relative to its rest pose, in axes that are ours there, as in all skeletal motions: identities
    put the skeleton into its rest pose. That is the bind pose of the file's skin; without a skin that of its bind pose
    object, then the pose without keys, where joints that are oriented by their pre-rotation have none of their own.

    Args:
        path: The file.
        data: Its bytes.
        clip: Number or name of the clip; the first one that moves something by default.
        fps: Frames a second of the result [1/s].

    Raises:
        FormatError: The file cannot be read, or has no clip that moves a skeleton.
        OptionError: It has no clip of this name or number.
    """
    scene = read_scene(read_tree(path, data))
    found = find_clip(scene, read_clips(scene), clip)
    joints = _joints(scene, found)
    values, count = sample_clip(scene, found, fps)
    frame = scene.frame
    rest = frame.world(_rest(scene, joints))
    moving = np.stack([np.broadcast_to(some, (count, 4, 4)) for some in world_matrices(scene, values, joints)], axis=1)
    world = frame.world(moving)
    turn = nearest_rotation(world[..., :3, :3] @ inverses(rest)[:, :3, :3])  # from the rest pose, in the world
    number = {model: joint for joint, model in enumerate(joints)}
    parents = np.array([number.get(_above(scene, model, number), -1) for model in joints])
    local = turn.copy()
    local[:, 1:] = np.swapaxes(turn[:, parents[1:]], -1, -2) @ turn[:, 1:]
    offsets = rest[:, :3, 3].copy()
    offsets[1:] -= rest[parents[1:], :3, 3]
    skeleton = Skeleton(tuple(scene.models[model].name for model in joints), parents, offsets)
    return SkeletalMotion(skeleton, local, world[:, 0, :3, 3], fps)


def _above(scene: FbxScene, model: int, chosen: dict[int, int]) -> int:
    """The nearest of chosen models above one, -1 for none."""
    model = int(scene.parents[model])
    while model >= 0 and model not in chosen:
        model = int(scene.parents[model])
    return model


def _joints(scene: FbxScene, clip: FbxClip) -> list[int]:
    """The joints of the skeleton that a clip moves most of, root first and parents before children."""
    moved = {model for model, _ in clip.curves}
    bones = [index for index, model in enumerate(scene.models) if model.subtype in BONES]
    chosen = dict.fromkeys(
        bones or [index for index, model in enumerate(scene.models) if index in moved and model.subtype != "Camera"], 0
    )
    trees: dict[int, list[int]] = {}
    root_of: dict[int, int] = {}
    for model in sorted(chosen):  # parents come first
        above = _above(scene, model, chosen)
        root_of[model] = root_of.get(above, model)
        trees.setdefault(root_of[model], []).append(model)
    if not trees:
        scene.tree.fail(f"its clip '{clip.name}' moves no skeleton; export it with its joints")
    return max(trees.values(), key=lambda tree: sum(model in moved for model in tree))


def _rest(scene: FbxScene, joints: list[int]) -> np.ndarray:
    """World transforms of joints in the rest pose, in the file's frame and unit, shape (J, 4, 4)."""
    clusters = [cluster for geometry in scene.of_kind("Geometry") for cluster in read_clusters(scene, geometry)]
    default = default_world(scene)
    if clusters:
        binds = bind_matrices(scene, default, clusters)
        return np.stack([binds.get(joint, default[joint]) for joint in joints])
    posed = _bind_pose(scene)
    if all(joint in posed for joint in joints):
        return np.stack([posed[joint] for joint in joints])
    oriented = [np.any(scene.models[joint].numbers("PreRotation", (0, 0, 0))) for joint in joints]
    if sum(oriented) * 2 < len(joints):
        return default[joints]
    still: Values = {(joint, "Lcl Rotation"): np.zeros((1, 3)) for joint in joints}
    return np.concatenate(world_matrices(scene, still, joints))


def _bind_pose(scene: FbxScene) -> dict[int, np.ndarray]:
    """World transforms that the file's bind pose objects list, by model."""
    out: dict[int, np.ndarray] = {}
    for pose in scene.of_kind("Pose"):
        for entry in pose.node.all("PoseNode"):
            matrix, model = entry.array("Matrix"), scene.indices.get(entry.value("Node", 0), -1)
            if pose.subtype == "BindPose" and len(matrix) == 16 and np.isfinite(matrix).all() and model >= 0:
                out.setdefault(model, matrix.astype(float).reshape(4, 4).T)
    return out
