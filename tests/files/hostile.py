"""Damaged and hostile files: readers give a result, or one sentence that names the file."""

import numpy as np
import pytest

from bunraku.errors import BunrakuError
from bunraku.files import load_character


def is_one_sentence(error, path):
    return path.name in str(error) and "\n" not in str(error) and len(str(error)) < 500


def refused(path, data, match, read=load_character, errors=BunrakuError):
    """A file of these bytes is refused with a sentence that matches."""
    path.write_bytes(data)
    with pytest.raises(errors, match=match) as caught:
        read(path)
    assert is_one_sentence(caught.value, path)


def damaged(whole, count, seed=0, most=3, first=0, cut=0.0):
    """Copies of a file with 1 to `most` other bytes from `first` on, a share of them cut off somewhere."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        data = bytearray(whole)
        for at in rng.integers(first, len(data), rng.integers(1, most + 1)):
            data[at] = rng.integers(256)
        yield bytes(data[: rng.integers(first + 1, len(data) + 1)] if rng.random() < cut else data)


def outcomes(path, copies, read=load_character):
    """Whether copies of a file are read or refused, each refused one with a sentence."""
    found = set()
    for data in copies:
        path.write_bytes(data)
        try:
            read(path)
            found.add("read")
        except BunrakuError as error:
            assert (is_one_sentence(error, path) and "the file is broken (" not in str(error)) or path.suffix != ".bvh"
            found.add("refused")
    return found
