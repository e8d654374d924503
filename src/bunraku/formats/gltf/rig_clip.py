"""The motion of a rig's bones as channels of a GLB."""

from __future__ import annotations

from typing import Any

import numpy as np

from bunraku.formats.gltf.builder import GltfBuilder
from bunraku.geometry.resampling import Resampling
from bunraku.geometry.rotations import nearest_rotation, quaternion_from_matrix

__all__ = ["add_bone_clip", "bone_tracks", "placed"]

SMALL = 1e-6  # what changes less, over the size of the rig or as a quaternion, stands still


def add_bone_clip(
    builder: GltfBuilder, joints: list[int], local: np.ndarray, have: float, want: float, name: str
) -> None:
    """Add the animation: channels where a node leaves what its entry says, one key where it stays there.

    Args:
        builder: With the nodes of the bones.
        joints: Node of each bone, length J.
        local: Transform of each bone's node in its parent, shape (N, J, 4, 4).
        have: Frames a second of these [1/s].
        want: Frames a second of the channels [1/s].
        name: The clip's name.
    """
    nodes = builder.tree["nodes"]
    scale = np.linalg.norm(local[..., :3, :3], axis=-2)
    _, rotation = bone_tracks(local)
    flips = np.where((rotation[1:] * rotation[:-1]).sum(-1) < 0, -1.0, 1.0)
    rotation[1:] *= np.cumprod(flips, axis=0)[..., None]
    between = Resampling.of(len(local), have, want)
    turned = between.quaternions(rotation)
    size = max(float(np.abs(local[..., :3, 3]).max()), 1e-9)
    every = builder.array((np.arange(len(between)) / want).astype(np.float32)[:, None], bounds=True)
    once = builder.array(np.zeros((1, 1), np.float32), bounds=True)
    tracks = (
        ("translation", between.linear(local[..., :3, 3]), SMALL * size),
        ("rotation", turned, SMALL),
        ("scale", between.linear(scale), None),
    )
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
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
            channels.append({"sampler": len(samplers), "target": {"node": node, "path": kind}})
            data = builder.array(np.ascontiguousarray(track if moves else track[:1]))
            samplers.append({"input": every if moves else once, "output": data, "interpolation": "LINEAR"})
    if not any(
        sampler["input"] == every for sampler in samplers
    ):  # one channel keeps the length of a motion that stands still
        first = next(channel["sampler"] for channel in channels if channel["target"]["path"] == "rotation")
        samplers[first] |= {
            "input": every,
            "output": builder.array(np.repeat(turned[:1, 0].astype(np.float32), len(between), axis=0)),
        }
    builder.add("animations", {"name": name, "channels": channels, "samplers": samplers})


def bone_tracks(local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Translations [m] (N, J, 3) and rotations (N, J, 4), quaternions xyzw, of transforms of shape (N, J, 4, 4)."""
    linear = local[..., :3, :3]
    scale = np.linalg.norm(linear, axis=-2)
    return local[..., :3, 3], quaternion_from_matrix(nearest_rotation(linear / np.maximum(scale, 1e-12)[..., None, :]))


def placed(node: dict[str, object]) -> dict[str, np.ndarray]:
    """Translation, rotation and scale of a node's entry; a matrix is taken apart, as animated nodes may have none."""
    if "matrix" in node:
        matrix = np.array(node.pop("matrix"), float).reshape(4, 4).T
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        rotation = quaternion_from_matrix(nearest_rotation(matrix[:3, :3] / np.maximum(scale, 1e-12)))
        node |= {"translation": matrix[:3, 3].tolist(), "rotation": rotation.tolist(), "scale": scale.tolist()}
    defaults = {"translation": (0, 0, 0), "rotation": (0, 0, 0, 1), "scale": (1, 1, 1)}
    return {key: np.array(node.get(key, value), float) for key, value in defaults.items()}
