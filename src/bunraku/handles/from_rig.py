"""Handles of a character from the rig that its file brings: bones become handles through their names."""

from __future__ import annotations

import numpy as np

from bunraku.body.layout import HANDLE_COUNT
from bunraku.body.reference import handle_positions
from bunraku.core.character import Character, Handles
from bunraku.errors import CharacterError
from bunraku.skeletons.bone_names import NO_HANDLE, handle_of_joints

__all__ = ["rig_handles", "resolve_joints"]


def resolve_joints(handles: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Handles of joints where those whose names say nothing join their nearest ancestor that has one, or the root.

    Args:
        handles: Handle of each joint, -1 for none, shape (J,).
        parents: Parent of each joint, -1 for roots, any order, shape (J,).

    Returns:
        Shape (J,), none of them -1.
    """
    out = np.array(handles, np.int64)
    for joint in np.flatnonzero(out == NO_HANDLE):
        above, steps = int(parents[joint]), 0
        while above >= 0 and handles[above] == NO_HANDLE and steps < len(parents):
            above, steps = int(parents[above]), steps + 1
        out[joint] = max(int(handles[above]), 0) if above >= 0 else 0
    return out


def rig_handles(character: Character, least: int = 2) -> Handles:
    """Handles of a rigged character from its own bones: the weights of all bones of a part added up.

    Args:
        character: With a rig; +Y up and facing +Z.
        least: How many of the 30 parts the bones' names must tell at the least.

    Raises:
        CharacterError: It has no rig, or its bones have no names that tell which part they move.
    """
    rig = character.rig
    if rig is None:
        raise CharacterError(
            f"{character.name}: there is no rig in this file to take the handles from; let them be predicted"
        )
    dense = rig.dense_weights()
    areas = character.areas
    mass = (dense * areas[:, None]).sum(axis=0)
    known = handle_of_joints(rig.names, rig.parents, rig.positions, mass)
    if len(np.unique(known[known != NO_HANDLE])) < least:
        some = ", ".join(rig.names[:3])
        raise CharacterError(
            f"{character.name}: the names of the rig's {len(rig.names)} bones ({some} ...) do not tell which part "
            "each moves; "
            "rename them (hips, spine, head, left_hand ...) or let the handles be predicted"
        )
    weights = dense @ np.eye(HANDLE_COUNT, dtype=np.float32)[resolve_joints(known, rig.parents)]
    total = weights.sum(axis=1, keepdims=True)
    weights = np.where(total > 1e-6, weights / np.maximum(total, 1e-6), np.eye(1, HANDLE_COUNT, dtype=np.float32))
    return Handles(handle_positions(character.vertices, weights, areas), weights)
