"""The handle motion inside a GLB that Bunraku wrote.

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

__all__ = ["add_clip", "clip_handles", "drop_clip", "packed_motion", "read_motion"]

KEY = "bunraku_motion"


def add_clip(builder: GltfBuilder, animation: Animation) -> None:
    """Put the handle motion of an animation into a document."""
    asset, view = builder.tree["asset"], builder.view(pack_animation(animation))
    asset["extras"] = {**(asset["extras"] if isinstance(asset.get("extras"), dict) else {}), KEY: view}


def drop_clip(tree: dict[str, Any]) -> dict[str, Any]:
    """The tree without the mark of a motion that it may have been carried over with."""
    extras = tree["asset"].get("extras")
    if isinstance(extras, dict) and KEY in extras:
        del extras[KEY]
        if not extras:
            del tree["asset"]["extras"]
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
    return Handles(
        rig.positions[order], weights, roles=None if np.array_equal(played, np.arange(len(played))) else played
    )


def _role(name: str) -> int | None:
    """The handle whose part a joint of this name plays, or None: left_hip_2 is the second left hip."""
    plain, _, number = name.rpartition("_")
    if name in HANDLE_NAMES:
        return HANDLE_NAMES.index(name)
    return HANDLE_NAMES.index(plain) if number.isdecimal() and plain in HANDLE_NAMES else None
