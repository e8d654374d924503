"""Motions and sentences in one space: the network of the ranker, the critic and the judge, and its configuration."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.core.files import weights_file
from bunraku.core.nn.checkpoints import config_of, dated_checkpoint, fitting_config, load_checkpoint
from bunraku.core.nn.layers import Linear, Norm, Perceptron, Weights, gelu, gelu_slope, softmax, split_heads
from bunraku.generation.features import FEATURE_SIZE
from bunraku.language.encoders import TextBatch

KIND, RANKER = "extractor", "ranker"  # kinds of checkpoints: the judge, and the ranker
LONGEST = 196  # frames that the ranker sees at once; longer parts are cut into pieces
SHORTEST = 8  # parts of fewer frames are not judged
RADIUS = 10.0  # length of all vectors
FARTHEST = 8.0  # standard deviations up to which a feature counts, as in training of the denoiser


@dataclass(frozen=True)
class ExtractorConfig:
    """All that builds an extractor; a checkpoint carries it.

    Args:
        width: Size of a token.
        layers: Transformer layers of the motion encoder.
        heads: Attention heads.
        feedforward: Inner size of the feed-forward blocks.
        embedding: Size of the common space. The covariance that FID needs has its square, so it stays small.
        frames_per_token: Frames that share a token.
        features: Numbers a frame, D.
        text_encoder: Name of the text encoder.
        text_size, pooled_size: Sizes of its tokens and of its sentence vector.
        dropout: Share of units left out while training.
    """

    width: int = 192
    layers: int = 3
    heads: int = 4
    feedforward: int = 384
    embedding: int = 64
    frames_per_token: int = 4
    features: int = FEATURE_SIZE
    text_encoder: str = "all-MiniLM-L6-v2"
    text_size: int = 384
    pooled_size: int = 384
    dropout: float = 0.1


Back = Callable[[np.ndarray], np.ndarray]  # the gradient by a function's output -> that by its input
_NEVER = np.float32(-1e4)


class Extractor:
    """Motion encoder and text encoder. The statistics of the training features travel with the weights.

    Raises:
        ValueError: The weights have other sizes than the config.
    """

    def __init__(self, config: ExtractorConfig, weights: Weights, notes: Mapping[str, object] | None = None):
        self.config = config
        self.notes: Mapping[str, object] = notes or {}
        width, inner = config.width, config.feedforward
        if config.heads < 1 or width % config.heads or config.frames_per_token < 1:
            raise ValueError(f"{width} channels cannot be shared by {config.heads} heads")
        self.mean, self.std = weights.array("mean", config.features), weights.array("std", config.features)
        self._weights = weights.array("weights", config.features)
        even = np.arange(0, width, 2, dtype=np.float32)
        self._rates = np.float32(1000.0) ** (-even / np.float32(width))
        self._motion_in = weights.linear("motion_in", config.features * config.frames_per_token, width)
        self._motion_layers = [
            _Layer(width, config.heads, inner, weights.part(f"motion_layers.{index}")) for index in range(config.layers)
        ]
        self._motion_norm = weights.norm("motion_norm", 2 * width)
        self._motion_out = weights.perceptron("motion_out.0 motion_out.3", 2 * width, width, config.embedding)
        self._text_in = weights.linear("text_in", config.text_size, width)
        self._text_layer = _Layer(width, config.heads, inner, weights.part("text_layers.0"))
        self._pooled_in = weights.linear("pooled_in", config.pooled_size, width)
        self._text_norm = weights.norm("text_norm", 2 * width)
        self._text_out = weights.perceptron("text_out.0 text_out.3", 2 * width, width, config.embedding)
        weights.array("log_scale")  # of the loss

    def motion(self, features: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """Vectors of motions, shape (B, E), of length `RADIUS`.

        Args:
            features: In the data's units, anything behind a motion's end, shape (B, N, D).
            lengths: Real frames, shape (B,).
        """
        return np.float32(RADIUS) * self._directions(features, lengths)[0]

    def cosine_gradient(self, features: np.ndarray, lengths: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """The gradient, by each feature, of the cosine of each motion's vector with a goal of length 1 (B, E), shape
        (B, N, D); other arguments as of `motion`.
        """
        return self._directions(features, lengths)[1](goals.astype(np.float32))

    def _directions(self, features: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, Back]:
        """Unit vectors of motions, shape (B, E), and the way back."""
        batch, frames, size = features.shape
        patch = self.config.frames_per_token
        tokens = -(-frames // patch)
        scaled = (features - self.mean) / self.std
        within = np.abs(scaled) <= FARTHEST
        real = np.arange(tokens * patch) < np.asarray(lengths)[:, None]
        x = np.zeros((batch, tokens * patch, size), np.float32)
        x[:, :frames] = np.clip(scaled, -FARTHEST, FARTHEST) * self._weights
        x *= real[..., None]
        mask = np.asarray(real.reshape(batch, tokens, patch).any(-1))
        angle = np.arange(tokens, dtype=np.float32)[:, None] * self._rates
        h = self._motion_in(x.reshape(batch, tokens, -1))
        h += np.float32(0.5) * np.concatenate([np.cos(angle), np.sin(angle)], axis=-1)
        backs = []
        for layer in self._motion_layers:
            h, layer_back = layer(h, mask)
            backs.append(layer_back)
        masked = np.where(mask[..., None], h, _NEVER)
        most = masked.argmax(1)  # a short event in a long motion survives in the maximum
        count = np.maximum(mask.sum(1), 1).astype(np.float32)[:, None]
        pooled = np.concatenate([_mean(h, mask), np.take_along_axis(masked, most[:, None], axis=1)[:, 0]], axis=-1)
        unit, end = _ended(pooled, self._motion_norm, self._motion_out)

        def back(gradient: np.ndarray) -> np.ndarray:
            mean, largest = np.split(end(gradient), 2, axis=-1)
            out = (mean / count)[:, None] * mask[..., None]
            at = most[:, None]
            np.put_along_axis(out, at, np.take_along_axis(out, at, axis=1) + largest[:, None], axis=1)
            for through in reversed(backs):
                out = through(out)
            out = (out.reshape(-1, out.shape[-1]) @ self._motion_in.matrix.T).reshape(batch, tokens * patch, size)
            out *= real[..., None]
            return np.asarray(out[:, :frames] * within * (self._weights / self.std))

        return unit, back

    def text(self, text: TextBatch) -> np.ndarray:
        """Vectors of sentences, shape (B, E), of length `RADIUS`."""
        h, _ = self._text_layer(self._text_in(text.tokens), text.mask)
        pooled = self._pooled_in(text.pooled * np.float32(self.config.pooled_size**0.5))
        both = np.concatenate([_mean(h, text.mask), pooled], axis=-1)
        return np.float32(RADIUS) * _ended(both, self._text_norm, self._text_out)[0]


class _Layer:
    """A pre-norm transformer layer."""

    def __init__(self, width: int, heads: int, inner: int, weights: Weights):
        layer = weights.pre_norm("inside outside norm_a wide narrow norm_b", width, heads, inner)
        self.heads, self.norm_a, self.norm_b = heads, layer.norm_a, layer.norm_b
        self.inside, self.outside, self.wide, self.narrow = layer.own.enter, layer.own.leave, *layer.mix

    def __call__(self, x: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, Back]:
        """x (B, T, d), mask (B, T), True where real."""
        batch, length, width = x.shape
        scale = np.float32((width // self.heads) ** -0.5)
        first, norm_a = _normed(x, self.norm_a)
        inside = first.reshape(-1, width) @ self.inside.matrix
        inside += self.inside.bias
        query, key, value = inside.reshape(batch, length, 3, self.heads, -1).transpose(2, 0, 3, 1, 4)
        share = np.matmul(query, key.swapaxes(-1, -2))
        share *= scale
        share = softmax(np.where(mask[:, None, None], share, _NEVER))
        mixed = np.matmul(share, value).swapaxes(1, 2).reshape(-1, width)
        middle = x + ((mixed @ self.outside.matrix) + self.outside.bias).reshape(x.shape)
        second, norm_b = _normed(middle, self.norm_b)
        wide = second.reshape(-1, width) @ self.wide.matrix
        wide += self.wide.bias
        out = middle + ((gelu(wide.copy()) @ self.narrow.matrix) + self.narrow.bias).reshape(x.shape)
        wide = wide.reshape(batch, length, -1)

        def back(gradient: np.ndarray) -> np.ndarray:
            own = _through(gradient, self.narrow)
            own *= gelu_slope(wide)
            gradient = gradient + norm_b(_through(own, self.wide))
            (own,) = split_heads(_through(gradient, self.outside), self.heads)
            parts = np.empty((batch, length, 3, self.heads, width // self.heads), np.float32)
            by_query, by_key, by_value = parts.transpose(2, 0, 3, 1, 4)
            by_value[:] = np.matmul(share.swapaxes(-1, -2), own)
            slope = np.matmul(own, value.swapaxes(-1, -2))
            slope -= (slope * share).sum(-1, keepdims=True)
            slope *= share * scale
            by_query[:] = np.matmul(slope, key)
            by_key[:] = np.matmul(slope.swapaxes(-1, -2), query)
            return np.asarray(gradient + norm_a(_through(parts.reshape(batch, length, -1), self.inside)))

        return np.asarray(out), back


def _through(gradient: np.ndarray, layer: Linear) -> np.ndarray:
    """A gradient back through a linear layer, shape (..., D) -> (..., C)."""
    return np.asarray((gradient.reshape(-1, gradient.shape[-1]) @ layer.matrix.T).reshape(*gradient.shape[:-1], -1))


def _normed(x: np.ndarray, norm: Norm) -> tuple[np.ndarray, Back]:
    """A layer norm."""
    centred = x - x.mean(-1, keepdims=True)
    inverse = 1 / np.sqrt((centred * centred).mean(-1, keepdims=True) + np.float32(norm.epsilon))
    centred *= inverse

    def back(gradient: np.ndarray) -> np.ndarray:
        scaled = gradient * norm.scale
        mean, along = scaled.mean(-1, keepdims=True), (scaled * centred).mean(-1, keepdims=True)
        return np.asarray((scaled - mean - centred * along) * inverse)

    return centred * norm.scale + norm.shift, back


def _ended(x: np.ndarray, norm: Norm, ends: Perceptron) -> tuple[np.ndarray, Back]:
    """Unit vectors of what was pooled, shape (B, 2 d) -> (B, E)."""
    normed, back_norm = _normed(x, norm)
    wide = ends[0](normed)
    said = ends[1](gelu(wide.copy()))
    length = np.maximum(np.sqrt((said * said).sum(-1, keepdims=True)), np.float32(1e-12))
    unit = said / length

    def back(gradient: np.ndarray) -> np.ndarray:
        across = (gradient - unit * (gradient * unit).sum(-1, keepdims=True)) / length
        return back_norm(_through(_through(across, ends[1]) * gelu_slope(wide), ends[0]))

    return np.asarray(unit), back


def _mean(x: np.ndarray, mask: np.ndarray) -> np.ndarray:
    share = mask[..., None].astype(np.float32)
    return np.asarray((x * share).sum(1) / np.maximum(share.sum(1), 1))


def embed_motions(extractor: Extractor, motions: Sequence[np.ndarray], batch: int = 64) -> np.ndarray:
    """Vectors of motions (N, 271) in the data's units, in order, (B, E), float64; `batch` of them in one pass."""
    order = sorted(range(len(motions)), key=lambda index: len(motions[index]))
    out = np.zeros((len(motions), extractor.config.embedding))
    for start in range(0, len(order), batch):
        part = order[start : start + batch]
        lengths = np.array([len(motions[index]) for index in part])
        values = np.zeros((len(part), int(lengths.max()), extractor.config.features), np.float32)
        for row, index in enumerate(part):
            values[row, : len(motions[index])] = motions[index]
        out[part] = extractor.motion(values, lengths)
    return out


def sentence_vectors(extractor: Extractor, batch: TextBatch) -> np.ndarray:
    """The vectors of encoded sentences, shape (B, E), float64."""
    return extractor.text(batch).astype(np.float64)


def load_extractor(path: str | Path, kind: str = KIND) -> Extractor:
    """Read an extractor, or a ranker.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    state, config = load_checkpoint(path, kind, half=True)
    notes = config.pop("notes", None)
    with fitting_config(path):
        weights = Weights(state)
        model = Extractor(config_of(ExtractorConfig, config), weights, dict(notes or {}))
        weights.done()
    return model


def load_ranker(path: str | Path | None = None) -> Extractor:
    """The shipped ranker, or another one, kept between calls as long as the file does not change.

    Raises:
        WeightsError: The weights are missing or broken.
    """
    return _load(*dated_checkpoint("ranker", path))


def load_critic() -> Extractor | None:
    """The critic, which guides motions (`classifier_guidance`) and, trained apart from the ranker, chooses none; None
    where the file was taken away.

    Raises:
        WeightsError: The weights are broken.
    """
    if not weights_file("critic.safetensors").is_file():
        return None
    return _load(*dated_checkpoint("critic"))


@functools.lru_cache(maxsize=4)
def _load(path: Path, changed: int) -> Extractor:
    return load_extractor(path, kind=RANKER)
