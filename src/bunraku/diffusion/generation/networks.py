"""The networks that make a motion from a sentence: denoiser, text encoder, ranker, critic, and the examples."""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from bunraku.formats.files import weights_file
from bunraku.language.encoders import TextEncoder, text_encoder
from bunraku.nn.checkpoints import dated, dated_checkpoint

if TYPE_CHECKING:
    from bunraku.diffusion.examples.pack import ExamplePack
    from bunraku.diffusion.inference.denoiser import Denoiser
    from bunraku.diffusion.inference.extractor import Extractor

__all__ = ["Networks", "load_generator"]


@dataclass(frozen=True)
class Networks:
    """The networks that make a motion, each loaded when it is first asked for and then kept.

    Args:
        checkpoint: Weights of the denoiser in place of the shipped ones.

    Raises:
        WeightsError: The weights of a network are missing or broken; raised when it is first used.
    """

    checkpoint: str | Path | None = None

    @cached_property
    def denoiser(self) -> Denoiser:
        """What predicts the clean motion (section 3.2 of TapMo)."""
        return _denoiser(*dated_checkpoint("diffusion", self.checkpoint))

    @cached_property
    def encoder(self) -> TextEncoder:
        """The denoiser's text encoder."""
        return _encoder(*dated_checkpoint("diffusion", self.checkpoint))

    @cached_property
    def few_steps(self) -> Denoiser | None:
        """The denoiser for the few steps that it was distilled into, which holds its guidance; None where it was not.
        The changes are a file beside its weights, or the shipped ones where they are of these weights.
        """
        path, changed = dated_checkpoint("diffusion", self.checkpoint)
        return _load_few(path, changed, *dated(self.few_steps_file))

    @property
    def few_steps_file(self) -> Path:
        """Where the changes are; it need not exist."""
        beside = dated_checkpoint("diffusion", self.checkpoint)[0].with_name("few-steps.safetensors")
        return beside if beside.is_file() else weights_file("few-steps.safetensors")

    @cached_property
    def ranker(self) -> Extractor:
        """What chooses among candidates."""
        from bunraku.diffusion.inference.extractor import load_ranker

        return load_ranker()

    @cached_property
    def critic(self) -> Extractor | None:
        """What guides motions towards their sentences; None where its file was taken away."""
        from bunraku.diffusion.inference.extractor import load_critic

        return load_critic()

    @cached_property
    def examples(self) -> ExamplePack | None:
        """Captured examples that candidates start from; None where their file was taken away."""
        from bunraku.diffusion.examples.pack import load_examples

        return load_examples()


def load_generator(checkpoint: str | Path | None = None) -> tuple[Denoiser, TextEncoder]:
    """The denoiser and its text encoder, kept between calls as long as the file does not change.

    Weights trained with CLIP look for its folder in the environment variable BUNRAKU_CLIP.

    Args:
        checkpoint: Weights in place of the shipped ones.

    Raises:
        WeightsError: The weights are missing or broken.
    """
    found = dated_checkpoint("diffusion", checkpoint)
    return _denoiser(*found), _encoder(*found)


@functools.lru_cache(maxsize=2)
def _denoiser(path: Path, changed: int) -> Denoiser:
    from bunraku.diffusion.inference.denoiser import load_denoiser

    return load_denoiser(path)


@functools.lru_cache(maxsize=2)
def _encoder(path: Path, changed: int) -> TextEncoder:
    from bunraku.diffusion.inference.denoiser import text_encoder_name

    name = text_encoder_name(path)
    return text_encoder(name, os.environ.get("BUNRAKU_CLIP") if name.startswith("clip") else None)


@functools.lru_cache(maxsize=1)
def _load_few(path: Path, changed: int, few: Path, few_changed: int) -> Denoiser | None:
    from bunraku.diffusion.inference.denoiser import load_denoiser_of_few_steps

    return load_denoiser_of_few_steps(path, few) if few.is_file() else None
