"""Words that only clips of one's own say: `bunraku data examples` writes them beside the pack that it adds those to."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterable
from pathlib import Path

from bunraku.errors import WeightsError
from bunraku.formats.files import atomic_write, read_bounded, weights_file

__all__ = ["FILE", "own_words", "write_own_words"]

FILE = "own_words.json"
"""Its name, in a folder of weights."""
_MOST = 100_000


@functools.cache
def own_words() -> frozenset[str]:
    """The words of the first folder of weights that has such a file; none where there is none.

    Raises:
        WeightsError: The file is no list of words.
    """
    path = weights_file(FILE)
    if not path.is_file():
        return frozenset()
    try:
        found = json.loads(read_bounded(path))
    except ValueError:
        found = None
    if not isinstance(found, list) or len(found) > _MOST or not all(isinstance(one, str) for one in found):
        raise WeightsError(f"{path}: this is no list of words; write it again with: bunraku data examples --add-to")
    return frozenset(word.lower() for word in found)


def write_own_words(folder: Path, words: Iterable[str]) -> Path:
    """Write words into a folder of weights.

    Raises:
        FormatError: It cannot be written.
    """
    path = folder / FILE
    with atomic_write(path) as file:
        file.write((json.dumps(sorted({word.lower() for word in words}), ensure_ascii=False) + "\n").encode())
    return path
