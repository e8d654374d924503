"""Animations of one rig, end to start: each goes on where the one before it ends."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import MotionError
from bunraku.geometry.easing import smooth_step
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, matrix_y

__all__ = ["end_to_start"]

FADE = 0.3
"""How long the difference of two poses at a join takes to fade out [s]."""


def end_to_start(animations: Sequence[RigAnimation]) -> RigAnimation:
    """One animation of all in a row.

    Each is moved over the ground and turned about +Y until its first pose lies on the last of the one before as closely
    as can be, by least squares over the heads of all bones. What is left of the difference fades out.

    Args:
        animations: Of the same rig, at least one; the rate is that of the first.

    Raises:
        MotionError: They are of several rigs.
    """
    first = animations[0]
    rest = first.character.rig
    assert rest is not None
    rotations, translations = [first.rotations], [first.translations]
    _, places = first.world()
    last = places[-1]
    for some in animations[1:]:
        if some.character is not first.character:
            raise MotionError("animations of several characters cannot be joined; put them on one with `transfer`")
        one = _placed(some.at(first.fps), last)
        share = smooth_step(1 - np.arange(len(one)) / max(round(FADE * first.fps), 1))[:, None, None]
        off = axis_angle_from_matrix(rotations[-1][-1].astype(float) @ np.swapaxes(one.rotations[0], -1, -2))
        rotations.append(matrix_from_axis_angle(share * off) @ one.rotations.astype(float))
        translations.append(one.translations + share * (translations[-1][-1] - one.translations[0]))
        rotations[-1], translations[-1] = rotations[-1][1:], translations[-1][1:]  # its first pose is there already
        if len(rotations[-1]):
            last = RigAnimation(first.character, rotations[-1][-1:], translations[-1][-1:]).world()[1][0]
    return RigAnimation(first.character, np.concatenate(rotations), np.concatenate(translations), first.fps)


def _placed(animation: RigAnimation, goal: np.ndarray) -> RigAnimation:
    """The animation moved over the ground so that its first pose lies on another.

    Args:
        animation: N frames of J bones.
        goal: Where the heads of the bones are [m], shape (J, 3).
    """
    turns, places = animation.world()
    start, middle = places[0].mean(axis=0), goal.mean(axis=0)
    own, theirs = (places[0] - start)[:, [0, 2]], (goal - middle)[:, [0, 2]]
    cross = float((own[:, 1] * theirs[:, 0] - own[:, 0] * theirs[:, 1]).sum())
    angle = math.atan2(cross, float((own * theirs).sum()))
    turn = matrix_y(np.array([angle]))[0]
    places = (places - start) @ turn.T + start + (middle - start) * [1, 0, 1]
    return RigAnimation.of_world(animation.character, turn @ turns, places, animation.fps)
