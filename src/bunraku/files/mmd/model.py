"""What PMX and PMD have in common: bounded reading, rigid bodies and joints, and the character of a model."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from bunraku.core.avatars import (
    BODY_SHAPES,
    MMD_METRE,
    MmdBody,
    MmdBone,
    MmdIkLink,
    MmdJoint,
    MmdModel,
    MmdMorph,
    MmdSdef,
    mmd_angles,
    mmd_points,
    mmd_rotation,
    warning_sentences,
)
from bunraku.core.character import Character
from bunraku.errors import FormatError
from bunraku.files.gltf.read import character_from_document
from bunraku.files.mmd.document import MmdMaterial, model_document
from bunraku.files.mmd.vmd import AGAIN, MmdReader

Note = Callable[[str, str], None]


def read_body(reader: MmdReader, name: str, bone: int, origin: np.ndarray) -> MmdBody:
    """A rigid body of a name and a bone, from its group on; `origin` is the origin of its position [m], shape (3,)."""
    group, mask, shape = reader.values("BHB")
    size, position, angles = reader.floats(3), reader.floats(3), reader.floats(3)
    mass, linear, angular, restitution, friction, mode = reader.values("5fB")
    return MmdBody(
        name, bone, BODY_SHAPES[shape] if shape < len(BODY_SHAPES) else "", size * MMD_METRE,
        origin + mmd_points(position), mmd_rotation(angles),
        mass, linear, angular, restitution, friction, mode, group, mask,
    )  # fmt: skip


def read_joint(reader: MmdReader, name: str, bodies: tuple[int, int]) -> MmdJoint:
    """A joint from its position on."""
    position, angles, lower, upper, angle_lower, angle_upper, spring, angle_spring = reader.floats(24).reshape(8, 3)
    low, high = mmd_points([lower, upper])
    low[2], high[2] = high[2], low[2]  # z is turned round
    turned = mmd_angles(angle_lower, angle_upper)
    return MmdJoint(name, bodies, mmd_points(position), mmd_rotation(angles), low, high, *turned, spring, angle_spring)


def check_physics(
    bodies: list[MmdBody], joints: list[MmdJoint], bones: int, note: Note
) -> tuple[tuple[MmdBody, ...], tuple[MmdJoint, ...]]:
    """The bodies and joints that can be used in a file of some bones."""
    kept: dict[int, MmdBody] = {}
    for index, body in enumerate(bodies):
        numbers = [body.mass, body.linear_damping, body.angular_damping, body.restitution, body.friction]
        if not (np.isfinite(numbers).all() and np.isfinite([body.size, body.position, *body.rotation]).all()):
            note("rigid bodies hold values that are not numbers and are left out", body.name)
        elif not body.shape or body.mode > 2 or body.group > 15:
            note("rigid bodies have a shape, mode or group that there is not and are left out", body.name)
        elif (body.size[: (1 if body.shape == "sphere" else 3 if body.shape == "box" else 2)] < 0).any():
            note("rigid bodies have a negative size and are left out", body.name)
        else:
            kept[index] = _repaired(body, bones, note)
    number = {index: row for row, index in enumerate(kept)}
    good = []
    for joint in joints:
        a, b = joint.bodies
        if a not in kept or b not in kept:
            note("joints are between rigid bodies that do not exist and are left out", joint.name)
        elif a == b:
            note("joints tie a rigid body to itself and are left out", joint.name)
        elif not all(np.isfinite(value).all() for value in vars(joint).values() if isinstance(value, np.ndarray)):
            note("joints hold values that are not numbers and are left out", joint.name)
        else:
            good.append(replace(joint, bodies=(number[a], number[b])))
    return tuple(kept.values()), tuple(good)


def _repaired(body: MmdBody, bones: int, note: Note) -> MmdBody:
    if not -1 <= body.bone < bones:
        note("rigid bodies are on a bone that does not exist and hang on none", body.name)
        body = replace(body, bone=-1)
    if body.dynamic and body.mass <= 0:
        note("rigid bodies have no mass and follow their bones", body.name)
        body = replace(body, mode=0, mass=0.0)
    return body


MAX_BONES, MAX_BODIES, MAX_JOINTS = 10_000, 10_000, 20_000
MAX_LOOPS, MAX_LINKS = 1_000, 256  # of inverse kinematics; MMD itself stops at 255 loops
_log = logging.getLogger(__name__)


@dataclass
class MmdFile:
    """What a file says: the mesh in MMD's frame and unit, bones, bodies and joints in ours. Its indices are not
    checked.
    """

    version: str  # "PMX 2.0", "PMX 2.1" or "PMD"
    # name, english: names of the model
    name: str
    english: str = ""
    # positions, normals: of the vertices, shape (V, 3)
    positions: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    normals: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    uvs: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))  # with v downwards, shape (V, 2)
    # 0 BDEF1, 1 BDEF2, 2 BDEF4, 3 SDEF, 4 QDEF, shape (V,)
    deforms: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint8))
    # indices, weights: bones of each vertex, -1 for none, and their shares, shape (V, 4)
    indices: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), np.int64))
    weights: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    # C, R0 and R1 of those that are SDEF, shape (V, 3, 3)
    sdef: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    triangles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.int64))  # shape (F, 3)
    materials: list[MmdMaterial] = field(default_factory=list)  # in the order of the triangles
    bones: list[MmdBone] = field(default_factory=list)  # those whose tail is a bone have it in `tails`, by their index
    tails: dict[int, int] = field(default_factory=dict)
    # morphs, bodies, joints: as in the file
    morphs: list[MmdMorph] = field(default_factory=list)
    bodies: list[MmdBody] = field(default_factory=list)
    joints: list[MmdJoint] = field(default_factory=list)
    warnings: dict[str, list[str]] = field(default_factory=dict)  # problems, each with the names of its subjects

    def note(self, problem: str, name: str = "") -> None:
        """Remember a problem: a whole sentence, or one about the subject of this name."""
        self.warnings.setdefault(problem, []).append(name)


def mmd_character(path: Path, file: MmdFile) -> Character:
    """The character that a file holds, its model as its `avatar`; textures are looked for in its folder and below,
    nowhere else. FormatError if a vertex or bone does not exist, or a bone has no position; CharacterError if what it
    holds is no character.
    """
    _check_mesh(path, file)
    bones = _check_bones(path, file)
    bodies, joints = check_physics(file.bodies, file.joints, len(bones), file.note)
    indices, weights = _check_weights(path, file)
    # In our frame; triangles wind the other way in a left-handed one.
    mesh = mmd_points(file.positions), file.normals * [1, 1, -1], file.uvs, file.triangles[:, ::-1]
    document = model_document(path, file.name or path.stem, file.materials, mesh, (indices, weights), bones, file.note)
    character = character_from_document(document, path.stem, None, path.suffix.lower() or ".pmx")
    model = MmdModel(
        file.name, file.english, file.version, bones, tuple(file.morphs), bodies, joints, file.deforms.copy(),
        _sdef(file), warning_sentences(file.warnings)
    )  # fmt: skip
    for warning in model.warnings:
        _log.warning("%s: %s", path, warning)
    return replace(character, avatar=model)


def _check_mesh(path: Path, file: MmdFile) -> None:
    count = len(file.positions)
    if len(file.triangles) and not 0 <= int(file.triangles.min()) <= int(file.triangles.max()) < count:
        worst = int(file.triangles.max()) if file.triangles.max() >= count else int(file.triangles.min())
        raise FormatError(path, f"a triangle uses vertex {worst} but there are {count}; {AGAIN}")
    covered = sum(max(material.corners, 0) for material in file.materials)
    if file.materials and covered != 3 * len(file.triangles):
        file.note(f"its materials are for {covered // 3:,} of its {len(file.triangles):,} triangles")


def _check_weights(path: Path, file: MmdFile) -> tuple[np.ndarray, np.ndarray]:
    """Bones and shares of each vertex, shape (V, 4); rows sum to 1."""
    count, indices = len(file.bones), file.indices
    weights = np.where(np.isfinite(file.weights) & (file.weights > 0) & (indices >= 0), file.weights, 0)
    beyond = np.where(weights > 0, indices, -1).max(initial=-1)
    if beyond >= count and (count or beyond > 0):  # a model without bones weighs all to the first
        raise FormatError(path, f"a vertex is weighted to bone {beyond} but there are {count}; {AGAIN}")
    for later in range(1, 4):  # glTF names a bone once for a vertex
        for earlier in range(later):
            again = (indices[:, later] == indices[:, earlier]) & (weights[:, later] > 0) & (weights[:, earlier] > 0)
            weights[again, earlier] += weights[again, later]
            weights[again, later] = 0
    total = weights.sum(axis=1, keepdims=True)
    lost = int((total[:, 0] <= 1e-9).sum())
    if lost and count:
        few = f"{lost:,} of its {len(indices):,} vertices"
        file.note(f"{few} are weighted to no bone; they take their neighbours' weights")
    return np.where(weights > 0, indices, 0), weights / np.where(total > 1e-9, total, 1)


def _check_bones(path: Path, file: MmdFile) -> tuple[MmdBone, ...]:
    count, out = len(file.bones), []
    for index, bone in enumerate(file.bones):
        if not np.isfinite(bone.position).all() or np.abs(bone.position).max() > 1e6:
            raise FormatError(path, f"bone {index} has a position that is not a number; {AGAIN}")
        if not -1 <= bone.parent < count:
            raise FormatError(path, f"bone {index} has the parent {bone.parent} but there are {count} bones; {AGAIN}")
        tail = file.tails.get(index)
        if tail is not None:
            there = file.bones[tail].position if 0 <= tail < count else bone.position
            bone = replace(bone, tail=there - bone.position)
        if bone.append is not None and (
            not 0 <= bone.append.bone < count or bone.append.bone == index or not np.isfinite(bone.append.ratio)
        ):
            file.note("bones take over the motion of a bone that does not exist, which is left out", bone.name)
            bone = replace(bone, append=None)
        ik = bone.ik
        if ik is not None:
            good = 0 <= ik.target < count and np.isfinite(ik.limit) and len(ik.links) <= MAX_LINKS
            if not good or not all(0 <= link.bone < count and _limits(link) for link in ik.links):
                problem = "bones have inverse kinematics of bones or with limits that do not exist, which are left out"
                file.note(problem, bone.name)
                bone = replace(bone, ik=None)
            else:
                bone = replace(bone, ik=replace(ik, loops=min(max(ik.loops, 0), MAX_LOOPS)))
        out.append(bone)
    for index in _loops([bone.parent for bone in out]):
        file.note("bones are their own parents, by a loop that is cut there", out[index].name)
        out[index] = replace(out[index], parent=-1)
    for index in _loops([-1 if bone.append is None else bone.append.bone for bone in out]):
        file.note("bones take over their own motion, by a loop that is cut there", out[index].name)
        out[index] = replace(out[index], append=None)
    return tuple(out)


def _limits(link: MmdIkLink) -> bool:
    """Whether the limits of a link are numbers, if it has any."""
    return link.lower is None or link.upper is None or bool(np.isfinite([link.lower, link.upper]).all())


def _loops(above: list[int]) -> list[int]:
    """One member of each loop that a table of parents has."""
    state, out = [0] * len(above), []  # 0 not seen, 1 on this walk, 2 known to be good
    for start in range(len(above)):
        walk, at = [], start
        while at >= 0 and state[at] == 0:
            state[at] = 1
            walk.append(at)
            at = above[at]
        if at >= 0 and state[at] == 1:
            out.append(at)
        for member in walk:
            state[member] = 2
    return out


def _sdef(file: MmdFile) -> MmdSdef:
    chosen = np.flatnonzero(file.deforms == 3)
    constants = mmd_points(file.sdef[chosen])
    return MmdSdef(chosen, constants[:, 0], constants[:, 1], constants[:, 2])
