"""The clips of an FBX file: curves, layers, sampling, and skeletal motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.core.files import read_bounded
from bunraku.core.geometry.rotations import nearest_rotation
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.files.fbx.mesh import BONES, bind_matrices, inverses, read_clusters
from bunraku.files.fbx.nodes import BROKEN, FbxTree, read_tree
from bunraku.files.fbx.scene import (
    PROPERTIES,
    TICKS,
    FbxObject,
    FbxScene,
    Values,
    default_world,
    read_scene,
    world_matrices,
)
from bunraku.files.gltf.carry import clip_number

CONSTANT, CUBIC, NEXT, WEIGHTED_RIGHT, WEIGHTED_LEFT = 0x2, 0x8, 0x100, 0x0100_0000, 0x0200_0000
# How a cubic key gets its tangents.
AUTO, TCB, USER, FLAT_AT_EQUAL, OVER_TIME, PROGRESSIVE = 0x100, 0x200, 0x400, 0x1000, 0x2000, 0x4000
WEIGHT_UNIT = 9999.0


@dataclass(frozen=True, eq=False)
class Curve:
    """One number over time."""

    times: np.ndarray  # of the keys [s], ascending, shape (M,)
    values: np.ndarray  # at the keys, shape (M,)
    flags: np.ndarray  # interpolation from each key to the next, shape (M,)
    slopes: np.ndarray  # slopes after each key and before the next [1/s], shape (M, 2)
    weights: np.ndarray  # lengths of these tangents as a share of the span, shape (M, 2)

    def at(self, moments: np.ndarray) -> np.ndarray:
        """Values at moments [s], held before the first key and after the last, shape (N,)."""
        times, values = self.times, self.values
        before = np.clip(np.searchsorted(times, moments, side="right") - 1, 0, len(times) - 1)
        after = np.minimum(before + 1, len(times) - 1)
        span = times[after] - times[before]
        share = np.clip((moments - times[before]) / np.where(span > 0, span, 1), 0, 1)
        start, end, flags = values[before], values[after], self.flags[before]
        out = start + (end - start) * share
        held = (flags & CONSTANT) > 0
        out = np.where(held, np.where((flags & NEXT) > 0, end, start), out)
        curved = np.flatnonzero(((flags & CUBIC) > 0) & ~held & (after > before))
        if len(curved):
            rows = before[curved]
            out[curved] = _cubic(
                share[curved], start[curved], end[curved], span[curved], self.slopes[rows], self.weights[rows]
            )
        return np.where(share <= 0, start, np.where(share >= 1, end, out))


def _cubic(
    share: np.ndarray, start: np.ndarray, end: np.ndarray, span: np.ndarray, slopes: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """A Bezier curve over time whose inner points lie on the tangents, at shares of its span."""
    right, left = weights[:, 0], weights[:, 1]
    s = share.copy()
    bent = np.flatnonzero((np.abs(right - 1 / 3) > 1e-3) | (np.abs(left - 1 / 3) > 1e-3))
    if len(bent):  # time itself bends: find the parameter by bisection, time only goes forward
        low, high = np.zeros(len(bent)), np.ones(len(bent))
        for _ in range(40):
            middle = (low + high) / 2
            first, second = 3 * (1 - middle) ** 2 * middle, 3 * (1 - middle) * middle**2
            time = first * right[bent] + second * (1 - left[bent]) + middle**3
            low, high = np.where(time < share[bent], middle, low), np.where(time < share[bent], high, middle)
        s[bent] = (low + high) / 2
    first, second = start + right * span * slopes[:, 0], end - left * span * slopes[:, 1]
    out: np.ndarray = (1 - s) ** 3 * start + 3 * (1 - s) ** 2 * s * first + 3 * (1 - s) * s**2 * second + s**3 * end
    return out


def read_curve(tree: FbxTree, thing: FbxObject) -> Curve | None:
    """The curve of an AnimationCurve object, None where it has no keys. FormatError if its keys do not fit together."""
    times, values = thing.node.array("KeyTime") / TICKS, thing.node.array("KeyValueFloat").astype(float)
    if len(times) != len(values) or not np.isfinite(values).all() or (np.diff(times) < 0).any():
        tree.fail(f"a curve of a clip has keys that do not fit together; {BROKEN}")
    if not len(times):
        return None
    flags, data, counts = (thing.node.array(name) for name in ("KeyAttrFlags", "KeyAttrDataFloat", "KeyAttrRefCount"))
    fitting = 0 < len(flags) == len(counts) and len(data) == 4 * len(flags) and counts.min(initial=1) >= 1
    if not fitting or int(counts.astype(float).sum()) != len(times):  # nothing says how to go on: straight
        straight = np.zeros((len(times), 2))
        return Curve(times, values, np.zeros(len(times), np.int64), straight, straight + 1 / 3)
    data = data.reshape(-1, 4)
    packed = data[:, 2].astype(np.float32).view(np.int32)
    weights = np.stack([packed & 0xFFFF, (packed >> 16) & 0xFFFF], 1) / WEIGHT_UNIT
    flags = flags.astype(np.int64)
    used = np.stack([(flags & WEIGHTED_RIGHT) > 0, (flags & WEIGHTED_LEFT) > 0], 1)
    weights = np.where(used, np.clip(weights, 0, 1), 1 / 3)
    slopes = np.nan_to_num(data[:, :2], posinf=0, neginf=0)
    counts = counts.astype(np.int64)
    flags, slopes, weights = (np.repeat(each, counts, axis=0) for each in (flags, slopes, weights))
    return Curve(times, values, flags, _with_auto(times, values, flags, slopes), weights)


def _with_auto(times: np.ndarray, values: np.ndarray, flags: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The slopes, shape (M, 2), with those computed that a key leaves to the program and that are not stored."""
    computed = ((flags & CUBIC) > 0) & ((flags & (AUTO | TCB)) > 0) & ((flags & USER) == 0)
    if len(times) < 2 or not computed.any():
        return slopes
    span = np.diff(times)
    secant = np.diff(values) / np.where(span > 0, span, 1)
    left, right = np.concatenate([secant[:1], secant]), np.concatenate([secant, secant[-1:]])
    gap = np.concatenate([span[:1], times[2:] - times[:-2], span[-1:]])
    inner = (values[2:] - values[:-2]) / np.where(gap[1:-1] > 0, gap[1:-1], 1)
    over_time = np.concatenate([secant[:1], inner, secant[-1:]])
    slope = np.where((flags & OVER_TIME) > 0, over_time, (left + right) / 2)
    limit = 3 * np.minimum(np.abs(left), np.abs(right))
    limited = np.where(left * right > 0, np.clip(slope, -limit, limit), 0)  # never beyond the values of its neighbours
    limited[[0, -1]] = 0
    slope = np.where((flags & PROGRESSIVE) > 0, limited, slope)
    slope = np.where(((flags & FLAT_AT_EQUAL) > 0) & ((left == 0) | (right == 0)), 0, slope)
    out = slopes.copy()
    out[computed, 0] = slope[computed]
    out[:-1, 1] = np.where(computed[1:], slope[1:], slopes[:-1, 1])
    return out


MAX_TRANSFORMS = 2_000_000
_AXES = ("d|X", "d|Y", "d|Z")


@dataclass(frozen=True, eq=False)
class FbxClip:
    """A clip."""

    name: str
    # start, end: its span [s]
    start: float
    end: float
    # for each (model, property) that it moves, three curves or the numbers that stand for them
    curves: dict[tuple[int, str], tuple[Curve | float, ...]]

    @property
    def seconds(self) -> float:
        """Its length [s]."""
        return self.end - self.start


def read_clips(scene: FbxScene) -> list[FbxClip]:
    """All clips that move something. Of several layers, the first that moves a property counts."""
    clips = []
    for number, stack in enumerate(scene.of_kind("AnimationStack")):
        curves: dict[tuple[int, str], tuple[Curve | float, ...]] = {}
        for layer in scene.below(stack, "AnimationLayer"):
            for group in scene.below(layer, "AnimationCurveNode"):
                for owner, obj in scene.owners.get(group.id, ()):
                    if obj in PROPERTIES and owner in scene.indices and (scene.indices[owner], obj) not in curves:
                        curves[scene.indices[owner], obj] = _curves(scene, group, owner, obj)
        keys = [curve.times for trio in curves.values() for curve in trio if isinstance(curve, Curve)]
        if not keys:
            continue  # Mixamo and Maya leave an empty "Take 001" behind
        start, end = stack.number("LocalStart", 0) / TICKS, stack.number("LocalStop", 0) / TICKS
        if not end > start:
            start, end = min(float(times[0]) for times in keys), max(float(times[-1]) for times in keys)
        clips.append(FbxClip(stack.name or f"animation {number}", start, end, curves))
    return clips


def _curves(scene: FbxScene, group: FbxObject, owner: int, what: str) -> tuple[Curve | float, ...]:
    still = scene.objects[owner].numbers(what, PROPERTIES[what])
    curves: list[Curve | float] = [group.number(axis, still[i]) for i, axis in enumerate(_AXES)]
    for child, axis in scene.links.get(group.id, ()):
        thing = scene.objects.get(child)
        if thing is not None and thing.kind == "AnimationCurve" and axis in _AXES:
            curve = read_curve(scene.tree, thing)
            if curve is not None:
                curves[_AXES.index(axis)] = curve
    return tuple(curves)


def find_clip(scene: FbxScene, clips: list[FbxClip], clip: int | str | None) -> FbxClip:
    """A clip by its number or name (`clip_number`), the first one for None; FormatError where the file has no clip."""
    if not clips:
        scene.tree.fail("it holds no animation; export it with its keys baked")
    return clips[0 if clip is None else clip_number(scene.tree.path, [entry.name for entry in clips], clip)]


def sample_clip(scene: FbxScene, clip: FbxClip, fps: float) -> tuple[Values, int]:
    """The values that a clip moves, at a frame rate from its start [1/s], and the number of frames N. FormatError if
    the clip is too long for the number of models.
    """
    count = int(np.floor(min(clip.seconds * fps, 1e9) + 1e-3)) + 1
    if count * max(len(scene.models), 1) > MAX_TRANSFORMS:
        frames = f"{count:,} frames of {len(scene.models)} objects"
        scene.tree.fail(f"its clip '{clip.name}' has {frames}, too many to read; cut it or lower the frame rate")
    moments = clip.start + np.arange(count) / fps

    def sampled(curve: Curve | float) -> np.ndarray:
        return curve.at(moments) if isinstance(curve, Curve) else np.full(count, curve)

    return {key: np.stack(list(map(sampled, trio)), axis=1) for key, trio in clip.curves.items()}, count


def load_fbx_motion(path: str | Path, clip: int | str | None = None, fps: float = 20.0) -> SkeletalMotion:
    """Read a clip of an FBX file; arguments and errors are those of `read_motion`."""
    path = Path(path)
    return read_motion(path, read_bounded(path), clip=clip, fps=fps)


def read_motion(path: Path, data: bytes, *, clip: int | str | None = None, fps: float = 20.0) -> SkeletalMotion:
    """Read a clip of an FBX file from its bytes at a rate [1/s]: that of a number or name, or the first one that moves
    something.

    A joint's rotation is relative to its rest pose, in axes that are ours there, as in all skeletal motions. The rest
    pose is the bind pose of the file's skin; without a skin that of its bind pose object, then the pose without keys,
    where joints that are oriented by their pre-rotation have no rotation of their own. FormatError if the file cannot
    be read, or has no clip that moves a skeleton; OptionError if it has no clip of this name or number.
    """
    scene = read_scene(read_tree(path, data))
    chosen = find_clip(scene, read_clips(scene), clip)
    joints = _joints(scene, chosen)
    values, count = sample_clip(scene, chosen, fps)
    frame = scene.frame
    rest = frame.world(_rest(scene, joints))
    moving = np.stack([np.broadcast_to(some, (count, 4, 4)) for some in world_matrices(scene, values, joints)], axis=1)
    world = frame.world(moving)
    turn = nearest_rotation(world[..., :3, :3] @ inverses(rest)[:, :3, :3])  # from the rest pose, in the world
    number = {model: joint for joint, model in enumerate(joints)}
    parents = np.array([number.get(scene.above(model, number), -1) for model in joints])
    local = turn.copy()
    local[:, 1:] = np.swapaxes(turn[:, parents[1:]], -1, -2) @ turn[:, 1:]
    offsets = rest[:, :3, 3].copy()
    offsets[1:] -= rest[parents[1:], :3, 3]
    skeleton = Skeleton(tuple(scene.models[model].name for model in joints), parents, offsets)
    return SkeletalMotion(skeleton, local, world[:, 0, :3, 3], fps)


def _joints(scene: FbxScene, clip: FbxClip) -> list[int]:
    """The joints of the skeleton that a clip moves most of, root first and parents before children."""
    moved = {model for model, _ in clip.curves}
    bones = [index for index, model in enumerate(scene.models) if model.subtype in BONES]
    others = [index for index, model in enumerate(scene.models) if index in moved and model.subtype != "Camera"]
    chosen = dict.fromkeys(bones or others, 0)
    trees: dict[int, list[int]] = {}
    root_of: dict[int, int] = {}
    for model in sorted(chosen):  # parents come first
        above = scene.above(model, chosen)
        root_of[model] = root_of.get(above, model)
        trees.setdefault(root_of[model], []).append(model)
    if not trees:
        scene.tree.fail(f"its clip '{clip.name}' moves no skeleton; export it with its joints")
    return max(trees.values(), key=lambda tree: sum(model in moved for model in tree))


def _rest(scene: FbxScene, joints: list[int]) -> np.ndarray:
    """World transforms of joints in the rest pose, in the file's frame and unit, shape (J, 4, 4)."""
    clusters = [cluster for geometry in scene.of_kind("Geometry") for cluster in read_clusters(scene, geometry)]
    default = default_world(scene)
    if clusters:
        binds = bind_matrices(scene, default, clusters)
        return np.stack([binds.get(joint, default[joint]) for joint in joints])
    posed = _bind_pose(scene)
    if all(joint in posed for joint in joints):
        return np.stack([posed[joint] for joint in joints])
    oriented = [np.any(scene.models[joint].numbers("PreRotation", (0, 0, 0))) for joint in joints]
    if sum(oriented) * 2 < len(joints):
        return default[joints]
    still: Values = {(joint, "Lcl Rotation"): np.zeros((1, 3)) for joint in joints}
    return np.concatenate(world_matrices(scene, still, joints))


def _bind_pose(scene: FbxScene) -> dict[int, np.ndarray]:
    """World transforms that the file's bind pose objects list, by model."""
    out: dict[int, np.ndarray] = {}
    for pose in scene.of_kind("Pose"):
        for entry in pose.node.all("PoseNode"):
            matrix, model = entry.array("Matrix"), scene.indices.get(entry.value("Node", 0), -1)
            if pose.subtype == "BindPose" and len(matrix) == 16 and np.isfinite(matrix).all() and model >= 0:
                out.setdefault(model, matrix.astype(float).reshape(4, 4).T)
    return out
