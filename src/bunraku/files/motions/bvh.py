"""BVH (Biovision Hierarchy): skeletal motion as text, read and written."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bunraku.core.files import atomic_write
from bunraku.core.geometry.axes import UNITS
from bunraku.core.motion import SkeletalMotion, Skeleton, resample_motion
from bunraku.errors import FormatError, OptionError

MOST_JOINTS = 4096
MOST_CHANNELS = 9
_WORDS = re.compile(
    r"(?:ROOT|JOINT)\b[ \t]*(?P<joint>[^\r\n{}]*)|(?P<end>END[ \t]+SITE)\b[^\r\n{}]*|(?P<open>\{)|(?P<close>\})"
    r"|OFFSETS?\b[ \t]*(?P<offset>[^\r\n{}]*)"
    r"|CHANNELS\b\s*(?P<channels>\d{1,18}\b(?:\s+[XYZ](?:position|rotation|scale)\b)*)|(?P<other>\S+)",
    re.IGNORECASE,
)


def _broken(path: Path, problem: str) -> FormatError:
    return FormatError(path, f"{problem}; export it again")


@dataclass
class BvhJoint:
    """A joint or the end of one."""

    name: str  # its name; empty for an end site
    parent: int  # index of its parent, -1 for a root
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from the parent's, in the file's unit
    # (axis, "position" or "rotation" or "scale", column) in the order of the file
    channels: list[tuple[int, str, int]] = field(default_factory=list)


def parse_hierarchy(path: Path, text: str) -> tuple[list[BvhJoint], int]:
    """Joints and end sites in the order of the file, parents first, and the number of columns of the motion.
    FormatError if the text breaks the grammar, holds a joint inside itself, or has too many joints.
    """
    text = text.removeprefix("\ufeff").strip()
    if not re.match(r"HIERARCHY\b", text, re.IGNORECASE):
        raise _broken(path, "it does not begin with HIERARCHY, so it is not a BVH file")
    joints: list[BvhJoint] = []
    above: list[int] = []  # open braces
    names: dict[str, int] = {}
    inside: list[str] = []  # names as they are in the file, of the joints in `above`
    columns, waiting = 0, False
    for word in _WORDS.finditer(text, len("HIERARCHY")):
        kind = word.lastgroup
        here = joints[above[-1]] if above else None
        if kind in ("joint", "end"):
            name = (word["joint"] or "").strip()
            if waiting or (kind == "end" and here is None):
                raise _broken(path, f"its hierarchy has no braces before {name or 'an end site'}")
            if kind == "joint" and name in inside:
                raise FormatError(
                    path, f"its joint '{name}' is inside itself, a cycle; give every joint a name of its own"
                )
            if len(joints) >= MOST_JOINTS:
                raise FormatError(path, f"it has more than {MOST_JOINTS} joints; export the skeleton without its props")
            title = _unique(name or "joint", names) if kind == "joint" else ""
            joints.append(BvhJoint(title, above[-1] if above else -1))
            inside.append(name)
            waiting = True
        elif kind == "open" and waiting:
            above.append(len(joints) - 1)
            waiting = False
        elif kind == "close" and above and not waiting:
            above.pop()
            inside.pop()
        elif kind == "offset" and here is not None:
            here.offset = _offset(path, word["offset"], here.name)
        elif kind == "channels" and here is not None and here.name and not here.channels:
            count, *kinds = word["channels"].lower().split()
            if int(count) != len(kinds) or len(kinds) > MOST_CHANNELS:
                raise _broken(path, f"its joint '{here.name}' announces {count} channels and names {len(kinds)}")
            here.channels = [("xyz".index(each[0]), each[1:], column) for column, each in enumerate(kinds, columns)]
            columns += len(kinds)
        else:
            raise _broken(path, f"its hierarchy has '{word[0].strip()[:40]}' where it makes no sense")
    if above or waiting:
        raise _broken(path, "its hierarchy is cut off: braces are open at its end")
    if not any(joint.name for joint in joints):
        raise FormatError(path, "its hierarchy holds no joint; export it with its skeleton")
    return joints, columns


def _unique(name: str, names: dict[str, int]) -> str:
    """The name, with a number where another joint has it."""
    while True:
        names[name] = names.get(name, 0) + 1
        if names[name] == 1:
            return name
        name = f"{name}_{names[name]}"


def _offset(path: Path, words: str, name: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(word) for word in words.split())
    except ValueError:
        x = y = z = math.nan
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        raise _broken(path, f"the offset of its joint '{name}' is '{words.strip()[:40]}', not three numbers")
    return x, y, z


BVH_UNITS: dict[str, float] = {**UNITS, "cmu": 0.0254 / 0.45}
"""Units of BVH files [m], by definition; "cmu" is 1/0.45 inch, as published skeletons of the CMU database state it."""

# From the toes up the trunk and out to a hand [m]; measured on the reference body it is 1.3 of the height.
PERSON = 2.2
MOST_HEADER = 4 << 20
CHUNK = 2000  # frames turned into matrices at once
MOST_ROTATIONS = 40_000_000  # of all joints in all frames: 1.4 GB
_MOTION = re.compile(rb"^[ \t]*MOTION\b", re.MULTILINE | re.IGNORECASE)
_FRAMES = re.compile(
    rb"\s*MOTION\s+Frames\s*:?[ \t]*(?P<count>[^\s]*)[ \t]*\r?\n?\s*Frame\s*Time\s*:?[ \t]*(?P<time>[^\s]*)",
    re.IGNORECASE,
)
_NO_NUMBER = re.compile(rb"(?<!\S)(?![+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?(?!\S))\S+")


def read_bvh(path: Path, data: bytes) -> SkeletalMotion:
    """Read a BVH file from its bytes: the motion at the file's rate, +Y up, in metres. The skeleton's size and how it
    stands tell unit and up axis.

    Of joints whose position moves, the root gives the motion's path, a joint with most of the skeleton below it (the
    hips below a still `Root`) replaces the root, and others keep their mean offset. Of several roots the one with most
    joints is read. FormatError if the file is broken, cut off, too large, without frames, or holds something that is
    not a number.
    """
    start = _MOTION.search(data, 0, MOST_HEADER)
    if start is None:
        parse_hierarchy(path, data[:MOST_HEADER].decode("utf-8", "replace"))  # says if that is no hierarchy
        raise _broken(path, "there is no MOTION after its hierarchy, the file is cut off")
    joints, columns = parse_hierarchy(path, data[: start.start()].decode("utf-8", "replace"))
    values, fps = _frames(path, data, start.start(), columns)
    tree = _largest_tree(joints)
    if len(values) * len(tree) > MOST_ROTATIONS:  # joints without channels take no room in the file
        raise FormatError(
            path, f"its {len(values):,} frames of {len(tree):,} joints are too many; cut it into shorter ones"
        )
    rotations = _rotations(values, [joints[joint] for joint in tree])
    motion = _assembled(path, joints, tree, values, rotations, fps)
    return _in_our_frame(motion, _unit(joints))


def _frames(path: Path, data: bytes, start: int, columns: int) -> tuple[np.ndarray, float]:
    """Values of all channels, shape (N, columns), and frames a second."""
    head = _FRAMES.match(data, start)
    if head is None:
        raise _broken(path, "there is no 'Frames:' and 'Frame Time:' after MOTION")
    try:
        count, seconds = int(head["count"]), float(head["time"])
    except ValueError:
        raise _broken(path, "its number of frames or its frame time is missing or not a number") from None
    if count <= 0:
        raise FormatError(path, f"it has {count} frames; export at least one")
    if not 1e-4 <= seconds <= 10:
        raise _broken(path, f"its frame time is {seconds:g} s, which no motion has")
    need = count * columns
    if not columns:
        raise _broken(path, "none of its joints has channels, so nothing moves")
    room = len(data) - head.end()
    if need > (room + 1) // 2:  # a number and a blank are two bytes
        raise _broken(path, f"it announces {count} frames of {columns} numbers but is cut off, they do not fit into it")
    values = _numbers(path, data[head.end() :], need, columns)
    if len(values) < need:
        raise _broken(path, f"it is cut off: of {count} frames {len(values) // columns} are there")
    values = values[:need].reshape(count, columns)
    if not np.isfinite(values).all():
        frame = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        raise _broken(path, f"its frame {frame + 1} holds values that are not numbers")
    rate = 1 / seconds
    return values, float(round(rate)) if abs(rate - round(rate)) < 5e-4 * rate else rate


def _numbers(path: Path, text: bytes, need: int, columns: int) -> np.ndarray:
    """The numbers of the text; anything else is an error unless it comes after all that are needed."""
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
    raise _broken(path, f"its frame {len(before) // columns + 1} holds '{word}', which is not a number{comma}")


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
            for index, turn in zip(indices, turns, strict=True):
                out[:, index] = np.eye(3)
                for axis, column in zip(axes, turn, strict=True):
                    out[:, index] = out[:, index] @ _euler(np.radians(values[:, None, column, None]), (axis,))[:, 0]
            continue
        all_turn = len(indices) == len(joints)
        for start in range(0, len(values), CHUNK):
            angles = np.radians(values[start : start + CHUNK][:, np.array(turns, np.int64).reshape(len(indices), -1)])
            out[start : start + CHUNK, slice(None) if all_turn else indices] = _euler(angles, axes)
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
    """Offset of a joint from its parent in every frame, shape (N, 3), or (1, 3) without position channels."""
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
        raise _broken(path, "its joints are a billion units apart")
    offsets = np.array([index.mean(axis=0) for index in positions])
    size = max(float(np.linalg.norm(offsets[1:], axis=-1).sum()), 1e-9)
    root, path_of_root = 0, positions[0]
    while True:  # the hips below a root that stays behind
        below = np.flatnonzero(parents == root).tolist()
        moving = [joint for joint in below if np.ptp(positions[joint], axis=0).max() > 0.003 * size]
        most = len(_below(parents, root))
        lower = next((joint for joint in moving if 2 * len(_below(parents, joint)) >= most), None)
        if lower is None:
            break
        moved = np.broadcast_to(positions[lower], (len(values), 3))
        path_of_root = path_of_root + np.einsum("nij,nj->ni", rotations[:, root], moved)
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
    """A joint and all below it; parents come before children."""
    inside = np.zeros(len(parents), bool)
    inside[root] = True
    for joint in range(root + 1, len(parents)):
        inside[joint] = parents[joint] >= 0 and inside[parents[joint]]
    return [int(joint) for joint in np.flatnonzero(inside)]


def _unit(joints: list[BvhJoint]) -> float:
    """The unit [m] that brings the skeleton's size, with its end sites, closest to a person's, in any rest pose."""
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


def _in_our_frame(motion: SkeletalMotion, scale: float) -> SkeletalMotion:
    """In metres, and rotated from +Z to +Y up where that is how it stands."""
    skeleton = motion.skeleton
    shown = np.unique(np.linspace(0, len(motion) - 1, 50).astype(int))
    few = SkeletalMotion(skeleton, motion.rotations[shown], motion.root_translation[shown], 1.0)
    extent = np.ptp(few.world()[1], axis=1).mean(axis=0)
    x, y, z = np.ptp(skeleton.positions, axis=0)
    lies = bool(z > 3 * y and z > 0.4 * x and extent[2] > 1.3 * extent[1])
    turn = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]] if lies else np.eye(3), np.float32)
    turned = Skeleton(skeleton.names, skeleton.parents, skeleton.offsets @ turn.T * scale)
    rotations = turn @ motion.rotations @ turn.T if lies else motion.rotations
    return SkeletalMotion(turned, rotations, motion.root_translation @ turn.T * scale, motion.fps)


ORDERS = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")
FRAMES_AT_ONCE = 2000  # frames made into text at once
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
    """Write a skeletal motion as BVH, at its own or another rate [1/s]. FormatError if the file cannot be written;
    OptionError if an option makes no sense, or the motion has no frame.

    Args:
        unit: Unit of lengths, one of `BVH_UNITS`; most programs take "cm".
        up: "+y", or "+z" for programs that use the file's axes as they are.
        order: Order of the rotation channels, "zxy" as in most files.
    """
    path = Path(path)
    if unit not in BVH_UNITS:
        raise OptionError(f"'{unit}' is not a unit; there are {', '.join(BVH_UNITS)}")
    if up not in ("+y", "+z"):
        raise OptionError(f"up in a BVH file is +y or +z, not {up}")
    if order.lower() not in ORDERS:
        raise OptionError(f"'{order}' is not an order of rotations; there are {', '.join(ORDERS)}")
    if not len(motion):
        raise OptionError("a motion without frames cannot be written; give it at least one")
    motion = motion if fps is None else resample_motion(motion, fps)
    turn = np.eye(3) if up == "+y" else np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    scale = 1 / BVH_UNITS[unit]
    sequence, lines = _hierarchy(motion.skeleton, motion.skeleton.offsets @ turn.T * scale, order.upper())
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / motion.fps:.9g}", ""]
    with atomic_write(path) as file:
        file.write("\n".join(lines).encode("utf-8", "replace"))
        row = " ".join(["%.6f"] * (3 + 3 * len(sequence))) + "\n"
        before = None
        for start in range(0, len(motion), FRAMES_AT_ONCE):
            cut = slice(start, start + FRAMES_AT_ONCE)
            angles = _angles(turn @ motion.rotations[cut][:, sequence].astype(float) @ turn.T, order.upper(), before)
            before = angles[-1]
            roots = motion.root_translation[cut] @ turn.T * scale
            rows = np.concatenate([roots, angles.reshape(len(angles), -1)], axis=1)
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
    """Angles of rotations (N, J, 3, 3) [degrees], shape (N, J, 3), without jumps by full circles between frames."""
    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of gimbal lock: one of the solutions is as good as another
        flat = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_euler(order, degrees=True)
    angles = flat.reshape(*rotations.shape[:2], 3)
    if before is not None:
        return np.asarray(np.unwrap(np.concatenate([before[None], angles]), axis=0, period=360)[1:])
    return np.asarray(np.unwrap(angles, axis=0, period=360))
