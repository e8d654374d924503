"""Motion in NumPy files: handle motion as NPZ, AMASS, and HumanML3D."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.core.arrays import npz_names, open_npz, read_member, read_npy, refuse_objects
from bunraku.core.body.layout import JOINT_COUNT, JOINT_PARENTS, handle_names
from bunraku.core.files import atomic_write
from bunraku.core.geometry.rotations import matrix_from_6d, matrix_from_axis_angle, matrix_y
from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton
from bunraku.errors import FormatError

if TYPE_CHECKING:
    from bunraku.core.animation import Animation
    from bunraku.core.character import Handles

AMASS_ARRAYS = frozenset({"poses", "trans", "root_orient", "pose_body"})
"""Arrays that mark an .npz as one of AMASS."""

_RATES = ("mocap_framerate", "mocap_frame_rate", "mocap_frame_rates")
_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float32)  # +Z up to +Y up
MOST_FRAMES = 1_000_000  # more than two hours at 120 frames a second; files of zeros pack to next to nothing
_STRAIGHT = 0.9  # a person who stands has the pelvis at least this share of a leg above the lower ankle
_SIZES = (0.7, 1.3)  # of people, as shares of the reference body; what else is found says that the ground is not at 0


def read_amass(path: Path, data: bytes) -> SkeletalMotion:
    """Read an AMASS file: SMPL's 22 joints, +Y up, at the rate of the file.

    Rotations are converted from SMPL's T-pose to the reference body's, so limbs point where they did. The pelvis is at
    the file's `trans`, which differs from it by a constant of the body's shape; the skeleton is the reference body's,
    scaled so that the feet reach the ground at height 0 where the person stands. FormatError if the file is broken,
    holds pickled objects, or lacks what a motion needs; MotionError if a value is not a number.
    """
    with open_npz(path, data) as archive:
        refuse_objects(path, archive)
        names = npz_names(archive)
        rate = next((name for name in _RATES if name in names), None)
        if "trans" not in names or not ("poses" in names or {"root_orient", "pose_body"} <= names) or rate is None:
            raise FormatError(path, "this NPZ lacks poses, trans or mocap_framerate, so it is not a motion of AMASS")
        parts = ("poses",) if "poses" in names else ("root_orient", "pose_body")
        poses = np.concatenate(
            [_rows(path, read_member(path, archive, name, len(data)), name) for name in parts], axis=1
        )
        trans = _rows(path, read_member(path, archive, "trans", len(data)), "trans")
        fps = read_member(path, archive, rate, len(data))
    if poses.shape[1] < 3 * JOINT_COUNT or trans.shape != (len(poses), 3):
        raise FormatError(
            path,
            f"its poses {poses.shape} and trans {trans.shape} are not (N, 66 or more) and (N, 3); download it again",
        )
    if fps.size != 1 or not 1 <= float(fps.reshape(())) <= 1000:
        raise FormatError(path, f"its '{rate}' must be one number from 1 to 1000; download it again")
    if len(poses) > MOST_FRAMES:
        raise FormatError(
            path, f"its {len(poses):,} frames are too many, at most {MOST_FRAMES:,} are read; cut it into shorter ones"
        )
    rotations = matrix_from_axis_angle(poses[:, : 3 * JOINT_COUNT].reshape(-1, JOINT_COUNT, 3))
    rotations[:, 0] = _UP @ rotations[:, 0]
    rotations = _in_our_pose(rotations)
    return _sized(rotations, trans @ _UP.T, float(fps.reshape(())))


def _in_our_pose(rotations: np.ndarray) -> np.ndarray:
    """Local rotations relative to SMPL's T-pose as ones relative to the reference body's, shape (N, 22, 3, 3)."""
    from bunraku.core.body.reference import smpl_rotations  # after the formats, in the order of imports

    rest_rotations = smpl_rotations()
    above = rest_rotations[[max(parent, 0) for parent in JOINT_PARENTS]]
    return np.asarray(np.swapaxes(above, -1, -2) @ rotations @ rest_rotations, np.float32)


def _rows(path: Path, array: np.ndarray, name: str) -> np.ndarray:
    if array.ndim != 2 or not len(array):
        raise FormatError(
            path, f"its '{name}' must have a row for each frame, not the shape {array.shape}; download it again"
        )
    return array


def _sized(rotations: np.ndarray, trans: np.ndarray, fps: float) -> SkeletalMotion:
    """On the reference body's skeleton, scaled to the person by the height of the pelvis while standing."""
    from bunraku.core.body.reference import leg_length, reference_body  # after the formats, in the order of imports

    body = reference_body()
    skeleton = body.skeleton
    motion = SkeletalMotion(skeleton, rotations, trans, fps)
    ankles = (motion.world()[1][:, [7, 8], 1] - trans[:, 1:2]).min(axis=1) - body.joints[7, 1]
    standing = ankles < -_STRAIGHT * leg_length(body.joints)
    size = float(np.median(trans[standing, 1] / -ankles[standing])) if standing.sum() >= 5 else 1.0
    if not _SIZES[0] < size < _SIZES[1]:
        return motion
    return SkeletalMotion(
        Skeleton(skeleton.names, skeleton.parents, skeleton.offsets * np.float32(size)), rotations, trans, fps
    )


HUMANML3D_FPS = 20.0
"""Rate of all motions of the set (Guo et al. 2022) [1/s]."""
MAX_FRAMES = 24_000
"""Longest motion that is read: each frame takes a tenth of a millisecond to fit its rotations."""
VECTOR_SIZE = 12 * JOINT_COUNT - 1


def read_humanml3d(path: Path, data: bytes) -> SkeletalMotion:
    """Read a file of `new_joint_vecs` or `new_joints`: SMPL's 22 joints at 20 frames a second. FormatError if the file
    is broken, holds objects, or has another shape; MotionError if a value is not a number.
    """
    array = read_npy(path, data)
    if len(array.shape) and len(array) > MAX_FRAMES:
        raise FormatError(
            path, f"it has {len(array):,} frames but at most {MAX_FRAMES:,} (20 minutes) are read; cut it into parts"
        )
    if array.ndim == 2 and array.shape[1] == VECTOR_SIZE and len(array):
        positions = positions_of_vectors(array)
    elif array.ndim == 3 and array.shape[1:] == (JOINT_COUNT, 3) and len(array):
        positions = array
    else:
        shapes = f"(N, {VECTOR_SIZE}) or (N, {JOINT_COUNT}, 3)"
        raise FormatError(path, f"motions of HumanML3D have shape {shapes}, not {array.shape}; give one of those")
    from bunraku.core.body.joint_rotations import motion_from_positions  # after the formats, in the order of imports

    return motion_from_positions(positions, HUMANML3D_FPS)


def positions_of_vectors(vectors: np.ndarray) -> np.ndarray:
    """Joint positions [m], shape (N, 22, 3), of raw features (N, 263), from a start at x = z = 0 that faces +Z."""
    x = np.asarray(vectors, float)
    turned, steps = np.zeros(len(x)), np.zeros((len(x), 3))
    turned[1:] = np.cumsum(x[:-1, 0])
    steps[1:, [0, 2]] = x[:-1, 1:3]
    facing = matrix_y(-2 * turned)  # the set stores the turn that takes the heading off
    root = np.cumsum(np.einsum("nij,nj->ni", facing, steps), axis=0)
    local = np.zeros((len(x), JOINT_COUNT, 3))
    local[:, 0, 1] = x[:, 3]
    local[:, 1:] = x[:, 4 : 4 + 3 * (JOINT_COUNT - 1)].reshape(len(x), -1, 3)
    return np.asarray(np.einsum("nij,nkj->nki", facing, local) + root[:, None])


REFERENCE = "reference_"

_NEEDED = ("translations", "rotations", "root_translation", "root_rotation", "fps")
_OWN = ("own_kind", "own_height", "soft")
_ALL_OWN = "native"
"""The single member that older files hold for all three."""


def write_animation(animation: Animation, path: Path) -> Path:
    """Write the handle motion of an animation (see `pack_animation`)."""
    with atomic_write(path) as file:
        file.write(pack_animation(animation))
    return path


def pack_animation(animation: Animation) -> bytes:
    """The NPZ of an animation's handle motion.

    The arrays, all float32: `translations` (N, K, 3) [m], `rotations` (N, K, 3, 3), `root_translation` (N, 3) [m],
    `root_rotation` (N, 3, 3), `fps` () [1/s], `own_kind`, `own_height` and `soft` (), 0 or 1 (`HandleMotion`),
    `handle_positions` (K, 3) [m]; and `handle_names` (K,) text. Where it is known, the reference body's motion that it
    was fitted from, under the same names with `reference_` before them.
    """
    return pack_motion(animation.motion, animation.handles, animation.reference)


def pack_motion(motion: HandleMotion, handles: Handles, reference: HandleMotion | None = None) -> bytes:
    """The NPZ of a motion of some handles, as `pack_animation` describes it."""
    arrays: dict[str, Any] = motion_arrays(motion)
    arrays |= {"handle_positions": handles.positions, "handle_names": np.array(handle_names(handles.played))}
    if reference is not None:
        arrays |= motion_arrays(reference, REFERENCE)
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)
    return packed.getvalue()


def motion_arrays(motion: HandleMotion, prefix: str = "") -> dict[str, np.ndarray]:
    """The arrays of a motion by their names in an NPZ, with `prefix` before each."""
    return {f"{prefix}{name}": np.asarray(getattr(motion, name), np.float32) for name in (*_NEEDED, *_OWN)}


def read_any_motion(path: Path, data: bytes) -> HandleMotion | SkeletalMotion:
    """Read an NPZ: a motion of AMASS if it has that set's arrays, a handle motion otherwise. FormatError if the file is
    broken, or is neither; MotionError if what it holds breaks the rules of a motion.
    """

    with open_npz(path, data) as archive:
        names = npz_names(archive)
    return read_amass(path, data) if AMASS_ARRAYS & names else read_npz_motion(path, data)


def read_npz_motion(path: Path, data: bytes, *, prefix: str = "") -> HandleMotion:
    """Read a handle motion, with rotations in 6D or as matrices; with the prefix `REFERENCE` the reference body's
    motion. FormatError if the file is broken, or is not a handle motion; MotionError if what it holds breaks the rules
    of a motion.
    """
    with open_npz(path, data) as archive:
        missing = [name for name in _NEEDED if prefix + name not in npz_names(archive)]
        if missing:
            raise FormatError(
                path, f"this NPZ lacks {', '.join(missing)}, so it is not handle motion; save one with Animation.save"
            )
        arrays = {name: read_member(path, archive, prefix + name, len(data)) for name in _NEEDED}
        members = npz_names(archive)
        names = {name: prefix + (name if prefix + name in members else _ALL_OWN) for name in _OWN}
        own = {
            name: member in members and bool(np.any(read_member(path, archive, member, len(data))))
            for name, member in names.items()
        }
    if arrays["fps"].size != 1:
        raise FormatError(path, "its 'fps' must be one number; save it again")
    fps = float(arrays["fps"].reshape(()))
    if not 1 <= fps <= 1000:
        raise FormatError(path, f"its 'fps' must be from 1 to 1000, not {fps:g}; save it again")
    return HandleMotion(
        arrays["translations"],
        _matrices(path, arrays["rotations"], 4),
        arrays["root_translation"],
        _matrices(path, arrays["root_rotation"], 3),
        fps,
        **own,
    )


def read_reference(path: Path, data: bytes) -> HandleMotion | None:
    """The reference body's motion that a handle motion was fitted from, or None where the file does not hold it. Errors
    are those of `read_npz_motion`.
    """
    with open_npz(path, data) as archive:
        has_reference = f"{REFERENCE}translations" in npz_names(archive)
    return read_npz_motion(path, data, prefix=REFERENCE) if has_reference else None


def read_positions(path: Path, data: bytes) -> np.ndarray | None:
    """Rest positions of the handles that a motion was made for [m], shape (K, 3), or None where the file does not hold
    them. FormatError if the file is broken.
    """
    with open_npz(path, data) as archive:
        if "handle_positions" not in npz_names(archive):
            return None
        positions = read_member(path, archive, "handle_positions", len(data))
    if positions.ndim != 2 or positions.shape[1] != 3 or not np.isfinite(positions).all():
        raise FormatError(path, "its 'handle_positions' must be points; save it again")
    return positions


def _matrices(path: Path, values: np.ndarray, dimensions: int) -> np.ndarray:
    if values.ndim == dimensions - 1 and values.shape[-1] == 6:
        matrices: np.ndarray = matrix_from_6d(values)
        return matrices
    if values.ndim == dimensions and values.shape[-2:] == (3, 3):
        return values
    raise FormatError(path, f"rotations must be 6D or 3 x 3 matrices, not of shape {values.shape}; save it again")
