"""The nodes of an FBX file, and how much they may hold."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from bunraku.errors import FormatError

__all__ = ["Allowance", "FbxArray", "FbxNode", "FbxTree"]

MAX_DEPTH, MAX_NODES, MAX_VALUES = 64, 1_500_000, 6_000_000


MAX_UNPACKED = 1 << 30
"""Most bytes that the arrays of a file may take when they are unpacked."""


BROKEN = "the file is broken, export it again"


class Allowance:
    """What the arrays of one file may still take [bytes].

    Args:
        path: The file, for messages.
        left: Bytes.
    """

    def __init__(self, path: Path, left: int = MAX_UNPACKED):
        self.path, self.left = path, left

    def take(self, size: int) -> None:
        """Use some of it.

        Raises:
            FormatError: It is used up.
        """
        self.left -= size
        if self.left < 0:
            raise FormatError(
                self.path,
                f"its arrays take more than {MAX_UNPACKED >> 20} MiB when unpacked; simplify the mesh or shorten its "
                "clips first",
            )


@dataclass(frozen=True, eq=False)
class FbxArray:
    """An array of a node, packed as the file holds it.

    Args:
        allowance: Of the file.
        dtype: Of its elements.
        count: How many there are.
        packed: Whether zlib packed them.
        data: The bytes of the file, or the elements.
    """

    allowance: Allowance
    dtype: np.dtype[Any]
    count: int
    packed: bool
    data: memoryview | np.ndarray

    def numbers(self) -> np.ndarray:
        """The elements, shape (count,).

        Raises:
            FormatError: They are damaged, or larger than may be.
        """
        if isinstance(self.data, np.ndarray):
            return self.data
        size = self.count * self.dtype.itemsize
        self.allowance.take(size)
        data: Any = self.data
        if self.packed:
            try:
                data = zlib.decompressobj().decompress(data, size) if size else b""
            except zlib.error:
                raise FormatError(self.allowance.path, f"a packed array is damaged; {BROKEN}") from None
        if len(data) != size:
            raise FormatError(self.allowance.path, f"an array is shorter than it says; {BROKEN}")
        return np.frombuffer(data, self.dtype)


@dataclass(eq=False)
class FbxNode:
    """A node of the tree.

    Args:
        name: Its name.
        values: Numbers, text, bytes and arrays.
        children: Nodes below it.
    """

    name: str
    values: list[Any] = field(default_factory=list)
    children: list[FbxNode] = field(default_factory=list)

    def all(self, name: str) -> Iterator[FbxNode]:
        """The children of this name."""
        return (child for child in self.children if child.name == name)

    def child(self, name: str) -> FbxNode | None:
        """The first child of this name."""
        return next(self.all(name), None)

    def value(self, name: str, default: Any = None) -> Any:
        """The first value of the first child of this name."""
        node = self.child(name)
        return node.values[0] if node is not None and node.values else default

    def text(self, name: str, default: str = "") -> str:
        """The same, where it is text."""
        value = self.value(name)
        return value if isinstance(value, str) else default

    def array(self, name: str) -> np.ndarray:
        """The numbers of a child, as float64 or int64; none where there is no such child."""
        node = self.child(name)
        if node is None or not node.values:
            return np.zeros(0)
        first = node.values[0]
        if isinstance(first, FbxArray):
            numbers = first.numbers()
        else:  # short arrays may be plain values
            numbers = np.array([value for value in node.values if isinstance(value, (int, float))])
        return numbers.astype(np.float64 if numbers.dtype.kind == "f" else np.int64)


@dataclass(frozen=True, eq=False)
class FbxTree:
    """An FBX file.

    Args:
        path: The file.
        version: 7400 for 7.4.
        root: The node above all others.
    """

    path: Path
    version: int
    root: FbxNode

    def fail(self, problem: str) -> NoReturn:
        """Raise a FormatError about this file."""
        raise FormatError(self.path, problem)

    def section(self, name: str) -> FbxNode:
        """A node at the top, empty where the file has none."""
        return self.root.child(name) or FbxNode(name)


def check_version(path: Path, version: int) -> None:
    """Refuse FBX of before 2011 and after what is known.

    Raises:
        FormatError: The version is not read.
    """
    if version < 7000:
        raise FormatError(
            path,
            f"this is FBX {version / 1000:.1f}, which is not read; export it again as FBX 2011 or later (7.1 to 7.7)",
        )
    if version >= 8000:
        raise FormatError(
            path, f"this is FBX {version / 1000:.1f}, newer than what is read; export it as FBX 2020 (7.7) or earlier"
        )
