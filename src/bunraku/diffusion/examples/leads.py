"""Which candidate starts from which example: other seeds and other candidates take others of those that fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bunraku.diffusion.examples.guide import Lead, fills, fits_into
from bunraku.diffusion.examples.pack import ExamplePack
from bunraku.diffusion.examples.retrieve import Found, retrieve

__all__ = ["Leads"]


class Leads:
    """Examples for the sentences of a call, looked up once each.

    Args:
        pack: To choose from.
        vectors: The ranker's unit vector of each sentence.
    """

    def __init__(self, pack: ExamplePack, vectors: Mapping[str, np.ndarray]):
        self.pack = pack
        self._found = {sentence: retrieve(pack, sentence, vector) for sentence, vector in vectors.items()}

    def lead(self, script: Sequence[tuple[str, int]], noise: tuple[int, int], number: int) -> Lead | None:
        """What a candidate starts from; None where no sentence has an example.

        Args:
            script: Sentences with the frames that each lasts.
            noise: Seed and row of the motion's own noise: it orders the examples.
            number: Of the candidate among those that start from examples.
        """
        seed = (noise[0] % 2**63, noise[1] % 2**63)
        random = np.random.default_rng(seed)
        chosen: list[Found | None] = []
        for sentence, frames in script:
            fitting = [one for one in self._found.get(sentence, ()) if fits_into(self.pack, one, frames)]
            fitting = [one for one in fitting if fills(self.pack, one, frames)] or fitting
            order = random.permutation(len(fitting))
            chosen.append(fitting[int(order[number % len(order)])] if fitting else None)
        return Lead(self.pack, tuple(chosen), (*seed, number)) if any(chosen) else None
