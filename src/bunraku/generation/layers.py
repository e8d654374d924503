"""Layers of the denoiser in numpy, its configuration and the presets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.core.body.layout import HANDLE_COUNT
from bunraku.core.nn.checkpoints import config_of
from bunraku.core.nn.layers import Attention, Memory, Norm, Rotary, Weights, apply_rotary, hidden_by, split_heads
from bunraku.generation.features import FEATURE_SIZE

TRAINING_STEPS = 1000  # of noise, from the clean motion on; a sampler visits some of them

_RETIRED = ("architecture", "convolution")
"""Fields of older checkpoints; what they switched on had weights of its own, by which it is refused."""


@dataclass(frozen=True)
class DenoiserConfig:
    """All that builds a denoiser; a checkpoint carries it."""

    width: int = 256  # size of a token, d
    layers: int = 8  # decoder layers
    heads: int = 4  # attention heads
    feedforward: int = 1024  # inner size of the feed-forward blocks
    frames: int = 196  # longest motion in one pass
    frames_per_token: int = 4  # frames that share a token
    features: int = FEATURE_SIZE  # numbers a frame, D
    handles: int = HANDLE_COUNT  # mesh handles, K
    mesh_features: int = 448  # size of f_phi
    text_encoder: str = "all-MiniLM-L6-v2"  # name of the text encoder that it was trained with
    # text_size, pooled_size: sizes of its tokens and of its sentence vector
    text_size: int = 384
    pooled_size: int = 384
    fps: float = 20.0  # frames a second [1/s]
    adaptation_mesh: bool = False  # whether the adaptation's linear layer sees the mesh token beside the hidden state
    # output of that layer: "root", offsets in the root's frame as in the paper; or "joints", how far the joint between
    # each handle and its parent should be moved, which gives `joint_offsets`
    adaptation_frame: str = "root"
    examples: int = 0  # captured examples, retrieved for the sentence, that motion tokens attend to; 0 for none


def denoiser_config(data: Mapping[str, object]) -> DenoiserConfig:
    """The config of a checkpoint, also one with fields that are no longer in use.

    Raises:
        OptionError: As of `config_of`.
    """
    return config_of(DenoiserConfig, {name: value for name, value in data.items() if name not in _RETIRED})


PRESETS: dict[str, DenoiserConfig] = {
    "small": DenoiserConfig(),
    "paper": DenoiserConfig(width=512, feedforward=1024, frames_per_token=1),
}


@dataclass(frozen=True, eq=False)
class Condition:
    """What the layers read beside the motion."""

    memories: Sequence[Memory]  # of sentence and mesh, in each layer
    hidden: np.ndarray | None  # of them, as of `hidden_by`
    sentence: np.ndarray  # shape (B, d)
    mesh: np.ndarray  # the mesh token, shape (B, d)
    examples: Sequence[Memory | None]  # of examples, in each layer; None in one that does not attend to them
    hidden_examples: np.ndarray | None  # of these

    def rows(self, rows: slice) -> Condition:
        """Of these rows of the batch."""
        return Condition(
            [Memory(memory.keys[rows], memory.values[rows]) for memory in self.memories],
            None if self.hidden is None else self.hidden[rows], self.sentence[rows], self.mesh[rows],
            [None if memory is None else Memory(memory.keys[rows], memory.values[rows]) for memory in self.examples],
            None if self.hidden_examples is None else self.hidden_examples[rows],
        )  # fmt: skip


def rotary_positions(tokens: np.ndarray, size: int) -> Rotary:
    """Cosines and sines of rotary positions (Su et al. 2021) of tokens at these times, shape (T,), each of shape (T,
    size / 2).
    """
    rates = np.float32(1000.0) ** (-np.arange(0, size, 2, dtype=np.float32) / np.float32(size))
    angle = tokens[:, None].astype(np.float32) * rates
    return np.cos(angle), np.sin(angle)


def waves(angle: np.ndarray, width: int) -> np.ndarray:
    """Cosines and sines of numbers of shape (A,), shape (A, width)."""
    half = width // 2
    rates = np.exp(np.float32(-math.log(10_000.0)) * np.arange(half, dtype=np.float32) / np.float32(half))
    turned = angle[:, None] * rates
    return np.concatenate([np.cos(turned), np.sin(turned)], axis=-1)


class DecoderLayer:
    """Self-attention, cross-attention, feed-forward; each behind an adaptive norm and a gate. `examples` tells whether
    this layer attends to examples.
    """

    def __init__(self, config: DenoiserConfig, weights: Weights, examples: bool):
        width = config.width
        self.heads = config.heads
        self.offset = weights.array("offset", 9, width)
        self.own = weights.attention("self_in", "self_out", width, config.heads)
        query, out = weights.linear("cross_query", width, width), weights.linear("cross_out", width, width)
        self.cross = Attention(query, out, config.heads)
        self.cross_memory = weights.linear("cross_memory", width, 2 * width)
        self.mix = weights.feed_forward("wide", "narrow", width, config.feedforward)
        if config.examples:
            self.offset = np.concatenate([self.offset, weights.array("offset_more", 3, width)])
        self.examples = None
        if examples:
            part = weights.part("examples")
            query, out, self.example_key, self.example_value = (
                part.linear(name, width, width) for name in ("query", "out", "key", "value")
            )
            self.examples = Attention(query, out, config.heads)

    def memory(self, tokens: np.ndarray) -> tuple[np.ndarray, ...]:
        """Keys and values of tokens (B, M, d)."""
        return split_heads(self.cross_memory(tokens), self.heads, 2)

    def example_memory(self, keys: np.ndarray, values: np.ndarray, rotary: Rotary) -> Memory | None:
        """Keys and values of examples' tokens (B, M, d); None in a layer that does not attend to them."""
        if self.examples is None:
            return None
        (key,) = split_heads(self.example_key(keys), self.heads)
        (value,) = split_heads(self.example_value(values), self.heads)
        return Memory(apply_rotary(key, rotary), value)

    def __call__(
        self, x: np.ndarray, steer: np.ndarray, rotary: Rotary, real: np.ndarray | None, condition: Condition,
        index: int,
    ) -> np.ndarray:  # fmt: skip
        """The next hidden states, shape (B, T, d).

        Args:
            x: Hidden states, shape (B, T, d), which it writes on.
            steer: Scale, shift and gate of each block, shape (B, 9, or 12 with examples, d).
            rotary: Of the tokens.
            real: Which tokens are real, shape (B, T); None where all are.
            condition: As of `Condition`.
            index: Of the layer.
        """
        parts = (steer + self.offset)[:, :, None].swapaxes(0, 1)
        scales = 1 + parts[::3]
        hidden = None if real is None else hidden_by(real)
        x = self.own(x, Norm(scales[0], parts[1]), None, hidden, rotary, parts[2])
        x = self.cross(x, Norm(scales[1], parts[4]), condition.memories[index], condition.hidden, None, parts[5])
        examples = condition.examples[index]
        if self.examples is not None and examples is not None:
            x = self.examples(x, Norm(scales[-1], parts[-2]), examples, condition.hidden_examples, rotary, parts[-1])
        return self.mix(x, Norm(scales[2], parts[7]), parts[8])
