"""What the segmentation and the body network train on: sampled meshes of the wardrobe with their masks, stiffness,
weights and geodesic distances. No physics are simulated for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.apparel.sampled_mesh import SampledMesh, joint_distances, sampled_mesh
from bunraku.core.character import Character
from bunraku.errors import BunrakuError, FormatError
from bunraku.formats.files import atomic_write, sweep
from bunraku.physics.told.clothed import clothed_from_file
from bunraku_lab.datasets.apparel.plan import character_split

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
    """
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    folder.mkdir(parents=True, exist_ok=True)
    sweep(folder)
    out: dict[str, list[MeshSample]] = {"train": [], "val": [], "test": []}
    for done, seed in enumerate(range(first, first + count), 1):
        name = f"wardrobe_{seed:06d}"
        path = folder / f"{name}.npz"
        if not path.is_file():
            try:
                sample = mesh_sample(wardrobe_character(seed), name, seed)
            except BunrakuError:
                continue
            _write(path, sample)
        out[character_split(name)].append(_read(path))
        if progress:
            progress(done / count)
    return out


def _write(path: Path, sample: MeshSample) -> None:
    mesh = {
        name: getattr(sample.mesh, name) for name in ("clean", "points", "joints", "features", "part", "neighbours")
    }
    own = {name: getattr(sample, name) for name in ("apparel", "stiffness", "damping", "weights", "geodesics")}
    with atomic_write(path) as file:
        np.savez(file, **mesh, **own)  # type: ignore[arg-type]


def _read(path: Path) -> MeshSample:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        empty = np.zeros(0, np.int64)
        own = {name: arrays.pop(name) for name in _MESH}
        mesh = SampledMesh(**own, index=empty, nearest=empty, shares=empty)
        return MeshSample(path.stem, mesh, **arrays)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FormatError(path, f"this is no sampled mesh ({error}); remove it and train again") from None
