"""Clips as FBX: a stack for each, with curves of the joints and of the shapes, a key a frame and straight lines
between them.

All clips of a file move the same joints: what one of them leaves at rest has a key that says so, for programs that go
from clip to clip and leave alone what the next does not name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bunraku.formats.fbx.write.bones import Bones, Track, euler_degrees
from bunraku.formats.fbx.write.encode import element, prop, properties
from bunraku.formats.fbx.write.objects import SECOND, Objects, Span

__all__ = ["ShapeTrack", "add_clips"]

STILL_DEGREES, STILL_LENGTH = 1e-5, 1e-7  # the latter of the skeleton's extent
_LINEAR = 4
_BEZIER_DEFAULTS = np.zeros(4, np.float32)


@dataclass(frozen=True, eq=False)
class ShapeTrack:
    """What a clip does with the shapes of a mesh.

    Args:
        channels: The number of each shape's channel, length T.
        frames: Frames that have keys, ascending, shape (F,).
        weights: Amount of each from 0 to 1, shape (F, T).
    """

    channels: Sequence[int]
    frames: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True, eq=False)
class _Curves:
    """What goes to one property of an object in each clip."""

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
    """Add clips.

    Args:
        objects: The file.
        tracks: What each does with the joints, by its name.
        bones: The joints.
        joints: Their numbers.
        shapes: What each does with shapes.
    """
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
    """The properties of joints that move in any clip, with what they do in each; those that rest are set to rest."""
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
            if max(np.abs(one[:, bone] - base).max() for one in values.values()) <= still:
                continue
            own = _Curves(joint, title, short, base)
            for name, one in values.items():
                flat = np.ptp(one[:, bone], axis=0).max() <= still
                own.values[name] = np.tile(one[:1, bone], (len(one), 1)) if flat else one[:, bone]
            out.append(own)
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
