"""Handles of a figure of rigid blocks: each block is wholly of one handle, which stands at its joint."""

from __future__ import annotations

import numpy as np

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.character import Character, Handles
from bunraku.handles.blocks.contacts import BlockShapes
from bunraku.handles.blocks.find import Blocks, find_blocks
from bunraku.handles.blocks.parts import BlockParts, block_parts

__all__ = ["joint_parents", "rigid_handles"]

BENDS = 0.1  # what holds so much of the knees and elbows of either side bends, as a share of its surface
EVEN = 0.5  # a leg has a little of the knee of the other that it touches: less than so much of what its own has
_OUTER = {
    side: [HANDLE_NAMES.index(f"{side}_{part}") for part in ("knee", "ankle", "foot", "elbow", "wrist", "fingers")]
    for side in ("left", "right")
}


def rigid_handles(character: Character, weights: np.ndarray) -> Handles | None:
    """The handles of a figure of rigid blocks; None of others.

    Args:
        character: +Y up and facing +Z.
        weights: What the predictor says of its vertices, shape (V, 30). Where no names tell the limbs, it is asked
            whether a block is one: a pair of trousers is none.
    """
    blocks = find_blocks(character)
    if blocks is None:
        return None
    shapes = BlockShapes.of(character, blocks)
    parts = block_parts(shapes)
    if parts is None or (not parts.named and _bends(character, blocks, weights)):
        return None
    whole = np.zeros((len(character.vertices), HANDLE_COUNT), np.float32)
    label = np.where(blocks.label >= 0, blocks.label, parts.trunk[0])
    whole[np.arange(len(label)), parts.handles[label]] = 1
    return Handles(_positions(shapes, parts), whole, rigid=True)


def _bends(character: Character, blocks: Blocks, weights: np.ndarray) -> bool:
    """Whether the predictor sees knees and elbows of both sides in one block."""
    mass = weights * character.areas[:, None]
    for block in range(len(blocks.names)):
        own = mass[blocks.label == block].sum(axis=0)
        less, more = sorted(float(own[parts].sum()) for parts in _OUTER.values())
        if less > max(BENDS * float(own.sum()), EVEN * more):
            return True
    return False


def joint_parents(present: np.ndarray) -> np.ndarray:
    """The handle that each hangs on, by which have blocks, shape (K,); -1 for the root.

    Where the pelvis has none, legs and all else hang on the lowest block of the trunk.
    """
    spine = [HANDLE_NAMES.index(f"spine{number}") for number in (1, 2, 3)]
    base = 0 if present[0] else next((handle for handle in spine if present[handle]), 0)
    out = np.full(len(present), -1)
    for handle in range(1, len(present)):
        above = HANDLE_PARENTS[handle]
        while above > 0 and not present[above]:
            above = HANDLE_PARENTS[above]
        out[handle] = above if above > 0 or handle == base or handle in spine[: _rank(spine, base)] else base
    return out


def _rank(spine: list[int], base: int) -> int:
    return spine.index(base) if base in spine else 0


def _positions(shapes: BlockShapes, parts: BlockParts) -> np.ndarray:
    """Where each handle stands [m], shape (K, 3): at its joint; the root between the legs, and absent ones where their
    parents stand. The head of who has none stands at the upper or the front end of the trunk.
    """
    members = [np.flatnonzero(parts.handles == handle).tolist() for handle in range(HANDLE_COUNT)]
    present = np.array([bool(some) for some in members])
    above = joint_parents(present)
    out = np.zeros((HANDLE_COUNT, 3))
    hips = [handle for handle, name in enumerate(HANDLE_NAMES) if name.endswith("_hip") and members[handle]]
    low, high = shapes.low[parts.trunk].min(axis=0), shapes.high[parts.trunk].max(axis=0)
    bottom = np.array([0.5 * (low + high)[0], low[1], 0.5 * (low + high)[2]])
    out[0] = np.mean([shapes.pivot(members[hip], members[above[hip]]) for hip in hips], axis=0) if hips else bottom
    base = int(above[hips[0]]) if hips else 0
    for handle in range(1, HANDLE_COUNT):
        parent = int(above[handle])
        jointed = members[handle] and members[parent] and handle != base
        out[handle] = shapes.pivot(members[handle], members[parent]) if jointed else out[max(parent, 0)]
    head = HANDLE_NAMES.index("head")
    if not members[head]:
        middle = 0.5 * (low + high)
        front = np.array([middle[0], out[0, 1] + 0.5 * (high[1] - out[0, 1]), high[2] + (high[1] - low[1])])
        out[head] = np.array([middle[0], high[1], middle[2]]) if parts.upright else front
    return out.astype(np.float32)
