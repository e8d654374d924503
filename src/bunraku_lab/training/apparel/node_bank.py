"""What the displacement networks train on: features and true displacements of the nodes of many characters, computed
once from a data set and kept in mapped files.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.displacement.features import clip_features, static_features
from bunraku.apparel.nodes import apparel_nodes, part_neighbours
from bunraku.apparel.segmentation.predict import find_apparel
from bunraku.apparel.stiffness import clothed_with_springs
from bunraku.apparel.swing import Swing
from bunraku.errors import BunrakuError, FormatError
from bunraku.formats.files import sweep
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.datasets.apparel.reader import ApparelCharacter, ApparelClip
from bunraku_lab.datasets.apparel.standing_out import standing_out

__all__ = ["BANK_NODES", "BankCharacter", "build_bank", "truly_clothed"]

BANK_NODES = 128
HEADS = (48, 72, 128)
"""Numbers of nodes that are trained on: heads of the same order, each with neighbours of its own."""
UNTOLD = 2
"""One of so many characters for training is seen once more as bare meshes are: what holds its parts is guessed."""
STANDS_OUT = 0.1
"""Share of its calm frames in which the hem of a clip may stand out for the clip to be trained on."""
_FORMAT = 6


def truly_clothed(character: ApparelCharacter) -> ClothedCharacter:
    """A character of the data set as the networks see it, with all that its file says."""
    limp = np.zeros(len(character.spring), np.float32)
    clothed = ClothedCharacter(
        character.rest, character.faces, character.joints, character.weights, character.apparel, character.part, limp,
        character.damping,
    )  # fmt: skip
    swing = None if character.swing is None else Swing.of_rows(character.swing)
    return clothed_with_springs(clothed, character.spring, character.mass, character.limit, swing=swing)


@dataclass(frozen=True, eq=False)
class BankCharacter:
    """The nodes of one character in all of its clips.

    Args:
        path: Its folder.
        name: Of the character.
    """

    path: Path
    name: str

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """Small arrays, by name."""
        with np.load(self.path / "static.npz", allow_pickle=False) as file:
            return {name: file[name] for name in file.files}

    @cached_property
    def moving(self) -> dict[str, np.ndarray]:
        """Mapped arrays of all frames: vectors (N, M, VECTORS, 3), scalars (N, M, SCALARS), whole (N, GLOBAL), truth
        (N, M, 3), turns (N, M, 3, 3), positions (N, M, 3) and root (N, 3) in the world [m].
        """
        names = ("vectors", "scalars", "whole", "truth", "turns", "positions", "root")
        return {name: np.load(self.path / f"{name}.npy", mmap_mode="r", allow_pickle=False) for name in names}

    @cached_property
    def swings(self) -> float:
        """Mean displacement of its nodes in all frames, over its size."""
        some = self.moving["truth"][:: max(1, len(self) // 64)].astype(np.float32)
        return float(np.linalg.norm(some, axis=-1).mean())

    def __len__(self) -> int:
        return int(self.arrays["frames"])

    def head(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Neighbours and parts of the first nodes."""
        parts = self.arrays["part"][:count]
        count = len(parts)
        key = next((size for size in HEADS if size >= count), HEADS[-1])
        near = self.arrays.get(f"neighbours_{key}")
        if near is None or len(near) != count:
            near = part_neighbours(self.arrays["rest"][:count].astype(np.float64), parts)
        return near, parts


def build_bank(
    data: ApparelData, folder: Path, progress: Callable[[float], None] | None = None, nodes: int = BANK_NODES
) -> list[BankCharacter]:
    """Compute what is not there yet; characters that cannot be used are left out.

    Args:
        data: The data set, of one split.
        folder: Where it is kept.
        progress: Called with the share done.
        nodes: Most nodes of a character.
    """
    out = []
    for number, (name, clips) in enumerate(_by_character(data)):
        frames = sum(clip.frames for clip in clips)
        twice = clips[0].split == "train" and zlib.crc32(name.encode()) % UNTOLD == 0
        for told in (True, False) if twice else (True,):
            path = folder / (name if told else f"{name}-untold")
            found = BankCharacter(path, name)
            if not _complete(found, frames):
                try:
                    _write(data, clips, path, nodes, told)
                except BunrakuError:
                    continue
                found = BankCharacter(path, name)
            out.append(found)
        if progress:
            progress((number + 1) / max(len(data.characters), 1))
    return out


def _by_character(data: ApparelData) -> Iterator[tuple[str, list[ApparelClip]]]:
    for name in data.characters:
        yield name, [clip for clip in data.clips if clip.character == name]


def _complete(found: BankCharacter, frames: int) -> bool:
    try:
        return int(found.arrays["format"]) == _FORMAT and int(found.arrays["of_frames"]) == frames
    except (OSError, ValueError, KeyError):
        return False


def guessed_clothed(clothed: ClothedCharacter) -> ClothedCharacter:
    """A character whose stiffness and damping the shipped mask network guesses, as those of bare meshes."""
    found = find_apparel(clothed.rest, clothed.faces, clothed.joints)
    count = np.maximum(np.bincount(clothed.part[clothed.apparel], minlength=len(clothed.stiffness)), 1)

    def mean(values: np.ndarray) -> np.ndarray:
        total = np.bincount(clothed.part[clothed.apparel], values[clothed.apparel], len(clothed.stiffness))
        return np.asarray(total / count, np.float32)

    return replace(clothed, stiffness=mean(found.stiffness), damping=mean(found.damping), limit=None, swing=None)  # type: ignore[arg-type]


def _write(data: ApparelData, clips: list[ApparelClip], path: Path, most: int, told: bool = True) -> None:
    character = data.character(clips[0])
    clothed = truly_clothed(character)
    if not told:
        clothed = guessed_clothed(clothed)
    nodes = apparel_nodes(clothed, most)
    if not len(nodes):
        raise FormatError(path, "the character has no apparel")
    path.mkdir(parents=True, exist_ok=True)
    sweep(path)
    index = np.full(len(character.rest), -1)
    index[character.loose] = np.arange(len(character.loose))
    rows = index[nodes.vertex]
    columns: dict[str, list[np.ndarray]] = {
        name: [] for name in ("vectors", "scalars", "whole", "truth", "turns", "positions", "root")
    }
    kept = []
    for clip in clips:
        shard = data.shard(clip.shard)
        transforms = shard.frames("transforms", clip.first, clip.first + clip.frames)
        loose = shard.frames("offsets", clip.first, clip.first + clip.frames)
        if standing_out(clothed, transforms, character.loose, loose) > STANDS_OUT:
            continue
        kept.append(clip.frames)
        offsets = loose[:, rows].astype(np.float32)
        offsets[:, rows < 0] = 0
        frames = clip_features(clothed, nodes, transforms)
        turns = np.stack([frame.turns for frame in frames])
        columns["truth"].append(np.einsum("nmba,nmb->nma", turns, offsets) / clothed.scale)
        columns["turns"].append(turns)
        columns["root"].append(transforms[:, 0, :, 3])
        for name in ("vectors", "scalars", "whole", "positions"):
            columns[name].append(np.stack([getattr(frame, name) for frame in frames]))
    if not kept:
        raise FormatError(path, "the hem of the character stands out in all of its clips")
    for name, values in columns.items():
        kind = np.float32 if name in ("positions", "root") else np.float16
        np.save(path / f"{name}.npy", np.concatenate(values).astype(kind))
    vectors, scalars = static_features(clothed, nodes)
    heads = {
        f"neighbours_{size}": part_neighbours(nodes.rest[:size].astype(np.float64), nodes.part[:size]) for size in HEADS
    }
    still: dict[str, Any] = {
        "format": _FORMAT, "frames": sum(kept), "of_frames": sum(clip.frames for clip in clips),
        "scale": clothed.scale, "starts": np.cumsum([0, *kept]), "static_vectors": vectors,
        "static_scalars": scalars, "rest": nodes.rest, "part": nodes.part, "vertex": nodes.vertex, **heads,
    }  # fmt: skip
    np.savez(path / "static.npz", **still)
