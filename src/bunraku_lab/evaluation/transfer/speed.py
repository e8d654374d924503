"""How exact BVH files are, and how long reading and transferring motion takes."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.character import Character
from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton

__all__ = ["MANY", "bvh_again", "times"]

MANY = 20_000  # vertices of the character that is timed


def bvh_again(path: Path) -> float | None:
    """Largest difference of a rotation after a skeletal motion is written as BVH and read again [degrees]."""
    from bunraku.formats.bvh.write import write_bvh
    from bunraku.geometry.rotations import axis_angle_from_matrix
    from bunraku.io.registry import read_motion

    motion = read_motion(path)
    if not isinstance(motion, SkeletalMotion):
        return None
    with tempfile.TemporaryDirectory() as folder:
        again = read_motion(write_bvh(motion, Path(folder) / "again.bvh"))
    assert isinstance(again, SkeletalMotion)
    order = [again.skeleton.names.index(name) for name in motion.skeleton.names]
    change = np.swapaxes(again.rotations[:, order].astype(float), -1, -2) @ motion.rotations.astype(float)
    return float(np.degrees(np.linalg.norm(axis_angle_from_matrix(change), axis=-1)).max())


def times(character: Character | None, walk: HandleMotion) -> dict[str, float | None]:
    """Seconds of reading a long BVH and of 10 s of motion onto a character's rig and onto its handles.

    Args:
        character: With a rig; its triangles are split until they have `MANY` vertices. None leaves out what needs it.
        walk: Motion of the reference body; played on to 10 s.
    """
    out: dict[str, float | None] = {"seconds_bvh": _bvh_seconds(), "seconds_rig": None, "seconds_handles": None}
    if character is None:
        return out
    from bunraku.pipelines.animate import rig
    from bunraku.pipelines.transfer import transfer

    dense = _many(character)
    rounds = int(np.ceil(200 / len(walk)))
    long = replace(walk.take(np.tile(np.arange(len(walk)), rounds)[:200]), fps=20.0)
    ways: Sequence[tuple[str, dict[str, Any]]] = (
        ("seconds_rig", {"onto": "rig"}),
        ("seconds_handles", {"onto": "handles", "handles": rig(dense)}),
    )
    for key, how in ways:
        taken = []
        for _ in range(2):  # the first call also loads what is kept
            start = time.perf_counter()
            transfer(dense, long, **how).vertices()
            taken.append(time.perf_counter() - start)
        out[key] = min(taken)
    return out


def _many(character: Character) -> Character:
    """The character with each triangle split into four until it has 20,000 vertices or more."""
    from bunraku.core.character import Rig, top_influences

    rig = character.rig
    assert rig is not None
    weights = rig.dense_weights()
    vertices, faces = character.vertices.astype(np.float64), character.faces
    while len(vertices) < MANY:
        sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        pairs, index = np.unique(sides, axis=0, return_inverse=True)
        middles = len(vertices) + index.reshape(-1, 3)
        (a, b, c), (p, q, r) = faces.T, middles.T
        faces = np.concatenate([np.stack(three, axis=1) for three in ((a, p, r), (p, b, q), (r, q, c), (p, q, r))])
        vertices, weights = (np.concatenate([some, some[pairs].mean(axis=1)]) for some in (vertices, weights))
    indices, shares = top_influences(weights, 4)
    return Character(character.name, vertices, faces, Rig(rig.names, rig.parents, rig.transforms, indices, shares))


def _bvh_seconds() -> float:
    """Time to read a file of 14,400 frames of 31 joints [s], the best of two."""
    from bunraku.formats.bvh.write import write_bvh
    from bunraku.geometry.rotations import matrix_from_axis_angle
    from bunraku.io.registry import read_motion

    random = np.random.default_rng(0)
    names = tuple(HANDLE_NAMES) + ("end",)
    parents = np.array([-1] + [max(0, joint - 1 - joint % 5) for joint in range(1, 31)])
    swing = np.sin(np.linspace(0, 300, 14_400))[:, None, None] * random.normal(size=(1, 31, 3))
    motion = SkeletalMotion(
        Skeleton(names, parents, random.normal(size=(31, 3)) * 0.2),
        matrix_from_axis_angle(swing),
        np.zeros((14_400, 3)),
        120.0,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = write_bvh(motion, Path(folder) / "long.bvh")
        taken = []
        for _ in range(2):
            start = time.perf_counter()
            read_motion(path)
            taken.append(time.perf_counter() - start)
    return min(taken)
