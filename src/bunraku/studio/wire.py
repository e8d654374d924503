"""A take as it is sent to the page, and on disk.

The page gets a character's mesh and skin once, as GLB, and of each take only the tracks of its joints, and where
apparel moves on its own how it leaves its skin. These are the tracks that the GLB of the take would hold, so what is
shown is what is saved.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bunraku.core.animation import Animation, PointAnimation, RigAnimation
from bunraku.core.arrays import npz_names, open_npz, read_member
from bunraku.core.character import Character, Handles, Rig
from bunraku.core.files import atomic_write, read_bounded
from bunraku.errors import CharacterError, FormatError, MotionError
from bunraku.files import (
    REFERENCE,
    before_skin,
    joint_tracks,
    motion_arrays,
    pack_animation,
    read_npz_motion,
    read_positions,
    read_reference,
    shapes_of_meshes,
)

APPAREL = "apparel.npz"
"""The file beside a take's motion that says where apparel is that moves on its own."""


@dataclass(frozen=True, eq=False)
class Dressed:
    """A take whose apparel is learned, or swings on chains of bones: what moves the body, the same at the rate of
    apparel, with its displacements, the factors that it was made with, and the same on a rig with chains, where apparel
    swings on them.
    """

    body: Animation | RigAnimation
    points: PointAnimation
    stiffness: float
    gravity: float = 1.0
    bones: RigAnimation | None = None

    @classmethod
    def of_chains(
        cls, body: Animation | RigAnimation, bones: RigAnimation, stiffness: float, gravity: float
    ) -> Dressed:
        """The take of a body's motion, and of the same on a rig with chains."""
        moved = body.at(bones.fps)
        skinned = moved.animation() if isinstance(moved, RigAnimation) else moved
        offsets = bones.vertices() - skinned.vertices()
        offsets[:, np.abs(offsets).max(axis=(0, 2)) < 1e-5 * body.character.height] = 0
        return cls(body, PointAnimation(skinned, offsets.astype(np.float32)), stiffness, gravity, bones)

    @property
    def motion(self) -> Literal["learn", "chains"]:
        """How its apparel moves."""
        return "learn" if self.bones is None else "chains"

    @property
    def handles(self) -> Handles:
        """What moves its skin."""
        return self.points.handles

    @property
    def fps(self) -> float:
        """Frames a second [1/s]."""
        return self.points.fps

    def __len__(self) -> int:
        return len(self.points.motion)


Take = Animation | RigAnimation | Dressed


def body_of(take: Take) -> Animation | RigAnimation:
    """What moves the body of a take."""
    return take.body if isinstance(take, Dressed) else take


MAGIC = b"BNRC"
_VERSION = 1


def packed_clip(take: Take) -> bytes:
    """The tracks of a take: magic, bytes of the header, a JSON header padded to four bytes, then float32 translations
    [m] (N, K, 3) and quaternions xyzw (N, K, 4), both in the frame of each joint's parent as in the GLB.

    Where apparel is learned, for each primitive that the header names (`parts`: mesh, primitive, rows) follow uint32
    indices of its vertices that leave their skin (R,) and int16 displacements before the skin (N, R, 3), padded to four
    bytes, in units of the header's `unit` [m].
    """
    shown = take.points if isinstance(take, Dressed) else take
    translations, rotations = joint_tracks(shown.handles.positions, shown.motion)
    frames, joints = translations.shape[:2]
    header: dict[str, Any] = {"version": _VERSION, "frames": frames, "joints": joints, "fps": float(take.fps)}
    if not isinstance(body_of(take), Animation):  # the first joint of bones stands still
        middle = shown.character.vertices.mean(axis=0)
        header["root"] = 1 + int(np.argmin(np.linalg.norm(shown.handles.positions[1:] - middle, axis=1)))
    arrays: list[np.ndarray] = [translations.astype("<f4"), rotations.astype("<f4")]
    if isinstance(take, Dressed):
        moving = np.flatnonzero(take.points.offsets.any(axis=(0, 2)))
        moved = before_skin(take.points, moving)
        meshes = shapes_of_meshes(take.points.character, moving, moved)
        parts = []
        unit = max((float(np.abs(group.shapes).max(initial=0)) for groups in meshes for group in groups), default=0.0)
        unit = max(unit, 1e-9) / np.iinfo(np.int16).max
        for mesh, groups in enumerate(meshes):
            by_member = {member: group for group in groups for member in group.primitives}
            for primitive, member in enumerate(sorted(by_member)):
                rows = by_member[member].rows
                parts.append({"mesh": mesh, "primitive": primitive, "rows": len(rows)})
                values = np.round(by_member[member].shapes / unit).astype("<i2").reshape(-1)
                arrays += [rows.astype("<u4"), np.pad(values, (0, values.size % 2))]
        header |= {"unit": unit, "parts": parts}
    words = json.dumps(header).encode()
    words += b" " * (-len(words) % 4)
    return b"".join([MAGIC, struct.pack("<I", len(words)), words, *(array.tobytes() for array in arrays)])


def save_take(take: Take, path: Path) -> None:
    """Write a take so that `load_take` gives it back: its motion, and `APPAREL` beside it where that is learned;
    FormatError where the file cannot be written.
    """
    if isinstance(take, Dressed):
        offsets = take.points.offsets
        moving = np.flatnonzero(offsets.any(axis=(0, 2)))
        _write_arrays(path.with_name(APPAREL), np.savez_compressed, {
            "vertices": moving.astype(np.int32), "offsets": offsets[:, moving],
            "stiffness": np.float32(take.stiffness), "gravity": np.float32(take.gravity),
            **({} if take.bones is None else _packed_bones(take.bones)),
        })  # fmt: skip
        take = take.body
    if isinstance(take, Animation):
        with atomic_write(path) as file:
            file.write(pack_animation(take))
        return
    arrays: dict[str, Any] = {} if take.reference is None else motion_arrays(take.reference, REFERENCE)
    arrays |= {"bone_rotations": take.rotations, "bone_translations": take.translations}
    _write_arrays(path, np.savez_compressed, {"bone_fps": np.float32(take.fps), **arrays})


def _write_arrays(path: Path, pack: Callable[..., None], arrays: Mapping[str, Any]) -> None:
    packed = io.BytesIO()
    pack(packed, **arrays)
    with atomic_write(path) as file:
        file.write(packed.getvalue())


def load_take(path: Path, character: Character, handles: Handles) -> Take:
    """A take of a character; FormatError where the file is broken, or was made for other handles, MotionError where
    what it holds breaks the rules of a motion.
    """
    from bunraku.pipelines.apparel import RATE

    body = _load_body(path, character, handles)
    beside = path.with_name(APPAREL)
    if not beside.is_file():
        return body
    data = read_bounded(beside)
    with open_npz(beside, data) as archive:
        if not {"vertices", "offsets", "stiffness"} <= npz_names(archive):
            raise FormatError(beside, "it holds no apparel; make the take again")
        arrays = {name: read_member(beside, archive, name, len(data)) for name in sorted(npz_names(archive))}
    moving, offsets, stiffness = (arrays[name] for name in ("vertices", "offsets", "stiffness"))
    moved = body.at(RATE)
    skinned = moved.animation() if isinstance(moved, RigAnimation) else moved
    shape = len(skinned.motion), len(moving), 3
    if offsets.shape != shape or moving.ndim != 1 or (moving >= len(character.vertices)).any() or (moving < 0).any():
        raise FormatError(beside, "its apparel is of another mesh or clip; make the take again")
    everywhere = np.zeros((len(offsets), len(character.vertices), 3), np.float32)
    everywhere[:, moving.astype(np.int64)] = offsets
    bones = _bones_of(arrays, beside, skinned) if "rig_names" in arrays else None
    gravity = float(arrays.get("gravity", 1.0))
    return Dressed(body, PointAnimation(skinned, everywhere), float(stiffness), gravity, bones)


def _packed_bones(bones: RigAnimation) -> dict[str, Any]:
    """The rig with chains and what it does."""
    rig = bones.character.rig
    assert rig is not None
    names = np.frombuffer(json.dumps(rig.names).encode(), np.uint8)
    return {
        "rig_names": names, "rig_parents": rig.parents, "rig_transforms": rig.transforms, "rig_indices": rig.indices,
        "rig_weights": rig.weights, "rig_fps": np.float32(bones.fps), "rig_rotations": bones.rotations,
        "rig_translations": bones.translations,
    }  # fmt: skip


def _bones_of(found: dict[str, np.ndarray], path: Path, skinned: Animation) -> RigAnimation:
    """The inverse of `_packed_bones`; FormatError where its rig is of another mesh, or none."""
    try:
        names = tuple(str(name) for name in json.loads(found["rig_names"].astype(np.uint8).tobytes()))
        rig = Rig(names, *(found[f"rig_{name}"] for name in ("parents", "transforms", "indices", "weights")))
        character = replace(skinned.character, rig=rig, avatar=None)
        if len(rig.indices) != len(character.vertices):
            raise FormatError(path, "its chains are of another mesh; make the take again")
        return RigAnimation(character, found["rig_rotations"], found["rig_translations"], float(found["rig_fps"]))
    except (KeyError, TypeError, ValueError, CharacterError, MotionError):
        raise FormatError(path, "it holds no chains that can be read; make the take again") from None


def _load_body(path: Path, character: Character, handles: Handles) -> Animation | RigAnimation:
    data = read_bounded(path)
    with open_npz(path, data) as archive:
        if "bone_rotations" in npz_names(archive):
            rotations, translations, fps = (
                read_member(path, archive, f"bone_{name}", len(data)) for name in ("rotations", "translations", "fps")
            )
            return RigAnimation(character, rotations, translations, float(fps), read_reference(path, data))
    positions = read_positions(path, data)
    if positions is None or positions.shape != handles.positions.shape:
        raise FormatError(path, "this take was made for other handles of the character; make it again")
    return Animation(character, handles, read_npz_motion(path, data), read_reference(path, data))


def save_handles(handles: Handles, path: Path) -> None:
    """Write handles: positions, the four largest weights of each vertex, features, roles; FormatError where the file
    cannot be written.
    """
    arrays = {"positions": handles.positions, "weights": handles.weights, "roles": handles.played}
    if handles.features is not None:
        arrays["features"] = handles.features
    if handles.rigid:
        arrays["rigid"] = np.ones(1)
    _write_arrays(path, np.savez, arrays)  # compressing a large mesh would take too long


def load_handles(path: Path) -> Handles:
    """The handles of `save_handles`; FormatError where the file is broken, CharacterError where what it holds breaks
    the rules of handles.
    """
    data = read_bounded(path)
    with open_npz(path, data) as archive:
        names = npz_names(archive)
        arrays = {name: read_member(path, archive, name, len(data)) for name in sorted(names)}
    if not {"positions", "weights", "roles"} <= set(arrays):
        raise FormatError(path, "it holds no handles; open the character again")
    roles = arrays["roles"].astype(np.int64)
    return Handles(
        arrays["positions"],
        arrays["weights"],
        arrays.get("features"),
        None if np.array_equal(roles, np.arange(len(roles))) else roles,
        "rigid" in arrays,
    )
