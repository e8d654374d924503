"""Networks of sentences: encoded sentences, and motions and sentences in one space (section A.2 of TapMo)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bunraku.core.nn.checkpoints import config_of
from bunraku.core.nn.layers import Weights
from bunraku.errors import WeightsError
from bunraku.generation import extractor as running
from bunraku.generation.extractor import FARTHEST, KIND, RADIUS, ExtractorConfig
from bunraku.generation.features import FEATURE_SIZE, feature_weights
from bunraku.language import encoders
from bunraku_lab.nn.checkpoints import fitted_network, load_checkpoint, save_checkpoint
from bunraku_lab.nn.differentiable import arrays_of


@dataclass(frozen=True)
class TextBatch:
    """Encoded sentences, as `language.encoders.TextBatch`.

    Args:
        tokens: Shape (B, L, C).
        mask: True where a token is real, shape (B, L).
        pooled: One vector a sentence, shape (B, P).
    """

    tokens: Tensor
    mask: Tensor
    pooled: Tensor

    def to(self, device: torch.device | str) -> TextBatch:
        """The same on a device."""
        return TextBatch(self.tokens.to(device), self.mask.to(device), self.pooled.to(device))

    def arrays(self) -> encoders.TextBatch:
        """The same as arrays."""
        return encoders.TextBatch(*(part.cpu().numpy() for part in (self.tokens, self.mask, self.pooled)))


def tensors_of(batch: encoders.TextBatch) -> TextBatch:
    """Encoded sentences as tensors."""
    return TextBatch(*(torch.from_numpy(part) for part in (batch.tokens, batch.mask, batch.pooled)))


def _layers(config: ExtractorConfig, count: int) -> nn.ModuleList:
    return nn.ModuleList(_Layer(config.width, config.heads, config.feedforward, config.dropout) for _ in range(count))


class _Layer(nn.Module):
    """A pre-norm transformer layer."""

    def __init__(self, width: int, heads: int, feedforward: int, dropout: float):
        super().__init__()
        self.heads = heads
        self.norm_a, self.norm_b = nn.LayerNorm(width), nn.LayerNorm(width)
        self.inside, self.outside = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.wide, self.narrow = nn.Linear(width, feedforward), nn.Linear(feedforward, width)
        self.drop = nn.Dropout(dropout)

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        """x (B, T, d), mask (B, T), True where real."""
        parts = self.inside(self.norm_a(x)).unflatten(-1, (3, self.heads, -1))
        query, key, value = parts.permute(2, 0, 3, 1, 4).unbind()  # shape (B, H, T, d/H) each
        # written out: torch's fused backward takes most of a step on a CPU
        scores = ((query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)).masked_fill(~mask[:, None, None], -1e4)
        mixed = torch.softmax(scores, dim=-1, dtype=scores.dtype) @ value
        x = x + self.drop(self.outside(mixed.transpose(1, 2).flatten(2)))
        return x + self.drop(self.narrow(F.gelu(self.wide(self.norm_b(x)))))


def _mean(x: Tensor, mask: Tensor) -> Tensor:
    share = mask[..., None].to(x.dtype)
    return (x * share).sum(1) / share.sum(1).clamp(min=1)


class Extractor(nn.Module):
    """Embeds motions and sentences. Statistics of the training features travel with the weights as buffers."""

    mean: Tensor
    std: Tensor
    weights: Tensor
    rates: Tensor

    def __init__(self, config: ExtractorConfig):
        super().__init__()
        self.config = config
        self.notes: dict[str, Any] = {}
        width, drop = config.width, config.dropout
        self.register_buffer("mean", torch.zeros(config.features))
        self.register_buffer("std", torch.ones(config.features))
        weights = feature_weights() if config.features == FEATURE_SIZE else np.ones(config.features, np.float32)
        self.register_buffer(
            "weights", torch.from_numpy(np.sqrt(weights))
        )  # idle handles count less, as in the denoiser's loss
        # On the meta device, where sizes are compared, `arange` would load torch's compiler, which takes two seconds.
        even = torch.arange(0, width, 2, device="cpu")
        self.register_buffer("rates", 1000.0 ** (-even / width), persistent=False)
        self.motion_in = nn.Linear(config.features * config.frames_per_token, width)
        self.motion_layers = _layers(config, config.layers)
        self.motion_norm = nn.LayerNorm(2 * width)
        self.motion_out = nn.Sequential(
            nn.Linear(2 * width, width), nn.GELU(), nn.Dropout(drop), nn.Linear(width, config.embedding)
        )
        self.text_in = nn.Linear(config.text_size, width)
        self.text_layers = _layers(config, 1)
        self.pooled_in = nn.Linear(config.pooled_size, width)
        self.text_norm = nn.LayerNorm(2 * width)
        self.text_out = nn.Sequential(
            nn.Linear(2 * width, width), nn.GELU(), nn.Dropout(drop), nn.Linear(width, config.embedding)
        )
        self.log_scale = nn.Parameter(torch.tensor(2.7))  # of the cosines in the loss

    def _positions(self, tokens: int, device: torch.device) -> Tensor:
        angle = torch.arange(tokens, device=device)[:, None] * self.rates
        return 0.5 * torch.cat([angle.cos(), angle.sin()], dim=-1)

    def motion(self, features: Tensor, lengths: Tensor) -> Tensor:
        """Vectors of motions.

        Args:
            features: In the data's units, anything behind a motion's end, shape (B, N, D).
            lengths: Real frames, shape (B,).

        Returns:
            Shape (B, E), of length `RADIUS`.
        """
        batch, frames, _ = features.shape
        patch = self.config.frames_per_token
        tokens = -(-frames // patch)
        x = ((features - self.mean) / self.std).clamp(-FARTHEST, FARTHEST) * self.weights
        real = torch.arange(tokens * patch, device=x.device) < lengths[:, None]
        x = F.pad(x, (0, 0, 0, tokens * patch - frames)).masked_fill(~real[..., None], 0)
        mask = real.view(batch, tokens, patch).any(-1)
        h = self.motion_in(x.reshape(batch, tokens, -1))
        h = h + self._positions(tokens, h.device).to(h.dtype)
        for layer in self.motion_layers:
            h = layer(h, mask)
        most = h.masked_fill(~mask[..., None], -1e4).amax(1)  # a short event in a long motion survives in the maximum
        return RADIUS * F.normalize(
            self.motion_out(self.motion_norm(torch.cat([_mean(h, mask), most], dim=-1))).float(), dim=-1
        )

    def text(self, text: TextBatch) -> Tensor:
        """Vectors of sentences, shape (B, E), of length `RADIUS`."""
        h = self.text_in(text.tokens)
        for layer in self.text_layers:
            h = layer(h, text.mask)
        pooled = self.pooled_in(text.pooled * self.config.pooled_size**0.5)
        return RADIUS * F.normalize(
            self.text_out(self.text_norm(torch.cat([_mean(h, text.mask), pooled.to(h.dtype)], dim=-1))).float(), dim=-1
        )


def running_extractor(model: Extractor) -> running.Extractor:
    """An extractor as the runtime has it, with a copy of the weights."""
    return running.Extractor(model.config, Weights(arrays_of(model)), dict(model.notes))


def save_extractor(
    path: str | Path, model: Extractor, notes: Mapping[str, object] | None = None, kind: str = KIND
) -> Path:
    """Write an extractor, or a ranker, in half precision with its config."""
    return save_checkpoint(path, model.state_dict(), asdict(model.config) | {"notes": notes or {}}, kind, half=True)


def load_extractor(path: str | Path, device: str | torch.device = "cpu", kind: str = KIND) -> Extractor:
    """Read an extractor, or a ranker, ready for use.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its config and weights disagree.
    """
    state, config = load_checkpoint(path, kind)
    notes = config.pop("notes", None)
    try:
        shape = config_of(ExtractorConfig, config)
        model = fitted_network(lambda: Extractor(shape), state)
        model.notes = dict(notes or {})
    except Exception as error:
        raise WeightsError(
            f"{path}: the config and the weights of this extractor disagree ({str(error).splitlines()[0]}); train it "
            "again"
        ) from error
    return model.to(device).eval().requires_grad_(False)


def embed_sentences(
    extractor: running.Extractor, encoder: encoders.TextEncoder, sentences: Sequence[str]
) -> dict[str, np.ndarray]:
    """The vector of each sentence, float64, shape (E,): one for all rows of a table."""
    distinct = sorted(set(sentences))
    vectors: dict[str, np.ndarray] = {}
    for start in range(0, len(distinct), 256):
        part = distinct[start : start + 256]
        vectors.update(zip(part, running.sentence_vectors(extractor, encoder.encode(part)), strict=True))
    return vectors
