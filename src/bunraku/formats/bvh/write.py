"""Skeletal motion as BVH, for every program that imports motion capture."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.core.resample import resample_motion
from bunraku.errors import OptionError
from bunraku.formats.bvh.read import BVH_UNITS
from bunraku.formats.files import atomic_write

__all__ = ["write_bvh"]

ORDERS = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")
CHUNK = 2000  # frames made into text at once
TIP = 0.4  # how long the end of a joint without children is, as a share of the bone above


def write_bvh(
    motion: SkeletalMotion,
    path: str | Path,
    *,
    fps: float | None = None,
    unit: str = "cm",
    up: str = "+y",
    order: str = "zxy",
) -> Path:
    """Write a skeletal motion as BVH.

    Args:
        motion: At least one frame.
        path: The file.
        fps: Frames a second of the file [1/s]; those of the motion by default.
        unit: Unit of lengths, "cm" as most programs take it, or another of `bunraku.formats.bvh.read.BVH_UNITS`.
        up: "+y", or "+z" for programs that take the file's axes for their own.
        order: Order of the rotation channels, "zxy" as most files have it.

    Returns:
        The file that was written.

    Raises:
        FormatError: The file cannot be written.
        OptionError: An option makes no sense, or the motion has no frame.
    """
    path = Path(path)
    if unit not in BVH_UNITS:
        raise OptionError(f"'{unit}' is no unit; there are {', '.join(BVH_UNITS)}")
    if up not in ("+y", "+z"):
        raise OptionError(f"up in a BVH file is +y or +z, not {up}")
    if order.lower() not in ORDERS:
        raise OptionError(f"'{order}' is no order of rotations; there are {', '.join(ORDERS)}")
    if not len(motion):
        raise OptionError("a motion without frames cannot be written; give it at least one")
    motion = motion if fps is None else resample_motion(motion, fps)
    turn = np.eye(3) if up == "+y" else np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    scale = 1 / BVH_UNITS[unit]
    sequence, lines = _hierarchy(motion.skeleton, motion.skeleton.offsets @ turn.T * scale, order.upper())
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / motion.fps:.9g}", ""]
    with atomic_write(path) as file:
        file.write("\n".join(lines).encode())
        row = " ".join(["%.6f"] * (3 + 3 * len(sequence))) + "\n"
        before = None
        for start in range(0, len(motion), CHUNK):
            cut = slice(start, start + CHUNK)
            angles = _angles(turn @ motion.rotations[cut][:, sequence].astype(float) @ turn.T, order.upper(), before)
            before = angles[-1]
            rows = np.concatenate(
                [motion.root_translation[cut] @ turn.T * scale, angles.reshape(len(angles), -1)], axis=1
            )
            file.write("".join([row % tuple(values) for values in rows.tolist()]).encode())
    return path


def _hierarchy(skeleton: Skeleton, offsets: np.ndarray, order: str) -> tuple[list[int], list[str]]:
    """The joints in the order of the file, depth first, and its lines."""
    children: list[list[int]] = [[] for _ in skeleton.names]
    for joint, parent in enumerate(skeleton.parents[1:], 1):
        children[int(parent)].append(joint)
    rotations = " ".join(f"{axis}rotation" for axis in order)
    sequence: list[int] = []
    lines = ["HIERARCHY"]
    todo: list[tuple[int, int]] = [(0, 0)]  # joint and depth; a joint below 0 is a brace to close
    while todo:
        joint, depth = todo.pop()
        pad = "  " * depth
        if joint < 0:
            lines.append(pad + "}")
            continue
        sequence.append(joint)
        x, y, z = offsets[joint] if joint else np.zeros(3)
        name = " ".join(skeleton.names[joint].translate(str.maketrans("{}", "()")).split()) or f"joint_{joint}"
        channels = f"6 Xposition Yposition Zposition {rotations}" if not joint else f"3 {rotations}"
        lines += [
            f"{pad}{'JOINT' if joint else 'ROOT'} {name}",
            pad + "{",
            f"{pad}  OFFSET {x:.6f} {y:.6f} {z:.6f}",
            f"{pad}  CHANNELS {channels}",
        ]
        if not children[joint]:
            x, y, z = offsets[joint] * TIP if joint else np.zeros(3)
            lines += [f"{pad}  End Site", f"{pad}  {{", f"{pad}    OFFSET {x:.6f} {y:.6f} {z:.6f}", f"{pad}  }}"]
        todo.append((-1, depth))
        todo += [(child, depth + 1) for child in reversed(children[joint])]
    return sequence, lines


def _angles(rotations: np.ndarray, order: str, before: np.ndarray | None) -> np.ndarray:
    """Angles of rotations (N, J, 3, 3) [degrees], shape (N, J, 3), without jumps by whole turns from frame to frame."""
    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of gimbal lock: one of the solutions is as good as another
        angles = (
            Rotation.from_matrix(rotations.reshape(-1, 3, 3))
            .as_euler(order, degrees=True)
            .reshape(*rotations.shape[:2], 3)
        )
    if before is not None:
        return np.asarray(np.unwrap(np.concatenate([before[None], angles]), axis=0, period=360)[1:])
    return np.asarray(np.unwrap(angles, axis=0, period=360))
