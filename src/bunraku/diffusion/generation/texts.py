"""What the networks read of scripts: each text is encoded once, before anything is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bunraku.diffusion.generation.networks import Networks
from bunraku.language.encoders import TextBatch, encoder_of
from bunraku.language.sentence import Clause
from bunraku.nn.threads import one_thread

if TYPE_CHECKING:
    from bunraku.diffusion.inference.extractor import Extractor

__all__ = ["Texts"]


@dataclass(frozen=True, eq=False)
class Texts:
    """The texts of some scripts as the networks read them.

    Args:
        rows: The row of `tokens` of each text.
        tokens: What the denoiser's text encoder makes of the texts of clauses and of the gestures made meanwhile.
        ranked: The ranker's vectors of the texts of clauses, shape (E,) each.
        shown: The ranker's unit vector of each clause as said of a person, by its text; none where no examples are
            looked up.
        guided: The critic's, of what all of the body but a gesture does.
    """

    rows: dict[str, int]
    tokens: TextBatch
    ranked: dict[str, np.ndarray]
    shown: dict[str, tuple[Clause, np.ndarray]]
    guided: dict[str, np.ndarray]

    @classmethod
    def of(
        cls, networks: Networks, scripts: Sequence[Sequence[Clause]], ranks: bool, shows: bool, critic: Extractor | None
    ) -> Texts:
        """The texts of scripts.

        Args:
            networks: That read them.
            scripts: For each motion its clauses.
            ranks: Whether the ranker is to choose among candidates.
            shows: Whether examples are to be looked up.
            critic: What guides motions; None for nothing.
        """
        from bunraku.diffusion.extractor_config import RADIUS
        from bunraku.diffusion.inference.extractor import sentence_vectors

        clauses = [clause for script in scripts for clause in script]
        clauses += [part for clause in clauses for part in clause.parts] if shows else []
        voices = [one for clause in clauses for one in (clause, *clause.voices)] if shows else []
        bodies = [clause.body for clause in clauses] if critic is not None else []
        plain = {text: None for clause in clauses for text in (clause.body.text, (clause.meanwhile or clause).text)}
        ranker = networks.ranker if ranks or shows else None
        networks_of = ranker, critic, ranker
        wanted = [sorted({clause.person for clause in some}) for some in (voices, bodies)]
        wanted.append(sorted({clause.text for clause in clauses}) if ranks else [])
        encoders = [
            networks.encoder if network is None else encoder_of(network.config.text_encoder, networks.encoder)
            for network in networks_of
        ]
        with one_thread():
            batches = [own.encode(texts) if texts else None for own, texts in zip(encoders[:2], wanted, strict=False)]
        tokens = networks.encoder.encode(list(plain))
        with one_thread():
            batches.append(encoders[2].encode(wanted[2]) if ranks else None)
            found: list[dict[str, np.ndarray]] = []
            for network, texts, batch in zip(networks_of, wanted, batches, strict=True):
                vectors = () if network is None or batch is None else sentence_vectors(network, batch)
                found.append(dict(zip(texts, vectors, strict=True)))
        shown = {clause.text: (clause, found[0][clause.person] / RADIUS) for clause in voices}
        guided = {clause.text: found[1][clause.person] / RADIUS for clause in bodies}
        return cls({text: row for row, text in enumerate(plain)}, tokens, found[2], shown, guided)

    def batch(self, texts: Sequence[str]) -> TextBatch:
        """The tokens of some texts, in the order that is given."""
        return self.tokens.some([self.rows[text] for text in texts])
