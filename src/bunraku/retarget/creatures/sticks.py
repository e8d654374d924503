"""A skeleton as a character: a thin body around its bones, so that all that is known of characters holds for it."""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character, Rig

__all__ = ["stick_character"]

WIDTH = 0.12  # of a bone, over its length
STUB = 0.3  # length of what a joint without children carries, over the bone above it
_FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1], [5, 2, 1], [5, 3, 2], [5, 4, 3], [5, 1, 4]])


def stick_character(
    name: str, names: tuple[str, ...], parents: np.ndarray, positions: np.ndarray, known: np.ndarray
) -> Character:
    """A body of an octahedron for each bone, wholly moved by the joint that the bone leaves from.

    Args:
        name: Of the character.
        names: Of the joints, length J.
        parents: Parent of each joint, before its children; -1 for the root, shape (J,).
        positions: Of the joints in the pose that becomes the rest pose [m], shape (J, 3).
        known: Which joints are parts of a body, shape (J,), bool; bones that lead to none, such as those to the poles
            of inverse kinematics, are left out.
    """
    pieces, owners = [], []
    body = known.copy()
    for joint in range(len(names) - 1, 0, -1):  # parents stand before their children
        body[parents[joint]] |= body[joint]
    joints = np.flatnonzero(body & (parents >= 0))
    bones = [(int(parents[joint]), positions[joint]) for joint in joints]
    for joint in np.setdiff1d(joints, parents[joints]):
        bones.append((int(joint), positions[joint] + STUB * (positions[joint] - positions[parents[joint]])))
    for joint, end in bones:
        start = positions[joint]
        length = float(np.linalg.norm(end - start))
        if length > 1e-9:
            pieces.append(_octahedron(start, end, WIDTH * length))
            owners.append(joint)
    faces = np.concatenate([_FACES + 6 * number for number in range(len(pieces))])
    transforms = np.tile(np.eye(4), (len(names), 1, 1))
    transforms[:, :3, 3] = positions
    indices = np.repeat(owners, 6)[:, None]
    rig = Rig(names, parents, transforms, indices, np.ones(indices.shape))
    return Character(name, np.concatenate(pieces), faces, rig)


def _octahedron(start: np.ndarray, end: np.ndarray, width: float) -> np.ndarray:
    along = (end - start) / np.linalg.norm(end - start)
    side = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    side /= np.linalg.norm(side)
    other = np.cross(along, side)
    middle = start + 0.3 * (end - start)
    ring = [middle + width * some for some in (side, other, -side, -other)]
    return np.array([start, *ring, end])
