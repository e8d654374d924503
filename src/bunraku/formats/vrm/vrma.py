"""VRMA: a motion of VRM's humanoid bones in a glTF file (the extension VRMC_vrm_animation 1.0).

The nodes of the file stand in the T-pose, whatever rotations they have there. What the bones do is said relative to it:
with W the world rotation of a bone in a frame and W_0 the one at rest, the humanoid's rotation is W W_0^-1.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton, local_rotations
from bunraku.errors import FormatError, MotionError
from bunraku.formats.gltf.container.document import Document
from bunraku.formats.gltf.container.open import open_document
from bunraku.formats.gltf.curves import MAX_SECONDS, clip_curves, node_worlds
from bunraku.formats.gltf.scene.nodes import read_nodes

__all__ = ["EXTENSION", "VRM_BONES", "read_glb_motion", "read_vrma"]

EXTENSION = "VRMC_vrm_animation"

VRM_BONES: dict[str, str] = {
    "pelvis": "hips", "spine1": "spine", "spine2": "chest", "spine3": "upperChest", "neck": "neck", "head": "head",
    **{
        f"{side}_{joint}": f"{side}{bone}"
        for side in ("left", "right")
        for joint, bone in (
            ("collar", "Shoulder"), ("shoulder", "UpperArm"), ("elbow", "LowerArm"), ("wrist", "Hand"),
            ("hip", "UpperLeg"), ("knee", "LowerLeg"), ("ankle", "Foot"), ("foot", "Toes"),
        )
    },
}  # fmt: skip
"""VRM's bone for each of SMPL's 22 joints."""

FPS = 30.0  # of files whose keys are not evenly spaced
MOST_ROTATIONS = 1_500_000  # ten minutes of all bones at 30 frames a second


def read_glb_motion(path: Path, data: bytes) -> HandleMotion | SkeletalMotion:
    """The motion that a GLB holds: that of VRM's humanoid in a VRMA, the handle motion in a GLB of Bunraku.

    Raises:
        FormatError: The file is broken, or holds neither.
        MotionError: What it holds breaks the rules of a motion.
    """
    from bunraku.formats.gltf.bunraku_clip import read_motion

    document = open_document(path, data)
    return _motion(document) if _extension(document) is not None else read_motion(path, data)


def read_vrma(path: Path, data: bytes) -> SkeletalMotion:
    """Read a VRMA.

    Args:
        path: The file.
        data: Its bytes.

    Returns:
        The humanoid bones that it has under VRM's names ("hips", "leftUpperArm"), with rotations relative to the
        T-pose, at the rate of its keys; 30 frames a second where they are not evenly spaced.

    Raises:
        FormatError: The file is broken, or no VRMA.
        MotionError: A value is not a number.
    """
    return _motion(open_document(path, data))


def _extension(document: Document) -> dict[str, Any] | None:
    extensions = document.tree.get("extensions")
    found = extensions.get(EXTENSION) if isinstance(extensions, dict) else None
    return found if isinstance(found, dict) else None


def _motion(document: Document) -> SkeletalMotion:
    bones = _bones(document)
    clips = document.items("animations")
    if not clips:
        document.fail("it holds no animation, so it is no VRMA; export it again")
    tree, curves = read_nodes(document), clip_curves(document, clips[0])
    keys = np.unique(np.concatenate([times for times, _, _ in curves.values()])) if curves else np.zeros(1)
    end = float(keys[-1])
    if end > MAX_SECONDS or end < 0:
        document.fail(f"its clip lasts {end:.0f} s but at most {MAX_SECONDS:.0f} s are read; cut it")
    fps = _rate(keys)
    count = int(np.floor(end * fps + 1e-3)) + 1
    if count * len(bones) > MOST_ROTATIONS:
        document.fail(f"its clip has {count} frames of {len(bones)} bones, which are too many; cut it")
    nodes = [bones[name] for name in bones]
    chosen = {node: joint for joint, node in enumerate(nodes)}
    order = [node for node in tree.order if node in chosen]
    index = {node: joint for joint, node in enumerate(order)}
    found, above = tree.nearest(index), tree.parents[order]
    parents = np.where(above >= 0, found[above], -1)
    if (parents < 0).sum() != 1 or parents[0] >= 0 or order[0] != bones["hips"]:
        document.fail("its humanoid bones do not all hang on the hips; the file is broken, export it again")
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
    found = _extension(document)
    humanoid = found.get("humanoid") if found is not None else None
    listed = humanoid.get("humanBones") if isinstance(humanoid, dict) else None
    if not isinstance(listed, dict) or "hips" not in listed:
        document.fail(
            f"it has no humanoid with hips under {EXTENSION}, so it is no VRMA; export it again as VRM Animation"
        )
    out: dict[str, int] = {}
    taken, last = set[int](), max(len(document.items("nodes")) - 1, 0)
    for name, bone in listed.items():
        if not isinstance(bone, dict):
            document.fail(f"its bone {name[:40]!r} is no object; the file is broken, export it again")
        node = document.integer(bone, "node", high=last)
        if node in taken:
            document.fail(f"two of its bones are node {node}; the file is broken, export it again")
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
