"""How well it is known which way up a character belongs and which way it faces."""

from __future__ import annotations

from typing import Any

import numpy as np

from bunraku.geometry.axes import ORIENTATIONS, right_angle_rotations, upright_rotation
from bunraku.handles.orientation import Orientation, guess_orientation, resolved_axes
from bunraku.handles.orientation_evidence import kind_weights
from bunraku_lab.evaluation.handles.subjects import Subject

__all__ = ["measure_orientation"]

BARE, RULED = ".obj", ".glb"
"""Formats that a character is judged in: one that does not say how it stands, and one whose rule is +Y up."""


def measure_orientation(one: Subject) -> dict[str, Any]:
    """How often a character is set up rightly, without its rig.

    Turning a mesh by right angles permutes what is seen of it and changes nothing else, so it is looked at once, and
    each of the 24 ways in which it may lie is judged from that.

    Args:
        one: The character, facing +Z; its place about the origin is that of its file.

    Returns:
        orientation_creatures or orientation_humanoids: share of the 24 orientations in which a file without a rule may
        have it from which it is turned upright and to the front. orientation_up, orientation_front: share whose up axis
        is right, and whose front is the likeliest given the right up. orientation_upright: whether it is left alone as
        it stands in a file with a rule. orientation_warned: of the wrong ones, the share that is called a guess; None
        where none is wrong.
    """
    seen = guess_orientation(one.character, prior=np.ones(len(ORIENTATIONS))).probabilities
    ups, fronts, both, warned = [], [], [], []
    for up, front in ORIENTATIONS:
        guess = _judged(seen[_permutation(up, front)], BARE)
        ups.append(guess.up == up)
        given = [guess.probability(*axes) if axes[0] == up else -1.0 for axes in ORIENTATIONS]
        fronts.append(ORIENTATIONS[int(np.argmax(given))][1] == front)
        both.append(resolved_axes(guess) == (up, front))
        if not both[-1]:
            warned.append(not guess.sure)
    standing = _judged(seen, RULED)
    upright = resolved_axes(standing, rule=True) == ("+y", "+z")
    if not upright:
        warned.append(not standing.sure)
    return {
        "orientation_humanoids" if one.humanoid else "orientation_creatures": float(np.mean(both)),
        "orientation_up": float(np.mean(ups)),
        "orientation_front": float(np.mean(fronts)),
        "orientation_upright": float(upright),
        "orientation_warned": float(np.mean(warned)) if warned else None,
    }


def _judged(seen: np.ndarray, suffix: str) -> Orientation:
    chances = seen * kind_weights(suffix)
    return Orientation.of(chances / chances.sum())


def _permutation(up: str, front: str) -> np.ndarray:
    """For each of `ORIENTATIONS` of a mesh that was laid so that `up` is up and `front` the front: the one that it was
    when the mesh stood, shape (24,).
    """
    rotations = right_angle_rotations()
    before = rotations @ upright_rotation(up, front).T
    return np.asarray((before[:, None] == rotations[None]).all(axis=(2, 3)).argmax(axis=1))
