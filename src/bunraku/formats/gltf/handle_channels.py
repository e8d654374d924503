"""Handle motion as glTF: the joint nodes of Eq. 3 and their animation channels."""

from __future__ import annotations

from typing import Any

import numpy as np

from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.formats.gltf.builder import GltfBuilder
from bunraku.formats.handle_names import handle_names
from bunraku.geometry.rotations import quaternion_from_matrix

__all__ = ["add_joints", "add_motion", "joint_tracks"]


def add_joints(builder: GltfBuilder, handles: Handles) -> list[int]:
    """Add one node for each handle, handle 0 above the others, and return the nodes.

    Args:
        builder: The document.
        handles: The K handles.
    """
    h = handles.positions.astype(np.float64)
    names = handle_names(handles)
    first = len(builder.tree.get("nodes", []))
    for handle, name in enumerate(names):
        offset = (h[handle] - h[0] if handle else h[0]).astype(np.float32)
        builder.add("nodes", {"name": name, "translation": offset.tolist()})
    if len(h) > 1:
        builder.tree["nodes"][first]["children"] = list(range(first + 1, first + len(h)))
    return list(range(first, first + len(h)))


def joint_tracks(positions: np.ndarray, motion: HandleMotion) -> tuple[np.ndarray, np.ndarray]:
    """What the nodes of `add_joints` do: translations [m] (N, K, 3) and rotations (N, K, 4), quaternions xyzw, float64.

    The root node gets translation h_0 + t_g and rotation R_g; joint k, its child, gets h_k + t_k - h_0 and R_k (Eq. 3).

    Args:
        positions: Handle positions h in the rest pose [m], shape (K, 3).
        motion: N frames of K handles.
    """
    h = positions.astype(np.float64)
    translations = h + motion.translations
    translations[:, 1:] -= h[0]
    translations[:, 0] = h[0] + motion.root_translation
    rotations = quaternion_from_matrix(motion.rotations.astype(np.float64))
    rotations[:, 0] = quaternion_from_matrix(motion.root_rotation.astype(np.float64))
    flips = np.where((rotations[1:] * rotations[:-1]).sum(-1) < 0, -1.0, 1.0)
    rotations[1:] *= np.cumprod(flips, axis=0)[
        ..., None
    ]  # an interpolated quaternion must not change its sign on the way
    return translations, rotations


def add_motion(builder: GltfBuilder, joints: list[int], positions: np.ndarray, motion: HandleMotion, name: str) -> None:
    """Add an animation: a translation and a rotation channel for each joint, constant ones as one key."""
    translations, rotations = joint_tracks(positions, motion)
    h = positions.astype(np.float64)
    times = (np.arange(len(motion)) / motion.fps).astype(np.float32)[:, None]
    every = builder.array(times, bounds=True)
    single: int | None = None
    extent = max(float(np.ptp(h, axis=0).max()), 1e-9)
    tracks = (("translation", translations, 1e-7 * extent), ("rotation", rotations, 1e-7))
    moving = {
        (path, k): np.ptp(values[:, k], axis=0).max() > small for path, values, small in tracks for k in range(len(h))
    }
    if not any(moving.values()):
        moving["translation", 0] = True  # one channel keeps the length of a motion that stands still
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    for joint in range(len(h)):
        for path, values, _ in tracks:
            track = values[:, joint].astype(np.float32)
            if moving[path, joint]:
                clock = every
            else:
                single = builder.array(times[:1], bounds=True) if single is None else single
                track, clock = track[:1], single
            channels.append({"sampler": len(samplers), "target": {"node": joints[joint], "path": path}})
            samplers.append({"input": clock, "output": builder.array(track), "interpolation": "LINEAR"})
    builder.add("animations", {"name": name, "channels": channels, "samplers": samplers})
