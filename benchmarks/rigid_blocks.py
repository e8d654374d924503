"""How rigid the blocks of figures stay in an animation, and how well they stay jointed: shear inside a block, and gaps
at joints.

    python benchmarks/rigid_blocks.py FILES ... [--sentence S] [--seconds 5] [--seed 1]

Each file does what the sentence says, is written as GLB, and is read back at a rate that falls between its frames.
Prints JSON, and exits with 1 where shear is over 0.01 % of the height, or a gap over 1 %. `rigid_blocks.md` has a list.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from bunraku.anatomy.handles.blocks import joint_parents
from bunraku.anatomy.handles.orientation import resolve_axes
from bunraku.core.animation import Animation
from bunraku.core.body.layout import handle_names
from bunraku.core.character import Character
from bunraku.core.geometry.closest import least_distance
from bunraku.core.geometry.surface import surface_points
from bunraku.core.skinning import register
from bunraku.files import load_animation, load_character
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.requests import Request, Sampling

SPACING = 0.005  # of the points that gaps are measured between, over the height: gaps are overrated by as much
AROUND = 0.06  # points so near to where two blocks touch at rest are looked at, by definition, over the height


@dataclass(frozen=True)
class BlockMotion:
    """What an animation does to blocks.

    Args:
        shear: Farthest that a vertex is from where the best rigid motion of its block takes it, over the height.
        gaps: How much farther from one another the two blocks of each joint are than at rest, at the most in any frame,
            over the height, shape (P,).
    """

    shear: float
    gaps: np.ndarray


def block_motion(
    character: Character, label: np.ndarray, joints: Sequence[tuple[int, int]], posed: np.ndarray
) -> BlockMotion:
    """Measure shear inside blocks and gaps at their joints on the posed surface, whatever posed it.

    Args:
        character: In its rest pose, V vertices.
        label: Block of each vertex, -1 for those that are not looked at, shape (V,).
        joints: Pairs of blocks that are jointed, P.
        posed: Vertices of each frame [m], shape (N, V, 3).
    """
    rest, height = character.vertices.astype(np.float64), character.height
    count = int(label.max()) + 1
    mass = np.eye(count + 1)[label][:, :count] * np.maximum(character.areas, 1e-12)[:, None]
    centers = (mass.T @ rest) / mass.sum(axis=0)[:, None]
    rotations, translations = register(rest, posed.astype(np.float64), mass, centers)
    own = np.flatnonzero(label >= 0)
    of = label[own]
    rigid = np.einsum("nvij,vj->nvi", rotations[:, of], rest[own] - centers[of]) + centers[of] + translations[:, of]
    shear = float(np.linalg.norm(rigid - posed[:, own], axis=-1).max()) / height
    points = [_points(character, label, block) for block in range(count)]
    gaps = []
    for one, other in joints:
        first, second = points[one], points[other]
        apart = cKDTree(second).query(first)[0]
        contact = cKDTree(first[apart <= apart.min() + 2 * SPACING * height])
        first, second = (
            some[np.isfinite(contact.query(some, distance_upper_bound=AROUND * height)[0])] for some in (first, second)
        )
        tree, widest = cKDTree(second), 0.0
        for frame in range(len(posed)):
            moved = (first - centers[one]) @ rotations[frame, one].T + centers[one] + translations[frame, one]
            back = (moved - centers[other] - translations[frame, other]) @ rotations[frame, other] + centers[other]
            widest = max(widest, least_distance(tree, back) - float(apart.min()))
        gaps.append(widest / height)
    return BlockMotion(shear, np.array(gaps))


def _points(character: Character, label: np.ndarray, block: int) -> np.ndarray:
    faces = character.faces[label[character.faces[:, 0]] == block]
    corners = character.vertices[faces].astype(np.float64)
    double = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(double, axis=1).sum()) / 2
    spread = max(int(area / (SPACING * character.height) ** 2), 200)
    own = character.vertices[np.unique(faces)].astype(np.float64)
    return np.concatenate([surface_points(character.vertices, faces, spread)[0], own])


SHEAR, GAP = 1e-4, 0.01
"""The bars, goals that were set before anything was measured: farthest from a rigid motion, and farthest apart at a
joint, over the height.
"""
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
        (`block_motion`).

    Raises:
        BunrakuError: The file cannot be read or animated.
    """
    from bunraku.files import rotated

    found = load_character(path, unit="m")
    standing = resolve_axes(found)
    character = rotated(found, standing.up, standing.front)
    request = Request(sentence, Sampling(seconds, seed, candidates=1), rig="handles")
    animation = (animator or Animator.shipped())(character, request)
    assert isinstance(animation, Animation)
    if not animation.handles.rigid:
        return {"file": path.name, "blocks": 0, "shear": None, "gap": None}
    with tempfile.TemporaryDirectory() as folder:
        back = load_animation(animation.save(Path(folder) / "moved.glb"), fps=RATE)
    rig = back.character.rig
    assert rig is not None
    names = handle_names(animation.handles.played)
    handle = np.array([names.index(name) if name in names else 0 for name in rig.names])
    rows = np.arange(len(rig.indices))
    label, joints = block_joints(handle[rig.indices[rows, rig.weights.argmax(axis=1)]], len(names))
    moved = block_motion(back.character, label, joints, back.vertices(slice(None, None, EVERY)))
    gap = float(moved.gaps.max(initial=0.0))
    return {"file": path.name, "blocks": int(label.max()) + 1, "shear": moved.shear, "gap": gap}


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--sentence", default="walks forward, then waves with the left hand")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(words)
    rows = [block_file(path, options.sentence, options.seconds, options.seed) for path in options.files]
    print(json.dumps(rows, indent=2))
    return int(any(row["blocks"] and (row["shear"] > SHEAR or row["gap"] > GAP) for row in rows))


if __name__ == "__main__":
    sys.exit(main())
