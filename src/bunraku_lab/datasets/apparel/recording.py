"""What one character does in its clips, as few numbers: joint transforms, and how far vertices leave what the joints
alone give.

The vertices of a frame are `LBS(W, T) + offsets` (Eq. 4 of MMDMC and what it leaves): bodies need no offsets, since
their bones are rigid with the joints, so only vertices that bones of apparel or helpers hold are stored. Offsets are
short where coordinates are long, so half precision loses less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.apparel.unified import UnifiedBody
from bunraku.core.rig_animation import RigAnimation
from bunraku.core.skinning import skin

__all__ = ["RIGID", "Recording", "record"]

RIGID = 2e-5
"""A bone that leaves its joint by less than this at all its vertices [m] counts as rigid with it."""
_CHUNK = 256


@dataclass(frozen=True, eq=False)
class Recording:
    """N frames of all clips, one after the other.

    Args:
        transforms: `[R | t]` of the joints, shape (N, 22, 3, 4), float32.
        loose: Vertices that have offsets, shape (M,), int32.
        offsets: How far they are from what the joints alone give [m], shape (N, M, 3), float16.
        rounding: Largest error of half precision in them [m].
    """

    transforms: np.ndarray
    loose: np.ndarray
    offsets: np.ndarray
    rounding: float


def record(body: UnifiedBody, clips: Sequence[RigAnimation]) -> Recording:
    """Write down what a character does.

    Args:
        body: The character's joints.
        clips: Its clips, simulated.

    Raises:
        ValueError: An offset is not finite or too long for half precision.
    """
    rig = body.parts.character.rig
    assert rig is not None
    vertices = body.parts.character.vertices
    bones = _loose_bones(body, clips)
    dense = np.zeros((len(vertices), len(rig.names)), np.float32)
    np.add.at(dense, (np.arange(len(dense))[:, None], rig.indices), rig.weights)
    loose = np.flatnonzero(dense[:, bones].sum(axis=1) > 1e-4).astype(np.int32)
    weights = dense[np.ix_(loose, bones)]
    transforms = np.concatenate([body.transforms(clip) for clip in clips])
    offsets = np.empty((len(transforms), len(loose), 3), np.float16)
    start, rounding = 0, 0.0
    for clip in clips:
        deviations = body.deviations(clip)[:, bones]
        for first in range(0, len(clip), _CHUNK):
            exact = skin(vertices[loose], weights, deviations[first : first + _CHUNK])
            if not np.abs(exact).max(initial=0) < 1000:
                raise ValueError("vertices leave their joints by more than a kilometre")
            here = slice(start + first, start + first + len(exact))
            offsets[here] = exact
            rounding = max(
                rounding, float(np.linalg.norm(offsets[here].astype(np.float32) - exact, axis=-1).max(initial=0))
            )
        start += len(clip)
    return Recording(transforms, loose, offsets, rounding)


def _loose_bones(body: UnifiedBody, clips: Sequence[RigAnimation]) -> np.ndarray:
    """Bones that hold vertices and leave their joints in some frame, shape (B,)."""
    rig = body.parts.character.rig
    assert rig is not None
    held = np.unique(rig.indices[rig.weights > 1e-4])
    centres, radii = _extents(body)
    far = np.zeros(len(held))
    for clip in clips:
        deviation = body.deviations(clip)[:, held].astype(np.float64)
        at = np.einsum("njab,jb->nja", deviation[..., :3], centres[held]) + deviation[..., 3]
        reach = np.linalg.norm(deviation[..., :3], axis=(-2, -1)) * radii[held]
        far = np.maximum(far, (np.linalg.norm(at, axis=-1) + reach).max(axis=0))
    return np.asarray(held[far > RIGID])


def _extents(body: UnifiedBody) -> tuple[np.ndarray, np.ndarray]:
    """Centre (J, 3) and radius (J,) [m] of a ball about the vertices that each bone holds."""
    rig, vertices = body.parts.character.rig, body.parts.character.vertices.astype(np.float64)
    assert rig is not None
    count = len(rig.names)
    rows, columns = np.nonzero(rig.weights > 1e-4)
    bones = rig.indices[rows, columns]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, bones, vertices[rows])
    np.maximum.at(high, bones, vertices[rows])
    some = np.isfinite(low[:, 0])
    centres, radii = rig.positions.astype(np.float64).copy(), np.zeros(count)
    centres[some] = (low[some] + high[some]) / 2
    radii[some] = np.linalg.norm(high[some] - low[some], axis=1) / 2
    return centres, radii
