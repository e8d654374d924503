"""Files that takes are written to."""

from __future__ import annotations

from dataclasses import dataclass

from bunraku.core.request.limits import FPS
from bunraku.errors import OptionError
from bunraku.io.presets import preset_named

__all__ = ["ClipsForm"]

MOST_CLIPS = 100
"""Takes in one file."""


@dataclass(frozen=True, kw_only=True)
class ClipsForm:
    """Takes that become the clips of one file.

    Args:
        takes: Their names, in order, each once.
        fps: Frames a second [1/s].
        preset: The program that the file is for, one of `bunraku.io.presets`; "" for a plain GLB. Its rate holds where
            `fps` is 0.
    """

    takes: tuple[str, ...] = ()
    fps: float = 30.0
    preset: str = ""

    def __post_init__(self) -> None:
        if self.preset:
            preset_named(self.preset)
        if not self.preset or self.fps:
            FPS.check(self.fps)
        if not 1 <= len(self.takes) <= MOST_CLIPS or len(set(self.takes)) < len(self.takes):
            raise OptionError(f"one file has 1 to {MOST_CLIPS} clips, each another take; choose them again")
