"""AMASS: motion capture as pose parameters of SMPL-H and SMPL-X in `.npz` files (Mahmood et al. 2019).

The rotations of the 22 body joints are taken and put on the reference body's bones; no body model is needed. Shapes,
soft tissue and fingers are left out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bunraku.body.layout import JOINT_COUNT, JOINT_PARENTS
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.errors import FormatError
from bunraku.formats.arrays.npy import npz_names, open_npz, read_member, refuse_objects
from bunraku.geometry.rotations import matrix_from_axis_angle

__all__ = ["AMASS_ARRAYS", "read_amass"]

AMASS_ARRAYS = frozenset({"poses", "trans", "root_orient", "pose_body"})
"""Arrays that make an .npz one of AMASS."""

_RATES = ("mocap_framerate", "mocap_frame_rate", "mocap_frame_rates")
_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float32)  # +Z up to +Y up
MOST_FRAMES = 1_000_000  # more than two hours at 120 frames a second; files of zeros pack to next to nothing
_STRAIGHT = 0.9  # who stands has the pelvis this share of a leg over the lower ankle, at least
_SIZES = (0.7, 1.3)  # of people, as shares of the reference body; what else is found says that the ground is not at 0


def read_amass(path: Path, data: bytes) -> SkeletalMotion:
    """Read an AMASS file.

    Rotations are turned from SMPL's T-pose to the reference body's, so limbs point where they did. The place of the
    pelvis is that of the file, whose `trans` is the pelvis but for a constant of the body's shape; the skeleton is the
    reference body's, scaled so that the feet reach the ground at height 0 where the person stands.

    Args:
        path: The file.
        data: Its bytes.

    Returns:
        The 22 joints of SMPL, +Y up, at the rate of the file.

    Raises:
        FormatError: The file is broken, holds pickled objects, or lacks what a motion needs.
        MotionError: A value is not a number.
    """
    with open_npz(path, data) as archive:
        refuse_objects(path, archive)
        names = npz_names(archive)
        rate = next((name for name in _RATES if name in names), None)
        if "trans" not in names or not ("poses" in names or {"root_orient", "pose_body"} <= names) or rate is None:
            raise FormatError(
                path,
                "this NPZ lacks poses, trans or mocap_framerate, so it is no motion of AMASS; some of its files are "
                "shapes only",
            )
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
    from bunraku.body.smpl_rest import smpl_rotations  # after the formats, in the order of imports

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
    """On the reference body's skeleton, scaled to the person as far as the height of the pelvis while standing
    tells.
    """
    from bunraku.body.reference import leg_length, reference_body  # after the formats, in the order of imports

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
