"""`bunraku animate --prompts`: one clip for each line of a file, several in one pass of the network."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bunraku.cli.checks import check_folder, check_input, check_sequence, slug
from bunraku.cli.evaluate.report import wrote
from bunraku.cli.ledger import begin, note, still_to_do
from bunraku.cli.progress import Report
from bunraku.errors import FormatError, OptionError

if TYPE_CHECKING:
    from bunraku.core.animated import AnimatedCharacter

__all__ = ["Clip", "clips_of", "clips_to_do", "read_lines", "save_clips"]

LIMIT = 10_000


def read_lines(path: Path, seconds: float, anyway: bool) -> list[str]:
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
                check_sequence(line, seconds, anyway)
            except OptionError as error:
                raise OptionError(f"{path}, line {number}: {error}") from None
            prompts.append(line.strip())
    if not 1 <= len(prompts) <= LIMIT:
        raise OptionError(f"{path} holds {len(prompts):,} prompts; give 1 to {LIMIT:,}, one a line")
    return prompts


@dataclass(frozen=True)
class Clip:
    """A file to write, the prompt that it shows, and the fingerprint of what it is made of."""

    path: Path
    prompt: str
    mark: str


def clips_of(folder: Path, prompts: list[str], mark: Callable[[str], str]) -> list[Clip]:
    """A clip for each prompt, its file named after its number and words.

    Args:
        folder: Of all files.
        prompts: What is to be shown.
        mark: Gives the fingerprint of a prompt's clip.
    """
    return [
        Clip(folder / f"{number:03d}-{slug(prompt)}.glb", prompt, mark(prompt))
        for number, prompt in enumerate(prompts, 1)
    ]


def clips_to_do(clips: list[Clip], overwrite: bool) -> list[Clip]:
    """The clips that are not there yet.

    Raises:
        FormatError: The folder is a file, or cannot be written to, or another file has a clip's name.
    """
    folder = clips[0].path.parent
    if folder.is_file():
        raise FormatError(folder, "this is a file; name a folder with -o, where each prompt gets a file")
    check_folder(folder)
    left = set(still_to_do({clip.path: clip.mark for clip in clips}, overwrite))
    if len(left) < len(clips):
        print(f"{len(clips) - len(left)} of {len(clips)} clips are there already")
    return [clip for clip in clips if clip.path in left]


def save_clips(animations: Iterator[AnimatedCharacter], clips: list[Clip], fps: float, report: Report) -> None:
    """Write each animation to its file as soon as it is made.

    Args:
        animations: As many as clips.
        clips: What they are.
        fps: Frames a second [1/s].
        report: Called with a stage's name and the share done.
    """
    clips[0].path.parent.mkdir(exist_ok=True)
    begin({clip.path: clip.mark for clip in clips})
    for done, clip in enumerate(clips, 1):
        wrote(next(animations).save(clip.path, fps=fps))
        note(clip.path, clip.mark)
        report("clips", done / len(clips))
