"""The runtime's own networks with parameters of torch, so that a network is defined once and learns as it runs.

`bunraku.core.nn.layers` and what is built of it compute on anything that speaks numpy's protocols (NEP 13 and 18). Here
a tensor does (`Array`), and the weights that a network's constructor asks for are parameters (`Trainable`).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NoReturn, cast

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from bunraku.core.nn import layers
from bunraku.core.nn.layers import Linear, Norm, Weights
from bunraku_lab.nn.checkpoints import SavedNetwork


class Array(np.lib.mixins.NDArrayOperatorsMixin):
    """A tensor that the runtime's networks take for an array of numpy.

    What writes on an array (`x += y`) puts another tensor into the box, so that gradients stay right. A slice is an
    array of its own: writing on it changes nothing else.
    """

    __slots__ = ("tensor",)

    def __init__(self, tensor: torch.Tensor):
        self.tensor = tensor

    @property
    def shape(self) -> tuple[int, ...]:
        """As numpy's."""
        return tuple(self.tensor.shape)

    def __len__(self) -> int:
        return len(self.tensor)

    def __getitem__(self, key: Any) -> Array:
        if isinstance(key, torch.Tensor):  # a third of the time of the other way
            return Array(self.tensor.index_select(0, key))
        return Array(self.tensor[_plain(key if isinstance(key, tuple) else (key,))])

    def __array__(self, *_: object, **__: object) -> NoReturn:
        raise TypeError("a tensor that learns cannot become an array; add the function to `OPERATIONS`")

    def __getattr__(self, name: str) -> Callable[..., Array]:
        if name not in METHODS:
            raise AttributeError(name)
        return lambda *arguments, **options: Array(METHODS[name](self.tensor, *arguments, **options))

    def __bool__(self) -> bool:
        return bool(self.tensor)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: Any = None, **options: object) -> Any:
        if method != "__call__" or options or ufunc not in OPERATIONS:
            return NotImplemented
        result = OPERATIONS[ufunc](*_plain(inputs, self.tensor.device))
        if out is None:
            return Array(result)
        out[0].tensor = result
        return out[0]

    def __array_function__(self, function: Any, _: Any, arguments: Any, options: Mapping[str, object]) -> Any:
        if function not in OPERATIONS:
            return NotImplemented
        device = self.tensor.device
        named = {key: _plain(item, device) for key, item in options.items()}
        return _boxed(OPERATIONS[function](*_plain(arguments, device), **named))


def _plain(value: Any, device: torch.device | None = None) -> Any:
    """Tensors and numbers of what arrays, and tuples of them, hold; arrays of numpy as tensors on a device."""
    if isinstance(value, Array):
        return value.tensor
    if isinstance(value, tuple):
        items = (_plain(item, device) for item in value)
        return type(value)._make(items) if hasattr(value, "_make") else tuple(items)  # type: ignore[attr-defined]
    if isinstance(value, list):
        return [_plain(item, device) for item in value]
    if isinstance(value, np.ndarray):
        return torch.from_numpy(value).to(device)
    return value.item() if isinstance(value, np.generic) else value


def _boxed(value: Any) -> Any:
    if isinstance(value, torch.Tensor):
        return Array(value)
    return tuple(_boxed(item) for item in value) if isinstance(value, tuple) else value


def _normed(x: torch.Tensor, norm: Norm | None = None) -> torch.Tensor:
    if norm is None:
        return F.layer_norm(x, x.shape[-1:])
    scale, shift = cast(tuple[torch.Tensor, torch.Tensor], norm[:2])
    if scale.ndim == 1:
        return F.layer_norm(x, x.shape[-1:], scale, shift, norm.epsilon)
    return F.layer_norm(x, x.shape[-1:], eps=norm.epsilon) * scale + shift


def _attended(
    query: torch.Tensor, key: torch.Tensor, value: torch.Tensor, mask: torch.Tensor | None = None
) -> torch.Tensor:
    """Attention with a mask that is True where something counts. With a mask, torch's fused backward takes most of a
    step on a CPU (1.7 s against 0.6 s for 64 clips with plain products), so training there writes the products out.
    """
    if mask is None or not (torch.is_grad_enabled() and query.device.type == "cpu"):
        mixed = F.scaled_dot_product_attention(query, key, value, attn_mask=mask)
    else:
        scores = ((query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)).masked_fill(~mask, -1e4)
        mixed = torch.softmax(scores, dim=-1, dtype=scores.dtype) @ value
    return mixed.transpose(1, 2).flatten(2)


def _rotated(x: torch.Tensor, rotary: tuple[torch.Tensor, torch.Tensor]) -> torch.Tensor:
    first, second = x.chunk(2, dim=-1)
    cos, sin = (part.to(x.dtype) for part in rotary)
    return torch.cat([first * cos - second * sin, first * sin + second * cos], dim=-1)


METHODS: dict[str, Callable[..., torch.Tensor]] = {
    "reshape": torch.Tensor.reshape, "transpose": torch.Tensor.permute, "swapaxes": torch.Tensor.transpose,
    "copy": lambda x: x, "any": torch.Tensor.any, "all": torch.Tensor.all,
    "mean": lambda x, axis: x.mean(axis), "max": lambda x, axis: x.amax(axis),
}  # fmt: skip
"""Methods of numpy's arrays."""

OPERATIONS: dict[Callable[..., Any], Callable[..., Any]] = {
    np.add: operator.add, np.subtract: operator.sub, np.multiply: operator.mul, np.matmul: operator.matmul,
    np.invert: operator.invert, np.bitwise_and: operator.and_, np.less: operator.lt, np.greater_equal: operator.ge,
    np.sin: torch.sin, np.cos: torch.cos, np.where: torch.where, np.broadcast_to: lambda x, shape: x.expand(shape),
    np.concatenate: lambda parts, axis=0: torch.cat(parts, axis),
    np.split: lambda x, count, axis: torch.chunk(x, count, axis),
    layers.gelu: F.gelu, layers.silu: F.silu, layers.normed: _normed, layers.attended: _attended,
    layers.apply_rotary: _rotated, layers.hidden_by: lambda mask: mask[:, None, None],
    layers.padded: lambda x, length: F.pad(x, (0, 0, 0, length - x.shape[-2])),
}  # fmt: skip
"""What numpy's functions and the runtime's own are for tensors."""


class _TensorLinear(Linear):
    """Torch's own linear layer, which adds the bias within its product."""

    def __call__(self, x: np.ndarray) -> np.ndarray:
        given, matrix, bias = (_plain(part) for part in (x, self.matrix, self.bias))
        return cast(np.ndarray, Array(F.linear(given, matrix.t(), bias)))


class _Parameters(Weights):
    """The parameters of a network, each made when its constructor first asks for it: linear layers as torch begins
    them, norms that do nothing, anything else 0.
    """

    def __init__(self, network: Trainable, held: dict[str, torch.Tensor], prefix: str = ""):
        self._network, self._held, self._prefix = network, held, prefix

    def part(self, name: str) -> Weights:
        return _Parameters(self._network, self._held, f"{self._prefix}{name}.")

    def array(self, name: str, *shape: int, as_stored: bool = False) -> np.ndarray:
        return cast(np.ndarray, Array(self._tensor(name, shape, 0.0)))

    def linear(self, name: str, width_in: int, width_out: int, bias: bool = True) -> Linear:
        most = width_in**-0.5
        matrix = self._tensor(f"{name}.weight", (width_out, width_in), -most, most)
        shift = Array(self._tensor(f"{name}.bias", (width_out,), -most, most)) if bias else None
        return _TensorLinear(*cast(Any, (Array(matrix.t()), shift)))

    def norm(self, name: str, width: int, epsilon: float = 1e-5) -> Norm:
        scale, shift = self._tensor(f"{name}.weight", (width,), 1.0), self._tensor(f"{name}.bias", (width,), 0.0)
        return Norm(cast(Any, Array(scale)), cast(Any, Array(shift)), epsilon)

    def _tensor(self, name: str, shape: tuple[int, ...], low: float, high: float | None = None) -> torch.Tensor:
        full_name = self._prefix + name
        if full_name not in self._held:
            value = torch.empty(shape)
            nn.init.constant_(value, low) if high is None else nn.init.uniform_(value, low, high)
            self._held[full_name] = self._network.hold(full_name, value)
        return self._held[full_name]


class _Held(nn.Module):
    """Some weights of a network; a linear layer where they are of one."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return F.linear(x, cast(torch.Tensor, self.weight), cast(torch.Tensor | None, getattr(self, "bias", None)))


class Trainable(SavedNetwork):
    """A network of the runtime whose weights learn, under the names that they have in a checkpoint.

    Args:
        config: Its shape.
    """

    network: ClassVar[Callable[..., Any]]
    """The runtime's class: made of a config and weights."""
    fixed: ClassVar[frozenset[str]] = frozenset()
    """Last parts of the names of what is not learned."""

    def __init__(self, config: Any = None):
        super().__init__()
        self.config = self.shape() if config is None else config
        self._names: list[str] = []
        type(self).network(self.config, _Parameters(self, {}))
        with torch.no_grad():
            self.begin()

    def begin(self) -> None:
        """Set weights that begin otherwise than layers do."""

    def hold(self, name: str, value: torch.Tensor) -> torch.Tensor:
        """Keep a weight under the name that it has in a checkpoint."""
        self._names.append(name)
        *parents, last = name.split(".")
        module: nn.Module = self
        for parent in parents:
            if parent not in module._modules:
                module.add_module(parent, _Held())
            module = module.get_submodule(parent)
        if last in self.fixed:
            module.register_buffer(last, value)
            return value
        module.register_parameter(last, nn.Parameter(value))
        return module.get_parameter(last)

    def learning(self) -> Any:
        """The runtime's network over the weights as they are now, for one pass over arrays that are `Array`s."""
        held = {name: operator.attrgetter(name)(self) for name in self._names}
        return type(self).network(self.config, _Parameters(self, held))

    def running(self) -> Any:
        """The runtime's network with a copy of the weights: what a training is judged by."""
        return type(self).network(self.config, Weights(arrays_of(self)))


def arrays_of(model: nn.Module) -> dict[str, np.ndarray]:
    """The weights of a network by name, float32 on the CPU; later changes of the network do not change them."""
    return {name: value.detach().float().cpu().numpy().copy() for name, value in model.state_dict().items()}
