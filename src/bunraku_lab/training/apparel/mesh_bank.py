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

__all__ = ["MeshSample", "bare_meshes", "build_meshes", "mesh_sample", "worn_meshes"]

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

    def made(seed: int, name: str) -> MeshSample | None:
        try:
            return mesh_sample(wardrobe_character(seed), name, seed)
        except BunrakuError:
            return None

    return _by_split(folder, "wardrobe", range(first, first + count), made, progress)


def bare_meshes(folder: Path, source: Path) -> list[MeshSample]:
    """Samples of characters on which nothing is apparel, by predicted handles, computed once.

    Args:
        folder: Where they are kept.
        source: Folder of the characters; those that cannot be read are left out.
    """
    from bunraku.io import load_character
    from bunraku.pipelines.animate import rig
    from bunraku.pipelines.clothes import body_of_handles

    folder.mkdir(parents=True, exist_ok=True)
    sweep(folder)
    out = []
    for number, file in enumerate(sorted(source.glob("*.glb"))):
        path = folder / f"bare_{file.stem}.npz"
        if not path.is_file():
            try:
                character = load_character(file)
                weights, joints = body_of_handles(character, rig(character))
                nothing = np.zeros(len(character.vertices), bool)
                _write(path, _seen(character, joints, weights, nothing, file.stem, number))
            except BunrakuError:
                continue
        out.append(_read(path))
    return out


def worn_meshes(folder: Path, clothes: Path, count: int, first: int = 700_000) -> dict[str, list[MeshSample]]:
    """Samples of people in MakeHuman's clothes by split, on whom skirts, capes, tails, ears and long hair are apparel
    as a whole, computed once.

    Args:
        folder: Where they are kept.
        clothes: MakeHuman's clothes and hair.
        count: How many people.
        first: Seed of the first.

    Raises:
        FormatError: The clothes or the body are missing or damaged.
    """
    from bunraku_lab.synthetic.dressed.people import dressed_person
    from bunraku_lab.synthetic.wardrobe.makehuman import closet

    def made(seed: int, name: str) -> MeshSample:
        person = dressed_person(closet(str(clothes)), seed)
        return _seen(person.character(name), person.joints, person.piece.joints, person.hangs, name, seed)

    return _by_split(folder, "worn", range(first, first + count), made)


def _by_split(
    folder: Path, kind: str, seeds: range, made: Callable[[int, str], MeshSample | None],
    progress: Callable[[float], None] | None = None,
) -> dict[str, list[MeshSample]]:  # fmt: skip
    """Samples of seeds by the split of their names, each made once and kept in a folder; None is left out."""
    folder.mkdir(parents=True, exist_ok=True)
    sweep(folder)
    out: dict[str, list[MeshSample]] = {"train": [], "val": [], "test": []}
    for done, seed in enumerate(seeds, 1):
        name = f"{kind}_{seed:06d}"
        path = folder / f"{name}.npz"
        if not path.is_file():
            sample = made(seed, name)
            if sample is None:
                continue
            _write(path, sample)
        out[character_split(name)].append(_read(path))
        if progress:
            progress(done / len(seeds))
    return out


def _seen(
    character: Character, joints: np.ndarray, weights: np.ndarray, apparel: np.ndarray, name: str, seed: int
) -> MeshSample:
    """A sample of a character of which is known what is apparel, and not how it moves."""
    joints = joints.astype(np.float32)
    mesh = sampled_mesh(character.vertices, character.faces, joints, seed=seed)
    first = np.zeros(mesh.index.max() + 1, np.int64)
    first[mesh.index] = np.arange(len(mesh.index))
    unknown = np.full(len(mesh.clean), np.nan, np.float32)
    own = first[mesh.clean]
    return MeshSample(
        name, mesh, apparel[own], unknown, unknown, weights[own].astype(np.float32),
        joint_distances(character.vertices, character.faces, joints, mesh.clean),
    )  # fmt: skip


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
