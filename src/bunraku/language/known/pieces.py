"""The text encoder's file: where it lies, and the word pieces of its tokenizer."""

from __future__ import annotations

import functools
import json
from pathlib import Path

from bunraku.errors import WeightsError
from bunraku.formats.files import weights_folder

__all__ = ["encoder_file", "read_header", "word_pieces"]


def encoder_file() -> Path:
    """The text encoder's weights: in the folder that BUNRAKU_WEIGHTS names, where they are there, or in the package."""
    path = weights_folder() / "text.safetensors"
    return path if path.is_file() else Path(__file__).resolve().parents[2] / "weights" / path.name


def read_header(path: Path) -> dict[str, str]:
    """The "config" and the "tokenizer" of the text encoder, as JSON.

    Raises:
        WeightsError: The file is missing, damaged or another.
    """
    from safetensors import safe_open

    try:
        with safe_open(path, framework="np") as file:
            header: dict[str, str] = file.metadata() or {}
    except Exception as error:
        raise WeightsError(f"{path}: the text encoder cannot be read ({error}); install Bunraku again") from error
    if header.get("kind") != "text" or not {"config", "tokenizer"} <= header.keys():
        raise WeightsError(f"{path}: this is not a text encoder of Bunraku; install Bunraku again")
    return header


@functools.cache
def word_pieces() -> frozenset[str]:
    """Whole words and pieces that the text encoder knows; empty where its file is not there."""
    try:
        return frozenset(json.loads(read_header(encoder_file())["tokenizer"])["model"]["vocab"])
    except (WeightsError, ValueError, KeyError, TypeError):
        return frozenset()
