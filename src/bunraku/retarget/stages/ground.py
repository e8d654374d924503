"""Feet on the floor: how high a character stands and how its lowest point follows the reference body's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d, minimum_filter1d, uniform_filter1d

from bunraku.anatomy.ground import lowest, standing
from bunraku.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.geometry.easing import smooth_step

__all__ = ["FLIES", "hovering", "set_on_ground", "settle_hovering"]

FLIES = (0.12, 0.2)
"""Heights over the ground, as shares of the body's, between which what hovers becomes what flies."""


def set_on_ground(
    motion: HandleMotion,
    fitted: HandleMotion,
    character: Character,
    handles: Handles,
    scale: float,
    stands: np.ndarray,
    heights: np.ndarray | None = None,
) -> HandleMotion:
    """The fitted motion with its lowest point as high over the floor, that of its rest pose, as the reference body's is
    over y = 0.

    The reference body's own drift off the ground is taken out first. Nobody stays in the air for a second, so the
    lowest height within 0.75 s of a frame is where the ground is for that frame.

    Args:
        motion: Of the reference body.
        fitted: Of the character.
        character: In its rest pose.
        handles: Its handles.
        scale: Its size over the reference body's.
        stands: What may stand on the ground, shape (V,), bool.
        heights: Of the lowest point of another body than the reference body, in the reference body's scale [m], shape
            (N,).
    """
    body = reference_body()
    want = lowest(body.vertices, body.handle_weights, motion, body.handles.positions) if heights is None else heights
    window = 2 * round(0.75 * motion.fps) + 1
    drift = gaussian_filter1d(minimum_filter1d(want, window, mode="nearest"), 0.25 * motion.fps, mode="nearest")
    have = lowest(character.vertices[stands], handles.weights[stands], fitted, handles.positions)
    seen = character.surface
    if heights is None and stands.sum() < seen.sum():
        feet = standing(body.character(), body.handles)
        hands_down = (
            lowest(body.vertices[feet], body.handle_weights[feet], motion, body.handles.positions) > want + 0.01
        )
        if hands_down.any():
            have = np.where(
                hands_down, lowest(character.vertices[seen], handles.weights[seen], fitted, handles.positions), have
            )
    floor = float(character.vertices[stands, 1].min())
    lift = uniform_filter1d(floor + (want - drift) * scale - have, 5, mode="nearest")
    moved = fitted.root_translation.copy()
    moved[:, 1] += lift
    return replace(fitted, root_translation=moved)


def settle_hovering(
    fitted: HandleMotion, character: Character, handles: Handles, stands: np.ndarray, flies: bool = True
) -> HandleMotion:
    """A motion that was generated for this very body, set down where it hovers: it brings its own height over the
    floor, and generators are a few centimetres off.

    Jumps keep their height (`hovering`), and what can fly and is farther up than `FLIES` means to be there.

    Args:
        fitted: Motion of the character.
        character: In its rest pose.
        handles: Its handles.
        stands: What may stand on the ground, shape (V,), bool.
        flies: Whether the body can be off the ground for long: with wings, without legs, or where it climbs.
    """
    hovers = hovering(fitted, character, handles, stands)
    if flies:
        hovers = hovers * (1 - smooth_step(hovers / character.height, *FLIES))
    moved = fitted.root_translation.copy()
    moved[:, 1] -= hovers
    return replace(fitted, root_translation=moved)


def hovering(
    fitted: HandleMotion, character: Character, handles: Handles, stands: np.ndarray, air: float | None = None
) -> np.ndarray:
    """How far a body is off the ground in each frame but for its jumps [m], shape (N,).

    Nobody stays in the air for a second, so the lowest height within 0.75 s of a frame is where the body thinks the
    ground is; it goes up and down softly. Who walks or runs is in the air for a shorter time, if at all, and is on the
    ground otherwise.

    Args:
        fitted: Motion of the character.
        character: In its rest pose.
        handles: Its handles.
        stands: What may stand on the ground, shape (V,), bool.
        air: Half of the time that the body is in the air at the most [s]; None for the 0.75 s.
    """
    floor = float(character.vertices[stands, 1].min())
    have = lowest(character.vertices[stands], handles.weights[stands], fitted, handles.positions) - floor
    window = 2 * round((0.75 if air is None else air) * fitted.fps) + 1
    low = minimum_filter1d(have, window, mode="nearest")
    if air is None:
        hovers = gaussian_filter1d(low, 0.25 * fitted.fps, mode="nearest")
    else:
        hovers = maximum_filter1d(low, window, mode="nearest")
    return np.asarray(np.maximum(hovers, 0))
