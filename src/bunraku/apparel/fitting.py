"""Clothed characters of meshes that say nothing of apparel: the carrier of each part, and the rig for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from bunraku.apparel.clothed import BESIDE, NORMAL_DAMPING, NORMAL_STIFFNESS, SOFTEST, STIFFEST, ClothedCharacter
from bunraku.apparel.nodes import NEIGHBOURS, apparel_parts, held_vertices, whole_pieces
from bunraku.apparel.part_network import CARRIERS, PARTS
from bunraku.apparel.parts import HANGING, Parts, carried_by
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_PARENTS, JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS, sided
from bunraku.core.character import Character, Handles, Rig
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.graph import clean_mesh, unique_edges

SPECK = 0.045  # of the height: what is no longer than this stays with the body; chosen by eye
_HIPS, _COLLARS = sided("hip"), sided("collar")
_HEAD, _WAIST = (tuple(JOINT_NAMES.index(name) for name in names) for names in (("head", "neck"), ("pelvis", "spine1")))


def joint_weights_of_handles(handles: Handles) -> np.ndarray:
    """Weights of the 22 joints, those of the other handles added to the joint that they hang on, shape (V, 22)."""
    out = np.array(handles.weights[:, :HANDLE_COUNT], np.float32)
    for handle in range(HANDLE_COUNT - 1, JOINT_COUNT - 1, -1):
        out[:, HANDLE_PARENTS[handle]] += out[:, handle]
    return np.ascontiguousarray(out[:, :JOINT_COUNT])


def joints_of_handles(
    vertices: np.ndarray, weights: np.ndarray, areas: np.ndarray, positions: np.ndarray
) -> np.ndarray:
    """Joints that the handles rotate about [m], shape (22, 3): in the middle of the skin that a handle shares with the
    one above it, by weights of the joints (V, 22) and areas (V,), or at the handle where two share nothing; the pelvis
    is its handle.
    """
    out = np.array(positions[:JOINT_COUNT], np.float64)
    for joint in range(1, JOINT_COUNT):
        mass = weights[:, joint] * weights[:, JOINT_PARENTS[joint]] * areas
        if mass.sum() > 1e-4 * areas.sum():
            out[joint] = mass @ vertices / mass.sum()
    return out


def fitted_clothes(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, weights: np.ndarray, apparel: np.ndarray,
    parts: Parts | None = None, dial: float = 1.0,
) -> ClothedCharacter:  # fmt: skip
    """A clothed character whose apparel goes as a whole with the joint that its parts hang on, whatever its skin says.

    Args:
        vertices, faces, joints: As of `ClothedCharacter`.
        weights: Of the body, shape (V, 22).
        apparel: The mask, shape (V,), bool.
        parts: What the vertices are of, and what carries them; None where that is not known.
        dial: Factor on how stiff apparel is.
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
    carriers = np.full(len(vertices), -1) if parts is None else parts.carrier
    for number in range(count):
        rows = np.flatnonzero(part == number)
        roots = held[part[held] == number]
        sewn = outer[part[inner] == number]
        if len(sewn):  # it goes on as the body on the same surface: hair beside an arm as the hair above it
            share = weights[sewn].mean(axis=0)
        elif tree is None or not len(roots):
            share = weights[rows].mean(axis=0)
        else:
            near = body[tree.query(vertices[roots], min(NEIGHBOURS, len(body)))[1].reshape(-1)]
            share = weights[near].mean(axis=0)
        said = carriers[rows[carriers[rows] >= 0]]
        carrier = int(np.bincount(said).argmax()) if len(said) else -1
        out[rows] = np.eye(JOINT_COUNT, dtype=np.float32)[_carrying(share, carrier)]
    if not count:
        return bare
    flat = np.ones(count, np.float32)
    stiffness = np.clip(NORMAL_STIFFNESS + np.log10(dial), SOFTEST, STIFFEST) * flat
    clothed = ClothedCharacter(vertices, faces, joints, out, apparel, part, stiffness, NORMAL_DAMPING * flat)
    return clothed if parts is None else _skirts_as_one(replace(clothed, kinds=kinds_of(clothed, parts.label)))


def kinds_of(clothed: ClothedCharacter, labels: np.ndarray) -> tuple[str, ...]:
    """Kind of each part of a character's apparel (`chains.chain.KINDS`) by labels of its vertices, shape (V,)."""
    kinds = []
    for number in range(len(clothed.stiffness)):
        rows = np.flatnonzero(clothed.part == number)
        counts = np.bincount(labels[rows], minlength=len(PARTS))[list(HANGING)]
        kind = PARTS[HANGING[int(counts.argmax())]] if counts.any() else "ribbon"
        on_head = len(rows) and clothed.weights[rows[0]].argmax() in _HEAD
        kinds.append("ear" if kind == "tail" and on_head else kind)
    return tuple(kinds)


def _joined(clothed: ClothedCharacter) -> tuple[np.ndarray, np.ndarray]:
    """Apparel vertices, and vertices of the body that an edge of the surface joins each to, both shape (E,)."""
    clean = clean_mesh(clothed.rest, clothed.faces)
    first = np.unique(clean.index, return_index=True)[1]
    edges = first[unique_edges(clean.faces, len(clean.vertices))]
    edges = np.concatenate([edges, edges[:, ::-1]])
    cloth = clothed.part >= 0
    edges = edges[cloth[edges[:, 0]] & ~cloth[edges[:, 1]]]
    return edges[:, 0], edges[:, 1]


def _skirts_as_one(clothed: ClothedCharacter) -> ClothedCharacter:
    """The same with all skirts that hang from the hips as one part on the pelvis: layers that moved independently would
    come through one another.
    """
    weights, number = np.array(clothed.weights), np.arange(len(clothed.kinds))
    skirts = [
        part for part, kind in enumerate(clothed.kinds)
        if kind == "skirt" and weights[clothed.part == part][0].argmax() in _WAIST
    ]  # fmt: skip
    number[skirts] = min(skirts, default=0)
    weights[np.isin(clothed.part, skirts)] = np.eye(JOINT_COUNT, dtype=np.float32)[0]
    kept, number = np.unique(number, return_inverse=True)
    part = np.where(clothed.part >= 0, number[clothed.part], -1)
    return replace(
        clothed, part=part, stiffness=clothed.stiffness[kept], damping=clothed.damping[kept], limit=clothed.limit[kept],
        kinds=tuple(clothed.kinds[one] for one in kept), weights=weights,
    )  # fmt: skip


def eased_border(clothed: ClothedCharacter) -> np.ndarray:
    """How far each vertex moves freely, shape (V,): 0 on the body and where apparel begins within a sheet, rising to 1.
    One surface must not be torn at the edge of the mask.
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
        out *= smooth_step(away / clothed.scale, 0.0, BESIDE).astype(np.float32)
    return out


def _carrying(share: np.ndarray, carrier: int) -> int:
    """The joint that carries a part by the joints' shares, of those of its carrier where that is known: the pelvis for
    both legs, the chest for both collars.
    """
    joint = int(share.argmax()) if carrier < 0 else carried_by(CARRIERS[carrier], share)
    for pair, above in ((_HIPS, 0), (_COLLARS, JOINT_NAMES.index("spine3"))):
        if joint in pair and share[list(pair)].min() > 0.25 * share[list(pair)].max():
            return above
    return joint


def _without_specks(vertices: np.ndarray, faces: np.ndarray, apparel: np.ndarray, least: float) -> np.ndarray:
    """The mask without parts of few vertices, and without those too short to swing: eyes, bolts and buttons."""
    part = apparel_parts(vertices, faces, apparel)
    sizes = np.bincount(part[apparel], minlength=1)
    small = sizes < 4
    for number in np.flatnonzero(~small):
        small[number] = np.linalg.norm(np.ptp(vertices[part == number], axis=0)) < least
    out = apparel.copy()
    out[apparel] = ~small[part[apparel]]
    return out


def fitted_rig(character: Character, clothed: ClothedCharacter, bones: np.ndarray) -> Character:
    """The character with apparel on the bone of the joint that carries it, by the bone of each of the 22 joints: hair
    that lies on an arm goes with the head. Where apparel begins within a sheet, its skin blends into that bone, so that
    nothing is torn.
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
    """How much of each vertex goes with a joint whatever its skin said, shape (V,), and that joint, shape (V,): apparel
    with the carrier of its part, and the rest of a loose piece that is mostly apparel with the same.
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
