"""What the segmentation and the body network train on: sampled meshes of the wardrobe with their masks, stiffness,
weights and geodesic distances. No physics are simulated for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from bunraku.apparel.learned.segmentation import SampledMesh, joint_distances, sampled_mesh
from bunraku.apparel.physics.clothed_from_file import clothed_from_file
from bunraku.core.character import Character
from bunraku_lab.datasets.apparel.plan import character_split
from bunraku_lab.training.rows.banks import kept_arrays

__all__ = ["MeshSample", "build_meshes", "mesh_sample"]

_MESH = ("clean", "points", "joints", "features", "part", "neighbours")


@dataclass(frozen=True, eq=False)
class MeshSample:
    """A character of the wardrobe.

    Args:
        name: Its name.
        mesh: Its points.
        apparel: Which are apparel, shape (S,), bool.
        stiffness: Of apparel points (`part_stiffness`), shape (S,); NaN where nobody knows.
        damping: log10 of what a second leaves of their velocity, shape (S,).
        weights: True skinning weights, shape (S, 22).
        geodesics: G, shape (S, 22).
    """

    name: str
    mesh: SampledMesh
    apparel: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    weights: np.ndarray
    geodesics: np.ndarray


def mesh_sample(character: Character, name: str, seed: int = 0) -> MeshSample:
    """Sample a character whose file has physics.

    Raises:
        BunrakuError: It cannot be used.
    """
    clothed = clothed_from_file(character)
    mesh = sampled_mesh(clothed.rest, clothed.faces, clothed.joints, seed=seed)
    first = np.zeros(mesh.index.max() + 1, np.int64)
    first[mesh.index] = np.arange(len(mesh.index))
    cloth = np.zeros(len(first), bool)
    cloth[mesh.index[clothed.apparel]] = True
    part = np.full(len(first), -1)
    part[mesh.index[clothed.apparel]] = clothed.part[clothed.apparel]
    own = part[mesh.clean]
    stiffness = np.where(own >= 0, clothed.stiffness[own], 0)
    damping = np.where(own >= 0, np.log10(1 - np.clip(clothed.damping, 0, 0.999))[own], 0)
    return MeshSample(
        name, mesh, cloth[mesh.clean], stiffness.astype(np.float32), damping.astype(np.float32),
        clothed.weights[first[mesh.clean]].astype(np.float32),
        joint_distances(clothed.rest, clothed.faces, clothed.joints, mesh.clean),
    )  # fmt: skip


def build_meshes(
    folder: Path, count: int, first: int = 10_000, progress: Callable[[float], None] | None = None
) -> dict[str, list[MeshSample]]:
    """Samples of wardrobe characters by split, computed once.

    Args:
        folder: Where they are kept.
        count: How many characters.
        first: Seed of the first.
        progress: Called with the share done.

    Raises:
        FormatError: A file of the folder is damaged.
    """
    makers = {f"wardrobe_{seed:06d}": partial(_arrays, seed) for seed in range(first, first + count)}
    out: dict[str, list[MeshSample]] = {"train": [], "val": [], "test": []}
    empty = np.zeros(0, np.int64)
    for name, arrays in kept_arrays(folder, makers, progress):
        mesh = SampledMesh(**{key: arrays.pop(key) for key in _MESH}, index=empty, nearest=empty, shares=empty)
        out[character_split(name)].append(MeshSample(name, mesh, **arrays))
    return out


def _arrays(seed: int) -> dict[str, np.ndarray]:
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    sample = mesh_sample(wardrobe_character(seed), "", seed)
    arrays = {key: value for key, value in vars(sample).items() if key not in ("name", "mesh")}
    return {key: getattr(sample.mesh, key) for key in _MESH} | arrays
