"""Motions longer than the denoiser's window: windows that overlap, each keeping the end of the one before."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from bunraku.diffusion.denoiser import Denoiser
from bunraku.diffusion.sampler import Known, Sample, sample
from bunraku.diffusion.text import TextBatch

__all__ = ["plan_windows", "sample_long"]

OVERLAP = 28  # frames that a window keeps of the one before
FADE = 12  # of these, the last ones, over which the hold lets go
SHORTEST = 40  # frames; training saw hardly anything shorter


def plan_windows(frames: int, longest: int, overlap: int = OVERLAP) -> list[tuple[int, int]]:
    """First and last-but-one frame of each window: equal lengths of at most `longest`, neighbours sharing `overlap` frames.

    The last window may reach beyond `frames` by the rounding; what it makes there is cut off.
    """
    if frames <= longest:
        return [(0, frames)]
    count = -(-(frames - overlap) // (longest - overlap))
    length = -(-(frames + (count - 1) * overlap) // count)
    return [(index * (length - overlap), index * (length - overlap) + length) for index in range(count)]


def hold(overlap: int, frames: int, fade: int) -> Tensor:
    """Share of each frame of a window that its predecessor decides, shape (frames,): 1, then a smooth fall to 0 that ends with the overlap."""
    fade = min(fade, overlap)
    ramp = torch.linspace(1, 0, fade + 2)[1:-1]
    share = torch.zeros(frames)
    share[: overlap - fade] = 1
    share[overlap - fade : overlap] = ramp * ramp * (3 - 2 * ramp)
    return share


def sample_long(
    model: Denoiser, text: TextBatch, frames: int, *, seed: int = 0, progress: Callable[[int, int], None] | None = None, **options: Any
) -> Sample:
    """Like `sample`, for any number of frames: long motions in windows, very short ones cut from the start of longer ones.

    Every window is given the whole sentence, so a sentence about one event is done once a window.

    Args:
        model: The denoiser.
        text: B encoded sentences.
        frames: Length of the motions.
        seed: Of the starting noise; window w uses its own.
        progress: Called with (done, total) steps of all windows.
        options: Others of `sample`.
    """
    longest = model.config.frames
    overlap, fade = min(OVERLAP, longest // 3), min(FADE, longest // 6)
    windows = plan_windows(max(frames, min(SHORTEST, longest)), longest, overlap)
    values: list[Tensor] = []
    adaptations: list[Tensor] = []
    for index, (start, stop) in enumerate(windows):
        known = None
        if values:
            held = torch.zeros_like(values[-1][:, :1]).repeat(1, stop - start, 1)
            held[:, :overlap] = values[-1][:, -overlap:]
            known = Known(held, hold(overlap, stop - start, fade))

        def tell(done: int, total: int, index: int = index) -> None:
            if progress is not None:
                progress(index * total + done, len(windows) * total)

        part = sample(model, text, stop - start, seed=seed + 7919 * index, known=known, progress=tell, **options)
        if known is None:
            adaptations.append(part.adaptation)
        else:  # the motion was blended while it was sampled; the adaptation is blended here
            share = known.share[:overlap, None, None].to(part.adaptation)
            mixed = torch.lerp(part.adaptation[:, :overlap], adaptations[-1][:, -overlap:], share)
            values[-1], adaptations[-1] = values[-1][:, :-overlap], adaptations[-1][:, :-overlap]
            adaptations.append(torch.cat([mixed, part.adaptation[:, overlap:]], 1))
        values.append(part.values)
    return Sample(torch.cat(values, 1)[:, :frames], torch.cat(adaptations, 1)[:, :frames])
