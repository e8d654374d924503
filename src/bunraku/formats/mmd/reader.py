"""A position in the bytes of a PMX or PMD file that never leaves them."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from bunraku.errors import FormatError

__all__ = ["MmdReader"]

_AGAIN = "save the model again"


class MmdReader:
    """Reads one value after the other.

    Args:
        path: The file, for messages.
        data: Its bytes.
        encoding: Of texts with a length before them.
    """

    def __init__(self, path: Path, data: bytes, encoding: str = "cp932"):
        self.path = path
        self.data = data
        self.encoding = encoding
        self.at = 0
        self.section = "header"

    def fail(self, problem: str) -> NoReturn:
        """Raise the error of this file."""
        raise FormatError(self.path, f"{problem}; {_AGAIN}")

    @property
    def left(self) -> int:
        """How many bytes are left."""
        return len(self.data) - self.at

    def take(self, size: int) -> bytes:
        """So many bytes."""
        if size > self.left:
            self.fail(f"it is cut off in its {self.section}")
        self.at += size
        return self.data[self.at - size : self.at]

    def skip(self, size: int) -> None:
        """Pass over so many bytes."""
        if size > self.left:
            self.fail(f"it is cut off in its {self.section}")
        self.at += size

    def values(self, layout: str) -> tuple[Any, ...]:
        """Values of a `struct` layout, little-endian."""
        size = struct.calcsize("<" + layout)
        if size > self.left:
            self.fail(f"it is cut off in its {self.section}")
        self.at += size
        return struct.unpack_from("<" + layout, self.data, self.at - size)

    def one(self, layout: str) -> Any:
        """A single value."""
        return self.values(layout)[0]

    def floats(self, count: int) -> np.ndarray:
        """Floating-point numbers, shape (count,)."""
        return np.array(self.values(f"{count}f"), float)

    def index(self, size: int) -> int:
        """A signed index of 1, 2 or 4 bytes, -1 for none."""
        return int(self.one({1: "b", 2: "h", 4: "i"}[size]))

    def count(self, section: str, least: int, layout: str = "i") -> int:
        """How many records follow, as long as they fit into the file.

        Args:
            section: What they are called.
            least: Bytes that each takes at the least.
            layout: Of the number itself.
        """
        self.section = section
        count = int(self.one(layout))
        if count < 0 or count * least > self.left:
            room = self.left // max(least, 1)
            self.fail(f"it announces {count & 0xFFFFFFFF} {section} but has room for {room}")
        return count

    def records(self, dtype: np.dtype, count: int) -> np.ndarray:
        """Records of a fixed size, shape (count,)."""
        return np.frombuffer(self.take(dtype.itemsize * count), dtype, count)

    def text(self) -> str:
        """A text with its length in bytes before it."""
        size = int(self.one("i"))
        if size < 0 or size > self.left:
            self.fail(f"a text in its {self.section} has {size & 0xFFFFFFFF} bytes but {self.left} are left")
        return self.take(size).decode(self.encoding, "replace").replace("\0", "")

    def field(self, size: int) -> str:
        """A text in a field of fixed size that ends with a zero byte."""
        return fixed_text(self.take(size))


def fixed_text(raw: bytes) -> str:
    """Shift JIS up to the first zero byte; the half of a letter that was cut off is dropped."""
    return raw.split(b"\0")[0].decode("cp932", "ignore")
