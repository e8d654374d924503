"""What avatar files hold besides their meshes: the model of MikuMikuDance (MMD), the humanoid and springs of VRM."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

MMD_METRE = 0.08
"""Length of one MMD unit [m]. MMD defines none; its first character, Hatsune Miku, is 158 cm tall by her makers, and
about 20 units in her model.
"""
BODY_SHAPES = ("sphere", "box", "capsule")
_MIRROR = np.array([1.0, 1, -1])


@dataclass(frozen=True)
class MmdAppend:
    """What a bone takes over from another bone's motion ("grant")."""

    bone: int  # the bone that it takes from
    ratio: float  # the share, which may be negative
    # rotation, translation: what is taken over
    rotation: bool
    translation: bool
    local: bool = False  # whether the other bone's transform relative to its parent is taken, instead of its keys


@dataclass(frozen=True)
class MmdIkLink:
    """A bone that inverse kinematics rotate."""

    bone: int
    # lower, upper: limits of its angles about x, y, z [rad], shape (3,), or None where it rotates freely
    lower: np.ndarray | None = None
    upper: np.ndarray | None = None


@dataclass(frozen=True)
class MmdIk:
    """Inverse kinematics: the bone that has them is the goal for the target."""

    target: int  # the bone that is brought to the goal, such as an ankle
    loops: int  # iterations
    limit: float  # largest rotation of a link in one step [rad]
    links: tuple[MmdIkLink, ...]  # the bones that rotate, from the target up


@dataclass(frozen=True)
class MmdBone:
    """A bone."""

    name: str  # Japanese name, by which motions know it
    english: str  # English name, often empty
    position: np.ndarray  # position in the rest pose [m], shape (3,)
    parent: int  # index of its parent, -1 for none
    layer: int = 0  # bones of higher layers are deformed later
    after_physics: bool = False  # whether it is deformed after the rigid bodies have moved
    # rotates, moves: whether motions may rotate and move it
    rotates: bool = True
    moves: bool = False
    tail: np.ndarray | None = None  # where it points, from its position [m], shape (3,)
    append: MmdAppend | None = None  # what it takes over from another bone's motion
    fixed_axis: np.ndarray | None = None  # the only axis that it rotates about, shape (3,), or None
    local_axes: np.ndarray | None = None  # rows x, y, z for the handles of editors, shape (3, 3), or None
    ik: MmdIk | None = None  # inverse kinematics whose goal it is


@dataclass(frozen=True)
class MmdMorph:
    """A morph without its offsets."""

    name: str  # Japanese name
    kind: str  # "group", "vertex", "bone", "uv", "material", "flip" or "impulse"
    count: int  # number of its offsets


@dataclass(frozen=True)
class MmdBody:
    """A rigid body."""

    name: str
    bone: int  # the bone that it goes with, -1 for none
    shape: str  # "sphere", "box" or "capsule"
    # radius of a sphere; half extents of a box; radius and distance between the ends' centres of a capsule along y [m],
    # shape (3,)
    size: np.ndarray
    position: np.ndarray  # its centre in the rest pose [m], shape (3,)
    rotation: np.ndarray  # its axes in the rest pose, columns, shape (3, 3)
    mass: float  # as in the file, 0 or more
    # linear_damping, angular_damping: share of the velocity that is lost in a second, as Bullet defines it
    linear_damping: float
    angular_damping: float
    # restitution, friction: coefficients, 0 to 1 as a rule
    restitution: float
    friction: float
    mode: int  # 0 follows its bone, 1 is moved by physics, 2 is rotated by physics and held at its bone
    group: int  # collision group, 0 to 15
    mask: int  # groups that it collides with, bit g for group g

    @property
    def dynamic(self) -> bool:
        """Whether physics move it."""
        return self.mode != 0


@dataclass(frozen=True)
class MmdJoint:
    """A joint of six degrees of freedom between two rigid bodies, with springs."""

    name: str
    bodies: tuple[int, int]  # the two bodies, A and B
    position: np.ndarray  # its position in the rest pose [m], shape (3,)
    rotation: np.ndarray  # its axes in the rest pose, columns, shape (3, 3)
    # lower, upper: limits of B's displacement along the axes [m], shape (3,); an empty range (lower > upper) is free,
    # as Bullet defines it
    lower: np.ndarray
    upper: np.ndarray
    # angle_lower, angle_upper: limits of its angles about the axes [rad], shape (3,)
    angle_lower: np.ndarray
    angle_upper: np.ndarray
    spring: np.ndarray  # stiffness against displacement, as in the file (force over MMD's unit), shape (3,)
    angle_spring: np.ndarray  # stiffness against rotation, as in the file, shape (3,)


@dataclass(frozen=True)
class MmdSdef:
    """Spherical deformation of S vertices; the rig has them as blends of two bones."""

    vertices: np.ndarray  # their indices, shape (S,)
    center: np.ndarray  # C of each [m], shape (S, 3)
    # r0, r1: R0 and R1 of each, of its two bones [m], shape (S, 3)
    r0: np.ndarray
    r1: np.ndarray


@dataclass(frozen=True, eq=False)
class MmdModel:
    """What a PMX or PMD file holds besides its mesh."""

    # name, english: names of the model; the English one is often empty
    name: str
    english: str
    version: str  # "PMX 2.0", "PMX 2.1" or "PMD"
    bones: tuple[MmdBone, ...]  # its bones, in the order of the rig's joints
    # morphs, bodies, joints: its morphs, rigid bodies and their joints
    morphs: tuple[MmdMorph, ...]
    bodies: tuple[MmdBody, ...]
    joints: tuple[MmdJoint, ...]
    deforms: np.ndarray  # how each vertex deforms: 0 BDEF1, 1 BDEF2, 2 BDEF4, 3 SDEF, 4 QDEF; shape (V,)
    sdef: MmdSdef  # constants of those that are SDEF
    warnings: tuple[str, ...] = ()  # what of the file was broken and left out or repaired, a sentence each

    @property
    def parents(self) -> np.ndarray:
        """Parent of each bone, -1 for none, shape (B,)."""
        return np.array([bone.parent for bone in self.bones], np.int64)

    @property
    def positions(self) -> np.ndarray:
        """Positions of the bones in the rest pose [m], shape (B, 3)."""
        return np.array([bone.position for bone in self.bones], float).reshape(-1, 3)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bones."""
        return tuple(bone.name for bone in self.bones)

    @property
    def order(self) -> list[int]:
        """Bones in the order in which MMD deforms them."""
        return sorted(
            range(len(self.bones)), key=lambda bone: (self.bones[bone].after_physics, self.bones[bone].layer, bone)
        )

    def bone(self, name: str) -> int:
        """Index of the first bone with this name, -1 for none."""
        return next((index for index, bone in enumerate(self.bones) if bone.name == name), -1)


def mmd_model(character: Any) -> MmdModel | None:
    """The model that a character was read from, or None if it comes from no PMX or PMD file."""
    return character.avatar if isinstance(character.avatar, MmdModel) else None


def mmd_points(values: Any) -> np.ndarray:
    """Positions or directions of MMD in our frame [m], shape (..., 3)."""
    return np.asarray(np.asarray(values, float) * _MIRROR * MMD_METRE + 0.0)  # no negative zeros


def mmd_rotation(angles: Any) -> np.ndarray:
    """The rotation of MMD's angles about x, y, z [rad] (applied about z, then x, then y) in our frame, shape (3, 3)."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(_MIRROR[:, None] * (y @ x @ z) * _MIRROR)


def mmd_angles(lower: Any, upper: Any) -> tuple[np.ndarray, np.ndarray]:
    """Limits of angles about x, y, z [rad] in our frame: those about x and y swap and change sign."""
    low, high = np.asarray(lower, float), np.asarray(upper, float)
    turned = np.array([True, True, False])
    return np.where(turned, 0 - high, low), np.where(turned, 0 - low, high)


@dataclass(frozen=True)
class VrmSpringJoint:
    """A node that swings."""

    node: int  # its index
    stiffness: float  # how strongly it returns to its rest pose
    gravity: float  # how strongly it is drawn along `gravity_direction`
    gravity_direction: np.ndarray  # in the world, shape (3,)
    drag: float  # share of its speed that it loses in a step, from 0 to 1
    radius: float  # of the ball that colliders push away [m]


@dataclass(frozen=True)
class VrmSpring:
    """A chain that swings."""

    name: str  # its name, often empty
    joints: tuple[VrmSpringJoint, ...]  # from the first to the last, each below the one before
    groups: tuple[int, ...]  # the groups of colliders that it is kept out of
    center: int = -1  # the node whose motion does not count, -1 for none
    # whether the last node swings as well, with a tail of 7 cm that the file leaves out (VRM 0.x)
    ends_free: bool = False


@dataclass(frozen=True)
class VrmCollider:
    """A body that springs are kept out of, or inside of."""

    node: int  # the node that carries it
    shape: str  # "sphere", "capsule" or "plane"
    offset: np.ndarray  # its centre, one end, or a point of the plane, in the node's axes [m], shape (3,)
    radius: float  # in metres; 0 for a plane
    # The other end of a capsule, or the normal of a plane, in the node's axes, shape (3,); None for a sphere.
    tail: np.ndarray | None = None
    inside: bool = False  # whether springs are kept inside


@dataclass(frozen=True, eq=False)
class VrmModel:
    """What a VRM file holds besides its meshes."""

    version: str  # "0.x" or "1.0"
    title: str  # name of the avatar
    humanoid: dict[str, int]  # node of each bone that VRM names ("hips", "leftUpperLeg" ...)
    # springs, colliders: the chains that swing, and all colliders
    springs: tuple[VrmSpring, ...]
    colliders: tuple[VrmCollider, ...]
    groups: tuple[tuple[int, ...], ...]  # colliders of each group
    warnings: tuple[str, ...] = ()  # what of the file was broken and left out, a sentence each


def vrm_model(character: Any) -> VrmModel | None:
    """What the VRM file of a character holds besides its meshes, or None if it comes from no VRM file."""
    return character.avatar if isinstance(character.avatar, VrmModel) else None


def warning_sentences(warnings: dict[str, list[str]]) -> tuple[str, ...]:
    """One line for each problem of a file, with the first names of its subjects."""
    out = []
    for problem, names in warnings.items():
        listed = ", ".join(" ".join(name.split())[:40] for name in names[:3] if name)
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        out.append(f"{problem}: {listed}{more}" if listed else problem)
    return tuple(out)
