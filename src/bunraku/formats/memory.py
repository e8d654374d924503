"""How much memory a file may take: a small one never takes much, whatever it promises."""

from __future__ import annotations

import sys
from pathlib import Path

__all__ = ["BASE", "PER_BYTE", "free_memory", "room"]

PER_BYTE = 4
"""Bytes of memory for each byte of a file."""

BASE = 240 << 20
"""What any file may take beside that [bytes]; the interpreter and its libraries make it some 300 MB."""


def free_memory() -> int:
    """Bytes that the machine can still give, as Linux tells; without an answer, all there can be."""
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) << 10
    except (OSError, ValueError, IndexError):
        pass
    return sys.maxsize


def room(size: int) -> int:
    """Bytes that reading a file may take at most, its own included.

    Args:
        size: Bytes of the file and of all that it names.
    """
    return min(PER_BYTE * size + BASE, free_memory())
