"""What a VRM file holds beside its meshes: the bones of the person, spring bones and colliders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["VrmCollider", "VrmModel", "VrmSpring", "VrmSpringJoint", "vrm_model"]


@dataclass(frozen=True)
class VrmSpringJoint:
    """A node that swings.

    Args:
        node: Its index.
        stiffness: How strongly it goes back to its rest pose.
        gravity: How strongly it is drawn along `gravity_direction`.
        gravity_direction: In the world, shape (3,).
        drag: Share of its speed that it loses in a step, from 0 to 1.
        radius: Of the ball that colliders push away [m].
    """

    node: int
    stiffness: float
    gravity: float
    gravity_direction: np.ndarray
    drag: float
    radius: float


@dataclass(frozen=True)
class VrmSpring:
    """A chain that swings.

    Args:
        name: Its name, often empty.
        joints: From the first to the last, each below the one before.
        groups: The groups of colliders that it is kept out of.
        center: The node whose motion does not count, -1 for none.
        ends_free: Whether the last node swings as well, with a tail of 7 cm that the file leaves out (VRM 0.x).
    """

    name: str
    joints: tuple[VrmSpringJoint, ...]
    groups: tuple[int, ...]
    center: int = -1
    ends_free: bool = False


@dataclass(frozen=True)
class VrmCollider:
    """A body that springs are kept out of, or inside of.

    Args:
        node: The node that carries it.
        shape: "sphere", "capsule" or "plane".
        offset: Its centre, one end or a point of the plane, in the node's axes [m], shape (3,).
        radius: In metres; 0 for a plane.
        tail: The other end of a capsule, or the normal of a plane, in the node's axes, shape (3,); None for a sphere.
        inside: Whether springs are kept inside.
    """

    node: int
    shape: str
    offset: np.ndarray
    radius: float
    tail: np.ndarray | None = None
    inside: bool = False


@dataclass(frozen=True, eq=False)
class VrmModel:
    """What a VRM file holds beside its meshes.

    Args:
        version: "0.x" or "1.0".
        title: Name of the avatar.
        humanoid: Node of each bone that VRM names ("hips", "leftUpperLeg" ...).
        springs: The chains that swing.
        colliders: All colliders.
        groups: Colliders of each group.
        warnings: What of the file was broken and left out, a sentence each.
    """

    version: str
    title: str
    humanoid: dict[str, int]
    springs: tuple[VrmSpring, ...]
    colliders: tuple[VrmCollider, ...]
    groups: tuple[tuple[int, ...], ...]
    warnings: tuple[str, ...] = ()


def vrm_model(character: Any) -> VrmModel | None:
    """What the VRM file of a character holds beside its meshes, None where it comes from no VRM file."""
    return character.avatar if isinstance(character.avatar, VrmModel) else None
