"""Skinning weights of any mesh for known joints, by the body network."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from bunraku.apparel.sampled_mesh import joint_distances, sampled_mesh
from bunraku.nn.checkpoints import dated
from bunraku_lab.nn.apparel.graph import node_graph
from bunraku_lab.nn.checkpoints import lab_checkpoint
from bunraku_lab.training.apparel.networks.body import BodyNetwork, load_body

__all__ = ["body_weights"]


@lru_cache(maxsize=4)
def _model(path: Path, changed: int) -> BodyNetwork:
    return load_body(path)


def body_weights(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, checkpoint: str | Path | None = None
) -> np.ndarray:
    """Skinning weights W for the 22 joints, shape (V, 22), float32, rows sum to 1.

    Args:
        vertices: Rest mesh V [m], +Y up and facing +Z, shape (V, 3).
        faces: Shape (F, 3).
        joints: J [m], shape (22, 3).
        checkpoint: Weights of kind "apparel-body"; those of a checkout when not given.

    Raises:
        CharacterError: The mesh is broken.
        WeightsError: The checkpoint is missing or does not fit.
    """
    model = _model(*dated(lab_checkpoint("apparel-body") if checkpoint is None else Path(checkpoint)))
    mesh = sampled_mesh(vertices, faces, joints)
    geodesics = joint_distances(vertices, faces, joints, mesh.clean)
    with torch.no_grad():
        weights = model(
            torch.from_numpy(mesh.points), torch.from_numpy(mesh.features[:, 3:6]),
            torch.from_numpy(mesh.joints)[None],
            torch.from_numpy(geodesics),
            node_graph([mesh.neighbours], [mesh.part]),
        ).numpy()  # fmt: skip
    full = mesh.spread(weights)
    return np.asarray(full / full.sum(axis=1, keepdims=True), np.float32)
