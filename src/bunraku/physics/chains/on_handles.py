"""Handles as the bones of a rig, so that chains can hang on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.body.layout import handle_names
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles, Rig, top_influences
from bunraku.core.rig_animation import RigAnimation

__all__ = ["handle_rig", "on_handle_rig"]


def handle_rig(character: Character, handles: Handles) -> Character:
    """The character with a bone for each handle: the first is the root, and all others hang on it."""
    count = len(handles.positions)
    transforms = np.tile(np.eye(4), (count, 1, 1))
    transforms[:, :3, 3] = handles.positions
    parents = np.where(np.arange(count) == 0, -1, 0)
    indices, weights = top_influences(handles.weights, min(8, count))
    rig = Rig(handle_names(handles), parents, transforms, indices, weights)
    return replace(character, rig=rig, avatar=None)


def on_handle_rig(animation: Animation) -> RigAnimation:
    """An animation of handles as one of `handle_rig`."""
    handles = animation.handles
    affine = animation.motion.transforms(handles.positions).astype(np.float64)
    positions = np.einsum("nkab,kb->nka", affine[..., :3], handles.positions) + affine[..., 3]
    character = handle_rig(animation.character, handles)
    return RigAnimation.of_world(character, affine[..., :3], positions, animation.fps, animation.reference)
