"""What the baselines of MMDMC train on: characters of its data set as meshes of about a thousand vertices, with their
true positions in some frames, computed once.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.apparel.skinning import eq4_transforms
from bunraku.errors import BunrakuError, FormatError
from bunraku.formats.files import atomic_write, sweep
from bunraku.geometry.simplify import NetworkMesh, network_mesh
from bunraku_lab.baselines.pose_transfer import ROOM
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.datasets.apparel.reader import ApparelClip

__all__ = ["ClothedSample", "build_clothed_bank", "clothed_sample"]


@dataclass(frozen=True, eq=False)
class ClothedSample:
    """A character of M vertices in P frames.

    Args:
        name: Of the character.
        rest: In the rest pose [m], shape (M, 3).
        normals: Shape (M, 3).
        faces: Shape (F, 3).
        edges: Of the faces, and those that join loose parts, shape (E, 2).
        areas: Share of the surface of each vertex, shape (M,).
        joints: J [m], shape (22, 3).
        weights: True skinning weights, shape (M, 22).
        apparel: Share of each vertex that is apparel, shape (M,).
        affine: Affine transforms of the joints, shape (P, 22, 3, 4).
        truth: Where the vertices are [m], shape (P, M, 3).
    """

    name: str
    rest: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    edges: np.ndarray
    areas: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    apparel: np.ndarray
    affine: np.ndarray
    truth: np.ndarray


def clothed_sample(
    data: ApparelData, clips: list[ApparelClip], mesh: NetworkMesh, frames: int, seed: int
) -> ClothedSample:
    """A character in some frames of its clips, evenly taken.

    Args:
        data: The data set.
        clips: Of one character.
        mesh: Its mesh of network size.
        frames: How many in all.
        seed: Of where the first is.
    """
    character = data.character(clips[0])
    random = np.random.default_rng(seed)
    affine, truth = [], []
    for clip in clips:
        share = max(1, round(frames * clip.frames / sum(one.frames for one in clips)))
        rows = ((np.arange(share) + random.random()) * clip.frames / share).astype(np.int64)
        window = data.window(clip)
        affine.append(eq4_transforms(window.transforms[rows], character.joints))
        moved = mesh.pull(window.vertices[rows].transpose(1, 0, 2).reshape(len(character.rest), -1))
        truth.append(moved.reshape(len(moved), -1, 3).transpose(1, 0, 2))
    weights = mesh.pull(character.weights)
    return ClothedSample(
        character.name, mesh.pull(character.rest), mesh.normals, mesh.faces, mesh.edges, mesh.areas,
        character.joints.astype(np.float32), weights / weights.sum(axis=1, keepdims=True),
        mesh.pull(character.apparel[:, None].astype(np.float64))[:, 0],
        np.concatenate(affine), np.ascontiguousarray(np.concatenate(truth), np.float32),
    )  # fmt: skip


def build_clothed_bank(
    data: ApparelData, folder: Path, vertices: int = 1000, frames: int = 48,
    progress: Callable[[float], None] | None = None, most: int | None = None,
) -> list[ClothedSample]:  # fmt: skip
    """The characters of a split, computed where they are not there yet; those that cannot be used are left out. Meshes
    have from three quarters to five quarters of the vertices, on grids that lie anyhow.

    Args:
        data: The data set, of one split.
        folder: Where they are kept.
        vertices: Of a mesh, about.
        frames: Of each character.
        progress: Called with the share done.
        most: How many characters at the most.
    """
    folder.mkdir(parents=True, exist_ok=True)
    sweep(folder)
    out = []
    names = data.characters[:most]
    for number, name in enumerate(names):
        path = folder / f"{name}.npz"
        if not path.is_file():
            try:
                _write(path, _sampled(data, name, vertices, frames))
            except BunrakuError:
                continue
        out.append(_read(path))
        if progress is not None:
            progress((number + 1) / len(names))
    return out


def _sampled(data: ApparelData, name: str, vertices: int, frames: int) -> ClothedSample:
    clips = [clip for clip in data.clips if clip.character == name]
    character = data.character(clips[0])
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big")
    random = np.random.default_rng(seed)
    room = round(ROOM * vertices * random.uniform(0.75, 1.25))
    x, y, z = random.random(3)
    mesh = network_mesh(character.rest, character.faces, room, offset=(x, y, z))
    return clothed_sample(data, clips, mesh, frames, seed)


def _write(path: Path, sample: ClothedSample) -> None:
    arrays = {name: value for name, value in vars(sample).items() if name != "name"}
    with atomic_write(path) as file:
        np.savez(file, **arrays)


def _read(path: Path) -> ClothedSample:
    try:
        with np.load(path, allow_pickle=False) as file:
            return ClothedSample(path.stem, **{name: file[name] for name in file.files})
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FormatError(path, f"this is no sampled character ({error}); remove it and train again") from None
