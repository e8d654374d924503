"""The layers of the networks for inference in numpy: built from the arrays of a checkpoint, run on few threads."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

    from threadpoolctl import ThreadpoolController

_NEVER = np.float32(-1e30)
"""Added to a score of attention, it hides a position."""
_PIECE = 1 << 15
"""Numbers of an array that go through all passes of a function at once."""
_GELU = tuple(np.float32(value) for value in (
    1.80559369e-09, -1.33445333e-07, 3.96909116e-06, -5.5240016e-05, -3.31305363e-05, 0.0363342845, 0.797884216,
))  # fmt: skip
"""P, falling powers, such that tanh(x P(x^2)) is erf(x / sqrt 2), fitted on |x| < 6 for the least error of `gelu`;
beyond, both are 1.
"""


def brought(function: Callable[..., Any], x: Any, *arguments: Any) -> Any:
    """The same of another kind of array, which brings its own, by the protocol of numpy's functions (NEP 18): torch's
    tensors do so in training.
    """
    return x.__array_function__(function, (type(x),), (x, *arguments), {})


Rotary = tuple[np.ndarray, np.ndarray]
"""Cosines and sines of rotary positions (Su et al. 2021), shape (T, d/H/2) each."""


class Linear(NamedTuple):
    """`x @ matrix + bias`, with a matrix (C, D) and a bias (D,) or None, and a change of the matrix of low rank (Hu et
    al. 2021): (C, R) and (R, D).
    """

    matrix: np.ndarray
    bias: np.ndarray | None
    change: tuple[np.ndarray, np.ndarray] | None = None

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Shape (..., C) -> (..., D): one product whatever the leading shape."""
        rows = x.reshape(-1, x.shape[-1])
        out: np.ndarray = rows @ self.matrix
        if self.bias is not None:
            out += self.bias
        if self.change is not None:
            out += rows @ self.change[0] @ self.change[1]
        return out.reshape(*x.shape[:-1], -1)


class Norm(NamedTuple):
    """Layer norm with a scale and a shift of each channel, shape (C,), and an epsilon added to the variance."""

    scale: np.ndarray
    shift: np.ndarray
    epsilon: float = 1e-5

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Shape (..., C) -> (..., C)."""
        return normed(x, self)


class Memory(NamedTuple):
    """Keys and values of what a layer attends to, of each head, shape (B, H, M, d/H)."""

    keys: np.ndarray
    values: np.ndarray


class Attention(NamedTuple):
    """Attention of H heads behind a norm, added to its input. `enter` makes queries, keys and values side by side, or
    queries alone where it attends to a memory; `leave` maps the result.
    """

    enter: Linear
    leave: Linear
    heads: int

    def __call__(
        self,
        x: np.ndarray,
        norm: Norm,
        memory: Memory | None = None,
        hidden: np.ndarray | None = None,
        rotary: Rotary | None = None,
        gate: np.ndarray | None = None,
    ) -> np.ndarray:
        """The next hidden states; writes on `x`, shape (B, T, d).

        Args:
            x: Hidden states.
            norm: Before attention; scale and shift may differ from row to row.
            memory: What is attended to; the states themselves where None.
            hidden: Mask of that, from `hidden_by`.
            rotary: Positions for queries, and for keys that are the states' own; None for no positions.
            gate: Factor of what is added.
        """
        batch, length, width = x.shape
        entered = self.enter(normed(x, norm)).reshape(batch, length, -1, self.heads, width // self.heads)
        parts = entered.transpose(2, 0, 3, 1, 4)
        if memory is None:
            query, key = parts[:2] if rotary is None else apply_rotary(parts[:2], rotary)
            mixed = attended(query, key, parts[2], hidden)
        else:
            query = parts[0] if rotary is None else apply_rotary(parts[0], rotary)
            mixed = attended(query, memory.keys, memory.values, hidden)
        left = self.leave(mixed)
        if gate is not None:
            left *= gate
        x += left
        return x


class FeedForward(NamedTuple):
    """Two linear layers with GELU between them behind a norm, added to their input."""

    wide: Linear
    narrow: Linear

    def __call__(self, x: np.ndarray, norm: Norm, gate: np.ndarray | None = None) -> np.ndarray:
        """The next hidden states; writes on `x`, shape (..., d)."""
        narrowed = self.narrow(gelu(self.wide(normed(x, norm))))
        if gate is not None:
            narrowed *= gate
        x += narrowed
        return x


class PreNorm(NamedTuple):
    """A transformer layer with norms before attention and feed-forward."""

    own: Attention
    norm_a: Norm
    mix: FeedForward
    norm_b: Norm

    def __call__(self, x: np.ndarray, hidden: np.ndarray | None = None) -> np.ndarray:
        """Shape (B, T, d), with a mask of `hidden_by`; writes on `x`."""
        return self.mix(self.own(x, self.norm_a, None, hidden), self.norm_b)


class Perceptron(NamedTuple):
    """Two linear layers with GELU between them."""

    first: Linear
    second: Linear

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Shape (..., C) -> (..., D)."""
        return self.second(gelu(self.first(x)))


class PostNorm(NamedTuple):
    """A transformer layer of BERT (Devlin et al. 2019), with norms after attention and feed-forward. Query, key and
    value have all heads side by side.
    """

    query: Linear
    key: Linear
    value: Linear
    leave: Linear
    heads: int
    norm_a: Norm
    wide: Linear
    narrow: Linear
    norm_b: Norm

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Shape (B, T, d) -> (B, T, d)."""
        shape = (*x.shape[:2], self.heads, -1)
        query, key, value = self.query(x).reshape(shape), self.key(x).reshape(shape), self.value(x).reshape(shape)
        heads = query.transpose(0, 2, 1, 3), key.transpose(0, 2, 1, 3), value.transpose(0, 2, 1, 3)
        x = normed(x + self.leave(attended(*heads)), self.norm_a)
        return normed(x + self.narrow(gelu(self.wide(x))), self.norm_b)


def mean_and_most(x: np.ndarray) -> np.ndarray:
    """Mean and largest value of each channel over the tokens, shape (B, T, d) -> (B, 2 d)."""
    return np.concatenate([x.mean(axis=1), x.max(axis=1)], axis=-1)


def through(layers: Sequence[Any], x: np.ndarray) -> np.ndarray:
    """What layers make of `x`, one after the other; mypy takes no named tuple for a callable."""
    for layer in layers:
        x = layer(x)
    return x


def through_parts(layers: Sequence[Any], parts: Sequence[np.ndarray]) -> np.ndarray:
    """The same of each part of a batch, one below the other; a part at a time stays in the processor's cache."""
    return np.concatenate([through(layers, part) for part in parts])


def normed(x: np.ndarray, norm: Norm | None = None) -> np.ndarray:
    """Layer norm over the last axis, without scale and shift where no norm is given."""
    if not isinstance(x, np.ndarray):
        return brought(normed, x, norm)
    out = x - x.mean(-1, keepdims=True)
    variance = np.einsum("...i,...i->...", out, out)
    variance /= np.float32(x.shape[-1])
    variance += np.float32(1e-5 if norm is None else norm.epsilon)
    out *= (1 / np.sqrt(variance))[..., None]
    if norm is not None:
        out *= norm.scale
        out += norm.shift
    return np.asarray(out)


def gelu(x: np.ndarray, share: bool = False) -> np.ndarray:
    """x times the share of a normal distribution below x (Hendrycks & Gimpel 2016), to 1e-6, or that `share` alone;
    writes on a contiguous array.
    """
    if not isinstance(x, np.ndarray):
        return brought(gelu, x)
    flat = x.reshape(-1)
    room = np.empty((2, min(flat.size, _PIECE)), np.float32)
    for start in range(0, flat.size, _PIECE):
        part = flat[start : start + _PIECE]
        square, value = room[:, : part.size]
        np.multiply(part, part, out=square)
        np.multiply(square, _GELU[0], out=value)
        for factor in _GELU[1:-1]:
            value += factor
            value *= square
        value += _GELU[-1]
        value *= part
        np.tanh(value, out=value)
        if share:
            value *= np.float32(0.5)
            np.add(value, np.float32(0.5), out=part)
        else:
            np.multiply(part, np.float32(0.5), out=square)
            value *= square
            np.add(value, square, out=part)
    return flat.reshape(x.shape)


def gelu_slope(x: np.ndarray) -> np.ndarray:
    """The derivative of `gelu`."""
    out = gelu(x.copy(), share=True)
    out += x * np.exp(np.float32(-0.5) * x * x) * np.float32(1 / np.sqrt(2 * np.pi))
    return out


def sigmoid(x: np.ndarray) -> np.ndarray:
    """1 / (1 + e^-x), without an overflow."""
    return np.asarray(np.float32(0.5) * (np.float32(1) + np.tanh(np.float32(0.5) * x)))


def silu(x: np.ndarray) -> np.ndarray:
    """x times its sigmoid."""
    if not isinstance(x, np.ndarray):
        return brought(silu, x)
    return np.asarray(x * sigmoid(x))


def softmax(scores: np.ndarray) -> np.ndarray:
    """Shares that sum to 1 over the last axis; writes on its argument."""
    scores -= scores.max(-1, keepdims=True)
    np.exp(scores, out=scores)
    scores /= scores.sum(-1, keepdims=True)
    return scores


def hidden_by(mask: np.ndarray) -> np.ndarray | None:
    """What hides all but what is True in a mask (B, M) when added to scores, (B, 1, 1, M); None where all is True."""
    if not isinstance(mask, np.ndarray):
        return brought(hidden_by, mask)
    return None if mask.all() else np.where(mask, np.float32(0), _NEVER)[:, None, None]


def split_heads(x: np.ndarray, heads: int, parts: int = 1) -> tuple[np.ndarray, ...]:
    """Queries, keys or values of each head (B, H, T, d/H), from `parts` of them side by side (B, T, parts d)."""
    return tuple(x.reshape(*x.shape[:2], parts, heads, -1).transpose(2, 0, 3, 1, 4))


def apply_rotary(x: np.ndarray, rotary: Rotary) -> np.ndarray:
    """Queries or keys with their positions in time, shape (..., T, d/H)."""
    if not isinstance(x, np.ndarray):
        return brought(apply_rotary, x, rotary)
    half = x.shape[-1] // 2
    first, second = x[..., :half], x[..., half:]
    cos, sin = rotary
    out = np.empty(x.shape, np.float32)
    np.subtract(first * cos, second * sin, out=out[..., :half])
    np.add(first * sin, second * cos, out=out[..., half:])
    return out


def attended(query: np.ndarray, key: np.ndarray, value: np.ndarray, hidden: np.ndarray | None = None) -> np.ndarray:
    """Attention (Vaswani et al. 2017) of queries (B, H, T, d) to keys and values (B, H, M, d), shape (B, T, H d)."""
    if not isinstance(query, np.ndarray):
        return brought(attended, query, key, value, hidden)
    scores = np.matmul(query, key.swapaxes(-1, -2))
    scores *= np.float32(query.shape[-1] ** -0.5)
    if hidden is not None:
        scores += hidden
    softmax(scores)
    batch, heads, length, size = query.shape
    out = np.empty((batch, length, heads, size), np.float32)
    np.matmul(scores, value, out=out.transpose(0, 2, 1, 3))
    return out.reshape(batch, length, heads * size)


def padded(x: np.ndarray, length: int) -> np.ndarray:
    """With zeros behind, shape (..., N, D) -> (..., length, D), float32."""
    if not isinstance(x, np.ndarray):
        return brought(padded, x, length)
    out = np.zeros((*x.shape[:-2], length, x.shape[-1]), np.float32)
    out[..., : x.shape[-2], :] = x
    return out


def rotary_positions(tokens: np.ndarray, size: int) -> Rotary:
    """Cosines and sines of rotary positions (Su et al. 2021) of tokens at these times (T,), shape (T, size / 2)."""
    rates = np.float32(1000.0) ** (-np.arange(0, size, 2, dtype=np.float32) / np.float32(size))
    angle = tokens[:, None].astype(np.float32) * rates
    return np.cos(angle), np.sin(angle)


def waves(angle: np.ndarray, width: int) -> np.ndarray:
    """Cosines and sines of numbers of shape (A,), shape (A, width)."""
    half = width // 2
    rates = np.exp(np.float32(-math.log(10_000.0)) * np.arange(half, dtype=np.float32) / np.float32(half))
    turned = angle[:, None] * rates
    return np.concatenate([np.cos(turned), np.sin(turned)], axis=-1)


def unit(x: np.ndarray) -> np.ndarray:
    """Vectors of length 1, shape (..., E); zero vectors stay."""
    length = np.sqrt(np.einsum("...i,...i->...", x, x))[..., None]
    return np.asarray(x / np.maximum(length, np.float32(1e-12)))


class Weights:
    """The arrays of a checkpoint, handed to the network that its config describes. Each is compared with the size that
    the config asks for before anything of that size is allocated.

    Args:
        state: Arrays by name; float16 is handed out as float32.
        prefix: Of the names of a part of the network.
    """

    def __init__(self, state: Mapping[str, np.ndarray], prefix: str = "", left: set[str] | None = None):
        self._state, self._prefix = state, prefix
        self._left = set(state) if left is None else left

    def part(self, name: str) -> Weights:
        """Those of a part of the network."""
        return Weights(self._state, f"{self._prefix}{name}.", self._left)

    def array(self, name: str, *shape: int, as_stored: bool = False) -> np.ndarray:
        """One of them, of this shape, float16 only `as_stored`. ValueError if it is missing, or has another shape."""
        full_name = self._prefix + name
        array = self._state.get(full_name)
        if array is None or array.shape != shape:
            there = "none" if array is None else str(list(array.shape))
            raise ValueError(f"its config makes '{full_name}' of size {list(shape)}, and the file has {there}")
        self._left.discard(full_name)
        return array.astype(np.float32) if array.dtype == np.float16 and not as_stored else array

    def linear(self, name: str, width_in: int, width_out: int, bias: bool = True) -> Linear:
        """The linear layer of this name; its matrix lies as the product reads it."""
        stored = self.array(f"{name}.weight", width_out, width_in, as_stored=True)
        # turned and converted at once, which takes a third of the time of one after the other
        matrix = np.ascontiguousarray(stored.T, np.dtype(np.float32) if stored.dtype == np.float16 else stored.dtype)
        return Linear(matrix, self.array(f"{name}.bias", width_out) if bias else None)

    def norm(self, name: str, width: int, epsilon: float = 1e-5) -> Norm:
        """The layer norm of this name."""
        return Norm(self.array(f"{name}.weight", width), self.array(f"{name}.bias", width), epsilon)

    def attention(self, enter: str, leave: str, width: int, heads: int) -> Attention:
        """Attention of the states to one another, from two linear layers by name."""
        if heads < 1 or width % heads:
            raise ValueError(f"{width} channels cannot be shared by {heads} heads")
        return Attention(self.linear(enter, width, 3 * width), self.linear(leave, width, width), heads)

    def feed_forward(self, wide: str, narrow: str, width: int, inner: int) -> FeedForward:
        """From two linear layers by name."""
        return FeedForward(self.linear(wide, width, inner), self.linear(narrow, inner, width))

    def perceptron(self, names: str, width_in: int, inner: int, width_out: int) -> Perceptron:
        """From the names of its two linear layers."""
        first, second = names.split()
        return Perceptron(self.linear(first, width_in, inner), self.linear(second, inner, width_out))

    def pre_norm(self, names: str, width: int, heads: int, inner: int) -> PreNorm:
        """A transformer layer from the names of its attention's two linear layers, its norm, the two of its
        feed-forward and that one's norm.
        """
        enter, leave, norm_a, wide, narrow, norm_b = names.split()
        return PreNorm(
            self.attention(enter, leave, width, heads), self.norm(norm_a, width),
            self.feed_forward(wide, narrow, width, inner), self.norm(norm_b, width),
        )  # fmt: skip

    def pre_norms(self, part: str, count: int, names: str, width: int, heads: int, inner: int) -> list[PreNorm]:
        """Several of them, in the numbered parts of a part."""
        return [self.part(f"{part}.{index}").pre_norm(names, width, heads, inner) for index in range(count)]

    def done(self) -> None:
        """Raise ValueError unless all have been handed out."""
        if self._left:
            raise ValueError(f"its config makes no '{min(self._left)}', which the file has")


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


class DecoderLayer:
    """Self-attention, cross-attention, feed-forward; each behind an adaptive norm and a gate.

    Args:
        width, heads, inner: Size of a token, attention heads, and size inside of the feed-forward block.
        weights: Of the layer.
        shown: Whether the network attends to examples, as every other layer does.
        examples: Whether this one does.
    """

    def __init__(self, width: int, heads: int, inner: int, weights: Weights, shown: bool, examples: bool):
        self.heads = heads
        self.offset = weights.array("offset", 9, width)
        self.own = weights.attention("self_in", "self_out", width, heads)
        query = weights.linear("cross_query", width, width)
        self.cross_memory = weights.linear("cross_memory", width, 2 * width)
        self.cross = Attention(query, weights.linear("cross_out", width, width), heads)
        self.mix = weights.feed_forward("wide", "narrow", width, inner)
        if shown:
            self.offset = np.concatenate([self.offset, weights.array("offset_more", 3, width)])
        self.examples = None
        if examples:
            part = weights.part("examples")
            query, self.example_key, self.example_value, out = (
                part.linear(name, width, width) for name in ("query", "key", "value", "out")
            )
            self.examples = Attention(query, out, heads)

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
        self, x: np.ndarray, steer: np.ndarray, rotary: Rotary, hidden: np.ndarray | None, condition: Condition,
        index: int,
    ) -> np.ndarray:  # fmt: skip
        """The next hidden states, shape (B, T, d).

        Args:
            x: Hidden states, shape (B, T, d), which it writes on.
            steer: Scale, shift and gate of each block, shape (B, 9, or 12 with examples, d).
            rotary: Of the tokens.
            hidden: Mask of the tokens, from `hidden_by`.
            condition: As of `Condition`.
            index: Of the layer.
        """
        parts = (steer + self.offset)[:, :, None].swapaxes(0, 1)
        scales = 1 + parts[::3]
        x = self.own(x, Norm(scales[0], parts[1]), None, hidden, rotary, parts[2])
        x = self.cross(x, Norm(scales[1], parts[4]), condition.memories[index], condition.hidden, None, parts[5])
        examples = condition.examples[index]
        if self.examples is not None and examples is not None:
            x = self.examples(x, Norm(scales[-1], parts[-2]), examples, condition.hidden_examples, rotary, parts[-1])
        return self.mix(x, Norm(scales[2], parts[7]), parts[8])


def decoded(
    layers: Sequence[DecoderLayer], x: np.ndarray, steer: np.ndarray, ends: np.ndarray, real: np.ndarray | None,
    condition: Condition,
) -> np.ndarray:  # fmt: skip
    """What decoder layers make of tokens that stand at 0, 1, 2 … in time, behind an adaptive norm, shape (B, T, d).

    Args:
        layers: In their order.
        x: Hidden states, shape (B, T, d), which it writes on.
        steer: As of `DecoderLayer`.
        ends: Scale and shift of the norm, side by side, shape (B, 2 d).
        real: Which tokens are real, shape (B, T); None where all are.
        condition: As of `Condition`.
    """
    rotary = rotary_positions(np.arange(x.shape[1]), x.shape[2] // layers[0].heads)
    hidden = None if real is None else hidden_by(real)
    for index, layer in enumerate(layers):
        x = layer(x, steer, rotary, hidden, condition, index)
    scale, shift = np.split(ends[:, None], 2, axis=-1)
    return normed(x, Norm(1 + scale, shift))


_spare: ContextVar[bool] = ContextVar("spare", default=False)
"""Whether `one_thread` left a processor without work."""
_One = TypeVar("_One")
_Other = TypeVar("_Other")


def usable_threads() -> int:
    """Number of threads for this process: OMP_NUM_THREADS, else one for each processor."""
    asked = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0]
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for each matrix product.

    The products of a small network are too short to share: a second thread gains a fifth where a core is free; where
    none is, threads wait for one another and a clip takes many times as long. One thread also always adds in one order.
    """
    spare = _spare.set(usable_threads() > 1)
    try:
        if os.environ.get("OPENBLAS_NUM_THREADS") == "1":  # as on the command line
            yield
        else:
            with _libraries().limit(limits=1, user_api="blas"):
                yield
    finally:
        _spare.reset(spare)


def each_in_one_thread(items: Iterator[_One]) -> Iterator[_One]:
    """The items of an iterator, each made within `one_thread`."""
    while True:
        with one_thread():
            try:
                item = next(items)
            except StopIteration:
                return
        yield item


def parallel(first: Callable[[], _One], second: Callable[[], _Other]) -> tuple[_One, _Other]:
    """The results of two calls. Within `one_thread` the second has a thread of its own, where there is a processor for
    it; each adds in its own order, so results do not depend on whether they ran at once.
    """
    if not _spare.get():
        return first(), second()
    other = _thread().submit(second)
    try:
        first_result = first()
    finally:
        other.exception()  # it has ended when this goes on
    return first_result, other.result()


@cache
def _thread() -> ThreadPoolExecutor:
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(1, "side")


@cache
def _libraries() -> ThreadpoolController:
    """The libraries that numpy multiplies with; finding them takes longer than setting their threads."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
