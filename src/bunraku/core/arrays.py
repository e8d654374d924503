"""NumPy arrays from untrusted files, read within bounds and without pickle; integer columns packed into few bytes."""

from __future__ import annotations

import io
import lzma
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.errors import FormatError

MAX_ARRAY_BYTES = 1 << 30
MAX_GROWTH = 200
"""An array may unpack to this many times the size of its file; motion packs to a half or a third."""
FREE_BYTES = 16 << 20
"""Any file may unpack to this size, whatever its own [bytes]: a long clip of zeros packs well."""


def read_npy(path: Path, data: bytes) -> np.ndarray:
    """The array of a .npy file as float32. FormatError if the file is broken, or does not hold plain numbers."""
    try:
        return _plain(path, data, "")
    except (EOFError, OSError, TypeError, ValueError, SyntaxError):
        raise FormatError(path, "the NPY is truncated or broken; save it again") from None


@contextmanager
def open_npz(path: Path, data: bytes) -> Iterator[zipfile.ZipFile]:
    """The archive of an .npz file. FormatError if it is broken, or the code in the block finds it so."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if {entry.compress_type for entry in archive.infolist()} - {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
                raise zipfile.BadZipFile  # numpy writes no others, and their errors are of other kinds
            yield archive
    except (
        zipfile.BadZipFile, EOFError, NotImplementedError, OSError, RuntimeError, SyntaxError, TypeError, ValueError,
        zlib.error,
    ):  # fmt: skip
        raise FormatError(path, "the NPZ is truncated or broken; save it again") from None


def npz_names(archive: zipfile.ZipFile) -> frozenset[str]:
    """Names of the arrays of an .npz file."""
    return frozenset(name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy"))


def refuse_objects(path: Path, archive: zipfile.ZipFile) -> None:
    """Raise FormatError if any array of an .npz file holds pickled objects, whether it is used or not."""
    for name in sorted(npz_names(archive)):
        with archive.open(f"{name}.npy") as file:
            header = io.BytesIO(file.read(65536))
        if _header(header)[1].hasobject:
            raise FormatError(path, f"its array '{name}' holds pickled objects, which can run code; save plain numbers")


def read_member(path: Path, archive: zipfile.ZipFile, name: str, data_size: int) -> np.ndarray:
    """One array of an .npz file of a size [bytes], which bounds that of the array, as float32. FormatError if the array
    is too large, or does not hold plain numbers.
    """
    entry = archive.getinfo(f"{name}.npy")
    if entry.file_size > MAX_ARRAY_BYTES:
        raise FormatError(path, f"its array '{name}' unpacks to more than {MAX_ARRAY_BYTES >> 30} GiB; cut the motion")
    if entry.file_size > FREE_BYTES + MAX_GROWTH * data_size:
        times = entry.file_size // data_size
        raise FormatError(path, f"its array '{name}' unpacks to {times} times the size of the file; save it again")
    with archive.open(entry) as file:
        return _plain(path, file.read(entry.file_size), f" '{name}'")


def _header(file: io.BytesIO) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type that a header announces; ValueError where it makes no sense."""
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    try:
        shape, _, dtype = header(file)
    except Exception as error:  # a header is Python text: its parser fails in many ways, for memory in deep brackets
        raise ValueError(str(error)) from None
    return shape, dtype


def _plain(path: Path, data: bytes, name: str) -> np.ndarray:
    content = io.BytesIO(data)
    shape, dtype = _header(content)
    size = dtype.itemsize
    for length in shape:
        size *= int(length)
    if dtype.hasobject:
        raise FormatError(path, f"its array{name} holds pickled objects, not plain numbers; save plain numbers")
    if dtype.kind not in "bfiu" or size != len(data) - content.tell():
        raise FormatError(path, f"its array{name} is not plain numbers, or is cut short; save it again")
    content.seek(0)
    array: np.ndarray = np.lib.format.read_array(content, allow_pickle=False)
    return array.astype(np.float32)


def lzma_filters(preset: int, window: int) -> list[dict[str, Any]]:
    """The settings for LZMA without a header: its preset and how many bytes it looks back."""
    return [{"id": lzma.FILTER_LZMA2, "preset": preset, "dict_size": window}]


def pack_steps(values: np.ndarray, order: int, filters: Sequence[dict[str, object]]) -> bytes:
    """Pack columns of integers, or of numbers to be rounded, shape (N, C): differences of some order, small numbers of
    either sign, high bytes together, LZMA with `lzma_filters`.
    """
    steps = np.rint(values).astype(np.int64)
    for _ in range(order):
        steps = np.diff(steps, axis=0, prepend=0)
    folded = np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u4").T.copy()  # small numbers of either sign
    planes = folded.view(np.uint8).reshape(-1, 4).T.tobytes()  # the high bytes, nearly all zero, stand together
    return lzma.compress(planes, lzma.FORMAT_RAW, filters=list(filters))


def unpack_steps(
    packed: Sequence[bytes], rows: Sequence[int], columns: int, order: int, filters: Sequence[dict[str, object]]
) -> np.ndarray:
    """Undo `pack_steps` for several arrays in bounded memory, one below the other, shape (sum of rows, columns), int64.
    ValueError if the bytes were not packed so, or have another shape.
    """
    out = np.empty((sum(rows), columns), np.int64)
    start = 0
    for data, count in zip(packed, rows, strict=True):
        size = 4 * count * columns
        try:
            planes = lzma.LZMADecompressor(lzma.FORMAT_RAW, filters=list(filters)).decompress(data, size + 1)
        except (lzma.LZMAError, EOFError) as error:
            raise ValueError("these bytes were packed in another way") from error
        if len(planes) != size:
            raise ValueError("these bytes hold another number of rows")
        folded = np.frombuffer(planes, np.uint8).reshape(4, -1).T.copy().view("<u4").reshape(columns, count)
        steps = folded.T.astype(np.int64)
        values = np.where(steps & 1, -(steps + 1) // 2, steps // 2)
        for _ in range(order):
            values = np.cumsum(values, axis=0)
        out[start : start + count] = values
        start += count
    return out
