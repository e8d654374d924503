"""`bunraku animate --prompts`: one clip for each line of a file, several in one pass of the network."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from bunraku.cli.checks import check_folder, check_input, check_sequence, slug
from bunraku.cli.evaluate.report import wrote
from bunraku.cli.progress import Report
from bunraku.errors import FormatError, OptionError

if TYPE_CHECKING:
    from bunraku.core.animated import AnimatedCharacter

__all__ = ["clips_to_do", "read_lines", "save_clips"]

LIMIT = 10_000


def read_lines(path: Path, seconds: float) -> list[str]:
    """The prompts of a text file, one a line; empty lines do not count.

    Raises:
        FormatError: The file is missing, or is no text.
        OptionError: It holds no prompt or too many, or one cannot be generated; the message names its line.
    """
    check_input(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise FormatError(path, "this is no text in UTF-8; save it as plain text with one prompt a line") from None
    prompts = []
    for number, line in enumerate(lines, 1):
        if line.strip():
            try:
                check_sequence(line, seconds)
            except OptionError as error:
                raise OptionError(f"{path}, line {number}: {error}") from None
            prompts.append(line.strip())
    if not 1 <= len(prompts) <= LIMIT:
        raise OptionError(f"{path} holds {len(prompts):,} prompts; give 1 to {LIMIT:,}, one a line")
    return prompts


def clips_to_do(folder: Path, prompts: list[str]) -> list[tuple[Path, str]]:
    """A file for each prompt, named after its number and words, and the prompt; without those that are there already.

    Raises:
        FormatError: The folder is a file, or cannot be written to.
    """
    if folder.is_file():
        raise FormatError(folder, "this is a file; name a folder with -o, where each prompt gets a file")
    check_folder(folder)
    files = [folder / f"{number:03d}-{slug(prompt)}.glb" for number, prompt in enumerate(prompts, 1)]
    todo = [(path, prompt) for path, prompt in zip(files, prompts, strict=True) if not path.is_file()]
    if len(todo) < len(files):
        print(f"{len(files) - len(todo)} of {len(files)} clips are there already")
    return todo


def save_clips(animations: Iterator[AnimatedCharacter], paths: list[Path], fps: float, report: Report) -> None:
    """Write each animation to its file as soon as it is made.

    Args:
        animations: As many as files.
        paths: The files.
        fps: Frames a second [1/s].
        report: Called with a stage's name and the share done.
    """
    paths[0].parent.mkdir(exist_ok=True)
    for done, path in enumerate(paths, 1):
        wrote(next(animations).save(path, fps=fps))
        report("clips", done / len(paths))
