"""The travel of a finished animation: taken out, or put on a root bone for engines that read it there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.core.animated import AnimatedCharacter
from bunraku.core.animation import Animation
from bunraku.core.rig_animation import RigAnimation
from bunraku.core.travel import SWAY, in_place
from bunraku.geometry.filters import gaussian
from bunraku.geometry.rotations import heading, matrix_y

__all__ = ["on_root_bone", "on_the_spot", "root_bone"]


def on_the_spot(animation: AnimatedCharacter) -> AnimatedCharacter:
    """The animation without its travel over the ground; what sways faster than half a second stays.

    Args:
        animation: Of handles or of the bones of a rig. Others are given back as they are.
    """
    if isinstance(animation, Animation):
        return replace(animation, motion=in_place(animation.motion), reference=None)
    if not isinstance(animation, RigAnimation):
        return animation
    turns, positions = animation.world()
    travel = _travel(positions[:, _carrier(animation)], animation.fps)
    return RigAnimation.of_world(animation.character, turns, positions - travel[:, None], animation.fps)


def root_bone(animation: AnimatedCharacter) -> int | None:
    """The bone that stands above all others and holds no vertex, as Unreal's `root`; None where there is none."""
    rig = animation.character.rig if isinstance(animation, RigAnimation) else None
    if rig is None:
        return None
    roots = np.flatnonzero(rig.parents < 0)
    holds = np.zeros(len(rig.names), bool)
    holds[rig.indices[rig.weights > 0]] = True
    return int(roots[0]) if len(roots) == 1 and not holds[roots[0]] and len(rig.names) > 1 else None


def on_root_bone(animation: AnimatedCharacter) -> AnimatedCharacter:
    """The animation with its travel over the ground and its turning about +Y on the bone above all others.

    The other bones go on from there, so no vertex moves otherwise. Where no bone stands above, or its own handles move
    the character, it is given back as it is: the travel is that of the first joint.
    """
    bone = root_bone(animation)
    if bone is None or not isinstance(animation, RigAnimation):
        return animation
    turns, positions = animation.world()
    carrier = _carrier(animation)
    turned = heading(turns[:, carrier], animation.fps)
    travel = _travel(positions[:, carrier], animation.fps)
    turns, positions = turns.copy(), positions.copy()
    assert animation.character.rig is not None
    turns[:, bone] = matrix_y(turned - turned[0])
    positions[:, bone] = animation.character.rig.positions[bone] + travel
    return RigAnimation.of_world(animation.character, turns, positions, animation.fps)


def _carrier(animation: RigAnimation) -> int:
    """The bone whose path is the character's: the first below the roots that holds vertices, or has several below."""
    rig = animation.character.rig
    assert rig is not None
    bone = int(np.flatnonzero(rig.parents < 0)[0])
    holds = np.zeros(len(rig.names), bool)
    holds[rig.indices[rig.weights > 0]] = True
    while not holds[bone]:
        below = np.flatnonzero(rig.parents == bone)
        if len(below) != 1:
            break
        bone = int(below[0])
    return bone


def _travel(path: np.ndarray, fps: float) -> np.ndarray:
    """What a path goes over the ground from its start, without its sway [m], shape (N, 3)."""
    if len(path) < 3:
        return np.zeros_like(path)
    margin = round(4 * SWAY * fps)
    longer = np.pad(path, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = gaussian(longer, SWAY * fps)[margin : margin + len(path)]
    out = smooth - smooth[0]
    out[:, 1] = 0
    return np.asarray(out)
