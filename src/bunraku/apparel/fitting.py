"""Clothed characters of meshes that say nothing of apparel: what carries each part, and the rig in which that holds
it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.nodes import apparel_parts, held_vertices, whole_pieces
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_PARENTS, JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.character import Character, Handles, Rig
from bunraku.core.geometry.axes import directions_about, goes_round
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.graph import clean_mesh, unique_edges

__all__ = [
    "carried", "eased_border", "fitted_clothes", "fitted_rig", "joint_weights_of_handles", "joints_of_handles",
    "without_worn",
]  # fmt: skip

_HIPS = tuple(JOINT_NAMES.index(name) for name in ("left_hip", "right_hip"))
_ABOVE_COLLARS = tuple(JOINT_NAMES.index(name) for name in ("left_collar", "right_collar"))
_ARMS = [JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("shoulder", "elbow", "wrist")]
BESIDE = 0.1  # of a part: what arms hold so little of hangs on no arm, however near one is
_LIMBS = [
    [JOINT_NAMES.index(f"{side}_{part}") for part in parts]
    for side in ("left", "right")
    for parts in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
]
WORN = 0.9  # of a part: one of which a limb holds so much is carried by it
_SMALL = 0.002  # of the apparel's vertices: parts with fewer stay with the body
SPECK = 0.045  # of the height: what is no longer than this stays with the body
_NEAR = 12
LAYER = 0.04  # of the size [m]: how far two layers of a skirt are from each other at the most
MOSTLY = 0.5  # share of a part that must lie so near another
BORDER = 0.04  # of the size: how far from the body of the same sheet apparel still goes with it in part


def joint_weights_of_handles(handles: Handles) -> np.ndarray:
    """Weights of the 22 joints, those of the other handles added to the joint that they hang on, shape (V, 22)."""
    out = np.array(handles.weights[:, :HANDLE_COUNT], np.float32)
    for handle in range(HANDLE_COUNT - 1, JOINT_COUNT - 1, -1):
        out[:, HANDLE_PARENTS[handle]] += out[:, handle]
    return np.ascontiguousarray(out[:, :JOINT_COUNT])


def joints_of_handles(
    vertices: np.ndarray, weights: np.ndarray, areas: np.ndarray, positions: np.ndarray
) -> np.ndarray:
    """Where the joints are that the handles turn about [m], shape (22, 3): in the middle of the skin that a handle
    shares with the one above it; the pelvis is its handle.

    Args:
        vertices: Rest mesh [m], shape (V, 3).
        weights: Of the 22 joints, shape (V, 22).
        areas: Of the vertices, shape (V,).
        positions: Of the handles, taken where two share nothing, shape (22 or more, 3).
    """
    out = np.array(positions[:JOINT_COUNT], np.float64)
    for joint in range(1, JOINT_COUNT):
        mass = weights[:, joint] * weights[:, JOINT_PARENTS[joint]] * areas
        if mass.sum() > 1e-4 * areas.sum():
            out[joint] = mass @ vertices / mass.sum()
    return out


def fitted_clothes(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, weights: np.ndarray, apparel: np.ndarray,
    stiffness: np.ndarray, damping: np.ndarray,
) -> ClothedCharacter:  # fmt: skip
    """A clothed character whose apparel goes whole with the joint that its parts hang on, whatever its skin says.

    Args:
        vertices, faces, joints: As of `ClothedCharacter`.
        weights: Of the body for the 22 joints, shape (V, 22).
        apparel: The mask, shape (V,), bool.
        stiffness, damping: Of each vertex, shape (V,).
    """
    apparel = _without_specks(vertices, faces, apparel, SPECK * float(np.ptp(vertices[:, 1])))
    part = apparel_parts(vertices, faces, apparel)
    count = int(part.max(initial=-1)) + 1
    blank = np.zeros(count, np.float32)
    bare = ClothedCharacter(vertices, faces, joints, weights, apparel, part, blank, blank)
    held = held_vertices(bare)
    out = np.array(weights, np.float32)
    body = np.flatnonzero(~apparel)
    tree = cKDTree(vertices[body]) if len(body) else None
    inner, outer = _joined(bare)
    for number in range(count):
        rows = np.flatnonzero(part == number)
        own = held[part[held] == number]
        sewn = outer[part[inner] == number]
        if len(sewn):  # it goes on as the body on the same surface: hair beside an arm as the hair above it
            share = weights[sewn].mean(axis=0)
        elif tree is None or not len(own):
            share = weights[rows].mean(axis=0)
        else:
            near = body[tree.query(vertices[own], min(_NEAR, len(body)))[1].reshape(-1)]
            share = weights[near].mean(axis=0)
            if weights[rows][:, _ARMS].sum(axis=1).mean() < BESIDE:  # a knot at the hip lies beside a hand
                share[_ARMS] = 0
        out[rows] = np.eye(JOINT_COUNT, dtype=np.float32)[_carrying(share)]
    part = _layers_as_one(bare, out)
    count = int(part.max(initial=-1)) + 1

    def mean(values: np.ndarray) -> np.ndarray:
        total = np.bincount(part[apparel], values[apparel], count) / np.maximum(np.bincount(part[apparel]), 1)
        return np.asarray(total, np.float32)

    if not count:
        return bare
    return ClothedCharacter(vertices, faces, joints, out, apparel, part, mean(stiffness), mean(damping))


def without_worn(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, weights: np.ndarray, apparel: np.ndarray
) -> np.ndarray:
    """A mask without what a limb wears: what a limb holds and goes round it, on a part that goes on beyond it, is a
    sleeve or a leg of trousers. On the joint that carries the rest it would stay behind.

    Args:
        vertices, faces, joints: As of `ClothedCharacter`.
        weights: Of the body for the 22 joints, shape (V, 22).
        apparel: What a network found, shape (V,), bool.
    """
    out = np.array(apparel)
    part = apparel_parts(vertices, faces, apparel)
    for limb in _LIMBS:
        held = weights[:, limb].sum(axis=1)
        angle = directions_about(vertices, joints[limb[0]], joints[limb[-1]])
        for number in np.unique(part[apparel & (held > MOSTLY)]):
            rows = np.flatnonzero(part == number)
            mine = rows[held[rows] > MOSTLY]
            if goes_round(angle[mine]) and held[rows].mean() < WORN:
                out[mine] = False
    return out


def _joined(clothed: ClothedCharacter) -> tuple[np.ndarray, np.ndarray]:
    """Apparel vertices, and vertices of the body that an edge of the surface joins each to, both shape (E,)."""
    clean = clean_mesh(clothed.rest, clothed.faces)
    first = np.unique(clean.index, return_index=True)[1]
    edges = first[unique_edges(clean.faces, len(clean.vertices))]
    edges = np.concatenate([edges, edges[:, ::-1]])
    cloth = clothed.part >= 0
    edges = edges[cloth[edges[:, 0]] & ~cloth[edges[:, 1]]]
    return edges[:, 0], edges[:, 1]


def _layers_as_one(clothed: ClothedCharacter, weights: np.ndarray) -> np.ndarray:
    """The parts, those that hang from the pelvis and lie on one another as one, shape (V,): two layers of a skirt that
    moved each for itself would come through one another.
    """
    part = np.array(clothed.part)
    count = int(part.max(initial=-1)) + 1
    near = LAYER * clothed.scale
    rows = [np.flatnonzero(part == number) for number in range(count)]
    hung = [number for number in range(count) if weights[rows[number][0]].argmax() == 0]
    trees = {number: cKDTree(clothed.rest[rows[number]]) for number in hung}
    one = np.arange(count)
    for number in sorted(hung, key=lambda number: len(rows[number])):
        points = clothed.rest[rows[number]]
        for other in hung:
            if one[other] != one[number]:
                gap = trees[other].query(points, distance_upper_bound=near)[0]
                if np.isfinite(gap).mean() > MOSTLY:
                    one[one == one[number]] = one[other]
    cloth = part >= 0
    part[cloth] = np.unique(one[part[cloth]], return_inverse=True)[1]
    return part


def eased_border(clothed: ClothedCharacter) -> np.ndarray:
    """How far each vertex goes its own way, from 0 on the body and where apparel begins in the midst of a sheet to 1,
    shape (V,): what is one surface must not be torn where the mask has an edge.
    """
    clean = clean_mesh(clothed.rest, clothed.faces)
    cloth = np.zeros(len(clean.vertices), bool)
    cloth[clean.index[clothed.part >= 0]] = True
    edges = unique_edges(clean.faces, len(clean.vertices))
    edges = edges[cloth[edges[:, 0]] != cloth[edges[:, 1]]]
    out = (clothed.part >= 0).astype(np.float32)
    if len(edges):
        body = np.unique(np.where(cloth[edges[:, 0]], edges[:, 1], edges[:, 0]))
        away = cKDTree(clean.vertices[body] * clean.scale + clean.center).query(clothed.rest)[0]
        out *= smooth_step(away / clothed.scale, 0.0, BORDER).astype(np.float32)
    return out


def _carrying(share: np.ndarray) -> int:
    """The joint that holds what is held by so much of each: what both legs hold hangs on the pelvis, what both collars
    hold on the chest.
    """
    joint = int(share.argmax())
    for pair, above in ((_HIPS, 0), (_ABOVE_COLLARS, JOINT_NAMES.index("spine3"))):
        if joint in pair and share[list(pair)].min() > 0.25 * share[list(pair)].max():
            return above
    return joint


def _without_specks(vertices: np.ndarray, faces: np.ndarray, apparel: np.ndarray, least: float) -> np.ndarray:
    """The mask without parts of few vertices, and without those too short to swing: eyes, bolts and buttons."""
    part = apparel_parts(vertices, faces, apparel)
    sizes = np.bincount(part[apparel], minlength=1)
    small = sizes < max(4, _SMALL * apparel.sum())
    for number in np.flatnonzero(~small):
        small[number] = np.linalg.norm(np.ptp(vertices[part == number], axis=0)) < least
    out = apparel.copy()
    out[apparel] = ~small[part[apparel]]
    return out


def fitted_rig(character: Character, clothed: ClothedCharacter, bones: np.ndarray) -> Character:
    """The character with apparel on the bone of the joint that carries it: hair that lies on an arm goes with the head.
    Where apparel begins in the midst of a sheet, its skin passes over to that bone smoothly, so that nothing is torn.

    Args:
        character: With a rig.
        clothed: The same mesh, its parts whole on one joint each.
        bones: The bone of the rig that each of the 22 joints is, shape (22,).
    """
    rig = character.rig
    assert rig is not None
    share, joint = carried(clothed)
    carrier = np.asarray(bones)[joint][:, None].astype(np.int32)
    grown = Rig(
        rig.names, rig.parents, rig.transforms, np.concatenate([rig.indices, carrier], axis=1),
        np.concatenate([rig.weights * (1 - share[:, None]), share[:, None]], axis=1),
    )  # fmt: skip
    return replace(character, rig=grown)


def carried(clothed: ClothedCharacter) -> tuple[np.ndarray, np.ndarray]:
    """How much of each vertex goes with a joint whatever its skin said, shape (V,), and with which, shape (V,): apparel
    with what carries its part, and the rest of a loose piece that is mostly apparel with the same.
    """
    share, joint = eased_border(clothed), clothed.weights.argmax(axis=1)
    piece = whole_pieces(clothed.rest, clothed.faces, clothed.apparel)
    rows = np.flatnonzero(piece >= 0)
    if len(rows):
        votes = np.zeros((int(piece.max()) + 1, JOINT_COUNT))
        marked = rows[clothed.apparel[rows]]
        np.add.at(votes, (piece[marked], joint[marked]), 1)
        share, joint = np.array(share), np.array(joint)
        share[rows], joint[rows] = 1.0, votes.argmax(axis=1)[piece[rows]]
    return share, joint
