"""The apparel of any mesh, found by the segmentation network."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from bunraku.apparel.clothed import SOFTEST, STIFFEST
from bunraku.apparel.sampled_mesh import POINTS, sampled_mesh
from bunraku.apparel.segmentation.scores import SegmentationNetwork, load_segmentation
from bunraku.nn.checkpoints import dated_checkpoint
from bunraku.nn.threads import one_thread

__all__ = ["FoundApparel", "find_apparel"]

VIEWS = 3
"""Samples of the mesh whose answers are averaged."""
LIKELY = 1 / 3
"""Probability from which on a vertex is apparel: where edges are in doubt, less than a half makes the most of the
intersection over the union (0.739 in place of 0.719 on 44 characters for validation).
"""


@dataclass(frozen=True, eq=False)
class FoundApparel:
    """What the network says of each vertex of a mesh.

    Args:
        likely: Probability to be apparel, shape (V,).
        stiffness: As of `ClothedCharacter`, shape (V,).
        damping: Share of the velocity that is lost in a second, shape (V,).
    """

    likely: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray

    @property
    def mask(self) -> np.ndarray:
        """Vertices that are apparel, shape (V,), bool."""
        return np.asarray(self.likely > LIKELY)


@lru_cache(maxsize=2)
def _model(path: Path, changed: int) -> SegmentationNetwork:
    return load_segmentation(path)


def find_apparel(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, checkpoint: str | Path | None = None
) -> FoundApparel:
    """Which vertices are apparel, and how stiff they are.

    Args:
        vertices: Rest mesh V [m], +Y up and facing +Z, shape (V, 3).
        faces: Shape (F, 3).
        joints: J [m], shape (22, 3).
        checkpoint: Weights of kind "apparel-mask"; the shipped ones when not given.

    Raises:
        CharacterError: The mesh is broken.
        WeightsError: The checkpoint is missing or does not fit.
    """
    model = _model(*dated_checkpoint("apparel-mask", checkpoint))
    total = np.zeros((len(vertices), 3))
    with one_thread():
        for seed in range(VIEWS):
            mesh = sampled_mesh(vertices, faces, joints, POINTS, seed)
            scores = model.scores(mesh).astype(np.float64)
            scores[:, 0] = 1 / (1 + np.exp(-np.clip(scores[:, 0], -30, 30)))
            total += mesh.spread(scores)
    likely, stiffness, left = (total / VIEWS).T
    return FoundApparel(
        likely.astype(np.float32), np.clip(stiffness, SOFTEST, STIFFEST).astype(np.float32),
        np.clip(1 - 10.0**left, 0, 0.999).astype(np.float32),
    )  # fmt: skip
