"""The node tree of an FBX file, binary 7.1 to 7.7 or text, and how much it may hold."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from bunraku.core.files import check_text
from bunraku.errors import FormatError

MAX_DEPTH, MAX_NODES, MAX_VALUES = 64, 1_500_000, 6_000_000


MAX_UNPACKED = 1 << 30
"""Most bytes of the unpacked arrays of a file."""

BROKEN = "the file is broken, export it again"


class Allowance:
    """The bytes that the arrays of one file may still take; the path is for messages."""

    def __init__(self, path: Path, left: int = MAX_UNPACKED):
        self.path, self.left = path, left

    def take(self, size: int) -> None:
        """Use some bytes; FormatError where they are used up."""
        self.left -= size
        if self.left < 0:
            most = f"{MAX_UNPACKED >> 20} MiB"
            raise FormatError(self.path, f"its arrays unpack to over {most}; simplify the mesh or shorten its clips")


@dataclass(frozen=True, eq=False)
class FbxArray:
    """An array of a node, packed as in the file."""

    allowance: Allowance  # of the file
    dtype: np.dtype[Any]  # of its elements
    count: int  # number of elements
    packed: bool  # whether zlib packed them
    data: memoryview | np.ndarray  # the bytes of the file, or the elements

    def numbers(self) -> np.ndarray:
        """The elements, shape (count,). FormatError if they are damaged or too large."""
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
    """A node of the tree: its name, its values (numbers, text, bytes and arrays), and the nodes below it."""

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
        """The numbers of a child, as float64 or int64; empty where there is no such child."""
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
    """An FBX file: its path, its version (7400 for 7.4), and the node above all others."""

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
    """Raise FormatError for FBX of before 2011, or newer than what is known."""
    if not 7000 <= version < 8000:
        raise FormatError(path, f"this is FBX {version / 1000:.1f}, which is not read; export it as FBX 7.1 to 7.7")


def _check_counts(path: Path, nodes: int, values: int) -> None:
    if nodes > MAX_NODES or values > MAX_VALUES:
        limits = f"{MAX_NODES:,} nodes or {MAX_VALUES:,} values"
        raise FormatError(path, f"it has more than {limits}; shorten its clips or export fewer objects")


# A name with its colon, a quoted text, a bracket, an array's length, a word or number, a comma.
_TOKEN = re.compile(rb'\s*(?:(;[^\n]*)|([A-Za-z_][\w|]*):(?=\s|$)|"([^"]*)"|([{}])|\*(\d+)|([^\s,{}"]+)|(,))')
_NUMBERS = re.compile(rb"[0-9eE+\-.,\s]*")


def read_text_tree(path: Path, data: bytes) -> FbxTree:
    """The tree of a text FBX file; errors are those of `read_tree`."""
    version = re.search(rb"FBXVersion:\s*(\d{1,9})", data[:100_000])
    if b"\0" in data[:1000] or version is None:
        raise FormatError(path, "this is not an FBX file, or its header is missing; export it again as binary FBX")
    check_version(path, int(version.group(1)))
    check_text(path, data)
    return FbxTree(path, int(version.group(1)), _parse(path, data))


def _parse(path: Path, data: bytes) -> FbxNode:
    root = FbxNode("")
    stack, current, at, nodes, values = [root], root, 0, 0, 0
    allowance = Allowance(path)
    while True:
        match = _TOKEN.match(data, at)
        if match is None:
            if data[at:].strip():
                raise FormatError(path, f"its text cannot be understood at byte {at}; {BROKEN}")
            break
        at, kind = match.end(), match.lastindex
        if kind == 2:
            current = FbxNode(match.group(2).decode())
            stack[-1].children.append(current)
            nodes += 1
        elif kind == 3:
            current.values.append(_unescaped(match.group(3).decode("utf-8", "replace")))
            values += 1
        elif kind == 4 and match.group(4) == b"{":
            if len(stack) >= MAX_DEPTH or current is stack[-1]:
                raise FormatError(path, f"brackets without an owner, or nested more than {MAX_DEPTH} deep; {BROKEN}")
            stack.append(current)
        elif kind == 4:
            if len(stack) == 1:
                raise FormatError(path, f"a bracket closes at byte {at} that was never opened; {BROKEN}")
            stack.pop()
            current = stack[-1]
        elif kind == 5:
            at = _array(path, data, at, int(match.group(5)[:12]), current, allowance)
        elif kind == 6:
            current.values.append(_word(match.group(6)))
            values += 1
        _check_counts(path, nodes, values)
    if len(stack) > 1:
        raise FormatError(path, f"it ends in the middle of '{stack[-1].name}'; {BROKEN}")
    return root


def _array(path: Path, data: bytes, at: int, count: int, node: FbxNode, allowance: Allowance) -> int:
    """Read `{ a: 1,2,3 }` into a node and return where it ends."""
    match = re.compile(rb"\s*\{\s*a:").match(data, at)
    if match is None:
        raise FormatError(path, f"an array of '{node.name}' has no numbers; {BROKEN}")
    block = _NUMBERS.match(data, match.end())
    assert block is not None
    end = re.compile(rb"\s*\}").match(data, block.end())
    allowance.take(8 * block.group().count(b",") + 8)
    words = block.group().replace(b",", b" ").split()
    try:
        integers = not any(letter in block.group() for letter in b".eE")
        numbers = np.array(words, dtype="S32").astype(np.int64 if integers else np.float64) if words else np.zeros(0)
    except (ValueError, OverflowError):
        raise FormatError(path, f"an array of '{node.name}' holds something that is not a number; {BROKEN}") from None
    if end is None or len(numbers) != count:
        raise FormatError(path, f"an array of '{node.name}' has {len(numbers)} numbers but says {count}; {BROKEN}")
    node.values.append(FbxArray(allowance, numbers.dtype, count, False, numbers))
    return end.end()


def _word(word: bytes) -> Any:
    for convert in (int, float):
        try:
            return convert(word)
        except ValueError:
            pass
    return word.decode("utf-8", "replace")


def _unescaped(text: str) -> str:
    return text.replace("&quot;", '"').replace("&cr;", "\r").replace("&lf;", "\n")


MAGIC = b"Kaydara FBX Binary  \x00"

_ARRAYS = {
    ord(k): np.dtype(d) for k, d in (("f", "<f4"), ("d", "<f8"), ("i", "<i4"), ("l", "<i8"), ("b", "u1"), ("c", "u1"))
}
_SCALARS = {
    ord(k): struct.Struct(f)
    for k, f in (("Y", "<h"), ("C", "<b"), ("B", "<b"), ("I", "<i"), ("F", "<f"), ("D", "<d"), ("L", "<q"))
}


def read_tree(path: Path, data: bytes) -> FbxTree:
    """The tree of an FBX file, binary or text. FormatError if it is no FBX, of a version that is not read, cut off, or
    nested beyond reason.
    """
    if not data.startswith(MAGIC[:18]):
        return read_text_tree(path, data)
    if len(data) < 27:
        raise FormatError(path, f"it ends in the middle of its header; {BROKEN}")
    version = struct.unpack_from("<I", data, 23)[0]
    check_version(path, version)
    return FbxTree(path, version, _Binary(path, data, version).read())


class _Binary:
    def __init__(self, path: Path, data: bytes, version: int):
        self.path, self.view, self.size = path, memoryview(data), len(data)
        self.header = struct.Struct("<QQQB" if version >= 7500 else "<IIIB")
        self.allowance = Allowance(path)
        self.nodes = self.values = 0

    def fail(self, problem: str = "it is cut off or damaged") -> NoReturn:
        raise FormatError(self.path, f"{problem}; {BROKEN}")

    def read(self) -> FbxNode:
        root = FbxNode("")
        stack: list[tuple[FbxNode, int]] = [(root, self.size)]  # open nodes and where they end
        at = 27
        while stack:
            node, end = stack[-1]
            if at == end and len(stack) > 1:
                stack.pop()
                continue
            if at + self.header.size > end:
                self.fail()
            stop, count, length, letters = self.header.unpack_from(self.view, at)
            if stop == 0:  # a null record ends the children
                at = end if len(stack) > 1 else at
                stack.pop()
                continue
            begin = at + self.header.size + letters
            if not begin + length <= stop <= end:
                self.fail()
            child = FbxNode(bytes(self.view[begin - letters : begin]).decode("utf-8", "replace"))
            self.nodes += 1
            self.values += count
            _check_counts(self.path, self.nodes, self.values)
            self._values(child.values, begin, begin + length, count)
            node.children.append(child)
            at = begin + length
            if at < stop:
                if len(stack) >= MAX_DEPTH:
                    self.fail(f"its nodes are nested more than {MAX_DEPTH} deep")
                stack.append((child, stop))
        return root

    def _values(self, out: list[Any], at: int, end: int, count: int) -> None:
        view = self.view
        for _ in range(count):
            if at >= end:
                self.fail()
            kind, at = view[at], at + 1
            if kind in _SCALARS:
                packer = _SCALARS[kind]
                if at + packer.size > end:
                    self.fail()
                out.append(packer.unpack_from(view, at)[0])
                at += packer.size
            elif kind in _ARRAYS:
                if at + 12 > end:
                    self.fail()
                number, encoding, length = struct.unpack_from("<III", view, at)
                at += 12
                dtype = _ARRAYS[kind]
                length = length if encoding else number * dtype.itemsize
                if at + length > end or encoding > 1 or number > 1100 * max(length, 1):  # zlib packs no better
                    self.fail("an array is longer than the file")
                out.append(FbxArray(self.allowance, dtype, number, bool(encoding), view[at : at + length]))
                at += length
            elif kind in (0x53, 0x52):  # S: text, R: bytes
                if at + 4 > end:
                    self.fail()
                length = struct.unpack_from("<I", view, at)[0]
                at += 4
                if at + length > end:
                    self.fail()
                raw = view[at : at + length]
                out.append(bytes(raw).decode("utf-8", "replace") if kind == 0x53 else raw)
                at += length
            else:
                self.fail(f"it holds a value of the unknown kind {chr(kind)!r}")
        if at != end:
            self.fail()
