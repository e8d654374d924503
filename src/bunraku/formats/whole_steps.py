"""Columns of whole numbers that change little from row to row, in few bytes: their differences, the bytes of each
place together, by LZMA.
"""

from __future__ import annotations

import lzma
from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["lzma_filters", "pack_steps", "unpack_steps"]


def lzma_filters(preset: int, window: int) -> list[dict[str, Any]]:
    """How LZMA packs without a header: its preset, and the bytes that it looks back over."""
    return [{"id": lzma.FILTER_LZMA2, "preset": preset, "dict_size": window}]


def pack_steps(values: np.ndarray, order: int, filters: Sequence[dict[str, object]]) -> bytes:
    """Numbers, packed.

    Args:
        values: Whole numbers, rounded where they are not, shape (N, C).
        order: How often differences are taken.
        filters: Of `lzma_filters`.
    """
    steps = np.rint(values).astype(np.int64)
    for _ in range(order):
        steps = np.diff(steps, axis=0, prepend=0)
    folded = np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u4").T.copy()  # small numbers of either sign
    planes = folded.view(np.uint8).reshape(-1, 4).T.tobytes()  # the high bytes, nearly all zero, stand together
    return lzma.compress(planes, lzma.FORMAT_RAW, filters=list(filters))


def unpack_steps(data: bytes, rows: int, columns: int, order: int, filters: Sequence[dict[str, object]]) -> np.ndarray:
    """What `pack_steps` packed, in bounded memory, shape (rows, columns), int64.

    Raises:
        ValueError: The bytes are none of that, or are of another shape.
    """
    size = 4 * rows * columns
    try:
        planes = lzma.LZMADecompressor(lzma.FORMAT_RAW, filters=list(filters)).decompress(data, size + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError("these bytes were not packed so") from error
    if len(planes) != size:
        raise ValueError("these bytes hold another number of rows")
    folded = np.frombuffer(planes, np.uint8).reshape(4, -1).T.copy().view("<u4").reshape(columns, rows)
    steps = folded.T.astype(np.int64)
    values = np.where(steps & 1, -(steps + 1) // 2, steps // 2)
    for _ in range(order):
        values = np.cumsum(values, axis=0)
    return values
