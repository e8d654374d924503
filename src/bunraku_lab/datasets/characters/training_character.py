"""Characters to train the Mesh Handle Predictor on, and the ways in which each is varied."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from bunraku.anatomy.names.bone_words import left_axis
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_MIRROR, HANDLE_NAMES
from bunraku.core.character import Character
from bunraku.core.files import atomic_write
from bunraku.core.geometry.rotations import matrix_from_axis_angle, matrix_y
from bunraku.core.skinning import skin
from bunraku.errors import FormatError

UPRIGHT = 0.7
"""Least share of the way from the pelvis to the head that leads up, on a humanoid."""
# Rigs whose bones have no names, or wrong ones: the turn about +Y that makes them face +Z [degrees], and the part of
# each bone.
# Sides follow from where the bone stands.
_PET = "Bone:pelvis Bone.001:spine2 Bone.002:neck Bone.003:head Bone.014:shoulder Bone.015:elbow Bone.016:wrist " \
    "Bone.017:shoulder Bone.018:elbow Bone.019:wrist Bone.004:tail Bone.005:tail Bone.006:tail_tip Bone.007:tail_tip " \
    "Bone.008:hip Bone.009:knee Bone.010:ankle Bone.011:hip Bone.012:knee Bone.013:ankle"  # fmt: skip
_BY_HAND: dict[str, tuple[float, str]] = {
    "quaternius2019/Cat": (-90, _PET),
    "quaternius2019/Dog": (-90, _PET),
    "quaternius2019/Wolf": (-90, _PET),
    "quaternius2019/Chick": (-90, "Bone:pelvis Bone.001:spine2 Bone.002:neck Bone.009:head Bone.003:hip Bone.004:knee "
                                  "Bone.005:ankle Bone.006:hip "
                             "Bone.007:knee Bone.008:ankle"),
    "quaternius2019/bird": (0, "Bone:pelvis Bone.001:spine3 Bone.002:head Bone.003:pelvis Bone.004:tail "
                               "Bone.005:tail_tip Bone.006:wing "
                            "Bone.007:wing Bone.008:wing Bone.009:wing"),
    "quaternius2019/Eagle": (180, "Bone:pelvis Bone.001:spine2 Bone.002:neck Bone.003:head Bone.007:wing "
                                  "Bone.008:wing Bone.009:wing Bone.010:wing "
                             "Bone.011:wing Bone.012:wing Bone.013:wing Bone.014:wing Bone.015:wing Bone.004:tail "
                             "Bone.005:tail Bone.006:tail_tip "
                             "Bone.016:hip Bone.017:knee Bone.018:ankle Bone.019:foot Bone.020:hip Bone.021:knee "
                             "Bone.022:ankle Bone.023:foot"),
    "quaternius2019/Fish": (0, "Bone:pelvis Bone.001:head Bone.002:tail Bone.003:shoulder Bone.004:elbow "
                               "Bone.005:shoulder Bone.006:elbow"),
    "quaternius2019/Whale": (0, "Bone:pelvis Bone.002:spine2 Bone.009:head Bone.005:shoulder Bone.006:elbow "
                                "Bone.007:shoulder Bone.008:elbow "
                             "Bone.003:tail Bone.004:tail_tip"),
    "quaternius2019/Red_Fox": (180, "Bone:pelvis Bone.001:spine3 Bone.002:head Bone.003:tail Bone.010:tail_tip "
                                    "Bone.004:hip Bone.005:knee "
                               "Bone.006:ankle Bone.007:hip Bone.008:knee Bone.009:ankle Bone.011:shoulder "
                               "Bone.012:elbow Bone.013:wrist "
                               "Bone.014:shoulder Bone.015:elbow Bone.016:wrist"),
    "quaternius2019/Piranha": (0, "Bone:pelvis Bone.001:spine2 Bone.002:spine3 Bone.003:head Bone.004:face "
                                  "Bone.007:shoulder Bone.008:shoulder "
                               "Bone.005:tail Bone.006:tail_tip"),
    "quaternius2019/Skeleton": (0, "Hips:pelvis Torso:spine2 Neck:neck Head:head L.UpperLeg:hip L.DownLeg:knee "
                                   "R.UpperLeg:hip R.DownLeg:knee "
                                "L.UpperLeg.001:shoulder L.DownLeg.001:elbow R.UpperLeg.001:shoulder "
                                "R.DownLeg.001:elbow"),
    "quaternius2019/Bat": (0, "Bone:face"),
    "quaternius2019/Dragon": (0, "Bone:face"),
}  # fmt: skip


def facing_rotation(name: str, names: tuple[str, ...], positions: np.ndarray) -> np.ndarray:
    """The quarter turn about +Y after which the character faces +Z, shape (3, 3)."""
    if name in _BY_HAND:
        return np.asarray(matrix_y(np.array(np.radians(_BY_HAND[name][0]))))
    left = left_axis(names, positions)
    if left is None or left[0] > 0.5:  # a stride or a twist is not a turn
        return np.eye(3)
    quarter = np.round(np.arctan2(left[2], left[0]) / (np.pi / 2))
    return np.asarray(matrix_y(np.array(quarter * np.pi / 2)))


def facing_ahead(character: Character, name: str) -> Character:
    """A character with its rig, rotated to face +Z (`facing_rotation`); one without a rig as it is."""
    rig = character.rig
    if rig is None:
        return character
    rotation, transforms = facing_rotation(name, rig.names, rig.positions), rig.transforms.copy()
    transforms[:, :3] = rotation @ transforms[:, :3]
    vertices = character.vertices @ rotation.T.astype(np.float32)
    return replace(character, vertices=vertices, rig=replace(rig, transforms=transforms), source=None)


def known_handles(name: str, names: tuple[str, ...], positions: np.ndarray, handles: np.ndarray) -> np.ndarray:
    """The handle of each joint, shape (J,): by name, but for listed rigs whose names say nothing.

    Args:
        name: Path of the character in its archive, without the suffix.
        names: Joint names, length J.
        positions: Joint positions, facing +Z, shape (J, 3).
        handles: What the names gave, shape (J,).
    """
    if name not in _BY_HAND:
        return handles
    parts = dict(entry.rsplit(":", 1) for entry in _BY_HAND[name][1].split())
    handles = handles.copy()
    middle = (positions[:, 0].max() + positions[:, 0].min()) / 2
    for joint, bone in enumerate(names):
        part = parts.get(bone)
        if part:
            side = "left_" if positions[joint, 0] > middle else "right_"
            handles[joint] = HANDLE_NAMES.index(part if part in HANDLE_NAMES else side + part)
    return handles


def root_joint(
    vertices: np.ndarray, joints: np.ndarray, parents: np.ndarray, handles: np.ndarray, mass: np.ndarray
) -> np.ndarray:
    """The root joint b_1 of Eq. 4, shape (3,): the mean of the pelvis joints, of those that move something if any.

    Args:
        vertices: Of the mesh, in the frame and unit of the joints, shape (V, 3); the root is kept inside their box.
        joints, parents, handles, mass: Position, parent, handle and total skin weight of each joint, J rows.
    """
    for choice in ((handles == 0) & (mass > 0), handles == 0, parents < 0):
        if choice.any():
            position = joints[choice].mean(axis=0)
            return np.asarray(np.clip(position, vertices.min(axis=0), vertices.max(axis=0)), np.float32)
    return np.zeros(3, np.float32)


@dataclass(frozen=True, eq=False)
class TrainingCharacter:
    """A network mesh with the rig's truth, in normalised units (bounding box centred on 0, largest extent 1).

    Args:
        name: Path of the character in its archive, without the suffix.
        vertices, normals: Of the network mesh, shape (V, 3).
        areas: Surface of each vertex, shape (V,).
        edges: Undirected edges, shape (E, 2).
        weights: The rig's skin weights, shape (V, J).
        joints: Joint positions, shape (J, 3).
        parents: Parent of each joint for posing (`limb_parents`), shape (J,).
        handles: Handle of each joint, -1 for none, shape (J,).
        target: Share of each handle in each vertex, shape (V, 30); rows sum to less than 1 for joints without handle.
        root: Position of the root joint b_1 of Eq. 4, shape (3,).
        height: Extent along +Y.
    """

    name: str
    vertices: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    edges: np.ndarray
    weights: np.ndarray
    joints: np.ndarray
    parents: np.ndarray
    handles: np.ndarray
    target: np.ndarray
    root: np.ndarray
    height: float

    def save(self, path: Path) -> None:
        """Write as npz, whole or not at all."""
        with atomic_write(path) as file:
            np.savez_compressed(file, **{field.name: np.asarray(getattr(self, field.name)) for field in fields(self)})  # type: ignore[arg-type]

    @staticmethod
    def load(path: Path) -> TrainingCharacter:
        """Read what `save` wrote.

        Raises:
            FormatError: The file is damaged or of an older layout.
        """
        try:
            with np.load(path, allow_pickle=False) as archive:
                values = {field.name: archive[field.name] for field in fields(TrainingCharacter)}
        except (OSError, KeyError, ValueError, BadZipFile) as error:
            raise FormatError(
                path, f"not a cached training character ({error}); delete it and build the cache again"
            ) from error
        return TrainingCharacter(**{**values, "name": str(values["name"]), "height": float(values["height"])})


@dataclass(eq=False)
class TrainingMesh:
    """One training example: a varied mesh and poses of its skeleton; fields as in `TrainingCharacter`.

    Args:
        posed: The mesh in random poses in which the root rests, shape (N, V, 3).
    """

    vertices: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    edges: np.ndarray
    weights: np.ndarray
    handles: np.ndarray
    target: np.ndarray
    root: np.ndarray
    height: float
    posed: np.ndarray


@dataclass(frozen=True)
class AugmentConfig:
    """How examples vary.

    Args:
        poses: Poses of each example for the Pose Loss.
        pose_angle: Largest angle of a joint in those poses [rad].
        rest_rate: Share of the examples whose rest pose is changed.
        rest_angle: Largest angle of a joint in a changed rest pose [rad].
        stretch: Largest change of each axis' scale, as a factor.
        joint_scale: Largest change of the girth and size of single parts, as a factor.
        yaw: Standard deviation of the turn about +Y [rad].
    """

    poses: int = 2
    pose_angle: float = 1.05
    rest_rate: float = 0.8
    rest_angle: float = 0.6
    stretch: float = 1.25
    joint_scale: float = 1.35
    yaw: float = 0.2


def forward_kinematics(
    joints: np.ndarray, parents: np.ndarray, rotations: np.ndarray, scales: np.ndarray | None = None
) -> np.ndarray:
    """Affine transforms that take rest points to posed points, for rotations about the joints in world axes.

    Args:
        joints: Joint positions, shape (J, 3).
        parents: Parent of each joint, -1 for roots, any order, shape (J,).
        rotations: Turn of each joint on top of its parent's, shape (J, 3, 3).
        scales: Size of the part that each joint moves, not handed down, shape (J,).

    Returns:
        Shape (J, 3, 4).
    """
    count = len(joints)
    world, positions, done = np.empty((count, 3, 3)), np.empty((count, 3)), np.zeros(count, bool)
    waiting = list(range(count))
    while waiting:
        later = []
        for joint in waiting:
            parent = parents[joint]
            if parent < 0:
                world[joint], positions[joint] = rotations[joint], joints[joint]
            elif done[parent]:
                world[joint] = world[parent] @ rotations[joint]
                positions[joint] = world[parent] @ (joints[joint] - joints[parent]) + positions[parent]
            else:
                later.append(joint)
                continue
            done[joint] = True
        if len(later) == len(waiting):
            raise ValueError("the joints' parents form a loop")
        waiting = later
    linear = world if scales is None else world * scales[:, None, None]
    return np.concatenate([linear, (positions - np.einsum("jab,jb->ja", linear, joints))[..., None]], axis=-1)


def _resting(character: TrainingCharacter) -> np.ndarray:
    """Joints that must not turn so that the root rests: the pelvis and all above it, or the roots, shape (J,) bool."""
    rest = character.parents < 0
    for joint in np.flatnonzero(character.handles == 0):
        while joint >= 0:
            rest[joint] = True
            joint = character.parents[joint]
    return rest


def random_pose(rng: np.random.Generator, character: TrainingCharacter, angle: float, share: float = 0.5) -> np.ndarray:
    """Rotations of a random share of the joints by up to `angle` [rad] about random axes, shape (J, 3, 3)."""
    count = len(character.joints)
    axis = rng.normal(size=(count, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True) + 1e-9
    turn = rng.uniform(0, angle, count) * (rng.random(count) < share) * ~_resting(character)
    return np.asarray(matrix_from_axis_angle(axis * turn[:, None]))


def _first_of(character: TrainingCharacter, handle: int) -> list[int]:
    """Joints of a handle whose parent is of another."""
    found = np.flatnonzero(character.handles == handle)
    return [int(j) for j in found if character.parents[j] < 0 or character.handles[character.parents[j]] != handle]


def human_rest(rng: np.random.Generator, character: TrainingCharacter, rotations: np.ndarray) -> None:
    """Turn arms up or down and legs forward, for bodies that stand upright: T, A, arms down, sitting, crouching.

    Arms are turned to an elevation, whatever theirs is now: half of the time to any, else to one between A and arms
    down, where most files have them that are not in T.
    """
    heads = np.flatnonzero((character.handles == 15) | (character.handles == 12))
    if len(heads) == 0:
        return
    spine = character.joints[heads[0]] - character.root
    if spine[1] < 0.7 * np.linalg.norm(spine):
        return
    elevation = rng.uniform(-1.45, 1.1) if rng.random() < 0.5 else rng.uniform(-1.5, -0.6)
    forward = rng.normal(0, 0.35)
    hip, knee, elbow = (
        (rng.uniform(-1.6, 0.2), rng.uniform(0, 1.6), rng.uniform(-1.2, 0.2))
        if rng.random() < 0.35
        else (0.0, 0.0, 0.0)
    )
    for sign, shoulder, arm, leg, shin in ((1, 16, 18, 1, 4), (-1, 17, 19, 2, 5)):
        lift = elevation - _elevation(character, shoulder, arm) + rng.normal(0, 0.1)
        angles = {
            shoulder: (forward, 0.0, sign * lift), arm: (elbow, 0.0, 0.0), leg: (hip, 0.0, 0.0), shin: (knee, 0.0, 0.0),
        }  # fmt: skip
        for handle, turn in angles.items():
            for joint in _first_of(character, handle):
                rotations[joint] = matrix_from_axis_angle(np.array(turn)) @ rotations[joint]


def _elevation(character: TrainingCharacter, upper: int, lower: int) -> float:
    """Angle of a limb above the horizontal [rad]; 0 where the character lacks one of its ends."""
    starts, ends = _first_of(character, upper), _first_of(character, lower)
    if not starts or not ends:
        return 0.0
    along = character.joints[ends[0]] - character.joints[starts[0]]
    return float(np.arctan2(along[1], abs(along[0]) + 1e-9))


def _normalised(points: np.ndarray) -> tuple[np.ndarray, float]:
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, float((high - low).max()) or 1.0


def _bent_normals(normals: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Normals turned with their vertices; their lengths, which say how much the surface bends, stay."""
    linear = np.einsum("vj,jab->vab", weights, transforms[:, :, :3])
    moved = np.einsum("vab,vb->va", linear, normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    out: np.ndarray = moved * length / np.maximum(np.linalg.norm(moved, axis=1, keepdims=True), 1e-9)
    return out


def plain_mesh(
    character: TrainingCharacter, rng: np.random.Generator, config: AugmentConfig | None = None
) -> TrainingMesh:
    """The character as it is, with random poses for the Pose Loss."""
    config = config or AugmentConfig()
    frames = [
        forward_kinematics(character.joints, character.parents, random_pose(rng, character, config.pose_angle))
        for _ in range(config.poses)
    ]
    c = character
    posed = skin(c.vertices, c.weights, np.stack(frames)) if frames else np.zeros((0, *c.vertices.shape), np.float32)
    return TrainingMesh(
        c.vertices, c.normals, c.areas, c.edges, c.weights, c.handles, c.target, c.root, c.height,
        np.ascontiguousarray(posed),
    )  # fmt: skip


def augment(
    character: TrainingCharacter, rng: np.random.Generator, config: AugmentConfig | None = None
) -> TrainingMesh:
    """A random variant: another rest pose, other proportions, perhaps the mirror image; and poses of it."""
    config = config or AugmentConfig()
    c = character
    vertices, normals, joints, root = (
        np.asarray(values, np.float64) for values in (c.vertices, c.normals, c.joints, c.root)
    )
    if rng.random() < (config.rest_rate):
        rotations = random_pose(rng, c, config.rest_angle * rng.random(), share=0.4)
        if rng.random() < 0.6:
            human_rest(rng, c, rotations)
        scales = np.exp(rng.uniform(-1, 1, len(joints)) * np.log(config.joint_scale) * rng.random())
        transforms = forward_kinematics(joints, c.parents, rotations, scales)
        moved = skin(vertices, c.weights, transforms[None])[0].astype(np.float64)
        if np.isfinite(moved).all():
            vertices, normals = moved, _bent_normals(normals, c.weights, transforms)
            bones = forward_kinematics(joints, c.parents, rotations)
            joints = np.einsum("jab,jb->ja", bones[:, :, :3], joints) + bones[:, :, 3]
    handles, target = c.handles, c.target
    stretch = np.exp(rng.uniform(-1, 1, 3) * np.log(config.stretch))
    turn = np.asarray(matrix_y(np.array(rng.normal(0, config.yaw)))) @ np.diag(stretch)
    if rng.random() < 0.5:
        turn = turn @ np.diag([-1.0, 1, 1])
        swap = np.array(HANDLE_MIRROR)
        handles = np.where(handles >= 0, swap[handles], -1)
        target = target[:, swap]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    vertices, joints, root = vertices @ turn.T, joints @ turn.T, root @ turn.T
    normals = normals @ np.linalg.inv(turn)
    normals *= length / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    center, scale = _normalised(vertices)
    vertices, joints, root = (vertices - center) / scale, (joints - center) / scale, (root - center) / scale
    varied = TrainingCharacter(
        c.name, vertices.astype(np.float32), normals.astype(np.float32), c.areas, c.edges, c.weights, joints, c.parents,
        handles,
        np.ascontiguousarray(target), root.astype(np.float32), float(np.ptp(vertices[:, 1])),
    )  # fmt: skip
    return plain_mesh(varied, rng, config)


def handle_target(weights: np.ndarray, handles: np.ndarray) -> np.ndarray:
    """Joint weights added up by handle, shapes (V, J), (J,) -> (V, 30)."""
    known = np.zeros((weights.shape[1], HANDLE_COUNT), np.float32)
    rows = np.flatnonzero(handles >= 0)
    known[rows, handles[rows]] = 1
    return np.asarray(weights, np.float32) @ known


def folder_chances(names: Sequence[str]) -> np.ndarray:
    """How often each character is drawn, so that thirty fish that are alike do not outweigh the rest, shape (C,)."""
    folders = [name.rpartition("/")[0] for name in names]
    share = np.array([folders.count(folder) ** -0.5 for folder in folders])
    return np.asarray(share / share.sum())
