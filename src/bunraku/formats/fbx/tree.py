"""The node tree of an FBX file: binary FBX 7.1 to 7.7 here, text in `fbx_text`.

A node has a name, values and children. Arrays stay packed until they are asked for, so what nobody reads costs nothing,
and all that are unpacked share one allowance: a file of some kilobytes cannot ask for gigabytes.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from bunraku.errors import FormatError
from bunraku.formats.fbx.nodes import (
    BROKEN,
    MAX_DEPTH,
    MAX_NODES,
    MAX_UNPACKED,
    MAX_VALUES,
    Allowance,
    FbxArray,
    FbxNode,
    FbxTree,
    check_version,
)

__all__ = ["read_tree"]

MAGIC = b"Kaydara FBX Binary  \x00"

_ARRAYS = {
    ord(k): np.dtype(d) for k, d in (("f", "<f4"), ("d", "<f8"), ("i", "<i4"), ("l", "<i8"), ("b", "u1"), ("c", "u1"))
}
_SCALARS = {
    ord(k): struct.Struct(f)
    for k, f in (("Y", "<h"), ("C", "<b"), ("B", "<b"), ("I", "<i"), ("F", "<f"), ("D", "<d"), ("L", "<q"))
}


def read_tree(path: Path, data: bytes) -> FbxTree:
    """The tree of an FBX file, binary or text.

    Raises:
        FormatError: It is no FBX, of a version that is not read, cut off, or nested beyond reason.
    """
    if not data.startswith(MAGIC[:18]):
        from bunraku.formats.fbx.text import read_text_tree

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
            if self.nodes > MAX_NODES or self.values > MAX_VALUES:
                raise FormatError(
                    self.path,
                    f"it has more than {MAX_NODES:,} nodes or {MAX_VALUES:,} values; shorten its clips or export "
                    "fewer objects",
                )
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
                if (
                    at + length > end
                    or encoding > 1
                    or number * dtype.itemsize > MAX_UNPACKED
                    or number > 1100 * max(length, 1)
                ):
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
