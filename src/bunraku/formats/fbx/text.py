"""The node tree of a text FBX file, as the same nodes that a binary one has."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.errors import FormatError
from bunraku.formats.fbx.nodes import (
    BROKEN,
    MAX_DEPTH,
    MAX_NODES,
    MAX_VALUES,
    Allowance,
    FbxArray,
    FbxNode,
    FbxTree,
    check_version,
)
from bunraku.formats.files import check_text

__all__ = ["read_text_tree"]

# A name with its colon, a quoted text, a bracket, an array's length, a word or number, a comma.
_TOKEN = re.compile(rb'\s*(?:(;[^\n]*)|([A-Za-z_][\w|]*):(?=\s|$)|"([^"]*)"|([{}])|\*(\d+)|([^\s,{}"]+)|(,))')
_NUMBERS = re.compile(rb"[0-9eE+\-.,\s]*")


def read_text_tree(path: Path, data: bytes) -> FbxTree:
    """The tree of a text FBX file.

    Raises:
        FormatError: It is no FBX, of a version that is not read, cut off, or nested beyond reason.
    """
    found = re.search(rb"FBXVersion:\s*(\d{1,9})", data[:100_000])
    if b"\0" in data[:1000] or found is None:
        raise FormatError(path, "this is not an FBX file, or its header is missing; export it again as binary FBX")
    check_version(path, int(found.group(1)))
    check_text(path, data)
    return FbxTree(path, int(found.group(1)), _parse(path, data))


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
                raise FormatError(
                    path, f"its brackets are nested more than {MAX_DEPTH} deep or belong to nothing; {BROKEN}"
                )
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
        if nodes > MAX_NODES or values > MAX_VALUES:
            raise FormatError(
                path,
                f"it has more than {MAX_NODES:,} nodes or {MAX_VALUES:,} values; shorten its clips or export fewer "
                "objects",
            )
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
        whole = not any(letter in block.group() for letter in b".eE")
        numbers = np.array(words, dtype="S32").astype(np.int64 if whole else np.float64) if words else np.zeros(0)
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
