"""How long a character's strides are."""

from __future__ import annotations

from bunraku.anatomy.decimate import decimated
from bunraku.anatomy.ground import standing, stride_scale
from bunraku.anatomy.stance import rest_to_reference, stance_of
from bunraku.core.character import Character, Handles

__all__ = ["stride_length"]


def stride_length(character: Character, handles: Handles) -> float:
    """The length of its strides over the reference body's, by which `fit_motion` scales the root's path."""
    light, own = decimated(character, handles)
    turns, joints = rest_to_reference(light, own)
    stance = stance_of(light, own, joints, turns)
    return stride_scale(*stance, standing(*stance))
