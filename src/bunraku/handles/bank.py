"""The mesh features f_phi of many characters, which the diffusion model trains with (section 3.2 of TapMo)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from bunraku.formats.files import atomic_write
from bunraku.handles.graph import mesh_graph
from bunraku.handles.predictor import HandlePredictor
from bunraku.handles.training_data import AugmentConfig, TrainingCharacter, augment, plain_mesh

__all__ = ["write_mesh_bank"]


@torch.no_grad()
def write_mesh_bank(model: HandlePredictor, characters: Sequence[TrainingCharacter], path: str | Path, variants: int = 3, seed: int = 0) -> Path:
    """Write f_phi of each character, as it is and in some other poses and proportions.

    Args:
        model: The trained predictor.
        characters: Those of the training split.
        path: An NPZ; it gets `features`, shape (C, 448), and `names`, shape (C,).
        variants: Changed forms of each character beside its own.
        seed: Of the changes.
    """
    model.eval()
    device = next(model.parameters()).device
    config = AugmentConfig(poses=0)
    features, names = [], []
    for number, character in enumerate(characters):
        rng = np.random.default_rng([seed, number])
        meshes = [plain_mesh(character, rng, config)] + [augment(character, rng, config) for _ in range(variants)]
        for mesh in meshes:
            graph = mesh_graph(mesh.vertices, mesh.normals, mesh.edges, mesh.areas, model.config.anchors).to(device)
            features.append(model(graph).features.float().cpu().numpy())
            names.append(character.name)
    path = Path(path)
    with atomic_write(path) as file:
        np.savez(file, features=np.stack(features).astype(np.float32), names=np.array(names))
    return path
