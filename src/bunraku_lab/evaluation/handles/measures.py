"""What handles are measured by: each measure a function of arrays, for one character.

All are shares or lengths over the character's height. Vertices that have no faces are left out by the caller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.skinning import handle_offsets, skin
from bunraku.geometry.registration import part_means, register
from bunraku_lab.evaluation.handles.joint_registration import refine_registration

__all__ = [
    "NAMED_PARTS",
    "accepted_handles",
    "drive",
    "main_handles",
    "part_handles",
    "part_meaning",
    "part_purity",
    "pose_error",
    "root_error",
    "same_main_handle",
    "truncation_error",
    "weight_difference",
]


def _sides(name: str, *parts: str) -> dict[str, tuple[str, ...]]:
    return {f"{side}_{name}": tuple(f"{side}_{part}" for part in parts) for side in ("left", "right")}


NAMED_PARTS: dict[str, tuple[str, ...]] = {
    "head": ("head",), **_sides("hand", "wrist", "fingers"), **_sides("forearm", "elbow"), **_sides("upper_arm",
    "shoulder"),
    "chest": ("spine2", "spine3"), "hips": ("pelvis",), **_sides("thigh", "hip"), **_sides("shin", "knee"),
    **_sides("foot", "ankle", "foot"),
}  # fmt: skip
"""The parts of a humanoid that people name, and the handles whose bones make each up."""


def main_handles(weights: np.ndarray) -> np.ndarray:
    """The handle with the largest weight on each vertex, shape (V, K) -> (V,)."""
    return weights.argmax(axis=1)


def root_error(handle: np.ndarray, root: np.ndarray, height: float) -> float:
    """Distance between the first handle and the rig's root joint, over the height.

    Args:
        handle: h_0 [m], shape (3,).
        root: The root joint b_1 of Eq. 4: the mean of the pelvis joints that move something [m], shape (3,).
        height: Of the character [m].
    """
    return float(np.linalg.norm(np.asarray(handle, float) - root) / height)


def part_purity(main: np.ndarray, weights: np.ndarray, sure: float = 0.9) -> float | None:
    """Share of the vertices of the rig's parts whose main handle is the one that most of their part have.

    A vertex is of a joint's part where the joint has more than `sure` of it. Each vertex counts the same.

    Args:
        main: Main handle of each vertex, shape (V,).
        weights: The rig's weights, shape (V, J).

    Returns:
        The share, or None where no vertex is surely of one part.
    """
    most = weights.argmax(axis=1)
    of_part = weights.max(axis=1) > sure
    if not of_part.any():
        return None
    counts = np.zeros((weights.shape[1], int(main.max()) + 1), np.int64)
    np.add.at(counts, (most[of_part], main[of_part]), 1)
    return float(counts.max(axis=1).sum() / of_part.sum())


def part_handles(
    weights: np.ndarray, areas: np.ndarray, target: np.ndarray, parts: Mapping[str, Sequence[str]] = NAMED_PARTS
) -> dict[str, int]:
    """The main handle of each named part: the one with the most weight, by area, on the part's vertices.

    A part's vertices are those of which its bones have more than half. Parts without vertices are left out.

    Args:
        weights: Of the handles that are measured, shape (V, K).
        areas: Surface of each vertex, shape (V,).
        target: What the rig's named bones have of each vertex, added up by handle, shape (V, 30).
    """
    out = {}
    for name, handles in parts.items():
        members = _members(target, handles)
        mass = areas[members] @ weights[members]
        if mass.sum() > 0:
            out[name] = int(mass.argmax())
    return out


def _members(target: np.ndarray, handles: Sequence[str]) -> np.ndarray:
    columns = [HANDLE_NAMES.index(handle) for handle in handles]
    return np.flatnonzero(target[:, columns].sum(axis=1) > 0.5)


def accepted_handles(weights: np.ndarray, areas: np.ndarray, target: np.ndarray) -> dict[str, set[int]]:
    """The handles that mean each named part on the reference body, where the same predictor looks at it.

    That is the part's main handle there. Rigs make a chest, a hand or a foot of one bone or of two, and each of these
    parts is two handles on the reference body (the lower and the upper chest, the palm and the fingers, the foot and
    the toes): for them, the main handle of either half means the part too.

    Args:
        weights: Of the predictor on the reference body, shape (V, K).
        areas: Surface of each vertex, shape (V,).
        target: The canonical weights, shape (V, 30).
    """
    out = {name: {handle} for name, handle in part_handles(weights, areas, target).items()}
    for name in out:
        halves = {half: (half,) for half in NAMED_PARTS[name]}
        out[name] |= set(part_handles(weights, areas, target, halves).values())
    return out


def part_meaning(
    weights: np.ndarray, areas: np.ndarray, target: np.ndarray, accepted: Mapping[str, set[int]]
) -> tuple[dict[str, bool], float | None]:
    """Whether the main handle of each named part is one that means it on the reference body.

    Args:
        weights, areas, target: As in `part_handles`.
        accepted: From `accepted_handles`.

    Returns:
        For each named part that the character has; and the share of its vertices whose own main handle is right,
        averaged over the parts, which is the stricter measure (None where it has no named part).
    """
    found = part_handles(weights, areas, target)
    main = main_handles(weights)
    right = {name: handle in accepted.get(name, set()) for name, handle in found.items()}
    shares = [
        float(np.isin(main[_members(target, NAMED_PARTS[name])], list(accepted.get(name, set()))).mean())
        for name in found
    ]
    return right, float(np.mean(shares)) if shares else None


def drive(
    rest: np.ndarray, posed: np.ndarray, weights: np.ndarray, rooted: bool = True, together: bool = False
) -> np.ndarray:
    """How handles follow a moving mesh: Eq. 3 without its global items, as in the Pose Loss (Eq. 14).

    Args:
        rest: Vertices [m], shape (V, 3).
        posed: The same in poses in which the root rests [m], shape (N, V, 3).
        weights: Skinning weights, shape (V, K).
        rooted: Handle 0 is the root and keeps the identity. Baselines have no root; all their parts are free to move.
        together: Fit the handles' motions to one another too (`refine_registration`), which Eq. 14 does not.

    Returns:
        Vertices [m], shape (N, V, 3), float32.
    """
    rotations, translations = register(rest, posed, weights)
    handles = part_means(rest, weights)
    if rooted:
        rotations[:, 0], translations[:, 0] = np.eye(3), 0
    offset = handle_offsets(handles, translations, rotations)
    transforms = np.concatenate([rotations, offset[..., None]], axis=-1)
    if together:
        transforms = refine_registration(rest, posed, weights, transforms, fixed=(0,) if rooted else ())
    return skin(rest, weights, transforms)


def pose_error(
    rest: np.ndarray, posed: np.ndarray, weights: np.ndarray, height: float, rooted: bool = True, together: bool = False
) -> float:
    """Mean distance over vertices and poses between a posed mesh and what the handles make of it (`drive`), over the
    height.
    """
    return float(np.linalg.norm(drive(rest, posed, weights, rooted, together) - posed, axis=-1).mean() / height)


def weight_difference(first: np.ndarray, second: np.ndarray) -> float:
    """Mean over points of the L1 difference `sum_k |a_k - b_k|` of their weights, 0 to 2; shapes (P, K), (P, K)."""
    return float(np.abs(np.asarray(first, float) - second).sum(axis=1).mean())


def same_main_handle(first: np.ndarray, second: np.ndarray) -> float:
    """Share of vertices whose main handle is the same in two sets of weights; shapes (V, K), (V, K)."""
    return float((main_handles(first) == main_handles(second)).mean())


def truncation_error(
    vertices: np.ndarray, full: np.ndarray, cut: np.ndarray, transforms: np.ndarray, height: float
) -> float:
    """Mean distance over vertices and frames between a mesh that plays with all its weights and with fewer, over the
    height.

    Args:
        vertices: Rest vertices [m], shape (V, 3).
        full, cut: The two sets of weights, shape (V, K).
        transforms: Of each handle in each frame, shape (N, K, 3, 4).
    """
    # Skinning is linear in the weights and these differ by rows that sum to 0, so one product gives the difference
    # itself.
    gap = skin(vertices, full - cut, transforms)
    return float(np.linalg.norm(gap, axis=-1).mean() / height)
