"""A character as the target of Skeleton-free Pose Transfer, all of its vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion
from bunraku.core.skinning import skin
from bunraku.geometry.simplify import NetworkMesh, network_mesh
from bunraku_lab.baselines.pose_transfer import (
    ROOM,
    PartMesh,
    SourcePoses,
    in_metres,
    in_root_frame,
    over_height,
    source_body,
    source_poses,
    source_turns,
    transferred,
)
from bunraku_lab.nn.baselines.pose_transfer import TransferNetwork

__all__ = ["SourceMotion", "TransferTarget", "source_motion"]


@dataclass(frozen=True, eq=False)
class SourceMotion:
    """A motion of the reference body as pose transfer takes it, whatever the target.

    Args:
        poses: In the frame of the root.
        turns: Of the root, shape (N, 3, 3).
        path: Of the root from where it is at rest [m], shape (N, 3).
    """

    poses: SourcePoses
    turns: np.ndarray
    path: np.ndarray


def source_motion(model: TransferNetwork, motion: SkeletalMotion) -> SourceMotion:
    """A motion of the reference body's joints.

    Args:
        model: The networks that take it.
        motion: Of SMPL's 22 joints.
    """
    turns, positions = motion.world()
    own = (np.swapaxes(turns[:, :1], 2, 3) @ turns).astype(np.float32)
    body = source_body()
    poses = source_poses(model, body.mesh, body.posed(own))
    return SourceMotion(poses, turns[:, 0], positions[:, 0] - reference_body().joints[0])


@dataclass(frozen=True, eq=False)
class TransferTarget:
    """A character, and the networks that move it.

    Args:
        rest: Vertices at rest [m], shape (V, 3).
        weights: Of the parts at each vertex, shape (V, K); None where the networks predict them.
        model: The networks.
        network: The mesh that they see.
        mesh: The same with its parts, over the height.
        origin: Where lengths over the height begin [m], shape (3,).
        height: [m].
    """

    rest: np.ndarray
    weights: np.ndarray | None
    model: TransferNetwork
    network: NetworkMesh
    mesh: PartMesh
    origin: np.ndarray
    height: float

    @classmethod
    def of(
        cls, vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray | None, root: np.ndarray,
        model: TransferNetwork, size: int = 1000,
    ) -> TransferTarget:  # fmt: skip
        """A mesh, facing +Z.

        Args:
            vertices: At rest [m], shape (V, 3).
            faces: Shape (F, 3).
            weights: Of the parts, shape (V, K); None for networks that predict them.
            root: Position of the root [m], shape (3,).
            model: The networks.
            size: Vertices of the mesh that they see, about.

        Raises:
            CharacterError: The mesh has no surface.
        """
        network = network_mesh(vertices, faces, round(ROOM * size))
        rest = network.pull(vertices)
        height = float(np.ptp(vertices[:, 1]))
        origin = np.array([root[0], rest[:, 1].min(), root[2]], np.float32)
        own = np.zeros((len(rest), 0), np.float32)
        if weights is not None:
            own = network.pull(weights)
            own /= own.sum(axis=1, keepdims=True)
        mesh = PartMesh((rest - origin) / np.float32(height), network.faces, network.edges, own)
        return cls(np.asarray(vertices, np.float32), weights, model, network, mesh, origin, height)

    def with_joints(self, affine: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """Its vertices where joints that are known move so [m], shape (P, V, 3); the source rests as it does, and takes
        the same pose.

        Args:
            affine: Affine transforms of its joints, shape (P, 22, 3, 4).
            joints: J at rest [m], shape (22, 3).
        """
        own, _ = in_root_frame(affine, np.zeros((len(affine), 0, 3), np.float32))
        tied = self.model.config.tied
        known = over_height(own[:, :tied], self.origin, self.height) if tied else None
        body = source_body()
        posed = body.posed(source_turns(affine[..., :3], joints))
        moved, weights = self._moved(source_poses(self.model, body.resting_as(joints), posed), known)
        turns, shift = affine[:, :1, :, :3], affine[:, :1, :, 3:]
        world = np.concatenate([turns @ moved[..., :3], turns @ moved[..., 3:] + shift], axis=3)
        return np.asarray(skin(self.rest, weights, world))

    def with_motion(self, motion: SourceMotion, root: np.ndarray) -> np.ndarray:
        """Its vertices as the reference body moves [m], shape (N, V, 3); its path is longer the higher its root is.

        Args:
            motion: Of the reference body, as `source_motion` gives it for the same networks.
            root: Position of its own root at rest [m], shape (3,).
        """
        moved, weights = self._moved(motion.poses, None)
        body = reference_body()
        scale = (root[1] - self.origin[1]) / (body.joints[0, 1] - body.vertices[:, 1].min())
        points = np.asarray(skin(self.rest, weights, moved)) - root
        path = root + scale * motion.path
        return np.asarray(np.einsum("nab,nvb->nva", motion.turns, points) + path[:, None], np.float32)

    def _moved(self, poses: SourcePoses, joints: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Affine transforms of the parts in the frame of the root [m], (P, K, 3, 4), and their weights, (V, K)."""
        affine, weights = transferred(self.model, poses, self.mesh, joints)
        if self.weights is not None:
            return in_metres(affine, self.origin, self.height), self.weights
        full = self.network.push(weights)
        return in_metres(affine, self.origin, self.height), full / full.sum(axis=1, keepdims=True)
