"""The mesh features f_phi of many characters, which the diffusion model trains with (section 3.2 of TapMo)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path

import numpy as np
import torch

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import handle_positions
from bunraku.formats.files import atomic_write
from bunraku_lab.datasets.characters.training_character import AugmentConfig, TrainingCharacter, augment, plain_mesh
from bunraku_lab.nn.handles.graph import mesh_graph
from bunraku_lab.nn.handles.predictor import HandlePredictor

__all__ = ["has_human_shape", "write_mesh_bank"]

_LIMBS = [
    HANDLE_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("shoulder", "elbow", "hip", "knee")
]
LEAST = 2e-3  # share of the surface under which a part counts as absent
UPRIGHT = 0.7  # least share of the way from the pelvis to the head that leads up


def has_human_shape(character: TrainingCharacter) -> bool:
    """Whether a character is an upright body with two arms and two legs, so that a person's motion fits it."""
    mass = character.target * (character.areas / character.areas.sum())[:, None]
    share = mass.sum(axis=0)
    head = HANDLE_NAMES.index("head")
    if (share[[*_LIMBS, head]] < LEAST).any():
        return False
    positions = handle_positions(character.vertices, character.target, character.areas)
    hips = positions[[HANDLE_NAMES.index("left_hip"), HANDLE_NAMES.index("right_hip")]].mean(axis=0)
    spine = positions[head] - (positions[0] if share[0] >= LEAST else hips)
    return bool(spine[1] > UPRIGHT * np.linalg.norm(spine))


@torch.no_grad()
def write_mesh_bank(
    model: HandlePredictor,
    characters: Iterable[TrainingCharacter] | Sequence[TrainingCharacter],
    path: str | Path,
    variants: int = 3,
    seed: int = 0,
    held_out: Collection[str] = (),
    progress: Callable[[int], None] | None = None,
) -> Path:
    """Write f_phi of each character, as it is and in some other poses and proportions.

    Args:
        model: The trained predictor.
        characters: All of them; what follows a "~" in a name says which variant of a character it is.
        path: An NPZ; it gets `features` (C, 448), `names` (C,), `split` (C,), "train" or "test", and `humanoid` (C,),
            see `has_human_shape`.
        variants: Changed forms of each character beside its own; those held out have none.
        seed: Of the changes.
        held_out: Names of the characters that no training may see: their rows are "test", for evaluation only.
        progress: Called with the number of characters done.
    """
    model.eval()
    device = next(model.parameters()).device
    config = AugmentConfig(poses=0)
    features, names, split, humanoid = [], [], [], []
    for number, character in enumerate(characters):
        rng = np.random.default_rng([seed, number])
        held, upright = character.name.partition("~")[0] in held_out, has_human_shape(character)
        meshes = [plain_mesh(character, rng, config)] + [
            augment(character, rng, config) for _ in range(0 if held else variants)
        ]
        for mesh in meshes:
            graph = mesh_graph(mesh.vertices, mesh.normals, mesh.edges, mesh.areas, model.config.anchors).to(device)
            features.append(model(graph).features.float().cpu().numpy())
            names.append(character.name)
            split.append("test" if held else "train")
            humanoid.append(upright)
        if progress:
            progress(number + 1)
    path = Path(path)
    with atomic_write(path) as file:
        np.savez(
            file,
            features=np.stack(features).astype(np.float32),
            names=np.array(names),
            split=np.array(split),
            humanoid=np.array(humanoid),
        )
    return path
