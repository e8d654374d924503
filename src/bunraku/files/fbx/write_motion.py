"""A skeleton and its clips as FBX objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bunraku.core.animation import Animation, RigAnimation, bone_order
from bunraku.core.body.layout import handle_names
from bunraku.core.character import Handles, Rig, top_influences
from bunraku.core.geometry.rotations import matrix_from_quaternion, nearest_rotation
from bunraku.files.fbx.write_objects import SECOND, Objects, Span, element, prop, properties
from bunraku.files.gltf.write import joint_tracks


@dataclass(frozen=True, eq=False)
class Track:
    """The joints in a clip, each in its parent's frame."""

    rotations: np.ndarray  # shape (N, J, 3, 3)
    translations: np.ndarray  # positions of their heads [m], shape (N, J, 3)
    fps: float  # frames a second [1/s]


@dataclass(frozen=True, eq=False)
class Bones:
    """Joints and the skin that hangs on them."""

    names: tuple[str, ...]  # their names, length J
    parents: np.ndarray  # the parent of each, -1 for a root, shape (J,)
    rotations: np.ndarray  # world rotation of each where the skin is bound, shape (J, 3, 3)
    positions: np.ndarray  # positions of their heads there [m], shape (J, 3)
    # indices, weights: joints that move each vertex of the character and their shares, shape (V, M); rows sum to 1
    indices: np.ndarray
    weights: np.ndarray

    @classmethod
    def of_handles(cls, handles: Handles, names: tuple[str, ...] | None = None) -> Bones:
        """Handles: the root and the others below it, none rotated; four weights a vertex, as viewers read."""
        count = len(handles.positions)
        parents = np.zeros(count, np.int64)
        parents[0] = -1
        indices, weights = top_influences(handles.weights, 4)
        turns = np.tile(np.eye(3), (count, 1, 1))
        positions = handles.positions.astype(np.float64)
        return cls(names or tuple(handle_names(handles.played)), parents, turns, positions, indices, weights)

    @classmethod
    def of_rig(cls, rig: Rig) -> Bones:
        """The rig of a file, with its weights as they are."""
        turns = nearest_rotation(rig.transforms[:, :3, :3])
        return cls(tuple(rig.names), rig.parents, turns, rig.positions, rig.indices, rig.weights)

    @property
    def bind(self) -> np.ndarray:
        """World transform of each joint where the skin is bound [m], shape (J, 4, 4)."""
        out = np.tile(np.eye(4), (len(self.names), 1, 1))
        out[:, :3, :3], out[:, :3, 3] = self.rotations, self.positions
        return out

    def rest(self) -> Track:
        """The pose in which the skin is bound."""
        return self._local(self.rotations[None], self.positions[None], 1.0)

    def handle_track(self, animation: Animation) -> Track:
        """What an animation of handles does."""
        translations, quaternions = joint_tracks(animation.handles.positions, animation.motion)
        return Track(matrix_from_quaternion(quaternions), translations, animation.motion.fps)

    def rig_track(self, animation: RigAnimation) -> Track:
        """What an animation of the rig does."""
        turns, positions = animation.world()
        return self._local(turns @ self.rotations, positions, animation.fps)

    def _local(self, rotations: np.ndarray, positions: np.ndarray, fps: float) -> Track:
        """World rotations (N, J, 3, 3) and positions (N, J, 3), each in the frame of its parent."""
        local, moved = np.array(rotations, np.float64), np.array(positions, np.float64)
        for bone, parent in enumerate(self.parents):
            if parent >= 0:
                back = np.swapaxes(rotations[:, parent], -1, -2)
                local[:, bone] = back @ rotations[:, bone]
                moved[:, bone] = np.einsum("nij,nj->ni", back, positions[:, bone] - positions[:, parent])
        return Track(local, moved, fps)


def add_bones(objects: Objects, bones: Bones) -> list[int]:
    """Add the joints as they rest, and return the number of each."""
    rest, frame = bones.rest(), objects.frame
    numbers = [0] * len(bones.names)
    for bone in bone_order(bones.parents):
        root = bones.parents[bone] < 0
        turn, place = rest.rotations[0, bone], rest.translations[0, bone] * frame.scale
        if root:
            turn, place = frame.turn @ turn, frame.turn @ place
        name = objects.free_name(bones.names[bone], "nodes")
        numbers[bone] = objects.add(
            "Model", name, "LimbNode", element("Version", 232),
            properties(
                prop("RotationActive", "bool", 1), prop("InheritType", "enum", 1),
                prop("DefaultAttributeIndex", "int", 0),
                prop("PreRotation", "vector", *euler_degrees(turn[None])[0].tolist()),
                prop("Lcl Translation", "Lcl Translation", *place.tolist()),
                prop("Lcl Rotation", "Lcl Rotation", 0.0, 0.0, 0.0),
                prop("Lcl Scaling", "Lcl Scaling", 1.0, 1.0, 1.0),
            ),
            element("Shading", True), element("Culling", "CullingOff"),
        )  # fmt: skip
        kind = properties(prop("Size", "double", 100.0 * max(_length(bones, bone), 1e-3)))
        attribute = objects.add("NodeAttribute", name, "LimbNode", element("TypeFlags", "Skeleton"), kind)
        objects.link(attribute, numbers[bone])
        objects.link(numbers[bone], 0 if root else numbers[int(bones.parents[bone])])
    return numbers


def _length(bones: Bones, bone: int) -> float:
    """How far the nearest joint below is [m], or the one above."""
    below = np.flatnonzero(bones.parents == bone)
    near = below if len(below) else np.array([max(int(bones.parents[bone]), 0)])
    return float(np.linalg.norm(bones.positions[near] - bones.positions[bone], axis=1).min())


def euler_degrees(rotations: np.ndarray) -> np.ndarray:
    """Angles about the fixed axes X, Y and Z, in this order [degrees], shape (N, ..., 3, 3) -> (N, ..., 3).

    Of the two triples of each rotation, and of their full circles, each frame takes what is nearest to the frame
    before. Where only the sum of two angles is determined, that about Z stays.
    """
    r = np.asarray(rotations, np.float64)
    level = np.hypot(r[..., 0, 0], r[..., 1, 0])
    y = np.arctan2(-r[..., 2, 0], level)
    out = np.stack([np.arctan2(r[..., 2, 1], r[..., 2, 2]), y, np.arctan2(r[..., 1, 0], r[..., 0, 0])], -1)
    sign = np.where(r[..., 2, 0] < 0, 1.0, -1.0)
    locked, sum_of_two = level < 1e-7, np.arctan2(sign * r[..., 0, 1], r[..., 1, 1])
    before = np.zeros(out.shape[1:])
    for frame, angles in enumerate(out):
        stuck = np.stack([sum_of_two[frame] + sign[frame] * before[..., 2], angles[..., 1], before[..., 2]], -1)
        first = np.where(locked[frame][..., None], stuck, angles)
        other = first * [1, -1, 1] + np.pi
        first, other = (one + 2 * np.pi * np.round((before - one) / (2 * np.pi)) for one in (first, other))
        nearer = np.abs(other - before).sum(-1) < np.abs(first - before).sum(-1) - 1e-9
        before = out[frame] = np.where(nearer[..., None], other, first)
    return np.degrees(out)


STILL_DEGREES, STILL_LENGTH = 1e-5, 1e-7  # the latter of the skeleton's extent; what float32 rounds in the file
_LINEAR = 4
_BEZIER_DEFAULTS = np.zeros(4, np.float32)


@dataclass(frozen=True, eq=False)
class ShapeTrack:
    """The shapes of a mesh in a clip."""

    channels: Sequence[int]  # the number of each shape's channel, length T
    frames: np.ndarray  # frames that have keys, ascending, shape (F,)
    weights: np.ndarray  # amount of each from 0 to 1, shape (F, T)


@dataclass(frozen=True, eq=False)
class _Curves:
    """The values of one property of an object in each clip."""

    model: int
    name: str
    short: str
    rest: np.ndarray
    values: dict[str, np.ndarray] = field(default_factory=dict)


def add_clips(
    objects: Objects,
    tracks: Mapping[str, Track],
    bones: Bones,
    joints: Sequence[int],
    shapes: Mapping[str, Sequence[ShapeTrack]] | None = None,
) -> None:
    """Add clips: what the joints do in each, by its name, and the shapes."""
    moving = _moving(objects, tracks, bones, joints)
    for name, track in tracks.items():
        stop = _ticks(len(track.rotations) - 1, track.fps)
        title = objects.free_name(name, "clips")
        objects.spans.append(Span(title, int(stop)))
        ends = [prop(key, "time", np.int64(value)) for key, value in (
            ("LocalStart", 0), ("LocalStop", stop), ("ReferenceStart", 0), ("ReferenceStop", stop),
        )]  # fmt: skip
        stack = objects.add("AnimationStack", title, "", properties(prop("Description", "string", ""), *ends))
        layer = objects.add("AnimationLayer", "BaseLayer")
        objects.link(layer, stack)
        every = _ticks(np.arange(len(track.rotations)), track.fps)
        for curves in moving:
            values = curves.values[name]
            still = np.ptp(values, axis=0).max() == 0
            _add_curves(
                objects, layer, curves.model, curves.name, curves.short,
                every[[0, -1]] if still and len(every) > 1 else every[: len(values)],
                values[[0, -1]] if still and len(every) > 1 else values, "XYZ",
            )  # fmt: skip
        for shape in (shapes or {}).get(name, ()):
            times = _ticks(shape.frames, track.fps)
            for channel, column in zip(shape.channels, shape.weights.T, strict=True):
                amount = 100 * column.astype(np.float64)[:, None]
                _add_curves(objects, layer, channel, "DeformPercent", "DeformPercent", times, amount, "")
    objects.fps = next(iter(tracks.values())).fps


def _ticks(frames: np.ndarray | int, fps: float) -> np.ndarray:
    return np.asarray(np.round(np.asarray(frames, np.float64) * (SECOND / fps)), np.int64)


def _moving(objects: Objects, tracks: Mapping[str, Track], bones: Bones, joints: Sequence[int]) -> list[_Curves]:
    """Properties of joints that move in any clip, with their values in each; in clips where they rest, set to rest."""
    rest, frame = bones.rest(), objects.frame
    small = STILL_LENGTH * max(float(np.ptp(bones.positions, axis=0).max(initial=0)), 1e-9) * frame.scale
    roots = bones.parents < 0
    base_turn, base_place = rest.rotations[0].copy(), rest.translations[0] * frame.scale
    base_turn[roots], base_place[roots] = frame.turn @ base_turn[roots], base_place[roots] @ frame.turn.T
    turned: dict[str, np.ndarray] = {}
    placed: dict[str, np.ndarray] = {}
    for name, track in tracks.items():
        turns, places = np.array(track.rotations, np.float64), track.translations * frame.scale
        turns[:, roots], places[:, roots] = frame.turn @ turns[:, roots], places[:, roots] @ frame.turn.T
        turned[name] = euler_degrees(np.swapaxes(base_turn, -1, -2) @ turns)
        placed[name] = places
    out = []
    for bone, joint in enumerate(joints):
        for title, short, values, base, still in (
            ("Lcl Translation", "T", placed, base_place[bone], small),
            ("Lcl Rotation", "R", turned, np.zeros(3), STILL_DEGREES),
        ):
            if max(np.abs(animated[:, bone] - base).max() for animated in values.values()) <= still:
                continue
            curves = _Curves(joint, title, short, base)
            for name, animated in values.items():
                flat = np.ptp(animated[:, bone], axis=0).max() <= still
                curves.values[name] = np.tile(animated[:1, bone], (len(animated), 1)) if flat else animated[:, bone]
            out.append(curves)
    return out


def _add_curves(
    objects: Objects, layer: int, model: int, name: str, short: str, times: np.ndarray, values: np.ndarray, axes: str
) -> None:
    """Add the curves of one property."""
    parts = [f"d|{axis}" for axis in axes] or [f"d|{short}"]
    defaults = [prop(part, "number", float(value)) for part, value in zip(parts, values[0], strict=True)]
    node = objects.add("AnimationCurveNode", short, "", properties(*defaults))
    objects.link(node, layer)
    objects.link(node, model, name)
    for part, column in zip(parts, values.T, strict=True):
        curve = objects.add(
            "AnimationCurve", "", "", element("Default", float(column[0])), element("KeyVer", 4008),
            element("KeyTime", times), element("KeyValueFloat", column.astype(np.float32)),
            element("KeyAttrFlags", np.array([_LINEAR], np.int32)),
            element("KeyAttrDataFloat", _BEZIER_DEFAULTS),
            element("KeyAttrRefCount", np.array([len(times)], np.int32)),
        )  # fmt: skip
        objects.link(curve, node, part)
