"""Write VRMA: the humanoid's rotations relative to the T-pose, and the position of the hips, for any VRM character to
play.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.motion import SkeletalMotion
from bunraku.core.resample import checked_fps
from bunraku.errors import FormatError, MotionError, OptionError
from bunraku.formats.files import atomic_write
from bunraku.formats.gltf.builder import GltfBuilder
from bunraku.formats.vrm.vrma import EXTENSION, VRM_BONES
from bunraku.geometry.rotations import quaternion_from_matrix

__all__ = ["write_vrma"]


def write_vrma(motion: SkeletalMotion, path: str | Path, *, fps: float | None = None, name: str | None = None) -> Path:
    """Write a skeletal motion as VRMA.

    Players scale the path of the hips by the height that the hips have at rest, so the skeleton is written standing on
    y = 0.

    Args:
        motion: Of SMPL's 22 joints; `bunraku.skeletons.to_smpl` converts other skeletons.
        path: The file.
        fps: Frames a second of the keys [1/s]; those of the motion by default.
        name: The clip's name; the file's by default.

    Returns:
        The file that was written.

    Raises:
        FormatError: The file cannot be written.
        MotionError: The skeleton does not have SMPL's 22 joints.
        OptionError: `fps` is no number from 1 to 1000, or the motion has no frame.
    """
    from bunraku.body.layout import JOINT_NAMES  # after the formats, in the order of imports
    from bunraku.core.resample import resample_motion

    path = Path(path)
    if not len(motion):
        raise OptionError("a motion without frames cannot be written; give it at least one")
    if motion.skeleton.names != JOINT_NAMES:
        raise MotionError("a VRMA holds the motion of SMPL's 22 joints; convert the skeleton with to_smpl first")
    motion = resample_motion(motion, checked_fps(fps, motion.fps))
    builder = GltfBuilder({"asset": {"version": "2.0", "generator": "bunraku"}, "scene": 0, "scenes": [{"nodes": [0]}]})
    _add_bones(builder, motion)
    _add_clip(builder, motion, name or path.stem)
    bones = {VRM_BONES[joint]: {"node": node} for node, joint in enumerate(JOINT_NAMES)}
    builder.tree["extensions"] = {EXTENSION: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
    builder.tree["extensionsUsed"] = [EXTENSION]
    with atomic_write(path) as file:
        try:
            builder.write(file)
        except ValueError as error:
            raise FormatError(path, f"the VRMA cannot be written ({error}); cut the motion into parts") from None
    return path


def _add_bones(builder: GltfBuilder, motion: SkeletalMotion) -> None:
    """One node for each joint in the T-pose, the lowest at the height that the reference body's has over the floor."""
    from bunraku.body.reference import leg_length, reference_body

    body, skeleton = reference_body(), motion.skeleton
    offsets = skeleton.offsets.astype(float)
    positions = skeleton.positions.astype(float) - skeleton.positions[0]
    scale = leg_length(positions) / leg_length(body.joints)
    offsets[0] = [0, float(body.joints[:, 1].min()) * scale - float(positions[:, 1].min()), 0]
    for joint, name in enumerate(skeleton.names):
        children = [int(child) for child in np.flatnonzero(skeleton.parents == joint)]
        node: dict[str, Any] = {"name": VRM_BONES[name], "translation": offsets[joint].astype(np.float32).tolist()}
        builder.add("nodes", node | ({"children": children} if children else {}))


def _add_clip(builder: GltfBuilder, motion: SkeletalMotion, name: str) -> None:
    rotations = quaternion_from_matrix(motion.rotations.astype(np.float64))
    flips = np.where((rotations[1:] * rotations[:-1]).sum(-1) < 0, -1.0, 1.0)
    rotations[1:] *= np.cumprod(flips, axis=0)[..., None]
    clock = builder.array((np.arange(len(motion)) / motion.fps).astype(np.float32)[:, None], bounds=True)
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []

    def add(node: int, kind: str, values: np.ndarray) -> None:
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": kind}})
        samplers.append({"input": clock, "output": builder.array(values.astype(np.float32)), "interpolation": "LINEAR"})

    add(0, "translation", motion.root_translation)
    for joint in range(rotations.shape[1]):
        add(joint, "rotation", rotations[:, joint])
    builder.add("animations", {"name": str(name), "channels": channels, "samplers": samplers})
