"""The thirty colours of the handles, always the same: what is blue on one character is blue on all."""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Handles

__all__ = ["HANDLE_PALETTE", "handle_colors"]

# Spread over the colours that can be told apart on a grey stage: any two are at least 30 apart in CIELAB, and parents
# and
# children, left and right, and handles with one parent at least 60.
_HEX = """
fa142c 14eeca 1444e2 696914 75b1fa 8de214 14ee5d b11499 2ca599 14d6fa
5d9914 fa99a5 fa6914 146938 e25dfa fa1499 7544a5 a52c2c fa3869 14bd69
faa514 e2b1fa 1481fa bd7538 145d99 bde299 8d385d d6d614 ee75bd faca75
"""

HANDLE_PALETTE: np.ndarray = np.frombuffer(bytes.fromhex(_HEX), np.uint8).reshape(30, 3)
"""sRGB colour of each handle, shape (30, 3), uint8, read-only."""


def handle_colors(handles: Handles) -> np.ndarray:
    """sRGB colour of each vertex, the handles' colours blended by weight, shape (V, 3), uint8."""
    palette = HANDLE_PALETTE[np.arange(len(handles.positions)) % len(HANDLE_PALETTE)].astype(np.float32)
    return np.clip(handles.weights @ palette + 0.5, 0, 255).astype(np.uint8)
