"""The networks that make a motion from a sentence, and the texts as they read them: each text is encoded once."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bunraku.core.files import weights_file
from bunraku.core.nn.checkpoints import dated, dated_checkpoint
from bunraku.core.nn.layers import one_thread
from bunraku.language.encoders import TextBatch, TextEncoder, encoder_of, text_encoder
from bunraku.language.sentence import Clause

if TYPE_CHECKING:
    from bunraku.generation.denoiser import Denoiser
    from bunraku.generation.extractor import Extractor
    from bunraku.generation.pack import ExamplePack


@dataclass(frozen=True)
class Networks:
    """The networks that make a motion, each loaded when it is first used and then kept. `checkpoint` replaces the
    shipped weights of the denoiser.

    Raises:
        WeightsError: The weights of a network are missing or broken; raised when it is first used.
    """

    checkpoint: str | Path | None = None

    @cached_property
    def denoiser(self) -> Denoiser:
        """Predicts the clean motion (section 3.2 of TapMo)."""
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
        """Path of the changes; it need not exist."""
        beside = dated_checkpoint("diffusion", self.checkpoint)[0].with_name("few-steps.safetensors")
        return beside if beside.is_file() else weights_file("few-steps.safetensors")

    @cached_property
    def ranker(self) -> Extractor:
        """Chooses among candidates."""
        from bunraku.generation.extractor import load_ranker

        return load_ranker()

    @cached_property
    def critic(self) -> Extractor | None:
        """Guides motions towards their sentences; None where its file was taken away."""
        from bunraku.generation.extractor import load_critic

        return load_critic()

    @cached_property
    def examples(self) -> ExamplePack | None:
        """Captured examples that candidates start from; None where their file was taken away."""
        from bunraku.generation.pack import load_examples

        return load_examples()


@functools.lru_cache(maxsize=2)
def _denoiser(path: Path, changed: int) -> Denoiser:
    from bunraku.generation.denoiser import load_denoiser

    return load_denoiser(path)


@functools.lru_cache(maxsize=2)
def _encoder(path: Path, changed: int) -> TextEncoder:
    from bunraku.generation.denoiser import text_encoder_name

    name = text_encoder_name(path)
    return text_encoder(name, os.environ.get("BUNRAKU_CLIP") if name.startswith("clip") else None)


@functools.lru_cache(maxsize=1)
def _load_few(path: Path, changed: int, few: Path, few_changed: int) -> Denoiser | None:
    from bunraku.generation.denoiser import load_denoiser_of_few_steps

    return load_denoiser_of_few_steps(path, few) if few.is_file() else None


@dataclass(frozen=True, eq=False)
class Texts:
    """The texts of scripts as the networks read them."""

    rows: dict[str, int]  # the row of `tokens` of each text
    tokens: TextBatch  # the denoiser's encoded texts of clauses and of the gestures made meanwhile
    ranked: dict[str, np.ndarray]  # the ranker's vectors of the texts of clauses, shape (E,) each
    # the ranker's unit vector of each clause as said of a person, by its text; empty without examples
    shown: dict[str, tuple[Clause, np.ndarray]]
    guided: dict[str, np.ndarray]  # the critic's, of what all of the body but a gesture does

    @classmethod
    def of(
        cls, networks: Networks, scripts: Sequence[Sequence[Clause]], ranks: bool, shows: bool, critic: Extractor | None
    ) -> Texts:
        """The texts of scripts, for the ranker (`ranks`), for examples (`shows`), and for a critic."""
        from bunraku.generation.extractor import RADIUS, sentence_vectors

        clauses = [clause for script in scripts for clause in script]
        clauses += [part for clause in clauses for part in clause.parts] if shows else []
        voices = [voice for clause in clauses for voice in (clause, *clause.voices)] if shows else []
        bodies = [clause.body for clause in clauses] if critic is not None else []
        plain = {text: None for clause in clauses for text in (clause.body.text, (clause.meanwhile or clause).text)}
        ranker = networks.ranker if ranks or shows else None

        def vectors(network: Extractor | None, texts: Iterable[str]) -> dict[str, np.ndarray]:
            """A network's vector of each text, shape (E,); none without the network."""
            wanted = sorted(set(texts))
            if network is None or not wanted:
                return {}
            encoder = encoder_of(network.config.text_encoder, networks.encoder)
            with one_thread():
                return dict(zip(wanted, sentence_vectors(network, encoder.encode(wanted)), strict=True))

        of_persons = vectors(ranker, (voice.person for voice in voices))
        guiding = vectors(critic, (clause.person for clause in bodies))
        tokens = networks.encoder.encode(list(plain))
        ranked = vectors(ranker, (clause.text for clause in clauses if ranks))
        shown = {clause.text: (clause, of_persons[clause.person] / RADIUS) for clause in voices}
        guided = {clause.text: guiding[clause.person] / RADIUS for clause in bodies}
        return cls({text: row for row, text in enumerate(plain)}, tokens, ranked, shown, guided)

    def batch(self, texts: Sequence[str]) -> TextBatch:
        """The tokens of these texts, in their order."""
        return self.tokens.some([self.rows[text] for text in texts])
