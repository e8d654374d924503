"""Characters for the weakly supervised losses of TapMo (section 3.2), reduced to what the losses look at."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import Joints, downwards, reference_joints
from bunraku.anatomy.names.bone_names import handle_of_joints, limb_parents, resolve_joints
from bunraku.anatomy.rest_pose import upright
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.files import atomic_write
from bunraku.core.geometry.graph import unique_edges
from bunraku.core.geometry.surface import vertex_areas
from bunraku.core.motion import line_up
from bunraku.errors import BunrakuError, FormatError
from bunraku_lab.datasets.characters.build import HELD_OUT, RIGGED, no_characters, rigged_files
from bunraku_lab.datasets.characters.training_character import (
    AugmentConfig,
    TrainingCharacter,
    augment,
    facing_ahead,
    facing_rotation,
    handle_target,
    known_handles,
)


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

    def rows(self, split: str = "train") -> np.ndarray:
        """Rows of a split, without the reference body."""
        return np.flatnonzero([row > 0 and own == split for row, own in enumerate(self.split)])

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
        "roles": handles, "order": handles, "parents": handles, "edge_index": handles, "arm_index": handles,
        "bone_handles": handles,
    }  # fmt: skip
    limits |= {"arm_bones": bones, "bone_parents": bones, "chest_bone": bones}
    for name, limit in limits.items():
        value = getattr(bank, name)
        least = -1 if name.endswith("parents") else 0
        if value.numel() and (int(value.min()) < least or int(value.max()) >= limit):
            raise ValueError(f"{name} points outside the {limit} that there are")


_log = logging.getLogger(__name__)

EDGES, ARM_POINTS = 1500, 256
_ARMS = [i for i, name in enumerate(HANDLE_NAMES) if name.endswith(("shoulder", "elbow", "wrist", "fingers"))]
_LIMBS = [HANDLE_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("shoulder", "hip")]
_CHEST = [HANDLE_NAMES.index(name) for name in ("spine3", "spine2", "spine1", "pelvis")]

Row = dict[str, Any]


def build_character_bank(
    folder: str | Path, path: str | Path, rig: Callable[[Character], Handles], code_made: int = 0, variants: int = 2,
    progress: Callable[[int, int, str], None] | None = None,
) -> tuple[Path, dict[str, str]]:  # fmt: skip
    """Pack all rigged characters under a folder.

    Args:
        folder: Folder of rigged files, searched through.
        path: NPZ to write.
        rig: Gives a character its handles with f_phi, as the animation will.
        code_made: How many characters made by code to add.
        variants: How many changed forms of each training character to add: other proportions and rest poses.
        progress: Called with the number done, the number of all, and the name.

    Returns:
        The path, and what was left out with its reason.

    Raises:
        FormatError: There is no such file under the folder.
    """
    from bunraku.files import load_character
    from bunraku_lab.synthetic.families import code_made_character, code_made_names

    folder = Path(folder)
    files = rigged_files(folder)
    if not files:
        raise no_characters(folder, RIGGED)
    makers: dict[str, Callable[[], Character]] = {}
    for file in files:
        makers.setdefault(file.relative_to(folder).with_suffix("").as_posix(), lambda file=file: load_character(file))  # type: ignore[misc]
    for family, seed in code_made_names(code_made):
        makers[f"code_made/{family}_{seed}"] = lambda family=family, seed=seed: code_made_character(family, seed)  # type: ignore[misc]
    rows: list[Row] = []
    failed: dict[str, str] = {}
    for number, (name, make) in enumerate(makers.items()):
        if progress:
            progress(number, len(makers), name)
        try:
            character = make()
            rows.append(bank_row(character, name, rig))
            if character.rig is not None and not name.startswith("code_made/") and name not in HELD_OUT:
                random = np.random.default_rng([number, 5])
                rows += [
                    bank_row(_varied(character, name, random), f"{name}~varied{index}", rig)
                    for index in range(variants)
                ]
        except BunrakuError as error:
            failed[name] = str(error)
            _log.warning("left out %s: %s", name, error)
    if progress:
        progress(len(makers), len(makers), "")
    reference = rig(replace(reference_body().character(), rig=None)).features
    return write_rows(path, rows, np.zeros(0) if reference is None else reference), failed


def write_rows(path: str | Path, rows: Iterable[Row], reference: np.ndarray) -> Path:
    """Write a bank of rows that `bank_row` gave, the reference body, whose f_phi is `reference`, before them."""
    return save_character_bank(path, _stacked([_reference_row(reference), *rows]))


def _reference_row(features: np.ndarray) -> Row:
    """The reference body with its own handles and true joints."""
    body = reference_body()
    handles = replace(body.handles, features=features)
    still = np.tile(np.eye(3), (HANDLE_COUNT, 1, 1))
    return _row(body.character(), "reference/average", handles, still, reference_joints(), 1.0)


def bank_row(character: Character, name: str, rig: Callable[[Character], Handles], seed: int = 0) -> Row:
    """What a bank keeps of one character.

    Args:
        character: As its file has it, with or without a rig.
        name: Path of the character in its archive; some rigs are known by it.
        rig: Gives it its handles with f_phi.
        seed: Of the edges and vertices that are drawn.

    Raises:
        CharacterError: The mesh has no surface.
    """
    character = facing_ahead(character, name)
    plain = replace(character, rig=None)
    handles = rig(plain)
    anatomy = Anatomy.of(plain, handles)
    return _row(character, name, handles, *anatomy.rest, anatomy.scale, seed)


def _varied(character: Character, name: str, random: np.random.Generator) -> Character:
    """The character in another rest pose and other proportions, perhaps mirrored, facing +Z, without its rig."""
    rig = character.rig
    assert rig is not None
    rotation = facing_rotation(name, rig.names, rig.positions)
    vertices, joints = character.vertices @ rotation.T.astype(np.float32), rig.positions @ rotation.T
    weights = np.maximum(rig.dense_weights(), 0)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
    areas = vertex_areas(vertices, character.faces)
    known = known_handles(
        name, rig.names, joints,
        handle_of_joints(rig.names, rig.parents, joints, (weights * areas[:, None]).sum(axis=0)),
    )  # fmt: skip
    truth = TrainingCharacter(
        name=name, vertices=vertices, normals=np.zeros_like(vertices), areas=areas, edges=np.zeros((0, 2), np.int64),
        weights=weights, joints=joints,
        parents=limb_parents(known, rig.parents, joints), handles=known, target=handle_target(weights, known),
        root=joints[0].astype(np.float32),
        height=float(np.ptp(vertices[:, 1])),
    )  # fmt: skip
    moved = augment(truth, random, AugmentConfig(poses=0, rest_angle=0.3)).vertices * np.ptp(vertices, axis=0).max()
    mirrored = _volume(moved, character.faces) * _volume(vertices, character.faces) < 0
    faces = character.faces[:, ::-1] if mirrored else character.faces
    return Character(character.name, moved, faces)


def _volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume that the faces enclose [m^3], negative where they look inward."""
    corners = vertices[faces].astype(np.float64)
    return float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def _row(
    character: Character, name: str, handles: Handles, rotations: np.ndarray, joints: Joints, scale: float,
    seed: int = 0,
) -> Row:  # fmt: skip
    random = np.random.default_rng([seed, len(character.vertices)])
    index, weights = _top(handles.weights)
    present = joints.present
    edges = unique_edges(character.faces, len(character.vertices))
    both = (
        np.abs(handles.weights[edges[:, 0]] - handles.weights[edges[:, 1]]).sum(axis=1) > 1e-3
    )  # others keep their length
    length = np.linalg.norm(character.vertices[edges[:, 0]] - character.vertices[edges[:, 1]], axis=1)
    edges = edges[both & (length > 1e-6 * float(np.ptp(character.vertices, axis=0).max()))]
    picked = (
        edges[random.choice(len(edges), EDGES, replace=len(edges) < EDGES)]
        if len(edges)
        else np.zeros((EDGES, 2), np.int64)
    )
    row: Row = {
        "names": name, "split": "test" if name.partition("~")[0] in HELD_OUT else "train",
        "humanoid": bool(upright(handles) and present[_LIMBS].all()),
        "features": np.zeros(0) if handles.features is None else handles.features,
        "handles": handles.positions, "roles": handles.played, "rotations": rotations, "joints": joints.positions,
        "parents": joints.parents,
        "order": downwards(joints.parents), "present": present, "scale": scale, "extent": np.ptp(character.vertices,
        axis=0).max(),
        "edge_points": character.vertices[picked], "edge_index": index[picked], "edge_weights": weights[picked],
        "edge_share": len(edges) / EDGES,
    }  # fmt: skip
    return row | _arms(character, name, handles, index, weights, random)


def _arms(
    character: Character, name: str, handles: Handles, index: np.ndarray, weights: np.ndarray,
    random: np.random.Generator,
) -> Row:  # fmt: skip
    """Arm vertices, their weights on handles and on the rig, and the bones of the rig that they need."""
    row: Row = {
        "arms": False, "arm_points": np.zeros((ARM_POINTS, 3)), "arm_index": np.zeros((ARM_POINTS, 4), np.int64),
        "arm_weights": np.eye(4)[[0] * ARM_POINTS], "arm_bones": np.zeros((ARM_POINTS, 4), np.int64),
        "arm_bone_weights": np.eye(4)[[0] * ARM_POINTS],
        "bone_joints": np.zeros((1, 3)), "bone_parents": np.array([-1]), "bone_handles": np.array([0]), "chest_bone": 0,
    }  # fmt: skip
    rig = character.rig
    if rig is None:
        return row
    dense = np.maximum(rig.dense_weights(), 0)
    mass = (dense * character.areas[:, None]).sum(axis=0)
    known = known_handles(name, rig.names, rig.positions, handle_of_joints(rig.names, rig.parents, rig.positions, mass))
    by_handle = handles.weights[:, np.isin(handles.played, _ARMS)].sum(axis=1)
    by_rig = dense[:, np.isin(known, _ARMS)].sum(axis=1)
    arm = np.flatnonzero(character.surface & (by_handle > 0.3) & (by_rig > 0.3))
    if len(arm) < 20:
        return row
    parents = limb_parents(known, rig.parents, rig.positions)
    arm = random.choice(arm, ARM_POINTS, replace=len(arm) < ARM_POINTS)
    bones, shares = _top(dense[arm])
    chest = next((joint for part in _CHEST for joint in np.flatnonzero(known == part).tolist()), int(np.argmax(mass)))
    used = _with_ancestors(set(bones[shares > 0].tolist()) | {chest}, parents)
    level = np.zeros(len(parents), np.int64)
    level[used] = np.arange(len(used))
    above = np.array([level[parents[joint]] if parents[joint] >= 0 else -1 for joint in used])
    roles = resolve_joints(known, parents)[used].tolist()
    return row | {
        "arms": True, "arm_points": character.vertices[arm], "arm_index": index[arm], "arm_weights": weights[arm],
        "arm_bones": np.where(shares > 0, level[bones], 0), "arm_bone_weights": shares,
        "bone_joints": rig.positions[used], "bone_parents": above,
        "bone_handles": np.array([_playing(role, handles) for role in roles]), "chest_bone": level[chest],
    }  # fmt: skip


def _top(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The four largest weights of each vertex, shape (V, 4), renormalised, and whose they are."""
    if weights.shape[1] < 4:
        weights = np.pad(weights, ((0, 0), (0, 4 - weights.shape[1])))
    index = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    top = np.take_along_axis(weights, index, axis=1).astype(np.float64)
    total = top.sum(axis=1, keepdims=True)
    top = np.where(total > 1e-9, top / np.maximum(total, 1e-9), [1.0, 0, 0, 0])
    return np.where(top > 0, index, 0), top


def _with_ancestors(joints: set[int], parents: np.ndarray) -> list[int]:
    """Joints and all above them, every parent before its children."""
    depth: dict[int, int] = {}
    for joint in joints:
        chain = line_up(joint, parents)
        depth |= {one: len(chain) - 1 - index for index, one in enumerate(chain)}
    return sorted(depth, key=lambda joint: (depth[joint], joint))


def _playing(role: int, handles: Handles) -> int:
    """A handle that plays a part: the one of that number where it does, else the first."""
    players = np.flatnonzero(handles.played == role)
    return role if role in players else int(players[0]) if len(players) else 0


def _stacked(rows: Iterable[Row]) -> Row:
    rows = list(rows)
    bones = max(len(row["bone_joints"]) for row in rows)
    out: Row = {}
    for name in rows[0]:
        values = [np.asarray(row[name]) for row in rows]
        if name.startswith("bone_"):  # a bone too many hangs on nothing and moves nothing
            fill = -1 if name == "bone_parents" else 0
            values = [
                np.concatenate([value, np.full((bones - len(value), *value.shape[1:]), fill, value.dtype)])
                for value in values
            ]
        out[name] = np.stack(values)
    return {name: value.astype(np.float32) if value.dtype.kind == "f" else value for name, value in out.items()}
