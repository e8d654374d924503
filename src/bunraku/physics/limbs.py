"""Colliders made from the body's mesh: for each bone of the body, the box of the vertices that it holds.

Files have few colliders, and often switch off those that apparel overlaps at rest. What overlaps at rest may overlap by
as much (`world`), so these can be on for all apparel. The world rounds the boxes off: an arm becomes a capsule, a slice
of the trunk a few that lie side by side.
"""

from __future__ import annotations

import numpy as np

from bunraku.apparel.mask import APPAREL_SHARE, moved_joints
from bunraku.core.character import Character
from bunraku.core.mmd_model import MmdBody

__all__ = ["body_limbs"]

LEAST = 24  # vertices that a limb is made of at least
# a bone whose vertices are all nearer to their middle than this share of the height gets none: fingers, eyes, teeth
SMALL = 0.03
MOST = 40  # limbs; the largest are kept
TAKEN = 20_000  # vertices of one bone at most
OUTER = 2.0  # share of the vertices that are outside of a box, on each side [%]


def body_limbs(character: Character, moved: np.ndarray | None = None) -> list[MmdBody]:
    """Boxes that follow the bones of a character's body, at most 40.

    Args:
        character: With a rig.
        moved: Joints that physics move, shape (J,), bool; what the file says by default.
    """
    rig = character.rig
    moved = moved_joints(character) if moved is None else moved
    if rig is None or moved is None:
        return []
    holder = np.take_along_axis(rig.indices, rig.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    body = (rig.weights * moved[rig.indices]).sum(axis=1) <= APPAREL_SHARE
    height = float(np.ptp(character.vertices[:, 1]))
    found = []
    for bone in np.unique(holder[body & ~moved[holder]]):
        chosen = np.flatnonzero((holder == bone) & body)
        if len(chosen) < LEAST:
            continue
        box = _box(int(bone), rig.names[bone], character.vertices[chosen[:: len(chosen) // TAKEN + 1]].astype(float))
        if np.linalg.norm(box.size) > SMALL * height:
            found.append(box)
    found.sort(key=lambda box: (-float(np.linalg.norm(box.size)), box.bone))
    return sorted(found[:MOST], key=lambda box: box.bone)


def _box(bone: int, name: str, points: np.ndarray) -> MmdBody:
    """The box of points along their principal axes."""
    _, _, rows = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    axes = rows.T * [1.0, 1.0, np.linalg.det(rows)]
    low, high = np.percentile(points @ axes, [OUTER, 100 - OUTER], axis=0)
    return MmdBody(
        name, bone, "box", (high - low) / 2, axes @ ((low + high) / 2), axes, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0
    )
