"""Shear and gaps of files of rigid blocks, as they are when an animation of them is written and read back."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.body.layout import handle_names
from bunraku.core.animation import Animation
from bunraku.handles.blocks.rigid import joint_parents
from bunraku.handles.orientation import resolve_axes
from bunraku.io import load_character
from bunraku.io.play import load_animation
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.requests.request import Request, Sampling
from bunraku_lab.evaluation.handles.rigid_blocks import block_motion

__all__ = ["GAP", "SHEAR", "block_file", "block_joints"]

SHEAR, GAP = 1e-4, 0.01
"""The bars: farthest from a rigid motion, and farthest apart at a joint, over the height."""
RATE = 41.0  # frames a second that fall between the 20 of the motion
EVERY = 4  # of those frames one is looked at


def block_joints(own: np.ndarray, count: int) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Pieces of a figure and which of them are jointed: what one handle moves is one piece.

    Args:
        own: The handle of each vertex, shape (V,).
        count: Handles, K.

    Returns:
        The piece of each vertex, shape (V,), and pairs of pieces.
    """
    present = np.isin(np.arange(count), own)
    number = np.cumsum(present) - 1
    parents = joint_parents(present)
    jointed = [handle for handle in np.flatnonzero(present) if parents[handle] >= 0 and present[parents[handle]]]
    return number[own], [(int(number[handle]), int(number[parents[handle]])) for handle in jointed]


def block_file(
    path: Path, sentence: str, seconds: float, seed: int, animator: Animator | None = None
) -> dict[str, Any]:
    """What an animation of a file does to its blocks.

    Returns:
        `file`, `blocks` (0 where it is no figure of them), and `shear` and `gap` over the height
        (`rigid_blocks.block_motion`).

    Raises:
        BunrakuError: The file cannot be read or animated.
    """
    from bunraku.formats.gltf.turning import turned

    found = load_character(path, unit="m")
    standing = resolve_axes(found)
    character = turned(found, standing.up, standing.front)
    request = Request(sentence, Sampling(seconds, seed, candidates=1), rig="handles")
    animation = (animator or Animator.shipped())(character, request)
    assert isinstance(animation, Animation)
    if not animation.handles.rigid:
        return {"file": path.name, "blocks": 0, "shear": None, "gap": None}
    with tempfile.TemporaryDirectory() as folder:
        back = load_animation(animation.save(Path(folder) / "moved.glb"), fps=RATE)
    rig = back.character.rig
    assert rig is not None
    names = handle_names(animation.handles)
    handle = np.array([names.index(name) if name in names else 0 for name in rig.names])
    rows = np.arange(len(rig.indices))
    label, joints = block_joints(handle[rig.indices[rows, rig.weights.argmax(axis=1)]], len(names))
    moved = block_motion(back.character, label, joints, back.vertices(slice(None, None, EVERY)))
    gap = float(moved.gaps.max(initial=0.0))
    return {"file": path.name, "blocks": int(label.max()) + 1, "shear": moved.shear, "gap": gap}
