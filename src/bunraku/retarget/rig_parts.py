"""What the bones of a rig are: which of the 30 handles each one moves, and where the rig's own joints are.

A rig tells joints exactly where skinning weights only imply them, so limbs are turned all the way from where they rest
to where the reference body's rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.handles.limbs import ARMS, LEGS, SIDES
from bunraku.anatomy.joints import PRESENT, Joints, reference_joints
from bunraku.anatomy.names.bone_names import NO_HANDLE, handle_of_joints, limb_parents, resolve_joints, rig_handles
from bunraku.anatomy.names.bone_words import part_of_name, without_prefix
from bunraku.anatomy.names.skeleton_map import joints_by_structure, mmd_centre, mmd_skeleton_map
from bunraku.anatomy.rest_pose import flat_feet, rest_rotations, upright
from bunraku.anatomy.rig_limbs import STUB, four_legs_of_rig, legs_of_rig
from bunraku.core.animation import bone_order
from bunraku.core.avatars import MmdModel, mmd_model, vrm_model
from bunraku.core.body.layout import BESIDE, HANDLE_COUNT, HANDLE_MIRROR, HANDLE_NAMES, HANDLE_PARENTS, WRISTS
from bunraku.core.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles, Rig
from bunraku.core.geometry.rotations import rotation_between
from bunraku.core.motion import Skeleton, line_up
from bunraku.errors import CharacterError
from bunraku.files import Source, clips_rise


def _both(*parts: str) -> list[int]:
    return [HANDLE_NAMES.index(f"{side}_{part}") for part in parts for side in SIDES]


HUMANOID = (0, *_both("hip", "knee", "shoulder", "elbow"))
"""Parts that a rig must have to take a person's motion bone by bone."""
_WINGED = (0, *_both("hip", "knee", "wing"))
"""Parts that a bird's rig must have."""
_VRM = {
    "hips": "pelvis", "spine": "spine1", "chest": "spine2", "upperChest": "spine3", "neck": "neck", "head": "head",
    "jaw": "face", "Shoulder": "collar", "UpperArm": "shoulder", "LowerArm": "elbow", "Hand": "wrist",
    "UpperLeg": "hip", "LowerLeg": "knee", "Foot": "ankle", "Toes": "foot",
}  # fmt: skip
OWN_BONES = 0.3
"""Share of a limb on bones that hold more of it than of all else. Measured on 40 animals: some fish bend in their last
third, and rigs without legs hold none of those of the mesh.
"""
BODY = 0.9  # share of the skin that is below the bone on which a body hangs; chosen by eye on a rig with targets
NEAR_LIMB = 0.05  # how near to the skin of a limb that is which begins where it ends, over the height; likewise
MIRRORED = 0.05  # how far the skin of a bone is from the mirror image of another's, over the height; chosen by eye
NEAR_HEAD = 0.1
"""A joint is at the head of its bone where that is so near, over the height. Chosen by eye."""
LEVEL, KNEE_UP = 0.2, (0.7, -1.2)
"""A leg of many that falls by less over its reach rests level; how much its parts rise then. By eye on two spiders."""
FEWEST_PARTS = 3  # parts that the bones of a body move
_WINGS, _TAIL = [[wing] for wing in _both("wing")], [HANDLE_NAMES.index(name) for name in ("tail", "tail_tip")]
_TRUNK = [HANDLE_NAMES.index(name) for name in ("pelvis", "spine1", "spine2", "spine3")]
_HIPS, _FEET = tuple(_both("hip")), tuple(_both("ankle", "foot"))


@dataclass(frozen=True, eq=False)
class RigParts:
    """The bones of a character's rig as parts of the reference body."""

    character: Character
    handles: Handles  # 30 handles whose weights are those of their bones
    joints: Joints  # where handles meet: heads of bones, and parents as the rig has them
    rotations: np.ndarray  # from the rest pose into the reference body's, shape (30, 3, 3)
    parts: np.ndarray  # handle of each bone, -1 where it goes along with its parent, shape (J,)
    leads: np.ndarray  # first bone of each handle, -1 for none, shape (30,)
    parents: np.ndarray  # parent of each bone for posing, shape (J,): feet that hang on the root hang on their legs
    still: np.ndarray  # bones over the pelvis that hold nothing and stay where they are, shape (J,), bool
    hung: bool = True  # whether each bone hangs on its parent and keeps its length, or goes wholly with its handle

    @classmethod
    def of(cls, character: Character, known: np.ndarray | None = None) -> RigParts:
        """Read a rig.

        Args:
            known: Handle of each bone, -1 for none, shape (J,); by the file and the bones' names when None.

        Raises:
            CharacterError: There is none, or the names of its bones do not tell which is the pelvis.
        """
        rig = character.rig
        if rig is None:
            raise CharacterError(f"{character.name}: it has no rig to put a motion on; put it on its handles instead")
        areas = character.areas
        mass = np.bincount(rig.indices.ravel(), (rig.weights * areas[:, None]).ravel(), minlength=len(rig.names))
        above = _followed(character)
        mass[[bone for bone, name in enumerate(rig.names) if name == BESIDE]] = 0  # that stays where it is
        parts = _avatar_parts(character, above, mass) if known is None else known.copy()
        if parts is None:
            handles, parts = rig_handles(character), handle_of_joints(rig.names, rig.parents, rig.positions, mass)
        else:
            weights = rig.dense_weights() @ np.eye(HANDLE_COUNT, dtype=np.float32)[resolve_joints(parts, above)]
            weights[:, 0] += 1 - weights.sum(axis=1)
            handles = Handles(handle_positions(character.vertices, weights, areas), weights)
        parents = limb_parents(parts, above, rig.positions)
        order = bone_order(parents)
        leads = np.full(HANDLE_COUNT, -1)
        for bone in order:
            if parts[bone] != NO_HANDLE and leads[parts[bone]] < 0:
                leads[parts[bone]] = bone
        for part in (*WRISTS, *_HIPS):
            parts, leads[part] = _lead_below(part, int(leads[part]), without_prefix(rig.names), parts, parents, mass)
        if leads[0] < 0:
            raise CharacterError(f"{character.name}: no bone is known to be the pelvis; put the motion on its handles")
        joints = _joints(handles, rig.positions, parts, parents, leads, mass / max(float(areas.sum()), 1e-30))
        turns, still = _turns(character, handles, joints), _still(parts, parents, mass)
        return cls(character, handles, joints, turns, parts, leads, parents, still)

    @classmethod
    def by_skin(cls, body: Anatomy) -> RigParts | None:
        """A rig by what its bones move, whatever their names: each bone is a part of the handle of the mesh that holds
        most of its skin. None where there is no rig, or its bones cannot move what the handles move.
        """
        character, found, rig = body.character, body.handles, body.character.rig
        if rig is None:
            return None
        areas, bones = character.areas, len(rig.names)
        rows = np.repeat(np.arange(len(areas)), rig.indices.shape[1])
        skin = csr_matrix((rig.weights.ravel(), (rig.indices.ravel(), rows)), shape=(bones, len(areas)))
        shared = skin @ (found.weights * areas[:, None])
        mass = shared.sum(axis=1)
        parents = _followed(character)
        even = found.roles is None  # else some handles play other parts than their own
        best = (_even(character, skin, shared) if even else shared).argmax(axis=1)
        parts = _as_borne(np.where(mass > 0, best, NO_HANDLE), parents, LEGS + body.further, rig.positions)
        loose = (parents != rig.parents) & (mmd_rig(character) is None)
        for bone in bone_order(parents):  # what is put on a limb moves as the limb does there
            loose[bone] |= parents[bone] >= 0 and loose[parents[bone]]
            parts[bone] = parts[parents[bone]] if loose[bone] else parts[bone]
        if not _moves_all(body, shared, parts):
            return None
        weights = np.asarray(skin.T @ np.eye(HANDLE_COUNT + 1, dtype=np.float32)[parts][:, :HANDLE_COUNT])
        weights[:, 0] += 1 - weights.sum(axis=1)
        positions = found.positions if found.rigid else handle_positions(character.vertices, weights, areas)
        handles = replace(found, positions=positions, weights=weights)
        leads = np.full(HANDLE_COUNT, -1)
        for bone in reversed(bone_order(parents)):
            leads[parts[bone]] = bone if parts[bone] != NO_HANDLE else leads[parts[bone]]
        measured = Anatomy.of(character, handles)
        joints = measured.joints if found.rigid else _at_heads(measured.joints, rig.positions, leads, character.height)
        still, turns = _still(parts, parents, mass), measured.rotations
        if measured.has_extra_legs:
            plain = [[handle for handle in leg if measured.own[handle]] for leg in LEGS]
            turns = _lowered(turns, handles, joints, plain + measured.further)
        return cls(character, handles, joints, turns, parts, leads, parents, still, hung=False)

    @cached_property
    def anatomy(self) -> Anatomy:
        """The body that the rig moves, with the rest pose and the joints that the rig tells."""
        found = Anatomy.of(self.character, self.handles, (self.rotations, self.joints))
        return replace(found, named=self.hung)

    @cached_property
    def rise(self) -> np.ndarray:
        """From where its rest pose stands to where the clips of its file do [m], shape (3,)."""
        return np.array([0.0, clips_rise(self.character), 0.0])

    @property
    def complete(self) -> bool:
        """Whether it has a pelvis, two legs, and two arms or front legs."""
        return bool((self.leads[list(HUMANOID)] >= 0).all())

    @property
    def winged(self) -> bool:
        """Whether it has a pelvis, two legs and two wings."""
        return bool((self.leads[list(_WINGED)] >= 0).all())

    @property
    def humanoid(self) -> bool:
        """Whether it stands upright and has a pelvis, two legs and two arms.

        The head is where its bone is: what hangs from it, hair to the knees for one, draws the mean of what it holds
        down.
        """
        head, rig = HANDLE_NAMES.index("head"), self.character.rig
        if not self.complete or self.leads[head] < 0 or rig is None:
            return self.complete and upright(self.handles)
        positions = np.array(self.handles.positions)
        positions[head] = rig.positions[self.leads[head]]
        return upright(self.handles) or upright(replace(self.handles, positions=positions))

    def world(self, transforms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World rotations (N, J, 3, 3) and heads [m] (N, J, 3) of the bones for transforms (N, 30, 3, 4) of the
        handles; bones keep their lengths.
        """
        assert self.character.rig is not None
        rest = self.character.rig.positions
        frames = len(transforms)
        rotations, positions = np.tile(np.eye(3), (frames, len(rest), 1, 1)), np.tile(rest, (frames, 1, 1))
        for bone in bone_order(self.parents):
            parent, part = int(self.parents[bone]), int(self.parts[bone])
            if self.still[bone]:
                continue
            if parent >= 0 and not self.still[parent] and (self.hung or part == NO_HANDLE):
                away = np.einsum("nij,j->ni", rotations[:, parent], rest[bone] - rest[parent])
                positions[:, bone] = positions[:, parent] + away
                rotations[:, bone] = rotations[:, parent] if part == NO_HANDLE else transforms[:, part, :, :3]
            else:
                move = transforms[:, max(part, 0)]
                rotations[:, bone], positions[:, bone] = move[..., :3], move[..., :3] @ rest[bone] + move[..., 3]
        return rotations, positions


def _still(parts: np.ndarray, parents: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Bones over the body that hold nothing, shape (J,), bool."""
    out = np.zeros(len(parts), bool)
    for bone in bone_order(parents):
        above = int(parents[bone])
        out[bone] = parts[bone] == NO_HANDLE and (above < 0 or out[above]) and mass[bone] <= 0
    return out


def _at_heads(joints: Joints, heads: np.ndarray, leads: np.ndarray, height: float) -> Joints:
    """The joints with those at the heads of their bones that are near them."""
    near = (leads >= 0) & (np.linalg.norm(heads[leads] - joints.positions, axis=1) < NEAR_HEAD * height)
    near[0] = False
    return replace(joints, positions=np.where(near[:, None], heads[leads], joints.positions))


def _lowered(turns: np.ndarray, handles: Handles, joints: Joints, legs: list[list[int]]) -> np.ndarray:
    """Rotations (K, 3, 3) from the rest pose into a stance, with legs that rest level, as rigs of spiders have them, up
    to their knees and down to their tips.

    Args:
        turns: Of the handles.
        handles: Of a body on many legs.
        joints: Where they meet.
        legs: The handles of each leg, from the body outwards.
    """
    out = turns.copy()
    for leg in legs:
        upper, *lower = [handle for handle in leg if joints.present[handle]] or [0]
        if not lower:
            continue
        hip, knee = joints.positions[[upper, lower[0]]]
        shin = handles.positions[lower[-1]] - knee
        whole = knee + shin - hip
        level = float(np.hypot(whole[0], whole[2]))
        if -whole[1] < LEVEL * level:
            outwards = np.array([whole[0], 0, whole[2]]) / level
            out[upper] = rotation_between(knee - hip, outwards + [0, KNEE_UP[0], 0])
            out[lower] = rotation_between(shin, outwards + [0, KNEE_UP[1], 0])
    return out


def _even(character: Character, skin: csr_matrix, shared: np.ndarray) -> np.ndarray:
    """What the bones of a character that faces +Z share with the handles (J, 30), each together with what the bone on
    its other side shares with the mirrored ones, so that both sides are read alike. `skin` (J, V) is what they hold.
    """
    held = np.flatnonzero(skin @ character.areas > 0)
    middles = (skin[held] @ (character.vertices * character.areas[:, None])) / (skin[held] @ character.areas)[:, None]
    across = 2 * float(np.average(character.vertices[:, 0], weights=character.areas))
    far, there = cKDTree(middles).query([across, 0, 0] + [-1, 1, 1] * middles)
    paired = (there[there] == np.arange(len(held))) & (far < MIRRORED * character.height)
    out = shared.copy()
    out[held[paired]] += shared[np.ix_(held[there[paired]], HANDLE_MIRROR)]
    return out


def _as_borne(parts: np.ndarray, parents: np.ndarray, legs: list[list[int]], heads: np.ndarray) -> np.ndarray:
    """Parts of bones, -1 for none, shape (J,), as the tree has them where their skin says otherwise: what bears legs of
    both sides is the pelvis, unless it is all that there is of the trunk, and so is what begins in the middle and bears
    a thigh; other bones that bear a leg alone are of that leg, and what is between two parts of a limb is of that limb.
    `heads` says where bones begin [m], shape (J, 3).
    """
    out, order = parts.copy(), bone_order(parents)
    free = np.setdiff1d((*_TRUNK, *_TAIL), [handle for leg in legs for handle in leg])
    borne = [{number for number, leg in enumerate(legs) if part in leg} for part in parts]
    for bone in reversed(order):
        if len(borne[bone]) == 1 and parts[bone] in free:
            leg, joints = legs[min(borne[bone])], [out[child] for child in np.flatnonzero(parents == bone)]
            out[bone] = leg[max(min((leg.index(part) for part in joints if part in leg), default=1) - 1, 0)]
        if parents[bone] >= 0:
            borne[parents[bone]] |= borne[bone]
    limbs = {part: limb for limb in [*ARMS, *legs] for part in limb}
    aside = np.abs(heads[:, 0] - np.median(heads[:, 0]))
    for bone in order:
        limb = limbs.get(int(out[parents[bone]]), []) if parents[bone] >= 0 else []
        below = [limb.index(part) for part in out[parents == bone] if part in limb]
        if below and out[bone] not in limb:
            out[bone] = limb[min(limb.index(out[parents[bone]]) + 1, *below)]
        thighs = [child for child in np.flatnonzero(parents == bone) if out[child] == out[bone] and out[bone] in _HIPS]
        if thighs and aside[bone] < STUB * aside[thighs[0]]:
            out[bone] = 0
    bearers = [bone for bone in order if len(borne[bone]) > 1 and parts[bone] != NO_HANDLE]
    trunk = [bone for bone in order if parts[bone] in free and parts[bone] in _TRUNK]
    if bearers and 0 not in parts[bearers] and (bearers[-1] not in trunk or len(trunk) > 1):
        out[bearers[-1]] = 0
    return out


def _moves_all(body: Anatomy, shared: np.ndarray, parts: np.ndarray) -> bool:
    """Whether bones, each a part of a handle or of none, -1, shape (J,), can move what carries a body, each limb on its
    own: its legs and the arms of a person, or, without legs and lying, its wings or its tail. `shared` (J, 30) says how
    much skin each bone shares with each handle.
    """
    plan = body.plan

    def moved(limb: list[int]) -> bool:
        own = [handle for handle in limb if body.own[handle]] or limb
        return bool(shared[np.isin(parts, own)][:, own].sum() >= OWN_BONES * shared[:, own].sum())

    limbs = [limb for limb in body.extra_limbs if limb[0] not in body.appendages]
    limbs += (LEGS if plan.legs else []) + (ARMS if plan.kind == "person" or plan.front else [])
    carried = bool(plan.legs) or plan.upright or not (plan.wings or plan.tail)
    carried |= (plan.wings and all(map(moved, _WINGS))) or (plan.tail and moved(_TAIL))
    return len(np.unique(parts[parts != NO_HANDLE])) >= FEWEST_PARTS and carried and all(map(moved, limbs))


def understood_rig(character: Character) -> RigParts | None:
    """The rig of a character that faces +Z: of a person, of four legs or more, or of a bird, read from the file, the
    names of its bones or their shape; None where it is none of these, or there is none.
    """
    rig = character.rig
    if rig is None:
        return None
    named = _readable(character, None)
    if named is not None and named.humanoid:
        return named
    four = four_legs_of_rig(character, handle_of_joints(rig.names, rig.parents, rig.positions))
    if four is not None:
        return RigParts.of(character, four)
    many = legs_of_rig(character)
    if many is not None:
        return RigParts.by_skin(Anatomy.of(character, many))
    if named is not None and (named.complete or named.winged):
        return named
    shaped = _readable(character, _shaped_parts(character))
    return shaped if shaped is not None and shaped.humanoid else None


def _readable(character: Character, known: np.ndarray | None) -> RigParts | None:
    try:
        return RigParts.of(character, known)
    except CharacterError:
        return None


def is_humanoid_rig(character: Character) -> bool:
    """Whether a character has a rig that takes a person's motion bone by bone."""
    named = _readable(character, None)
    return named is not None and named.humanoid


def _shaped_parts(character: Character) -> np.ndarray | None:
    """Handle of each bone of a person's rig by its shape alone, shape (J,); None where it has none of a person."""
    rig = character.rig
    if rig is None:
        return None
    skin = rig.weights * character.areas[:, None]
    mass = np.bincount(rig.indices.ravel(), skin.ravel(), minlength=len(rig.names))
    held, downwards = mass.copy(), bone_order(rig.parents)
    for bone in reversed(downwards):
        held[rig.parents[bone]] += held[bone] * (rig.parents[bone] >= 0)
    below = np.zeros(len(rig.names), bool)  # of the lowest bone that bears nearly all; targets for feet stand beside it
    bearing = [bone for bone in downwards if held[bone] > BODY * mass.sum()] or downwards[:1]
    below[bearing[-1]] = True
    for bone in downwards:
        below[bone] |= rig.parents[bone] >= 0 and below[rig.parents[bone]]
    order = [bone for bone in downwards if below[bone]]
    place = {bone: number for number, bone in enumerate(order)}
    parents = [place.get(int(rig.parents[bone]), -1) for bone in order]
    rest = rig.positions[order]
    offsets = rest - np.where(np.array(parents)[:, None] >= 0, rest[parents], 0)
    skeleton = Skeleton(tuple(rig.names[bone] for bone in order), np.array(parents), offsets)
    joints, out = joints_by_structure(skeleton, mass[order]), handle_of_joints(rig.names, rig.parents)
    out[below | ~np.isin(out, _FEET)] = NO_HANDLE
    for name, joint in joints.items():
        out[order[joint]] = HANDLE_NAMES.index(name)
    left, right = (np.isin(out, _both("hip", "knee", "shoulder", "elbow")[side::2]) for side in (0, 1))
    if left.any() and right.any() and rig.positions[left, 0].mean() < rig.positions[right, 0].mean():
        out[out != NO_HANDLE] = np.array(HANDLE_MIRROR)[out[out != NO_HANDLE]]
    return out if joints else None


def _followed(character: Character) -> np.ndarray:
    """The bone that each bone goes along with, shape (J,): its parent, or in MMD models the one whose rotation it takes
    over, as the legs that hold the skin do of those that are keyed. Bones that turn the other way stay with their
    parents. In other rigs a hand or foot that hangs on a target beside the body goes along with the limb that it ends.
    """
    rig, model = character.rig, mmd_rig(character)
    assert rig is not None
    out = np.array(rig.parents)
    if model is None:
        return _on_limbs(character, rig, out)
    for bone in model.order:
        append = model.bones[bone].append
        if append is not None and append.rotation and append.ratio > 0 and bone not in line_up(append.bone, out):
            out[bone] = append.bone
    return out


def _on_limbs(character: Character, rig: Rig, parents: np.ndarray) -> np.ndarray:
    """Parents of bones (J,), where what hangs on bones without skin goes along with the limb that ends where it is."""
    main = np.take_along_axis(rig.indices, rig.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    main, skin = main[character.surface], character.vertices[character.surface]
    held, below = np.bincount(main, minlength=len(parents)) > 0, np.zeros(len(parents), bool)
    for bone in reversed(bone_order(parents)):
        if parents[bone] >= 0:
            below[parents[bone]] |= held[bone] | below[bone]
    out = parents.copy()
    for bone in bone_order(parents):
        if parents[bone] < 0 or held[line_up(int(out[bone]), out)].any() or not (held[bone] or below[bone]):
            continue
        lines = [line_up(limb, out) for limb in np.flatnonzero(held & ~below).tolist()]
        limbs = [line[0] for line in lines if bone not in line and held[line[1:]].any()]
        ends = np.flatnonzero(np.isin(main, limbs))
        away = np.linalg.norm(skin[ends] - rig.positions[bone], axis=1)
        if away.min(initial=np.inf) < NEAR_LIMB * character.height:
            out[bone] = main[ends[away.argmin()]]
    return out


def mmd_rig(character: Character) -> MmdModel | None:
    """The MMD model whose bones a character's rig has; None for other characters."""
    model, rig = mmd_model(character), character.rig
    return model if model is not None and rig is not None and len(model.bones) == len(rig.names) else None


def _avatar_parts(character: Character, followed: np.ndarray, mass: np.ndarray) -> np.ndarray | None:
    """Handle of each bone of an avatar whose file or format says which bones are a person's, shape (J,), -1 for others;
    None for other characters. Each bone goes along with the one of `followed` (J,), and holds `mass` (J,) of the skin.
    """
    model = mmd_rig(character)
    standard = None if model is None else mmd_skeleton_map(model.names)
    if model is None or standard is None:
        return _vrm_parts(character)
    out = handle_of_joints(model.names, followed, model.positions, mass)
    out[[bone for bone, entry in enumerate(model.bones) if entry.append is not None]] = NO_HANDLE
    for joint, bone in enumerate(standard.joints):
        if bone >= 0:
            out[out == joint] = NO_HANDLE
            out[bone] = joint
    out[mmd_centre(model.names, model.parents, standard)] = 0
    return out


def _vrm_parts(character: Character) -> np.ndarray | None:
    """Handle of each bone of a VRM avatar, whose file names them (J,); -1 for others. None for other characters."""
    source, rig = character.source, character.rig
    model = vrm_model(character) if isinstance(source, Source) else None
    if model is None or rig is None or not model.humanoid or len(source.skins.nodes) != len(rig.names):
        return None
    bones = {node: bone for bone, node in enumerate(source.skins.nodes)}
    out = np.full(len(bones), NO_HANDLE)
    for name, node in model.humanoid.items():
        side = next((side for side in ("left", "right") if name.startswith(side)), "")
        part = name.removeprefix(side)
        word = _VRM.get(part) or ("fingers" if part.startswith(("Thumb", "Index", "Middle", "Ring", "Little")) else "")
        label = f"{side}_{word}" if side else word
        if label in HANDLE_NAMES and node in bones:
            out[bones[node]] = HANDLE_NAMES.index(label)
    if "upperChest" not in model.humanoid:
        out[out == HANDLE_NAMES.index("spine2")] = HANDLE_NAMES.index("spine3")
    return out if (out == 0).any() else None


def _lead_below(
    part: int, lead: int, names: Sequence[str], parts: np.ndarray, parents: np.ndarray, mass: np.ndarray
) -> tuple[np.ndarray, int]:
    """Parts and the first bone of a hand or a leg. Where a wrist bone stands above the one that holds the hand, clips
    turn the latter, and where a thigh hangs on half of a pelvis, that goes along with the pelvis.
    """
    below = [int(bone) for bone in np.flatnonzero(parents == lead) if parts[bone] == part]
    if part in WRISTS:
        below = [bone for bone in below if part_of_name(names[bone])[0] == "wrist"]
    if lead < 0 or len(below) != 1:
        return parts, lead
    if mass[below[0]] <= mass[lead] if part in WRISTS else part_of_name(names[lead])[0] != "hips":
        return parts, lead
    return np.where(np.arange(len(parts)) == lead, NO_HANDLE, parts), below[0]


def _joints(
    handles: Handles, rest: np.ndarray, parts: np.ndarray, parents: np.ndarray, leads: np.ndarray, share: np.ndarray
) -> Joints:
    positions, held = handles.positions.astype(np.float64), resolve_joints(parts, parents)
    present = leads >= 0
    for foot in _FEET:  # a foot that moves nothing has no sole to stand on
        present[foot] &= share[held == foot].sum() > PRESENT
    above = np.full(HANDLE_COUNT, -1)
    for handle in range(1, HANDLE_COUNT):
        parent = HANDLE_PARENTS[handle]
        while parent > 0 and not present[parent]:
            parent = HANDLE_PARENTS[parent]
        above[handle] = parent
        if not present[handle]:
            continue
        same = (parts == parts[leads[handle]]) & (parents == parents[leads[handle]])
        positions[handle] = rest[same].mean(axis=0)  # fingers that stand for a hand begin side by side
        bone = int(parents[leads[handle]])
        while bone >= 0 and (parts[bone] in (NO_HANDLE, handle) or not present[parts[bone]]):
            bone = int(parents[bone])
        above[handle] = parts[bone] if bone >= 0 else parent
    positions[0] = handles.positions[0]
    for handle in range(1, HANDLE_COUNT):  # rigs with bones of one part in several limbs could go round in a circle
        seen, index = [handle], int(above[handle])
        while index > 0 and index not in seen:
            seen.append(index)
            index = int(above[index])
        if index > 0:
            above[handle] = 0
    return Joints(positions, above, present)


def _turns(character: Character, handles: Handles, joints: Joints) -> np.ndarray:
    reference = reference_body()
    out = rest_rotations(handles, joints, reference.handles, reference_joints(), character.height)
    if not upright(handles):
        return out
    known = reference_joints().positions
    for side in ("left", "right"):
        above = np.eye(3)
        for part, end in (("hip", "knee"), ("knee", "ankle")):
            handle, child = HANDLE_NAMES.index(f"{side}_{part}"), HANDLE_NAMES.index(f"{side}_{end}")
            if joints.present[[handle, child]].all():
                direction = above @ (joints.positions[child] - joints.positions[handle])
                above = rotation_between(direction, known[child] - known[handle]) @ above
                out[handle] = above
    return flat_feet(character, handles, out)
