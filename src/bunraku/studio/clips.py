"""A take on the wire, and on disk.

The page gets a character's mesh and skin once, as GLB, and of each take only what the skin's joints do: the very tracks
that the GLB of the take would hold (`formats.gltf.handle_channels.joint_tracks`), so what is shown is what is saved.
"""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import FormatError
from bunraku.formats.arrays.npy import npz_names, open_npz, read_member
from bunraku.formats.arrays.npz import pack_animation, read_motion, read_positions, read_reference
from bunraku.formats.files import atomic_write, read_bounded
from bunraku.formats.gltf.handle_channels import joint_tracks

__all__ = ["Take", "load_handles", "load_take", "packed_clip", "save_handles", "save_take", "unpacked_clip"]

Take = Animation | RigAnimation
MAGIC = b"BNRC"
_VERSION = 1


def packed_clip(take: Take) -> bytes:
    """What the joints of a take do: magic, bytes of the header, a JSON header padded to four bytes, then float32
    translations [m] (N, K, 3) and quaternions xyzw (N, K, 4), both in the frame of each joint's parent as in the GLB.
    """
    translations, rotations = joint_tracks(take.handles.positions, take.motion)
    frames, joints = translations.shape[:2]
    header = json.dumps({"version": _VERSION, "frames": frames, "joints": joints, "fps": float(take.fps)}).encode()
    header += b" " * (-len(header) % 4)
    return b"".join(
        [
            MAGIC,
            struct.pack("<I", len(header)),
            header,
            translations.astype("<f4").tobytes(),
            rotations.astype("<f4").tobytes(),
        ]
    )


def unpacked_clip(data: bytes) -> tuple[float, np.ndarray, np.ndarray]:
    """Frames a second, translations (N, K, 3) and quaternions (N, K, 4) of `packed_clip`."""
    length = struct.unpack("<I", data[4:8])[0]
    header = json.loads(data[8 : 8 + length])
    values = np.frombuffer(data[8 + length :], "<f4")
    shape = header["frames"], header["joints"]
    split = shape[0] * shape[1] * 3
    return header["fps"], values[:split].reshape(*shape, 3), values[split:].reshape(*shape, 4)


def save_take(take: Take, path: Path) -> None:
    """Write a take so that `load_take` gives it back.

    Raises:
        FormatError: The file cannot be written.
    """
    if isinstance(take, Animation):
        data = pack_animation(take)
    else:
        packed = io.BytesIO()
        np.savez_compressed(
            packed, bone_rotations=take.rotations, bone_translations=take.translations, bone_fps=np.float32(take.fps)
        )
        data = packed.getvalue()
    with atomic_write(path) as file:
        file.write(data)


def load_take(path: Path, character: Character, handles: Handles) -> Take:
    """A take of a character.

    Raises:
        FormatError: The file is broken, or was made for other handles.
        MotionError: What it holds breaks the rules of a motion.
    """
    data = read_bounded(path)
    with open_npz(path, data) as archive:
        if "bone_rotations" in npz_names(archive):
            rotations, translations, fps = (
                read_member(path, archive, f"bone_{name}", len(data)) for name in ("rotations", "translations", "fps")
            )
            return RigAnimation(character, rotations, translations, float(fps))
    positions = read_positions(path, data)
    if positions is None or positions.shape != handles.positions.shape:
        raise FormatError(path, "this take was made for other handles of the character; make it again")
    return Animation(character, handles, read_motion(path, data), read_reference(path, data))


def save_handles(handles: Handles, path: Path) -> None:
    """Write handles: positions, the four largest weights of each vertex, features, roles.

    Raises:
        FormatError: The file cannot be written.
    """
    arrays = {"positions": handles.positions, "weights": handles.weights, "roles": handles.played}
    if handles.features is not None:
        arrays["features"] = handles.features
    packed = io.BytesIO()
    np.savez_compressed(packed, allow_pickle=False, **arrays)
    with atomic_write(path) as file:
        file.write(packed.getvalue())


def load_handles(path: Path) -> Handles:
    """The handles of `save_handles`.

    Raises:
        FormatError: The file is broken.
        CharacterError: What it holds breaks the rules of handles.
    """
    data = read_bounded(path)
    with open_npz(path, data) as archive:
        names = npz_names(archive)
        found = {name: read_member(path, archive, name, len(data)) for name in sorted(names)}
    if not {"positions", "weights", "roles"} <= set(found):
        raise FormatError(path, "it holds no handles; open the character again")
    roles = found["roles"].astype(np.int64)
    return Handles(
        found["positions"],
        found["weights"],
        found.get("features"),
        None if np.array_equal(roles, np.arange(len(roles))) else roles,
    )
