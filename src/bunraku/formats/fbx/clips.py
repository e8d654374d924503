"""The clips of an FBX file: animation stacks, the curves of their layers, and sampling them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.errors import OptionError
from bunraku.formats.fbx.curves import Curve, read_curve
from bunraku.formats.fbx.scene import TICKS, FbxObject, FbxScene
from bunraku.formats.fbx.transforms import PROPERTIES, Values

__all__ = ["FbxClip", "find_clip", "read_clips", "sample_clip"]

MAX_TRANSFORMS = 2_000_000
_AXES = ("d|X", "d|Y", "d|Z")


@dataclass(frozen=True, eq=False)
class FbxClip:
    """A clip.

    Args:
        name: Its name.
        start: Where it starts [s].
        end: Where it ends [s].
        curves: For each (model, property) that it moves, three curves or the numbers that stand for them.
    """

    name: str
    start: float
    end: float
    curves: dict[tuple[int, str], tuple[Curve | float, ...]]

    @property
    def seconds(self) -> float:
        """Its length [s]."""
        return self.end - self.start


def read_clips(scene: FbxScene) -> list[FbxClip]:
    """All clips that move something. Of several layers, the first that moves a property counts.

    Raises:
        FormatError: A curve is broken.
    """
    clips = []
    for number, stack in enumerate(scene.of_kind("AnimationStack")):
        curves: dict[tuple[int, str], tuple[Curve | float, ...]] = {}
        for layer in scene.below(stack, "AnimationLayer"):
            for group in scene.below(layer, "AnimationCurveNode"):
                for owner, what in scene.owners.get(group.id, ()):
                    if what in PROPERTIES and owner in scene.indices and (scene.indices[owner], what) not in curves:
                        curves[scene.indices[owner], what] = _curves(scene, group, owner, what)
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
    found: list[Curve | float] = [group.number(axis, still[i]) for i, axis in enumerate(_AXES)]
    for child, axis in scene.links.get(group.id, ()):
        thing = scene.objects.get(child)
        if thing is not None and thing.kind == "AnimationCurve" and axis in _AXES:
            curve = read_curve(scene.tree, thing)
            if curve is not None:
                found[_AXES.index(axis)] = curve
    return tuple(found)


def find_clip(scene: FbxScene, clips: list[FbxClip], clip: int | str | None) -> FbxClip:
    """A clip by its number or name, with or without its armature's name before a bar; the first one for None.

    Raises:
        FormatError: The file has no clip.
        OptionError: It has none of this name or number.
    """
    if not clips:
        scene.tree.fail("it holds no animation; export it with its keys baked")
    if clip is None:
        return clips[0]
    for names in ([known.name for known in clips], [known.name.rsplit("|", 1)[-1] for known in clips]):
        if clip in names:
            return clips[names.index(str(clip))]
    number = int(clip) if str(clip).isdecimal() else -1
    if not 0 <= number < len(clips):
        raise OptionError(
            f"{scene.tree.path} has no clip {clip!r}; it has {', '.join(known.name for known in clips[:20])}"
        )
    return clips[number]


def sample_clip(scene: FbxScene, clip: FbxClip, fps: float) -> tuple[Values, int]:
    """What a clip moves at a frame rate, and the number of frames N.

    Args:
        scene: The file.
        clip: The clip.
        fps: Frames a second [1/s]; frame n is at `clip.start + n / fps`.

    Raises:
        FormatError: The clip is too long for the number of models.
    """
    count = int(np.floor(min(clip.seconds * fps, 1e9) + 1e-3)) + 1
    if count * max(len(scene.models), 1) > MAX_TRANSFORMS:
        scene.tree.fail(
            f"its clip '{clip.name}' of {clip.seconds:.0f} s moves {len(scene.models)} objects, too many to read; cut "
            "it or lower the frame rate"
        )
    moments = clip.start + np.arange(count) / fps
    return {
        key: np.stack(
            [curve.at(moments) if isinstance(curve, Curve) else np.full(count, curve) for curve in trio], axis=1
        )
        for key, trio in clip.curves.items()
    }, count
