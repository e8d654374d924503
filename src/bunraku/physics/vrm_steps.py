"""How VRM 1.0 moves spring bones: its own steps of a sixtieth of a second, for many springs and values at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

__all__ = ["VrmValues", "between_frames", "link_turns", "vrm_steps"]

RATE = 60  # steps a second


@dataclass(frozen=True, eq=False)
class VrmValues:
    """Settings of a link: stiffness, drag and gravity power, each of shape (C, S) or one that fits."""

    stiffness: np.ndarray
    drag: np.ndarray
    gravity: np.ndarray


def between_frames(turns: np.ndarray, places: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (N, ..., 3, 3) and positions (N, ..., 3) of frames at the times of VRM's steps: positions go straight,
    rotations are those of the nearest frame. The first is the first frame's, the last the last one's.
    """
    parts = max(1, round(RATE / fps))
    time = np.arange((len(places) - 1) * parts + 1) / parts
    before = np.minimum(time.astype(np.int64), len(places) - 1)
    after = np.minimum(before + 1, len(places) - 1)
    share = (time - before).reshape(-1, *[1] * (places.ndim - 1))
    return turns[np.where(time - before > 0.5, after, before)], (1 - share) * places[before] + share * places[after]


def vrm_steps(turns: np.ndarray, heads: np.ndarray, bones: np.ndarray, values: VrmValues) -> Iterator[np.ndarray]:
    """Where the tails of C links are, without colliders, step by step as VRM's specification moves them: `x += (1 -
    drag) dx + stiffness dt rest + gravity dt down`, and then back to its length. What hangs on a link does not pull at
    it.

    Args:
        turns: World rotation of what each link hangs on at each step, shape (T, C, 3, 3).
        heads: Where each link begins [m], shape (T, C, 3).
        bones: From the beginning of each link to its tail at rest [m], shape (C, 3).
        values: S settings of each link.

    Yields:
        T times positions [m], shape (C, S, 3).
    """
    stiffness, drag, gravity = np.broadcast_arrays(values.stiffness, values.drag, values.gravity)
    length = np.linalg.norm(bones, axis=1)[:, None, None]
    aims = np.einsum("tcab,cb->tca", turns, bones / np.maximum(length[:, 0], 1e-9))[:, :, None]
    keep, back = (1 - drag)[..., None], (stiffness / RATE)[..., None]
    fall = np.stack([np.zeros_like(gravity), -gravity / RATE, np.zeros_like(gravity)], axis=-1)
    now = before = np.broadcast_to(heads[0][:, None] + length * aims[0], fall.shape)
    yield now
    for head, aim in zip(heads[1:], aims[1:], strict=True):
        away = now + keep * (now - before) + back * aim + fall - head[:, None]
        away /= np.maximum(np.sqrt(np.einsum("csa,csa->cs", away, away)), 1e-9)[..., None]
        before, now = now, head[:, None] + length * away
        yield now


def link_turns(turns: np.ndarray, heads: np.ndarray, bones: np.ndarray, tails: np.ndarray) -> np.ndarray:
    """World rotations of C links whose tails are known: by the least turn from where what they hang on holds them,
    shape (T, C, 3, 3).

    Args:
        turns, heads, bones: As in `vrm_steps`.
        tails: [m], shape (T, C, 3).
    """
    aims = np.einsum("tcab,cb->tca", turns, bones)
    aims /= np.maximum(np.linalg.norm(aims, axis=-1, keepdims=True), 1e-9)
    away = tails - heads
    away /= np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
    return np.asarray(_between(aims, away) @ turns)


def _between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The shortest rotations from unit vectors to others, shape (..., 3, 3)."""
    cross = np.cross(start, end)
    cosine = (start * end).sum(axis=-1)
    skew = np.zeros((*start.shape, 3))
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = -cross[..., 2], cross[..., 1], -cross[..., 0]
    skew -= np.swapaxes(skew, -1, -2)
    scale = 1 / np.maximum(1 + cosine, 1e-6)
    return np.asarray(np.eye(3) + skew + scale[..., None, None] * (skew @ skew))
