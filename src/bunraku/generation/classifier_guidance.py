"""Guidance by a network that knows which motion belongs to which sentence: at every step the predicted x0 goes a little
up the gradient of the cosine of their vectors (as classifier guidance, Dhariwal and Nichol 2021, but on x0).

The gradient is smoothed in time, so that it changes the action and not the details, in which such a network can be
deceived. It has one size whatever its length, since a prediction of the first steps resembles no motion and is far from
any sentence. The root is not guided: with it walks became slower and nothing better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.core.geometry.curves import gaussian
from bunraku.generation.denoiser import Denoiser
from bunraku.generation.extractor import LONGEST, SHORTEST, Extractor
from bunraku.generation.sampler import ROOT

STRENGTH = 0.2  # root mean square of a step, in standard deviations of the features
LAST = 100  # step of the sampler below which nothing is guided: what is left there are details
SPREAD = 2.0  # standard deviation of the smoothing [frames]
FEW = 10  # where fewer steps than this predict a motion, each prediction is guided twice
GROUP = 16  # stretches that go through the network at once


@dataclass(frozen=True)
class Spoken:
    """A stretch of the time line with its sentence."""

    frames: tuple[int, int]  # its first frame, and the one after its last
    vector: np.ndarray  # of the sentence, of length 1, shape (E,)
    # step of the sampler down to which it is not guided, because it is given; 1,000 where it never is
    until: int = 1000


class ClassifierGuidance:
    """Guides each predicted x0 towards the sentences of its stretches, `rounds` times by steps with a root mean square
    of `strength`; mean and deviation are those of the features, shape (D,).
    """

    def __init__(
        self, network: Extractor, mean: np.ndarray, std: np.ndarray, stretches: Sequence[Spoken],
        strength: float = STRENGTH, rounds: int = 1,
    ):  # fmt: skip
        self.network, self.mean, self.std, self.strength, self.rounds = network, mean, std, strength, rounds
        self.stretches = sorted(stretches, key=lambda one: one.frames[1] - one.frames[0])

    def __call__(self, x0: np.ndarray, step: int) -> np.ndarray:
        """x0 (F, D) in network units, nearer to the sentences."""
        guided = [stretch for stretch in self.stretches if LAST <= step < stretch.until]
        if not guided:
            return x0
        out = x0.copy()
        for start in range(0, len(guided), GROUP):
            group = guided[start : start + GROUP]
            for _ in range(self.rounds):
                for stretch, way in zip(group, self.gradients(out, group), strict=True):
                    size = max(float(np.sqrt((way * way).mean())), 1e-9)
                    out[slice(*stretch.frames)] += np.float32(self.strength / size) * way
        return out

    def gradients(self, x0: np.ndarray, stretches: Sequence[Spoken]) -> list[np.ndarray]:
        """The smoothed gradient of the cosine of each stretch with its sentence, without the root's, shape (N, D)."""
        parts = [x0[slice(*stretch.frames)] for stretch in stretches]
        lengths = np.array([len(part) for part in parts])
        values = np.zeros((len(parts), int(lengths.max()), x0.shape[1]), np.float32)
        for row, part in zip(values, parts, strict=True):
            row[: len(part)] = part
        goals = np.stack([stretch.vector for stretch in stretches])
        gradient = self.network.cosine_gradient(values * self.std + self.mean, lengths, goals) * self.std
        gradient[..., ROOT] = 0
        if (lengths == lengths[0]).all():  # as the candidates of one sentence are
            return list(gaussian(gradient.swapaxes(0, 1), SPREAD).swapaxes(0, 1))
        return [gaussian(row[:length], SPREAD) for row, length in zip(gradient, lengths, strict=True)]


@dataclass(frozen=True)
class Critic:
    """Guides the motions of a batch."""

    network: Extractor  # trained with motions and sentences of people
    vectors: Mapping[str, np.ndarray]  # of all their sentences, of length 1, shape (E,)
    strength: float = STRENGTH  # root mean square of a step

    def guidance(
        self, model: Denoiser, scripts: Sequence[Sequence[str]], lengths: Sequence[Sequence[int]], sizes: Sequence[int],
        guide: tuple[np.ndarray, np.ndarray, np.ndarray] | None, steps: int = FEW,
    ) -> ClassifierGuidance:  # fmt: skip
        """For motions one after the other on the time line: sentences of each, frames of each sentence, frames of each
        motion, the guide as of `Steering`, and the steps of the sampler.
        """
        stretches: list[Spoken] = []
        begin = 0
        for script, frames, size in zip(scripts, lengths, sizes, strict=True):
            first, end = begin, begin + size
            for sentence, length in zip(script, frames, strict=True):
                pieces = -(-length // LONGEST)
                bounds = [first + round(length * piece / pieces) for piece in range(pieces + 1)]
                for low, high in zip(bounds, bounds[1:], strict=False):
                    if min(high, end) - low >= SHORTEST:  # as the ranker looks at it
                        until = 1000
                        if guide is not None:
                            share, down_to = guide[1][low:high], guide[2][low:high]
                            until = int(np.where(share >= 1, down_to, 1000).max())
                        stretches.append(Spoken((low, min(high, end)), self.vectors[sentence], until))
                first += length
            begin = end
        return ClassifierGuidance(
            self.network, model.mean, model.std, stretches, self.strength, rounds=2 if steps < FEW else 1
        )
