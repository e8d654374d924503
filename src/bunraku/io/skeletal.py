"""Motions without a character, written to files: skeletal ones, and handle motions of the reference body as its
skeleton's.
"""

from __future__ import annotations

from pathlib import Path

from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.errors import OptionError

__all__ = ["as_skeletal", "write_motion_bvh", "write_motion_npz", "write_motion_vrma"]


def as_skeletal(motion: HandleMotion | SkeletalMotion) -> SkeletalMotion:
    """The motion itself if it is of a skeleton, that of the reference body's 22 joints if it is one of its handles.

    Raises:
        MotionError: A handle motion of too few handles.
    """
    from bunraku.body.from_handles import skeleton_from_handles  # after the formats, in the order of imports

    return skeleton_from_handles(motion) if isinstance(motion, HandleMotion) else motion


def write_motion_bvh(
    motion: HandleMotion | SkeletalMotion,
    path: Path,
    *,
    fps: float | None = None,
    unit: str = "cm",
    up: str = "+y",
    order: str = "zxy",
) -> Path:
    """Write a motion as BVH; see `write_bvh`."""
    from bunraku.core.resample import checked_fps
    from bunraku.formats.bvh.write import write_bvh

    skeletal = as_skeletal(motion)
    return write_bvh(skeletal, path, fps=checked_fps(fps, skeletal.fps), unit=unit, up=up, order=order)


def write_motion_vrma(
    motion: HandleMotion | SkeletalMotion, path: Path, *, fps: float | None = None, name: str | None = None
) -> Path:
    """Write a motion as VRMA; see `write_vrma`."""
    from bunraku.body.layout import JOINT_NAMES
    from bunraku.formats.vrm.vrma_write import write_vrma
    from bunraku.skeletons.to_smpl import to_smpl

    skeletal = as_skeletal(motion)
    if len(skeletal) and skeletal.skeleton.names != JOINT_NAMES:
        skeletal = to_smpl(skeletal)
    return write_vrma(skeletal, path, fps=fps, name=name)


def write_motion_npz(motion: HandleMotion | SkeletalMotion, path: Path) -> Path:
    """Write a handle motion of the reference body as NPZ.

    Raises:
        OptionError: The motion is of a skeleton.
    """
    from bunraku.body.reference import reference_body
    from bunraku.formats.arrays.npz import pack_motion
    from bunraku.formats.files import atomic_write

    if not isinstance(motion, HandleMotion):
        raise OptionError("an .npz holds handle motion, and this motion is of a skeleton; write it as .bvh or .vrma")
    with atomic_write(path) as file:
        file.write(pack_motion(motion, reference_body().handles))
    return path
