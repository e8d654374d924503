"""The handle motion inside a GLB that Bunraku wrote: as channels of its nodes, and as it is.

The channels of a GLB are quaternions at the frame rate of the file, from which the motion that was fitted cannot be had
back to the last bit, nor the one of the reference body at all. So an NPZ with both travels in a buffer view of its own,
which `asset.extras` names: viewers pass over it, and 3D programs that write the file anew leave it out.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError
from bunraku.formats.arrays.npz import pack_animation
from bunraku.formats.arrays.npz import read_motion as read_npz
from bunraku.formats.gltf.builder import GltfBuilder
from bunraku.formats.gltf.container.open import open_document

if TYPE_CHECKING:
    from bunraku.core.animation import Animation
from bunraku.body.layout import handle_names
from bunraku.geometry.rotations import quaternion_from_matrix

__all__ = [
    "add_clip",
    "add_joints",
    "add_motion",
    "clip_handles",
    "drop_clip",
    "joint_tracks",
    "packed_motion",
    "read_motion",
]


KEY = "bunraku_motion"
RIGID = "bunraku_rigid"
"""Mark of the root joint of a figure whose blocks do not bend."""


def add_clip(builder: GltfBuilder, animation: Animation) -> None:
    """Put the handle motion of an animation into a document."""
    asset, view = builder.tree["asset"], builder.view(pack_animation(animation))
    asset["extras"] = {**(asset["extras"] if isinstance(asset.get("extras"), dict) else {}), KEY: view}


def drop_clip(tree: dict[str, object]) -> dict[str, Any]:
    """The tree without the mark of a motion that it may have been carried over with."""
    asset = tree["asset"]
    extras = asset.get("extras") if isinstance(asset, dict) else None
    if isinstance(asset, dict) and isinstance(extras, dict) and KEY in extras:
        del extras[KEY]
        if not extras:
            del asset["extras"]
    return tree


def read_motion(path: Path, data: bytes) -> HandleMotion:
    """The handle motion of a GLB that Bunraku wrote, in the frame of its character.

    Raises:
        FormatError: The file is broken, or holds none.
        MotionError: What it holds breaks the rules of a motion.
    """
    return read_npz(path, packed_motion(path, data))


def packed_motion(path: Path, data: bytes) -> bytes:
    """The NPZ in a GLB that Bunraku wrote.

    Raises:
        FormatError: The file is broken, or holds none.
    """
    document = open_document(path, data)
    extras = document.tree["asset"].get("extras")
    view = extras.get(KEY) if isinstance(extras, dict) else None
    if view is None:
        raise FormatError(
            path,
            "it holds no handle motion of Bunraku (another program may have written it anew); make one with `bunraku "
            "animate`",
        )
    return bytes(document.view(view))


def clip_handles(path: Path, character: Character) -> Handles:
    """The handles that a file of `Animation.save` or `bunraku rig` has for joints, as they were but for rounding.

    Raises:
        FormatError: The joints are others.
    """
    rig = character.rig
    roles = [_role(name) for name in rig.names] if rig is not None else []
    if rig is None or len(rig.names) != len(HANDLE_NAMES) or None in roles:
        raise FormatError(
            path,
            f"its joints are not the {len(HANDLE_NAMES)} handles of Bunraku; animate the character anew with `bunraku "
            "animate`",
        )
    own = [
        HANDLE_NAMES.index(name) if name in HANDLE_NAMES else -1 for name in rig.names
    ]  # -1 plays the part of another
    free = iter(sorted(set(range(len(own))) - set(own)))
    order = np.argsort([next(free) if slot < 0 else slot for slot in own])
    weights = rig.dense_weights()[:, order]
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
    played = np.array(roles, np.int64)[order]
    rigid = _rigid(character) and weights.max(axis=1).min() > 0.999
    return Handles(
        rig.positions[order],
        weights,
        roles=None if np.array_equal(played, np.arange(len(played))) else played,
        rigid=bool(rigid),
    )


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
    if handles.rigid:
        builder.tree["nodes"][first]["extras"] = {RIGID: True}
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
