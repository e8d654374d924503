"""BVH (Biovision Hierarchy): skeletal motion as text, from any program that writes it.

The format names neither unit nor axes. The unit is the one that makes the skeleton most nearly as large as a person's,
and a skeleton that stands along +Z both at rest and in motion is turned to +Y. Joints keep the file's names and their
rotations its rest pose; `bunraku.skeletons.skeleton_map` finds out which joint is what.
"""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path

import numpy as np

from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.errors import FormatError, OptionError
from bunraku.formats.bvh.hierarchy import BvhJoint, parse_hierarchy
from bunraku.formats.files import MAX_TEXT_BYTES, check_input, read_bounded

__all__ = ["BVH_UNITS", "load_bvh", "read_bvh"]

BVH_UNITS: dict[str, float] = {
    "mm": 0.001,
    "cm": 0.01,
    "in": 0.0254,
    "cmu": 0.0254 / 0.45,
    "dm": 0.1,
    "ft": 0.3048,
    "m": 1.0,
}
"""Length of the units that are found in BVH files [m]; "cmu" is that of the CMU database's own skeletons."""

PERSON = 2.2  # from the toes up the trunk and out to a hand [m]
MOST_HEADER = 4 << 20
CHUNK = 2000  # frames turned into matrices at once
MOST_ROTATIONS = 40_000_000  # of all joints in all frames: 1.4 GB
_MOTION = re.compile(rb"^[ \t]*MOTION\b", re.MULTILINE | re.IGNORECASE)
_FRAMES = re.compile(
    rb"\s*MOTION\s+Frames\s*:?[ \t]*(?P<count>[^\s]*)[ \t]*\r?\n?\s*Frame\s*Time\s*:?[ \t]*(?P<time>[^\s]*)",
    re.IGNORECASE,
)
_NO_NUMBER = re.compile(rb"(?<!\S)(?![+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?(?!\S))\S+")


def load_bvh(path: str | Path, unit: str | None = None, up: str | None = None) -> SkeletalMotion:
    """Read a BVH file whose unit or upward axis is known.

    Args:
        path: The file.
        unit: One of `BVH_UNITS`; a guess by the skeleton's size by default.
        up: "+y" or "+z"; a guess by default.

    Raises:
        FormatError: The file cannot be read.
        OptionError: There is no such unit or axis.
    """
    path = Path(path)
    _check_size(path, check_input(path))
    return read_bvh(path, read_bounded(path), unit=unit, up=up)


def read_bvh(path: Path, data: bytes, *, unit: str | None = None, up: str | None = None) -> SkeletalMotion:
    """Read a BVH file from its bytes.

    Joints whose position moves: the root's is the motion's path; a joint with most of the skeleton below it takes its
    place, as the hips below a still `Root` do; others keep the mean as their offset. Of several roots the one with most
    joints is read.

    Args:
        path: The file.
        data: Its bytes.
        unit: One of `BVH_UNITS`; a guess by the skeleton's size by default.
        up: "+y" or "+z"; a guess by default.

    Returns:
        The motion at the file's rate, +Y up, in metres.

    Raises:
        FormatError: The file is broken, cut off, too large, without frames, or holds what is no number.
        OptionError: There is no such unit or axis.
    """
    if unit is not None and unit not in BVH_UNITS:
        raise OptionError(f"'{unit}' is no unit; there are {', '.join(BVH_UNITS)}")
    if up not in (None, "+y", "+z"):
        raise OptionError(f"up in a BVH file is +y or +z, not {up}")
    _check_size(path, len(data))
    start = _MOTION.search(data, 0, MOST_HEADER)
    if start is None:
        parse_hierarchy(
            path, data[:MOST_HEADER].decode("utf-8", "replace")
        )  # says what is wrong if that is no hierarchy
        raise FormatError(path, "there is no MOTION after its hierarchy, the file is cut off; export it again")
    joints, columns = parse_hierarchy(path, data[: start.start()].decode("utf-8", "replace"))
    values, fps = _frames(path, data, start.start(), columns)
    tree = _largest_tree(joints)
    if len(values) * len(tree) > MOST_ROTATIONS:  # joints without channels take no room in the file
        raise FormatError(
            path, f"its {len(values):,} frames of {len(tree):,} joints are too many; cut it into shorter ones"
        )
    rotations = _rotations(values, [joints[joint] for joint in tree])
    motion = _assembled(path, joints, tree, values, rotations, fps)
    scale = BVH_UNITS[unit] if unit else _unit(joints)
    return _in_our_frame(motion, scale, up)


def _check_size(path: Path, size: int) -> None:
    if size > MAX_TEXT_BYTES:
        raise FormatError(
            path,
            f"{size >> 20} MiB are too many for a motion, at most {MAX_TEXT_BYTES >> 20} are read; cut it into "
            "shorter ones",
        )


def _frames(path: Path, data: bytes, start: int, columns: int) -> tuple[np.ndarray, float]:
    """Values of all channels, shape (N, columns), and frames a second."""
    head = _FRAMES.match(data, start)
    if head is None:
        raise FormatError(path, "there is no 'Frames:' and 'Frame Time:' after MOTION; export it again")
    try:
        count, seconds = int(head["count"]), float(head["time"])
    except ValueError:
        raise FormatError(
            path, "its number of frames or its frame time is missing or is no number; export it again"
        ) from None
    if count <= 0:
        raise FormatError(path, f"it has {count} frames; export at least one")
    if not 1e-4 <= seconds <= 10:
        raise FormatError(path, f"its frame time is {seconds:g} s, which no motion has; export it again")
    need = count * columns
    if not columns:
        raise FormatError(path, "none of its joints has channels, so nothing moves; export it again")
    room = len(data) - head.end()
    if need > (room + 1) // 2:  # a number and a blank are two bytes
        raise FormatError(
            path,
            f"it announces {count} frames of {columns} numbers but is cut off: they do not fit into the file; export "
            "it again",
        )
    values = _numbers(path, data[head.end() :], need, columns)
    if len(values) < need:
        raise FormatError(
            path,
            f"it is cut off: of {count} frames {len(values) // columns} are there; export it again, or correct "
            "'Frames:'",
        )
    values = values[:need].reshape(count, columns)
    if not np.isfinite(values).all():
        frame = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        raise FormatError(path, f"its frame {frame + 1} holds values that are not numbers; export it again")
    rate = 1 / seconds
    return values, float(round(rate)) if abs(rate - round(rate)) < 5e-4 * rate else rate


def _numbers(path: Path, text: bytes, need: int, columns: int) -> np.ndarray:
    """The numbers of the text; what is no number is an error unless it stands behind all that are needed."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # how older versions of numpy say it
            return _parsed(text)
    except (DeprecationWarning, ValueError):
        pass
    bad = _NO_NUMBER.search(text)
    before = _parsed(text[: bad.start()]) if bad else np.zeros(0)
    if len(before) >= need:
        return before
    word = bad[0][:20].decode("utf-8", "replace") if bad else ""
    comma = ", decimals need a point" if "," in word else ""
    raise FormatError(
        path, f"its frame {len(before) // columns + 1} holds '{word}', which is no number{comma}; export it again"
    )


def _parsed(text: bytes) -> np.ndarray:
    return np.zeros(0) if text.isspace() else np.fromstring(text, sep=" ")  # numpy finds a number in mere blanks


def _largest_tree(joints: list[BvhJoint]) -> list[int]:
    """Joints, without end sites, below the root that has most of them."""
    root = list(range(len(joints)))
    for index, joint in enumerate(joints):
        if joint.parent >= 0:
            root[index] = root[joint.parent]
    named = [index for index, joint in enumerate(joints) if joint.name]
    most = max((root[index] for index in named), key=lambda some: (sum(root[index] == some for index in named), -some))
    return [index for index in named if root[index] == most]


def _rotations(values: np.ndarray, joints: list[BvhJoint]) -> np.ndarray:
    """Local rotation of each joint, shape (N, J, 3, 3), float32."""
    out = np.empty((len(values), len(joints), 3, 3), np.float32)
    groups: dict[tuple[int, ...], list[int]] = {}
    for index, joint in enumerate(joints):
        groups.setdefault(tuple(axis for axis, kind, _ in joint.channels if kind == "rotation"), []).append(index)
    for axes, indices in groups.items():
        turns = [[column for _, kind, column in joints[index].channels if kind == "rotation"] for index in indices]
        if len(set(axes)) != len(axes):  # an axis twice
            for index, own in zip(indices, turns, strict=True):
                out[:, index] = np.eye(3)
                for axis, column in zip(axes, own, strict=True):
                    out[:, index] = out[:, index] @ _euler(np.radians(values[:, None, column, None]), (axis,))[:, 0]
            continue
        whole = len(indices) == len(joints)
        for start in range(0, len(values), CHUNK):
            angles = np.radians(values[start : start + CHUNK][:, np.array(turns, np.int64).reshape(len(indices), -1)])
            out[start : start + CHUNK, slice(None) if whole else indices] = _euler(angles, axes)
    return out


def _euler(angles: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    """R_a R_b R_c of up to three different axes, shape (N, J, 3, 3), from angles [rad] (N, J, up to 3)."""
    i, j, k = order = (*axes, *(axis for axis in range(3) if axis not in axes))
    sign = 1 if order in ((0, 1, 2), (1, 2, 0), (2, 0, 1)) else -1
    padded = np.zeros((*angles.shape[:2], 3))
    padded[..., : len(axes)] = angles
    (ca, cb, cc), (sa, sb, sc) = np.moveaxis(np.cos(padded), -1, 0), sign * np.moveaxis(np.sin(padded), -1, 0)
    out = np.empty((*angles.shape[:2], 3, 3), np.float32)
    out[..., i, i], out[..., i, j], out[..., i, k] = cb * cc, -cb * sc, sb
    out[..., j, i], out[..., j, j], out[..., j, k] = ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb
    out[..., k, i], out[..., k, j], out[..., k, k] = sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb
    return out


def _positions(joint: BvhJoint, values: np.ndarray) -> np.ndarray:
    """Offset of a joint from its parent in every frame, shape (N, 3) or (1, 3): its position channels where it has
    some.
    """
    out = np.array([joint.offset])
    channels = [(axis, column) for axis, kind, column in joint.channels if kind == "position"]
    if not channels:
        return out
    moved = values[:, [column for _, column in channels]]
    if joint.parent >= 0 and not moved.any():
        return out  # zeros in place of the offset: some programs write how far the joint is from it
    out = np.repeat(out, len(values), axis=0)
    out[:, [axis for axis, _ in channels]] = moved
    return out


def _assembled(
    path: Path, joints: list[BvhJoint], tree: list[int], values: np.ndarray, rotations: np.ndarray, fps: float
) -> SkeletalMotion:
    """The tree as a skeletal motion in the file's unit and axes."""
    number = {joint: index for index, joint in enumerate(tree)}
    parents = np.array([number.get(joints[joint].parent, -1) for joint in tree])
    positions = [_positions(joints[joint], values) for joint in tree]
    if max(float(np.abs(index).max()) for index in positions) > 1e9:
        raise FormatError(path, "its joints are a billion units apart; export it again")
    offsets = np.array([index.mean(axis=0) for index in positions])
    size = max(float(np.linalg.norm(offsets[1:], axis=-1).sum()), 1e-9)
    root, path_of_root = 0, positions[0]
    while True:  # the hips below a root that stays behind
        moving = [
            j
            for j in np.flatnonzero(parents == root)
            if len(positions[j]) > 1 and np.ptp(positions[j], axis=0).max() > 0.003 * size
        ]
        lower = next((int(j) for j in moving if 2 * len(_below(parents, int(j))) >= len(_below(parents, root))), None)
        if lower is None:
            break
        path_of_root = path_of_root + np.einsum(
            "nij,nj->ni", rotations[:, root], np.broadcast_to(positions[lower], (len(values), 3))
        )
        rotations[:, lower] = rotations[:, root] @ rotations[:, lower]
        root = lower
    kept = _below(parents, root)
    again = {joint: index for index, joint in enumerate(kept)}
    above = np.array([again.get(int(parents[joint]), -1) for joint in kept])
    skeleton = Skeleton(tuple(joints[tree[joint]].name for joint in kept), above, offsets[kept])
    if len(kept) < len(tree):
        rotations = rotations[:, kept]
    return SkeletalMotion(skeleton, rotations, np.broadcast_to(path_of_root, (len(values), 3)), fps)


def _below(parents: np.ndarray, root: int) -> list[int]:
    """A joint and all below it; parents stand before children."""
    inside = np.zeros(len(parents), bool)
    inside[root] = True
    for joint in range(root + 1, len(parents)):
        inside[joint] = parents[joint] >= 0 and inside[parents[joint]]
    return [int(joint) for joint in np.flatnonzero(inside)]


def _unit(joints: list[BvhJoint]) -> float:
    """The unit [m] in which the skeleton, with its end sites, is most nearly as large as a person's, however it
    rests.
    """
    reach, size = [0.0] * len(joints), 0.0  # longest way down from each joint, longest way between any two
    for index in range(len(joints) - 1, -1, -1):
        parent = joints[index].parent
        if parent >= 0:
            length = reach[index] + math.dist(joints[index].offset, (0, 0, 0))
            size = max(size, length + reach[parent])
            reach[parent] = max(reach[parent], length)
    if not 1e-6 < size < math.inf:
        return 1.0
    return min(BVH_UNITS.values(), key=lambda unit: abs(math.log(size * unit / PERSON)))


def _in_our_frame(motion: SkeletalMotion, scale: float, up: str | None) -> SkeletalMotion:
    """In metres, and turned from +Z to +Y up where that is how it stands."""
    skeleton = motion.skeleton
    if up is None:
        shown = np.unique(np.linspace(0, len(motion) - 1, 50).astype(int))
        extent = np.ptp(
            SkeletalMotion(skeleton, motion.rotations[shown], motion.root_translation[shown], 1.0).world()[1], axis=1
        ).mean(axis=0)
        x, y, z = np.ptp(skeleton.positions, axis=0)
        up = "+z" if z > 3 * y and z > 0.4 * x and extent[2] > 1.3 * extent[1] else "+y"
    turn = np.eye(3, dtype=np.float32) if up == "+y" else np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float32)
    own = Skeleton(skeleton.names, skeleton.parents, skeleton.offsets @ turn.T * scale)
    rotations = motion.rotations if up == "+y" else turn @ motion.rotations @ turn.T
    return SkeletalMotion(own, rotations, motion.root_translation @ turn.T * scale, motion.fps)
