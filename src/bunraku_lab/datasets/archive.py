"""The character archive on disk: which of its files are there."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from bunraku.errors import FormatError

__all__ = ["present_files"]


def present_files(folder: Path, files: Iterable[str]) -> list[str]:
    """Those of the archive's files, named without their `.glb`, that a folder holds.

    Raises:
        FormatError: It holds none.
    """
    present = [file for file in files if (folder / f"{file}.glb").is_file()]
    if not present:
        raise FormatError(
            folder, "none of the known characters is here; give the folder of the unpacked character archive"
        )
    return present
