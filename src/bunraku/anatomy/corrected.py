"""Handles and joints of a character as a person corrected them (`core.body.corrections`)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from bunraku.anatomy.handles.limbs import FAMILIES, SIDES, limb_handles
from bunraku.anatomy.joints import Joints, find_joints
from bunraku.anatomy.rest_pose import upright
from bunraku.core.body.corrections import CLOTHES
from bunraku.core.body.layout import HANDLE_INDEX, HANDLE_NAMES, HANDLE_PARENTS, handle_names
from bunraku.core.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges
from bunraku.core.geometry.surface import vertex_normals
from bunraku.errors import CharacterError

_MIDDLE = {
    "body": ("pelvis", "spine1", "spine2", "spine3"),
    "head": ("neck", "head", "head_top", "face"),
    "tail": ("tail", "tail_tip"),
}
PARTS: dict[str, list[int]] = {name: [HANDLE_INDEX[part] for part in parts] for name, parts in _MIDDLE.items()}
for _side in SIDES:
    PARTS[f"{_side} arm"] = [HANDLE_INDEX[f"{_side}_collar"], *limb_handles(_side, FAMILIES[1])]
    PARTS[f"{_side} leg"] = limb_handles(_side, FAMILIES[0])
    PARTS[f"{_side} wing"] = [HANDLE_INDEX[f"{_side}_wing"]]
"""Handles of each part of a body."""
_NAMES = list(PARTS)
_PART_OF = np.array([next(i for i, name in enumerate(_NAMES) if handle in PARTS[name]) for handle in range(30)])

# The next four were chosen by eye on the sample person and on figures of blocks, with joints moved by hand.
BEHIND = 4.0  # how much farther a bone counts that lies outside of the surface, straight away from it
SHARP = 6  # power of a distance to a bone in a vertex's share of it
NEAR = 0.01  # what is nearer than this to a piece touches it, over the height
LEAST = 0.004  # share of the surface above which a piece is listed


def joint_facts(handles: Handles, joints: Joints) -> dict[str, list[float]]:
    """Positions of the joints that are there [m], by their names."""
    names = handle_names(handles.played)
    return {names[handle]: joints.positions[handle].round(4).tolist() for handle in np.flatnonzero(joints.present)}


def piece_facts(character: Character, handles: Handles) -> list[dict[str, Any]]:
    """The larger pieces of a character's surface, the largest first: loose parts, cut where limbs begin. Each has its
    kind, a point on it [m] and its share of the surface.
    """
    label, stands = _labels(character, handles), upright(handles)
    full = replace(character, beside=None).areas
    areas = np.bincount(label, full)
    still = np.zeros(len(label), bool) if character.beside is None else character.beside
    out = []
    for number in np.argsort(-areas, kind="stable"):
        if areas[number] <= LEAST * areas.sum():
            break
        rows = np.flatnonzero(label == number)
        points = character.vertices[rows].astype(np.float64)
        at = points[int(np.linalg.norm(points - full[rows] @ points / areas[number], axis=1).argmin())]
        kind = _NAMES[_PART_OF[handles.played[handles.weights[rows[0]].argmax()]]].split()[-1]
        kind = "leg" if kind == "arm" and not stands else kind  # the forelegs of an animal
        share = round(float(areas[number] / areas.sum()), 4)
        out.append({"kind": "ground" if still[rows[0]] else kind, "at": at.round(4).tolist(), "area": share})
    return out


def _labels(character: Character, handles: Handles | None) -> np.ndarray:
    """Number of the piece of each vertex, shape (V,): its loose part, and what limb it is taken for."""
    clean = clean_mesh(character.vertices, character.faces)
    loose = mesh_parts(unique_edges(clean.faces, len(clean.vertices)), len(clean.vertices))[clean.index]
    if handles is None:
        return np.asarray(loose)
    limb = _PART_OF[handles.played[handles.weights.argmax(axis=1)]]
    return np.unique(loose * len(_NAMES) + limb, return_inverse=True)[1]


def _around(character: Character, label: np.ndarray, points: tuple[tuple[float, float, float], ...]) -> np.ndarray:
    """The pieces at some points, shape (V,), bool."""
    used = np.flatnonzero(replace(character, beside=None).surface)
    nearest = used[cKDTree(character.vertices[used]).query(np.asarray(points, np.float64))[1]]
    return np.isin(label, label[nearest])


def beside_as_said(character: Character, beside: np.ndarray) -> np.ndarray:
    """Which vertices stand still beside the body, as corrected, shape (V,), bool."""
    said = character.corrections
    if said is None or not said.part:
        return beside
    label, out = _labels(character, None), beside.copy()
    for piece in said.part:
        out[_around(character, label, piece.at)] = piece.kind == "ground"
    return out


def joint_numbers(character: Character, handles: Handles) -> dict[int, np.ndarray]:
    """Positions of the joints that are said [m], by their handles; CharacterError where the body has no such joint."""
    said, names = character.corrections, handle_names(handles.played)
    out = {}
    for name, point in ({} if said is None else said.joints).items():
        if name not in names:
            raise CharacterError(f"{character.name}: there is no joint {name} in this body; leave it out of its file")
        out[names.index(name)] = np.array(point, np.float64)
    return out


def moved_joints(said: dict[int, np.ndarray], positions: np.ndarray) -> np.ndarray:
    """Joints (K, 3) with those that are said; what ends a limb goes along with the joint before it."""
    out = positions.copy()
    for handle, point in said.items():
        out[handle] = point
    for handle, parent in enumerate(HANDLE_PARENTS):
        if handle not in HANDLE_PARENTS and parent in said and handle not in said:
            out[handle] += said[parent] - positions[parent]
    return out


def corrected_handles(character: Character, handles: Handles) -> Handles:
    """Handles as a person corrected them.

    Where a joint is moved, vertices whose bone becomes another one take their weights from the bones; all others keep
    theirs. A piece is then given to the handles of its kind. CharacterError if a joint is said that the body does not
    have.

    Args:
        character: The character; without corrections its handles stay as they are.
        handles: As they were found.
    """
    said = character.corrections
    if said is None or not said.changes_body:
        return handles
    joints = find_joints(character, handles)
    numbers = joint_numbers(character, handles)
    moved = moved_joints(numbers, joints.positions)
    weights = handles.weights.astype(np.float64)
    there = joints.present.copy()
    there[list(numbers)] = True
    if numbers and not handles.rigid and handles.roles is None:
        old = _shares(character, _bones(joints.positions, handles.positions, there))
        new = _shares(character, _bones(moved, handles.positions + (moved - joints.positions), there))
        change = np.minimum(np.abs(new - old).sum(axis=1, keepdims=True), 1)
        weights = (1 - change) * weights + change * new
    label, props = _labels(character, replace(handles, weights=_rows(weights))), np.zeros(len(weights), bool)
    pieces = [
        (piece.kind, _around(character, label, piece.at))
        for piece in said.part
        if piece.kind not in ("ground", *CLOTHES)
    ]
    for kind, rows in pieces:
        props |= rows if kind in ("prop", "accessory") else False
    for kind, rows in pieces:
        if kind in ("prop", "accessory"):
            weights[rows] = _carried(character, weights, rows, props)
        else:
            weights[rows] = _of_kind(character, weights, kind, rows, moved, handles)
    if handles.rigid:
        weights = np.eye(weights.shape[1])[weights.argmax(axis=1)]
    full = _rows(weights)
    return replace(handles, weights=full, positions=handle_positions(character.vertices, full, character.areas))


def _rows(weights: np.ndarray) -> np.ndarray:
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), np.float32)


def _bones(joints: np.ndarray, middles: np.ndarray, there: np.ndarray) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Handle, start and end [m] of each bone: to the joints below, or as far beyond the middle of its part."""
    out = []
    for handle in np.flatnonzero(there).tolist():
        below = [child for child in np.flatnonzero(there).tolist() if HANDLE_PARENTS[child] == handle]
        ends = [joints[child] for child in below] or [2 * middles[handle] - joints[handle]]
        out += [(handle, joints[handle], end) for end in ends]
    return out


def _shares(character: Character, bones: list[tuple[int, np.ndarray, np.ndarray]]) -> np.ndarray:
    """How much of each vertex each handle has by distances to bones, shape (V, K), rows sum to 1.

    A bone on the outer side of the surface is not the one within: an arm beside the trunk does not get the trunk.
    """
    points = character.vertices.astype(np.float64)
    normals = vertex_normals(points, character.faces)
    share = np.zeros((len(points), len(HANDLE_PARENTS)))
    least = 1e-3 * character.height
    for handle, start, end in bones:
        way = end - start
        along = np.clip((points - start) @ way / max(float(way @ way), 1e-12), 0, 1)
        to = start + along[:, None] * way - points
        distance = np.maximum(np.linalg.norm(to, axis=1), least)
        outside = np.maximum(np.einsum("vi,vi->v", to, normals) / distance, 0)
        share[:, handle] = np.maximum(share[:, handle], (distance * (1 + BEHIND * outside) / least) ** -SHARP)
    return np.asarray(share / share.sum(axis=1, keepdims=True))


def _contact(character: Character, rows: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Vertices among others (V,) that touch a piece (V,), or else are nearest to it, numbers."""
    candidates = np.flatnonzero(others & ~rows)
    if not len(candidates):
        return candidates
    gap = cKDTree(character.vertices[rows]).query(character.vertices[candidates])[0]
    return np.asarray(candidates[gap <= gap.min() + NEAR * character.height])


def _carried(character: Character, weights: np.ndarray, rows: np.ndarray, props: np.ndarray) -> np.ndarray:
    """One row of weights for what is carried: the handle that holds most of what it touches, shape (K,)."""
    touched = _contact(character, rows, character.surface & ~props)
    mean = weights[touched].mean(axis=0) if len(touched) else np.eye(1, weights.shape[1])[0]
    return np.asarray(np.eye(len(mean))[int(mean.argmax())])


def _of_kind(
    character: Character, weights: np.ndarray, kind: str, rows: np.ndarray, joints: np.ndarray, handles: Handles
) -> np.ndarray:
    """Weights of a piece as the handles of its kind hold it, shape (n, K)."""
    if kind == "hair":
        return np.tile(np.eye(1, weights.shape[1], HANDLE_INDEX["head"]), (int(rows.sum()), 1))
    middle, center = character.vertices[rows].mean(axis=0), handles.positions[0]
    side = "left" if middle[0] >= center[0] else "right"
    if kind == "leg" and not upright(handles) and middle[2] > center[2]:
        kind = "arm"  # the forelegs of an animal
    members = PARTS[kind if kind in PARTS else f"{side} {kind}"]
    already = weights[rows] * np.isin(handles.played, members)
    if already.sum() < 0.5 * rows.sum():  # most of it was taken for something else
        already = _along(character, rows, kind, members, joints, joint_numbers(character, handles))
    bare = already.sum(axis=1) < 1e-3
    if bare.any():
        near = cKDTree(character.vertices[rows][~bare]).query(character.vertices[rows][bare])[1]
        already[bare] = already[~bare][near]
    return np.asarray(already / already.sum(axis=1, keepdims=True))


def _along(
    character: Character, rows: np.ndarray, kind: str, members: list[int], joints: np.ndarray,
    said: dict[int, np.ndarray],
) -> np.ndarray:  # fmt: skip
    """Weights of a piece that becomes a limb, whose joints lie along it as the reference body's do, shape (n, K)."""
    at = joints.copy()
    if kind not in ("body", "head"):
        members = [handle for handle in members if not HANDLE_NAMES[handle].endswith("collar")]
        points = character.vertices[rows].astype(np.float64)
        touched = _contact(character, rows, character.surface)
        start = character.vertices[touched].mean(axis=0) if len(touched) else points[points[:, 1].argmax()]
        far = points[int(np.linalg.norm(points - start, axis=1).argmax())]
        steps = np.linalg.norm(np.diff(reference_body().handles.positions[members], axis=0), axis=1)
        reached = np.concatenate([[0.0], np.cumsum(steps)]) / (steps.sum() + steps[-1:].sum() + 1e-9)
        at[members] = start + reached[:, None] * (far - start)
        at[[handle for handle in members if handle in said]] = [said[handle] for handle in members if handle in said]
    return _shares(character, _bones(at, at, np.isin(np.arange(len(at)), members)))[rows]
