"""Chains of a rig whose file says nothing of physics: bones of hair, skirts and the like that are not part of the body.

Names decide first (`apparel_of_name`). Where they are silent, shape decides: a bone below the body that no part of the
body needs and that holds the end of something, a strand or an edge, and not a piece within a limb, as bones for twists
and muscles do, or within the head, as eyes do.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bunraku.anatomy.names.bone_names import NO_HANDLE
from bunraku.anatomy.names.bone_words import apparel_of_name, part_of_name, without_prefix
from bunraku.apparel.chains.chain import Chain, parameters_beside, parameters_of, with_parameters
from bunraku.core.animation import bone_order
from bunraku.core.body.layout import HANDLE_NAMES, HANDLE_PARENTS, HEAD, sided
from bunraku.core.character import Character, Rig
from bunraku.core.geometry.graph import clean_mesh
from bunraku.retarget.rig_parts import RigParts, understood_rig

_SPARE = tuple(HANDLE_NAMES.index(name) for name in ("head_top", "tail", "tail_tip", "left_wing", "right_wing", "face"))
"""Handles of what many characters have beside a body; on a person they are apparel where names say so."""
_ENDS = sided("wrist", "fingers", "ankle", "foot")  # parts whose own bones hang on them like strands: fingers and toes
_BODY = ("wrist", "elbow", "shoulder", "collar", "leg", "foot", "hips", "spine", "neck", "head", "arm_leg")
"""Kinds of bones of the body; bones with such a name hang on it and do not swing."""
_TRUNK = tuple(HANDLE_NAMES.index(name) for name in ("pelvis", "spine1", "spine2", "spine3"))
_SILENT = ("none", "held", "face", "face_bone", "fingers", "toe")
"""Kinds of bones that move otherwise, whatever their shape, as do all bones above and below them."""
_FACE = re.compile(
    r"lid\b|lid[._]|forehead|temple|teeth|gums?\b|breast|boob|\bbust|jiggle|muscle|twist|helper|corrective"
)

# Chosen on characters of the wardrobe and on the twelve files of benchmarks/apparel_files.md;
# benchmarks/apparel_bones.py counts chains.
OWN = 0.85  # weight of a vertex from which on it is not the body's
TOUCHES = 0.5  # largest share of the vertices of a silent bone that have edges to others
FEWEST = 3  # vertices that a silent bone holds at least
LIGHTEST = 1.0  # sum of the weights of a bone that holds anything
OFF_CENTRE = 0.3  # distance of its middle from the bone that it hangs on, over its extent
AROUND = 0.4  # length of the mean direction from a limb's axis below which a bone's vertices lie on all sides of it
LEAST = 0.018  # least size of what silent bones hold, over the height
FORWARD = 0.7  # how far before the head its single bones may hold something, over the distance
ROW = 4  # silent bones that hang side by side on one bone of the trunk: so many are the hem of a skirt
SHORTEST = 5e-3  # of a link, over the height, since files have any unit; chosen by eye


@dataclass(frozen=True, eq=False)
class _Held:
    """What each bone holds."""

    bone: np.ndarray  # the bone that holds most of each vertex, shape (V,)
    free: np.ndarray  # the share of each vertex that no bone of the body holds, shape (V,)
    mass: np.ndarray  # sum of the weights of each bone, shape (J,)
    rim: np.ndarray  # vertices at an open edge of the surface, shape (V,), bool
    # between points of the surface, shape (E, 2), and the point of each vertex, shape (V,)
    edges: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, character: Character, rig: Rig, body: np.ndarray) -> _Held:
        most = rig.weights.argmax(axis=1)
        mass = np.bincount(rig.indices.ravel(), rig.weights.ravel(), minlength=len(rig.names))
        free = 1 - (rig.weights * body[rig.indices]).sum(axis=1)
        clean = clean_mesh(character.vertices, character.faces)
        faces = np.asarray(clean.faces, np.int64)
        sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        edges, counts = np.unique(sides, axis=0, return_counts=True)
        rim = np.zeros(len(clean.vertices), bool)
        rim[edges[counts == 1].ravel()] = True
        return cls(rig.indices[np.arange(len(most)), most], free, mass, rim[clean.index], (edges, clean.index))

    def touches(self, vertices: np.ndarray) -> float:
        """The share of vertices that have an edge to others."""
        edges, index = self.edges
        mine = np.zeros(int(index.max()) + 1, bool)
        mine[index[vertices]] = True
        mixed = edges[mine[edges[:, 0]] != mine[edges[:, 1]]]
        seam = np.unique(mixed[mine[mixed]]) if len(mixed) else np.zeros(0)
        return len(seam) / max(int(mine.sum()), 1)


def apparel_bones(character: Character, parts: RigParts | None = None) -> dict[int, str]:
    """The bones of a person's rig that hold apparel, each with its kind; none where the rig is not a person's."""
    rig = character.rig
    parts = parts or understood_rig(character)
    if rig is None or parts is None or not parts.humanoid:
        return {}
    body = _body_bones(parts)
    held = _Held.of(character, rig, body)
    below = _below(rig.parents)
    names = without_prefix(rig.names)
    out: dict[int, str] = {}
    for bone in bone_order(rig.parents):
        parent = int(rig.parents[bone])
        if body[bone] or parent < 0:
            continue
        kind = apparel_of_name(names[bone])
        if parent in out:
            out[bone] = kind or out[parent]
        elif kind or _silent(character, parts, held, bone, below[bone], body, names):
            above = _above(parts, bone, np.ones(len(body), bool))
            out[bone] = kind or ("hair" if above >= 0 and parts.parts[above] == HEAD else "strand")
    return {bone: kind for bone, kind in out.items() if held.mass[[bone, *below[bone]]].sum() > LIGHTEST}


def bone_chains(character: Character, stiffness: float = 1.0, gravity: float = 1.0) -> list[Chain]:
    """The chains of a person's rig, each after the one that it branches off from, with factors on stiffness and
    gravity. FormatError if the file of parameters beside the character's is broken.
    """
    rig = character.rig
    kinds = apparel_bones(character)
    if rig is None or not kinds:
        return []
    held = _Held.of(character, rig, np.zeros(len(rig.names), bool))
    height = character.height
    children: dict[int, list[int]] = {}
    for bone in kinds:
        children.setdefault(int(rig.parents[bone]), []).append(bone)
    mass = np.array(held.mass)
    for bone in reversed(bone_order(rig.parents)):
        if rig.parents[bone] >= 0:
            mass[rig.parents[bone]] += mass[bone]
    tops = [bone for bone in kinds if int(rig.parents[bone]) not in kinds]
    out = []
    while tops:
        line, after = [], [tops.pop(0)]
        while after:
            tops += after[1:]
            line.append(after[0])
            after = sorted(children.get(line[-1], ()), key=lambda bone: -mass[bone])
            after = [bone for bone in after if mass[bone] > 0]
        chain = _chain(character, rig, held, line, kinds[line[0]], height)
        if chain is not None:
            out.append(chain)
    chains = with_parameters(out, parameters_beside(character))
    return [replace(chain, parameters=chain.parameters.turned(stiffness, gravity)) for chain in chains]


def _body_bones(parts: RigParts) -> np.ndarray:
    """Bones of the body, and all above one, shape (J,), bool."""
    rig = parts.character.rig
    assert rig is not None
    out = np.array([part != NO_HANDLE and part not in _SPARE for part in parts.parts])
    leads = set(parts.leads.tolist())
    for bone, name in enumerate(without_prefix(rig.names)):
        # what a map takes along with the head, without a word for it, may be hair
        named = bone in leads or part_of_name(name)[0] not in ("", "root")
        out[bone] &= named and not apparel_of_name(name)
    for bone in reversed(bone_order(rig.parents)):
        if out[bone] and rig.parents[bone] >= 0:
            out[rig.parents[bone]] = True
    return out


def _below(parents: np.ndarray) -> list[list[int]]:
    out: list[list[int]] = [[] for _ in parents]
    for bone in reversed(bone_order(parents)):
        if parents[bone] >= 0:
            out[parents[bone]] += [bone, *out[bone]]
    return out


def _silent(
    character: Character, parts: RigParts, held: _Held, bone: int, below: list[int], body: np.ndarray,
    names: Sequence[str],
) -> bool:  # fmt: skip
    """Whether a bone with a silent name, and those below it, hold the end of something that hangs."""
    rig = character.rig
    assert rig is not None
    kind, _, _, target = part_of_name(names[bone])
    part = int(parts.parts[bone])
    if target or (part in _SPARE and kind) or body[below].any() or _of_body(names[bone]):
        return False
    around = [names[one] for one in (bone, *below, *(one for one in _line_up(rig.parents, bone) if not body[one]))]
    if any(part_of_name(name)[0] in _SILENT or _FACE.search(name.lower()) for name in around):
        return False
    above = _above(parts, bone, body)
    carried = int(parts.parts[above]) if above >= 0 else 0
    if carried in _ENDS:
        return False
    mine = np.flatnonzero(np.isin(held.bone, [bone, *below]))
    if len(mine) < FEWEST or not (held.free[mine] > OWN).any():
        return False
    points = character.vertices[mine].astype(float)
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    if extent < LEAST * character.height:
        return False
    away = points.mean(axis=0) - rig.positions[bone]
    links = sum(held.mass[one] > LIGHTEST for one in [bone, *below])
    if links < 2 and np.linalg.norm(away) < OFF_CENTRE * 0.5 * extent:  # a piece about its bone: an eye, a muscle
        return False
    if carried == HEAD and links < 2 and away[2] > FORWARD * np.linalg.norm(away):  # eyes and brows lie before theirs
        return False
    if carried != HEAD and _surrounds(parts, above, carried, points):
        return False
    # a strand ends in the air: what it holds has an edge of its own, or touches the body at few points
    if links > 1 or bool(held.rim[mine].any()) or held.touches(mine) < TOUCHES:
        return True
    beside = (rig.parents == rig.parents[bone]) & ~body & (held.mass > LIGHTEST)
    return carried in _TRUNK and int(beside.sum()) >= ROW


def _of_body(name: str) -> bool:
    """Whether a word of a name is one of the body's: `leg_scale.L`, `Head_End`."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name.split(":")[-1].split("|")[-1])
    return any(part_of_name(word)[0] in _BODY for word in words) or part_of_name(name)[0] in _BODY


def _line_up(parents: np.ndarray, bone: int) -> list[int]:
    out: list[int] = []
    while parents[bone] >= 0 and parents[bone] not in out:
        bone = int(parents[bone])
        out.append(bone)
    return out


def _above(parts: RigParts, bone: int, chosen: np.ndarray) -> int:
    """The nearest bone above one that has a handle and is chosen, shape (J,), bool; -1 for none."""
    above = int(parts.parents[bone])
    while above >= 0 and (not chosen[above] or parts.parts[above] == NO_HANDLE):
        above = int(parts.parents[above])
    return above


def _surrounds(parts: RigParts, above: int, carried: int, points: np.ndarray) -> bool:
    """Whether points lie on all sides of the limb or trunk that carries them, as helpers for twists do."""
    rig = parts.character.rig
    assert rig is not None
    after = [int(parts.leads[child]) for child, parent in enumerate(HANDLE_PARENTS) if parent == carried]
    ends = [rig.positions[lead] for lead in after if lead >= 0]
    if above < 0 or not ends:
        return False
    start = rig.positions[above]
    axis = np.mean(ends, axis=0) - start
    length = float(np.linalg.norm(axis))
    if length < 1e-6:
        return False
    axis /= length
    gap = points - start
    gap = gap - (gap @ axis)[:, None] * axis
    sides = gap / np.maximum(np.linalg.norm(gap, axis=1, keepdims=True), 1e-9)
    return float(np.linalg.norm(sides.mean(axis=0))) < AROUND


def _chain(character: Character, rig: Rig, held: _Held, line: list[int], kind: str, height: float) -> Chain | None:
    """A chain of bones; those at its end that hold most of no vertex go with the last that does."""
    while len(line) > 1 and not (held.bone == line[-1]).any():
        line = line[:-1]
    bones, starts = [line[0]], [rig.positions[line[0]]]
    for bone in line[1:]:
        if np.linalg.norm(rig.positions[bone] - starts[-1]) > SHORTEST * height:
            bones.append(bone)
            starts.append(rig.positions[bone])
    points = character.vertices.astype(float)
    last = np.flatnonzero(held.bone == bones[-1])
    if not len(last):
        return None
    away = points[last] - starts[-1]
    middle = away.mean(axis=0)
    if len(starts) > 1 and np.linalg.norm(middle) < 0.2 * np.linalg.norm(starts[-1] - starts[-2]):
        middle = starts[-1] - starts[-2]
    direction = middle / max(float(np.linalg.norm(middle)), 1e-9)
    reach = float(np.percentile(away @ direction, 95))
    if reach < SHORTEST * height:
        direction, reach = np.array([0.0, -1, 0]), 0.02 * height
    nodes = np.array([*starts, starts[-1] + reach * direction])
    width = np.full(len(bones), 0.02 * height)
    for number, bone in enumerate(bones):
        mine = np.flatnonzero(held.bone == bone)
        if len(mine) >= FEWEST:
            along = nodes[number + 1] - nodes[number]
            along /= max(float(np.linalg.norm(along)), 1e-9)
            gap = points[mine] - nodes[number]
            gap -= (gap @ along)[:, None] * along
            width[number] = np.median(np.linalg.norm(gap, axis=1))
    width = np.clip(width, 0.005 * height, 0.08 * height)
    return Chain(
        rig.names[line[0]], kind, np.array(bones, np.int64), nodes, int(rig.parents[line[0]]), width,
        float(np.clip(np.median(width) / 2, 0.004 * height, 0.015 * height)), parameters_of(kind),
    )  # fmt: skip
