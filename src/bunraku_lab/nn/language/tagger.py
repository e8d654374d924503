"""The tagger of other languages to train (`bunraku.language.foreign.tagger` is what reads).

A sentence says a movement if one of its words does (Zhang et al. 2005, "Multiple Instance Boosting": noisy or):
P(movement) = 1 - prod over words (1 - p(movement | word)), of which only the left side is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bunraku.language.foreign.tagger import KIND, TaggerConfig
from bunraku.nn.checkpoints import save_checkpoint

__all__ = ["TaggerNetwork", "said_by_sentence", "save_tagger"]

_QUIET = -6.0
"""What each movement is at the beginning, before the logistic function: no word says anything."""


class TaggerNetwork(torch.nn.Module):
    """The network.

    Args:
        config: Its sizes.
    """

    def __init__(self, config: TaggerConfig):
        super().__init__()
        self.config = config
        self.pieces = torch.nn.EmbeddingBag(config.buckets, config.width, mode="mean")
        self.enter = torch.nn.Linear(4 * config.width, config.hidden)
        self.leave = torch.nn.Linear(config.hidden, len(config.verbs))
        torch.nn.init.normal_(self.pieces.weight, std=0.3)
        torch.nn.init.constant_(self.leave.bias, _QUIET)

    def forward(self, pieces: Tensor, offsets: Tensor, lengths: Tensor, reach: Tensor) -> Tensor:
        """How sure each word is of each movement, before the logistic function, shape (words, V).

        Args:
            pieces: Hashes of all words of all sentences, modulo the buckets, in a row.
            offsets: Where the pieces of each word begin.
            lengths: Words of each sentence, shape (B,).
            reach: Words before and after that count, shape (B,).
        """
        own = self.pieces(pieces, offsets)
        stop = lengths.cumsum(0)
        row = torch.repeat_interleave(torch.arange(len(lengths), device=own.device), lengths)
        low, high = (stop - lengths)[row], stop[row]
        sums = torch.cat([own.new_zeros(1, own.shape[1]), own.cumsum(0)])
        at = torch.arange(len(own), device=own.device)
        first, last = torch.maximum(at - reach[row], low), torch.minimum(at + 1 + reach[row], high)
        before = (sums[at] - sums[first]) / (at - first).clamp(min=1)[:, None]
        after = (sums[last] - sums[at + 1]) / (last - at - 1).clamp(min=1)[:, None]
        whole = (sums[high] - sums[low]) / (high - low)[:, None]
        return self.leave(torch.relu(self.enter(torch.cat([own, before, after, whole], dim=1))))


def said_by_sentence(words: Tensor, lengths: Tensor) -> Tensor:
    """Minus the logarithm of the probability that no word of a sentence says a movement, shape (B, V).

    Args:
        words: What the network says of each word.
        lengths: Words of each sentence.
    """
    row = torch.repeat_interleave(torch.arange(len(lengths), device=words.device), lengths)
    silence = torch.nn.functional.softplus(words)
    return words.new_zeros(len(lengths), words.shape[1]).index_add(0, row, silence)


def save_tagger(path: Path, model: TaggerNetwork, notes: Mapping[str, object]) -> Path:
    """Write the network as it is read: the matrix of pieces in steps of int8."""
    state = {name: value.detach().cpu().numpy() for name, value in model.state_dict().items()}
    matrix = state.pop("pieces.weight")
    scale = np.abs(matrix).max(0) / 127
    state["pieces.steps"] = np.round(matrix / np.maximum(scale, 1e-12)).astype(np.int8)
    state["pieces.scale"] = scale.astype(np.float32)
    network = vars(model.config) | {"verbs": list(model.config.verbs)}
    config: dict[str, object] = {"network": network, "notes": dict(notes)}
    return save_checkpoint(path, state, config, KIND, half=True)
