"""Neural Blend Shapes (Li et al., SIGGRAPH 2021) on any mesh with given joints: the trained networks see it in network
size, and what they say is carried to every vertex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from bunraku.core.skinning import skin
from bunraku.geometry.simplify import network_mesh
from bunraku_lab.baselines.pose_transfer import ROOM
from bunraku_lab.nn.baselines.blend_shapes import NbsNetwork, local_turns
from bunraku_lab.nn.baselines.edge_mesh import edge_mesh

__all__ = ["BlendedMesh", "blended_mesh"]


@dataclass(frozen=True, eq=False)
class BlendedMesh:
    """A mesh as Neural Blend Shapes moves it.

    Args:
        rest: Vertices at rest [m], shape (V, 3).
        weights: Of the joints, shape (V, 22), rows sum to 1.
        shapes: Blend shapes of each vertex [m], shape (V, S, 3); none where the network has no such branch.
        takes: Which joints' shapes each vertex takes, shape (V, 22).
        model: The networks, whose coefficients depend on the pose.
    """

    rest: np.ndarray
    weights: np.ndarray
    shapes: np.ndarray | None
    takes: np.ndarray | None
    model: NbsNetwork

    def posed(self, affine: np.ndarray) -> np.ndarray:
        """Its vertices in poses [m], shape (P, V, 3).

        Args:
            affine: Affine transforms of the joints, shape (P, 22, 3, 4).
        """
        if self.shapes is None or self.takes is None or self.model.blend is None:
            return np.asarray(skin(self.rest, self.weights, affine))
        shapes, takes = torch.from_numpy(self.shapes), torch.from_numpy(self.takes)
        with torch.no_grad():
            turns = local_turns(torch.from_numpy(np.asarray(affine[..., :3], np.float32)))
            added = self.model.blend.moved(shapes, takes, turns).numpy()
        return np.stack(
            [skin(self.rest + more, self.weights, pose[None])[0] for more, pose in zip(added, affine, strict=True)]
        )


def blended_mesh(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, model: NbsNetwork, size: int = 1000
) -> BlendedMesh:
    """What the networks say of a mesh.

    Args:
        vertices: At rest [m], +Y up and facing +Z, shape (V, 3).
        faces: Shape (F, 3).
        joints: J [m], shape (22, 3).
        model: The networks.
        size: Vertices of the mesh that they see, about.

    Raises:
        CharacterError: The mesh has no surface.
    """
    mesh = network_mesh(vertices, faces, round(ROOM * size))
    rest = mesh.pull(vertices)
    low, height = rest[:, 1].min(), float(np.ptp(rest[:, 1]))
    origin = np.array([joints[0, 0], low, joints[0, 2]], np.float32)
    edges = edge_mesh(mesh.faces, mesh.edges, len(rest))
    shapes = takes = None
    with torch.no_grad():
        weights, logits, middles = model.skinned(torch.from_numpy((rest - origin) / np.float32(height)), edges)
        if model.blend is not None:
            said, taken = model.blend(middles, logits, weights, edges)
            flat = mesh.push(height * said.flatten(1).numpy())
            shapes = np.asarray(flat.reshape(len(vertices), -1, 3), np.float32)
            takes = np.asarray(mesh.push(taken.numpy()), np.float32)
    full = mesh.push(weights.numpy())
    return BlendedMesh(np.asarray(vertices, np.float32), full / full.sum(axis=1, keepdims=True), shapes, takes, model)
