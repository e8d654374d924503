"""Pairs that pose transfer learns from: a source in a pose, and a target that should take it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bunraku_lab.baselines.pose_transfer import PartMesh, source_body

__all__ = ["Pair", "Target", "drawn_pairs"]

REFERENCE = "reference_"
"""What the names of the reference body's shapes begin with."""
OF_REFERENCE = 0.5
"""Share of the pairs whose source is one of them; the others' is any character."""


@dataclass(frozen=True, eq=False)
class Target:
    """A character in P poses; lengths over its height, in the frame of the root.

    Args:
        name: Its name.
        mesh: At rest.
        skinning: True weights of the joints, shape (M, 22).
        truth: Its vertices in the poses, shape (P, M, 3).
        affine: Affine transforms of its joints, shape (P, 22, 3, 4); None where the poses are those of all characters.
        turns: Of the joints of the reference body in the same poses, shape (P, 22, 3, 3); None where the poses are
            those of all characters.
        source: The reference body at rest as the character rests; None where the poses are those of all characters.
    """

    name: str
    mesh: PartMesh
    skinning: np.ndarray
    truth: np.ndarray
    affine: np.ndarray | None = None
    turns: np.ndarray | None = None
    source: PartMesh | None = None


@dataclass(frozen=True, eq=False)
class Pair:
    """A source in a pose, and a target.

    Args:
        source: At rest.
        source_skinning: True weights of the source's joints, shape (M_s, 22).
        posed: The source's vertices in the pose, shape (M_s, 3).
        target: The target.
        pose: Which of the target's poses it is.
    """

    source: PartMesh
    source_skinning: np.ndarray
    posed: np.ndarray
    target: Target
    pose: int

    @property
    def truth(self) -> np.ndarray:
        """The target's vertices in the pose, shape (M, 3)."""
        return np.asarray(self.target.truth[self.pose])


def drawn_pairs(characters: Sequence[Target], count: int, random: np.random.Generator) -> list[Pair]:
    """Pairs of one source: in one pose where all characters have the same poses; otherwise the reference body in the
    pose of each target.

    Args:
        characters: Targets, and sources too where all have the same poses.
        count: How many pairs.
        random: Draws them.
    """
    targets = [characters[number] for number in random.integers(len(characters), size=count)]
    if targets[0].turns is not None:
        out = []
        for target in targets:
            assert target.turns is not None and target.source is not None
            pose = int(random.integers(len(target.truth)))
            body = source_body()
            out.append(Pair(target.source, body.skinning, body.posed(target.turns[pose : pose + 1])[0], target, pose))
        return out
    shapes = [one for one in characters if one.name.startswith(REFERENCE)]
    pool = shapes if shapes and random.random() < OF_REFERENCE else list(characters)
    source = pool[int(random.integers(len(pool)))]
    pose = int(random.integers(len(source.truth)))
    return [Pair(source.mesh, source.skinning, source.truth[pose], target, pose) for target in targets]
