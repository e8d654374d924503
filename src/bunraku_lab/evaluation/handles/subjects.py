"""The characters that handles are measured on, with the truth of their rigs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from bunraku.anatomy.names.bone_names import handle_of_joints, limb_parents
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Character
from bunraku.core.geometry.surface import vertex_areas
from bunraku.errors import CharacterError
from bunraku_lab.datasets.characters.build import HELD_OUT, no_characters
from bunraku_lab.datasets.characters.training_character import (
    UPRIGHT,
    TrainingCharacter,
    facing_rotation,
    handle_target,
    known_handles,
    root_joint,
)

_NEEDED = tuple(
    HANDLE_NAMES.index(name) for name in ("pelvis", "head", "left_shoulder", "right_shoulder", "left_hip", "right_hip")
)
_HEAD = HANDLE_NAMES.index("head")
_NO_RIG = {".ply", ".stl"}


@dataclass(frozen=True, eq=False)
class Subject:
    """A rigged character as it is measured.

    Args:
        name: Path under its folder, without the suffix.
        character: The mesh facing +Z, in metres; without its rig.
        truth: Its rig on all its vertices, in metres and facing +Z.
        turn: What made it face +Z, shape (3, 3).
        path: Its file, where it has one.
    """

    name: str
    character: Character
    truth: TrainingCharacter
    turn: np.ndarray
    path: Path | None = None

    @cached_property
    def humanoid(self) -> bool:
        """See `is_humanoid`."""
        return is_humanoid(self.truth)

    @property
    def height(self) -> float:
        """Extent along +Y [m], the unit of all errors."""
        return self.character.height

    @property
    def surface(self) -> np.ndarray:
        """Vertices that have faces, shape (V,), bool. Nothing is measured on the others."""
        return self.character.surface


def is_humanoid(truth: TrainingCharacter) -> bool:
    """Whether a rig is that of an upright body with arms.

    Its bone names give a pelvis, a head, two upper arms and two thighs that move something, and the way from the root
    joint to the head joints leads up for `UPRIGHT` of its length.
    """
    mass = truth.weights.sum(axis=0)
    moving = set(truth.handles[mass > 0].tolist())
    if not moving.issuperset(_NEEDED):
        return False
    spine = truth.joints[(truth.handles == _HEAD) & (mass > 0)].mean(axis=0) - truth.root
    return bool(spine[1] > UPRIGHT * np.linalg.norm(spine))


def subject(character: Character, name: str, path: Path | None = None) -> Subject:
    """A rigged character, turned to face +Z as in training, with the truth of its rig on its own vertices.

    Raises:
        CharacterError: It has no rig, or a rig that moves nothing.
    """
    rig = character.rig
    if rig is None:
        raise CharacterError(f"{name}: there is no rig in this file; only rigged characters can be measured")
    turn = facing_rotation(name, rig.names, rig.positions)
    vertices = np.ascontiguousarray(character.vertices @ turn.T.astype(np.float32))
    joints = rig.positions @ turn.T
    weights = np.maximum(rig.dense_weights(), 0)
    total = weights.sum(axis=1, keepdims=True)
    if not (total > 1e-6).any():
        raise CharacterError(f"{name}: the rig moves no vertex; export it again with its skin weights")
    areas = vertex_areas(vertices, character.faces)
    mass = (weights * areas[:, None]).sum(axis=0)
    handles = known_handles(name, rig.names, joints, handle_of_joints(rig.names, rig.parents, joints, mass))
    weights = np.where(total > 1e-6, weights / np.maximum(total, 1e-6), 1 / weights.shape[1]).astype(np.float32)
    turned = replace(character, vertices=vertices, rig=None, source=None, avatar=None)
    truth = TrainingCharacter(
        name=name, vertices=vertices, normals=np.zeros((0, 3), np.float32), areas=areas, edges=np.zeros((0, 2),
        np.int64), weights=weights,
        joints=joints, parents=limb_parents(handles, rig.parents, joints), handles=handles,
        target=handle_target(weights, handles),
        root=root_joint(vertices[turned.surface], joints, rig.parents, handles, mass), height=turned.height,
    )  # fmt: skip
    return Subject(name, turned, truth, turn, path)


def find_files(folder: Path, everything: bool = False) -> list[Path]:
    """Character files under a folder; of the archive only those that no training sees, unless everything is asked for.

    Raises:
        FormatError: There are none.
    """
    from bunraku.files import READERS

    suffixes = READERS["character"].keys() - _NO_RIG
    files = sorted(file for file in folder.rglob("*") if file.suffix.lower() in suffixes and file.is_file())
    if not files:
        raise no_characters(folder, sorted(suffixes))
    held = [file for file in files if subject_name(folder, file) in HELD_OUT]
    return files if everything or not held else held


def subject_name(folder: Path, file: Path) -> str:
    """A file's path under the folder, without the suffix, with forward slashes."""
    return file.relative_to(folder).with_suffix("").as_posix()


def load_subject(file: Path, name: str) -> Subject:
    """A rigged character from its file.

    Raises:
        BunrakuError: It cannot be read or has no rig.
    """
    from bunraku.files import load_character

    return subject(load_character(file), name, file)


ARCHIVE: tuple[str, ...] = (
    "kaykit/Rogue_Hooded", "quaternius/modular_men/King", "quaternius/modular_women/Formal",
    "quaternius/modular_women/Witch", "quaternius/single_knight_pack/KnightCharacter",
    "quaternius2019/Smooth_Female_Dress", "valid/Black_F_1_Busi",
)  # fmt: skip
"""Held-out characters of the archive, by their paths in it."""
AVATARS: tuple[str, ...] = ("MS_Uka.pmx", "Gene.pmx", "Godette_vrm_v4.vrm")
"""Files of avatars, wherever they lie in a folder of them."""
WARDROBE: tuple[int, ...] = tuple(range(900_000, 900_010))
"""Seeds of wardrobe characters."""


def detailed_subjects(characters: Path | None = None, avatars: Path | None = None) -> dict[str, Callable[[], Subject]]:
    """How to load each detailed person, by name; files that are not there are left out."""
    out: dict[str, Callable[[], Subject]] = {}
    for name in ARCHIVE if characters is not None else ():
        assert characters is not None
        path = characters / f"{name}.glb"
        if path.is_file():
            out[name] = partial(load_subject, path, name)
    found = sorted(avatars.rglob("*")) if avatars is not None else []
    for path in found:
        if path.name in AVATARS:
            out[path.stem] = partial(load_subject, path, path.stem)
    for seed in WARDROBE:
        out[f"wardrobe/{seed}"] = partial(_wardrobe, seed)
    return out


def _wardrobe(seed: int) -> Subject:
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    return subject(wardrobe_character(seed), f"wardrobe/{seed}")
