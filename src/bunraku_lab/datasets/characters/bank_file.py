"""Characters for the weakly supervised losses of TapMo (section 3.2), each reduced to what the losses look at.

The handle predictor is frozen while the diffusion model trains, so what it says of a character is computed once and
packed into one file by `bunraku data character-bank`: f_phi, handles, how a motion of the reference body is fitted to
them, a sample of the mesh's edges, vertices of the arms, and the bones of the character's own rig that move those. Row
0 is the reference body.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bunraku.errors import FormatError
from bunraku.formats.files import atomic_write

__all__ = ["CharacterBank", "load_character_bank", "save_character_bank"]


@dataclass(frozen=True, eq=False)
class CharacterBank:
    """C characters with K handles, S pairs of edge ends, A arm vertices and J bones each; all in metres, facing +Z.

    Args:
        names: Path of each character in its archive, length C; row 0 is the reference body.
        split: "train" or "test" (those that no training sees), length C.
        humanoid: Whether it is upright and has arms and legs, shape (C,).
        features: Mesh deformation feature f_phi, shape (C, 448).
        handles: Handle positions h, shape (C, K, 3).
        roles: Part that each handle plays, shape (C, K).
        rotations: Turn from the rest pose to the reference body's (`Anatomy.rotations`), shape (C, K, 3, 3).
        joints: Joint between each handle and its parent, shape (C, K, 3).
        parents: Shape (C, K), -1 for the root.
        order: Handles, every parent before its children, shape (C, K).
        present: Whether a handle has vertices of its own, shape (C, K).
        scale: Stride scale: what the reference body's metres become, shape (C,).
        extent: Largest extent of the rest pose, shape (C,).
        edge_points: Rest positions of the ends of sampled edges, shape (C, S, 2, 3).
        edge_index, edge_weights: Handles and weights of those ends, shape (C, S, 2, 4).
        edge_share: Edges that one sampled edge stands for, shape (C,).
        arms: Whether it has arms that its rig moves, shape (C,).
        arm_points: Rest positions of vertices of the arms, shape (C, A, 3).
        arm_index, arm_weights: Their handles and weights, shape (C, A, 4).
        arm_bones, arm_bone_weights: The bones of the rig that move them, and weights, shape (C, A, 4).
        bone_joints: Joints of those bones, parents first, shape (C, J, 3).
        bone_parents: Shape (C, J), -1 for roots.
        bone_handles: Handle whose rotation each bone takes, shape (C, J).
        chest_bone: Bone that stands for the chest, shape (C,).
    """

    names: tuple[str, ...]
    split: tuple[str, ...]
    humanoid: Tensor
    features: Tensor
    handles: Tensor
    roles: Tensor
    rotations: Tensor
    joints: Tensor
    parents: Tensor
    order: Tensor
    present: Tensor
    scale: Tensor
    extent: Tensor
    edge_points: Tensor
    edge_index: Tensor
    edge_weights: Tensor
    edge_share: Tensor
    arms: Tensor
    arm_points: Tensor
    arm_index: Tensor
    arm_weights: Tensor
    arm_bones: Tensor
    arm_bone_weights: Tensor
    bone_joints: Tensor
    bone_parents: Tensor
    bone_handles: Tensor
    chest_bone: Tensor

    def __len__(self) -> int:
        return len(self.names)

    def rows(self, split: str = "train", humanoid: bool | None = None) -> np.ndarray:
        """Rows of a split, without the reference body; only humanoids, or only others, where asked for."""
        kept = [
            row > 0 and own == split and (humanoid is None or bool(self.humanoid[row]) == humanoid)
            for row, own in enumerate(self.split)
        ]
        return np.flatnonzero(kept)

    def to(self, device: str | torch.device) -> CharacterBank:
        """The bank on another device."""
        moved: dict[str, Any] = {
            name: value.to(device) for name, value in vars(self).items() if isinstance(value, Tensor)
        }
        return replace(self, **moved)


def save_character_bank(path: str | Path, bank: dict[str, np.ndarray]) -> Path:
    """Write arrays by the names of `CharacterBank`'s fields as NPZ, whole or not at all."""
    path = Path(path)
    with atomic_write(path) as file:
        np.savez_compressed(file, **bank)  # type: ignore[arg-type]  # its own keyword is no name of a field
    return path


def load_character_bank(path: str | Path) -> CharacterBank:
    """A bank that `bunraku data character-bank` wrote.

    Raises:
        FormatError: The file is missing, damaged, or its parts disagree.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            raw = {field.name: file[field.name] for field in fields(CharacterBank)}
        names = tuple(str(name) for name in raw.pop("names"))
        split = tuple(str(name) for name in raw.pop("split"))
        values = {name: torch.from_numpy(_plain(value)) for name, value in raw.items()}
        bank = CharacterBank(names, split, **values)
        _check(bank)
    except Exception as error:
        raise FormatError(
            path, f"this is not a bank of characters ({error}); write one with 'bunraku data character-bank'"
        ) from error
    return bank


def _plain(value: np.ndarray) -> np.ndarray:
    if value.dtype.kind == "f":
        if not np.isfinite(value).all():
            raise ValueError("it holds values that are not numbers")
        return np.ascontiguousarray(value, np.float32)
    return np.ascontiguousarray(value) if value.dtype.kind == "b" else np.ascontiguousarray(value, np.int64)


def _check(bank: CharacterBank) -> None:
    count, handles = bank.handles.shape[:2]
    bones = bank.bone_joints.shape[1]
    for name, value in vars(bank).items():
        if len(value) != count:
            raise ValueError(f"{name} has {len(value)} rows, not {count}")
    limits = {
        "roles": handles,
        "order": handles,
        "parents": handles,
        "edge_index": handles,
        "arm_index": handles,
        "bone_handles": handles,
    }
    limits |= {"arm_bones": bones, "bone_parents": bones, "chest_bone": bones}
    for name, limit in limits.items():
        value = getattr(bank, name)
        least = -1 if name.endswith("parents") else 0
        if value.numel() and (int(value.min()) < least or int(value.max()) >= limit):
            raise ValueError(f"{name} points outside the {limit} that there are")
