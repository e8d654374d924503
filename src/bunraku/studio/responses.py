"""What the studio says: an error as one sentence, without the paths of the machine it runs on."""

from __future__ import annotations

import errno
import os
import re

from bunraku.errors import BunrakuError

__all__ = ["is_full", "sentence_of"]

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_SHUT = {errno.EROFS, errno.EACCES}
_FULL_WORDS = tuple(os.strerror(number).lower() for number in (*_FULL, *_SHUT))
_FOLDER = re.compile(r"(?<![\w.])/(?:[^\s:/]+/)+(?=[^\s:/]+)")


def is_full(error: Exception) -> bool:
    """Whether the disk takes nothing more: it is full, or can only be read."""
    if isinstance(error, BunrakuError):
        return any(word in str(error) for word in _FULL_WORDS)
    return isinstance(error, OSError) and error.errno in (*_FULL, *_SHUT)


def sentence_of(error: Exception) -> str:
    """The sentence of the library, or one for what it did not foresee; folders are left out of file names."""
    if isinstance(error, BunrakuError):
        text = str(error)
    elif isinstance(error, MemoryError) or "not enough memory" in str(error) or "can't allocate memory" in str(error):
        text = "the memory is not enough for this; close other programs, or give a smaller mesh or fewer seconds"
    elif isinstance(error, OSError) and error.errno in _FULL:
        text = "the disk is full; free some space, or start the studio with another --folder"
    elif isinstance(error, OSError):
        text = f"a file cannot be used ({(error.strerror or str(error)).lower()}); check the studio's folder"
    else:
        text = (
            f"this is a fault of Bunraku, not yours: {type(error).__name__}: {error}; start the studio with "
            "BUNRAKU_DEBUG=1 and report what it prints"
        )
    return " ".join(_FOLDER.sub("", text).split())
