"""Motions longer than the denoiser's window, and sentences in a row: windows that overlap and are denoised together.

A motion is cut into pieces, each within one sentence and short enough for the denoiser. The window of a piece reaches
over both its ends into its neighbours, and at every step of sampling the predictions of two windows fade into each
other there (see `sample_windows`). A loop is the same on a circle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.generation.denoiser import Denoiser
from bunraku.generation.sampler import Sample, Solver, Steering, Window, row_noise, sample_windows
from bunraku.language.encoders import TextBatch

OVERLAP = 28  # frames that two windows share
SHORTEST = 40  # frames; training saw hardly anything shorter


@dataclass(frozen=True)
class Plan:
    """How one motion is made."""

    frames: int  # frames on the time line; more than wanted where the motion is very short, and the rest is cut off
    windows: tuple[Window, ...]  # frames counted from the motion's first and rows from its first sentence
    # frames where one window hands over to the next, falling between this one and the one before
    seams: tuple[int, ...]


def plan_windows(lengths: Sequence[int], longest: int, *, loop: bool = False, overlap: int = OVERLAP) -> Plan:
    """Plan one motion.

    Args:
        lengths: Frames of each sentence, in a row.
        longest: Frames that the denoiser sees at most.
        loop: Whether the first frame follows the last.
        overlap: Frames that neighbouring windows share, where both are as long.
    """
    overlap = min(overlap, longest // 3)
    shortest = min(SHORTEST, longest)
    lengths = list(lengths)
    if not loop:
        lengths[-1] += max(shortest - sum(lengths), 0)
    total = sum(lengths)
    pieces: list[tuple[int, int, int]] = []  # first frame, frame after the last, sentence
    start = 0
    for row, length in enumerate(lengths):
        ends = 2 if loop else (row > 0) + (row < len(lengths) - 1)  # where it meets another sentence
        fits = length + ends * (overlap // 2) <= longest
        count = 1 if fits else -(-length // (longest - overlap))
        if loop and len(lengths) == 1:
            count = max(count, 2)  # the seam of one window is in the middle of the other
        bounds = [start + round(length * part / count) for part in range(count + 1)]
        pieces += [(first, after, row) for first, after in zip(bounds, bounds[1:], strict=False)]
        start += length
    count = len(pieces)
    halves = [(after - first) // 2 for first, after, _ in pieces]
    # half of what piece i shares with the next one
    fades = [min(overlap // 2, halves[i], halves[(i + 1) % count]) for i in range(count)]
    if not loop:
        fades[-1] = 0
    windows = []
    for i, (first, after, row) in enumerate(pieces):
        before, behind = (fades[i - 1] if loop or i else 0), fades[i]
        missing = max(shortest - (after - first + before + behind), 0)
        low, high = first - before - missing // 2, after + behind + missing - missing // 2
        if not loop:
            low, high = max(low - max(high - total, 0), 0), min(high + max(-low, 0), total)
        frames = np.arange(low, high)
        share = _rise(frames - (first - before), 2 * before) * (1 - _rise(frames - (after - behind), 2 * behind))
        windows.append(Window(frames % total, share, row))
    seams = tuple(first for first, _, _ in pieces[0 if loop else 1 :])
    return Plan(total, tuple(windows), seams)


def _rise(frames: np.ndarray, length: int) -> np.ndarray:
    """0 before frame 0, 1 from frame `length` on, and a smooth rise between."""
    share = np.clip((frames + 0.5) / max(length, 1), 0, 1) if length else (frames >= 0).astype(float)
    return np.asarray(share * share * (3 - 2 * share), np.float32)


def sample_plans(
    model: Denoiser, text: TextBatch, plans: Sequence[Plan], solver: Solver, steering: Steering | None = None, *,
    seeds: int | Sequence[int] | Sequence[tuple[int, int]] = 0, mesh_features: np.ndarray | None = None,
) -> list[Sample]:  # fmt: skip
    """Make several motions in one batch: one sample for each plan, values (N, D) and adaptation (N, K, 3).

    Args:
        model: The denoiser.
        text: The sentences of the first plan, then those of the second, and so on.
        plans: One for each motion.
        solver: How they are denoised.
        steering: What acts on the predictions; their time lines stand one after the other in it.
        seeds: Of the starting noise; one number gives each motion noise of its own, the first as when it is alone. See
            `drawn_noise`.
        mesh_features: f_phi for each sentence, shape (B, 448).
    """
    windows: list[Window] = []
    frame = row = 0
    for plan in plans:
        windows += [Window(window.frames + frame, window.share, window.row + row) for window in plan.windows]
        frame, row = frame + plan.frames, row + 1 + max(window.row for window in plan.windows)
    lengths, size = [plan.frames for plan in plans], model.config.features
    drawn = drawn_noise(seeds, len(plans))
    noise = [row_noise(length, size, *pair) for length, pair in zip(lengths, drawn, strict=True)]
    sample = sample_windows(
        model, text, windows, np.concatenate(noise), solver, steering or Steering(), mesh_features=mesh_features
    )
    ends = np.cumsum(lengths)[:-1]
    parts = np.split(sample.values, ends), np.split(sample.adaptation, ends)
    return [Sample(*part) for part in zip(*parts, strict=True)]


def drawn_noise(seeds: int | Sequence[int] | Sequence[tuple[int, int]], count: int) -> list[tuple[int, int]]:
    """Seed and row (see `row_noise`) of each of `count` motions, from one seed, a seed for each, or the very pairs."""
    if isinstance(seeds, int):
        return [(seeds, index) for index in range(count)]
    return [(seed, 0) if isinstance(seed, int) else seed for seed in seeds]
