"""From the arrays of a checkpoint to the layers that its config describes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bunraku.nn.layers import Attention, FeedForward, Linear, Norm

__all__ = ["Weights"]


class Weights:
    """The arrays of a checkpoint, handed to the network that its config describes. Each is compared with the size that
    the config asks for, before anything of that size is made.

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

    def array(self, name: str, *shape: int) -> np.ndarray:
        """One of them.

        Raises:
            ValueError: It is not there, or has another size.
        """
        whole = self._prefix + name
        found = self._state.get(whole)
        if found is None or found.shape != shape:
            there = "none" if found is None else str(list(found.shape))
            raise ValueError(f"its config makes '{whole}' of size {list(shape)}, and the file has {there}")
        self._left.discard(whole)
        return found.astype(np.float32) if found.dtype == np.float16 else found

    def linear(self, name: str, width_in: int, width_out: int, bias: bool = True) -> Linear:
        """The linear layer of this name; its matrix lies as the product reads it."""
        matrix = self.array(f"{name}.weight", width_out, width_in)
        return Linear(np.ascontiguousarray(matrix.T), self.array(f"{name}.bias", width_out) if bias else None)

    def norm(self, name: str, width: int, epsilon: float = 1e-5) -> Norm:
        """The layer norm of this name."""
        return Norm(self.array(f"{name}.weight", width), self.array(f"{name}.bias", width), epsilon)

    def attention(self, enter: str, leave: str, width: int, heads: int) -> Attention:
        """Attention of the states to one another, of two linear layers by name."""
        if heads < 1 or width % heads:
            raise ValueError(f"{width} channels cannot be shared by {heads} heads")
        return Attention(self.linear(enter, width, 3 * width), self.linear(leave, width, width), heads)

    def feed_forward(self, wide: str, narrow: str, width: int, inner: int) -> FeedForward:
        """Of two linear layers by name."""
        return FeedForward(self.linear(wide, width, inner), self.linear(narrow, inner, width))

    def done(self) -> None:
        """All have been handed out.

        Raises:
            ValueError: The checkpoint holds more.
        """
        if self._left:
            raise ValueError(f"its config makes no '{min(self._left)}', which the file has")
