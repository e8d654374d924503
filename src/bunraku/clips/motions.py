"""The motion of a clip: its stretch of the examples, as long as it is asked for."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.core.request.limits import SECONDS
from bunraku.errors import WeightsError

if TYPE_CHECKING:
    from bunraku.diffusion.examples.pack import ExamplePack

__all__ = ["features_of", "motion_of"]

_EASE = 0.3
"""Share of a pose's change that is left from frame to frame where a clip is held at its end."""


def motion_of(stretch: str, seconds: float | None = None, loop: bool = False) -> HandleMotion:
    """The motion of a stretch on the reference body, for `Clip.motion`."""
    from bunraku.diffusion.features import decode

    return decode(features_of(stretch, seconds, loop))


def features_of(stretch: str, seconds: float | None = None, loop: bool = False) -> np.ndarray:
    """What the denoiser sees of a stretch (see `diffusion.features`), shape (N, 271), as long as it is to last.

    Args:
        stretch: A name of the examples (`Clip.stretch`).
        seconds, loop: As of `Clip.motion`.

    Raises:
        OptionError: It cannot last so long.
        WeightsError: The examples are missing or broken.
    """
    from bunraku.diffusion.examples.pack import FPS, load_examples
    from bunraku.diffusion.splicing import held, played

    SECONDS.check(seconds, "seconds")
    pack = load_examples()
    if pack is None:
        raise WeightsError("the clips are stretches of examples.safetensors, which is missing; install Bunraku again")
    number = _numbers(pack).get(stretch)
    if number is None:
        raise WeightsError(f"the examples have no stretch {stretch}; install Bunraku again")
    values, rounds = pack.features(number), pack.examples[number].loop
    if loop and rounds:
        return _rounds(values, rounds, len(values) if seconds is None else round(seconds * FPS))
    if seconds is None:
        return values
    frames = max(round(seconds * FPS), 1)
    if len(values) < frames:
        still = np.zeros(3, values.dtype)
        values = played(values, rounds, frames) if rounds else held(values, frames - len(values), still, _EASE)
    return values[:frames]


def _rounds(values: np.ndarray, loop: tuple[int, int], frames: int) -> np.ndarray:
    """As many whole rounds of a loop as come nearest to so many frames: all that are played on are alike."""
    from bunraku.diffusion.splicing import played

    start, length = loop[0], loop[0] - loop[1]
    count = max(round(frames / length), 1)
    return played(values, loop, start + count * length)[start : start + count * length]


@functools.lru_cache(maxsize=2)
def _numbers(pack: ExamplePack) -> dict[str, int]:
    """Which example each stretch is."""
    return {one.name: number for number, one in enumerate(pack.examples)}
