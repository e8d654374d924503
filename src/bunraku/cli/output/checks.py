"""What can be known to be wrong before any heavy work starts."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from bunraku.core.request.limits import WHOLE, Limit
from bunraku.errors import FormatError, OptionError
from bunraku.language.prompts import check_prompt, split_name
from bunraku.pipelines.requests.apparel import Apparel

if TYPE_CHECKING:
    from bunraku.language.sentence import Sentence

__all__ = [
    "check_different", "check_folder", "check_input", "check_mask", "check_output", "check_range", "check_seconds",
    "check_sequence",
    "check_source", "check_written", "make_folder", "slug", "written_path",
]  # fmt: skip

SEQUENCES = (".obj", ".ply")
"""Outputs that are folders with one mesh a frame."""
NEEDY = (".usd", ".usda", ".usdc", ".usdz")
"""Outputs that need an optional library or program."""


def check_written(apparel: Apparel, outputs: Iterable[Path]) -> None:
    """Raise FormatError where apparel is to be learned and a file of its kind cannot hold what moves so."""
    from bunraku.io.registry import check_points_writer

    if apparel.learns:
        for path in outputs:
            check_points_writer(path)


def check_mask(apparel: Apparel) -> None:
    """Raise FormatError where --apparel names a mask that is not there."""
    if apparel.mask is not None:
        check_input(apparel.mask)


def check_range(option: str, value: float | None, low: float, high: float) -> None:
    """Raise OptionError unless the value is None or a number from low to high."""
    Limit(option, low, high).check(value)


def check_seconds(seconds: float) -> None:
    """Raise OptionError unless a clip of this length [s] can be made."""
    WHOLE.check(seconds, "--seconds")


def check_sequence(prompt: str, seconds: float, force: bool, named: bool = False) -> Sentence:
    """The sentence of a prompt, or of several in a row; one that is not understood is taken where it is to be made
    `force`, and the name of a clip may stand before one that is `named`.

    Raises:
        OptionError: It is none, or no clip of this length can be made.
    """
    from bunraku.language.parse import parse

    check_seconds(seconds)
    if named:
        from dataclasses import replace

        return replace(check_sequence(split_name(prompt)[1], seconds, force), prompt=prompt)
    if not prompt.strip() or ";" not in prompt:
        check_prompt(prompt)
    return parse(prompt, seconds, force)


def check_input(path: Path) -> None:
    """Raise FormatError unless this is a plain file that can be opened, holds something, and is not too large to
    read.
    """
    from bunraku.formats import files

    files.check_input(path)
    if not os.access(path, os.R_OK):
        raise FormatError(path, "you may not read this file; change its permissions")


def check_source(folder: Path | None, advice: str) -> None:
    """Raise FormatError unless this is a folder, or None.

    Args:
        folder: That is read from.
        advice: What to do where it is not there, after a semicolon.
    """
    if folder is not None and not folder.is_dir():
        raise FormatError(folder, f"there is no such folder; {advice}")


def check_output(path: Path, suffixes: Iterable[str], inputs: Iterable[Path] = ()) -> None:
    """Raise FormatError unless a file of this name can be written.

    Args:
        path: The file to be.
        suffixes: Suffixes that the verb can write, with their dots.
        inputs: Files that must not be overwritten.
    """
    known = list(suffixes)
    if path.suffix.lower() not in known:
        raise FormatError(path, f"{_describe(path)} cannot be written here; end the name in {_listed(known)}")
    if path.is_dir():
        raise FormatError(path, "this is a folder; name a file in it")
    if any(path.exists() and other.exists() and path.samefile(other) for other in inputs):
        raise FormatError(path, "this would overwrite the input; choose another name")
    if path.suffix.lower() in SEQUENCES:
        from bunraku.formats.mesh import sequences

        sequences.check_sequence(path)
    check_folder(path.parent)
    if path.suffix.lower() in NEEDY:
        from bunraku.io import registry

        registry.check_writer(path)


def written_path(path: Path) -> Path:
    """What is there once an output is written: the file, or the folder of a sequence of meshes."""
    return path.with_suffix("") if path.suffix.lower() in SEQUENCES else path


def check_different(paths: Iterable[Path]) -> None:
    """Raise OptionError where two outputs would be the same file, or the same folder of a sequence of meshes."""
    seen: dict[Path, Path] = {}
    for path in paths:
        target = written_path(path.resolve())
        if target in seen:
            raise OptionError(
                f"{seen[target]} and {path} would both be written to {target.name}; choose another name for one of them"
            )
        seen[target] = path


def check_folder(folder: Path) -> None:
    """Raise FormatError unless files can be made in this folder, or the folder in the one above it; remove what killed
    runs left half-done there.

    It is tried, not guessed from permissions, which say little on network drives and to root.
    """
    from bunraku.formats.files import sweep, temporary_prefix

    nearest = folder if folder.exists() else folder.parent
    if not nearest.exists():
        raise FormatError(folder, "the folder and the one above it do not exist; make them first")
    if not nearest.is_dir():
        raise FormatError(nearest, "this is not a folder; choose another folder to write to")
    try:
        with tempfile.NamedTemporaryFile(dir=nearest, prefix=temporary_prefix("probe"), suffix=".tmp"):
            pass
    except OSError as error:
        raise FormatError(
            folder, f"the folder cannot be written to ({error.strerror or error}); choose another one"
        ) from error
    sweep(nearest)


def make_folder(path: Path) -> None:
    """Make the folder of an output where only its last level is missing.

    Raises:
        FormatError: It cannot be made.
    """
    from bunraku.formats.files import check_output_folder

    check_output_folder(path)


def slug(text: str, length: int = 40) -> str:
    """Words of a sentence as a part of a file name: "Walks forward, then waves!" -> "walks-forward-then-waves".

    What is longer is cut at a word and gets six letters that tell it from others that begin alike.
    """
    words = re.findall(r"\w+", text.lower())
    whole, out = "-".join(words), ""
    if len(whole) <= length:
        return whole or "motion"
    mark = hashlib.sha256(whole.encode()).hexdigest()[:6]
    length -= len(mark) + 1
    for word in words:
        if out and len(out) + 1 + len(word) > length:
            break
        out = f"{out}-{word}" if out else word[:length]
    return f"{out}-{mark}"


def _describe(path: Path) -> str:
    return f"'{path.suffix}'" if path.suffix else "a file without a suffix"


def _listed(suffixes: list[str]) -> str:
    return suffixes[0] if len(suffixes) == 1 else f"{', '.join(suffixes[:-1])} or {suffixes[-1]}"
