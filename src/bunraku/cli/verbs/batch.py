"""Many clips of `bunraku animate`: one for each line of a file and each character of a folder, several in one pass of
the network, in this process, on several, or on a Ray cluster.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from bunraku.cli.output.checks import check_folder, check_input, check_sequence, slug
from bunraku.cli.output.ledger import begin, note, still_to_do
from bunraku.cli.output.outputs import wrote
from bunraku.cli.output.progress import Report
from bunraku.errors import FormatError, OptionError
from bunraku.nn.spread import spread

if TYPE_CHECKING:
    from bunraku.language.sentence import Sentence

__all__ = ["Clip", "characters_of", "clips_of", "clips_to_do", "make_clips", "passes", "read_lines"]

LIMIT = 10_000


def read_lines(path: Path, seconds: float, force: bool, named: bool = False) -> list[Sentence]:
    """The sentences of a text file, one a line, before which the name of a clip may stand where they are `named`; empty
    lines do not count.

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
                prompts.append(check_sequence(line.strip(), seconds, force, named))
            except OptionError as error:
                raise OptionError(f"{path}, line {number}: {error}") from None
    if not 1 <= len(prompts) <= LIMIT:
        raise OptionError(f"{path} holds {len(prompts):,} prompts; give 1 to {LIMIT:,}, one a line")
    return prompts


def characters_of(folder: Path) -> dict[Path, str]:
    """The characters of a folder, by their suffixes, each with the name of its own folder of results.

    Raises:
        FormatError: There is none, or the folder cannot be read.
    """
    from bunraku.io.table import FORMATS

    suffixes = {suffix for kind in FORMATS if kind.character for suffix in kind.suffixes} - {".txt"}  # beside an OBJ
    try:
        found = sorted(path for path in folder.iterdir() if path.suffix.lower() in suffixes and path.is_file())
    except OSError as error:
        raise FormatError(folder, f"this folder cannot be read ({error.strerror}); name another") from None
    if not found:
        raise FormatError(folder, "no character lies in this folder; name one with meshes, such as .glb")
    stems = [path.stem.lower() for path in found]
    return {path: path.stem if stems.count(path.stem.lower()) == 1 else path.name for path in found}


@dataclass(frozen=True)
class Clip:
    """A file to write.

    Args:
        path: Of the file.
        character: The file of who is shown.
        number: Which of the prompts of its pass it shows.
        beside: All prompts of that pass, which are generated along, so that a clip has the same bytes whether those
            beside it are wanted or not.
        mark: The fingerprint of what it is made of.
    """

    path: Path
    character: Path
    number: int
    beside: tuple[str, ...]
    mark: str


def clips_of(
    folder: Path, character: Path, prompts: list[str], at_once: int, mark: Callable[[Path, str], str]
) -> list[Clip]:
    """A clip of a character for each prompt, its file named after its number and words.

    Args:
        folder: Of all files.
        character: Who is shown.
        prompts: What is to be shown.
        at_once: Prompts in one pass of the network.
        mark: Gives the fingerprint of a character's clip of a prompt.
    """
    out = []
    for number, prompt in enumerate(prompts):
        first = number - number % at_once
        beside = tuple(prompts[first : first + at_once])
        path = folder / f"{number + 1:03d}-{slug(prompt)}.glb"
        out.append(Clip(path, character, number - first, beside, mark(character, prompt)))
    return out


def clips_to_do(clips: list[Clip], overwrite: bool) -> list[Clip]:
    """The clips of one folder that are not there yet.

    Raises:
        FormatError: The folder is a file, or cannot be written to, or another file has a clip's name.
    """
    folder = clips[0].path.parent
    if folder.is_file():
        raise FormatError(folder, "this is a file; name a folder with -o, where each prompt gets a file")
    check_folder(folder)
    left = set(still_to_do({clip.path: clip.mark for clip in clips}, overwrite))
    return [clip for clip in clips if clip.path in left]


def passes(clips: list[Clip]) -> list[list[Clip]]:
    """The clips, those of one pass of the network together."""
    out: list[list[Clip]] = []
    for clip in clips:
        last = out[-1][-1] if out else None
        if last and (last.character, last.beside) == (clip.character, clip.beside) and last.number < clip.number:
            out[-1].append(clip)
        else:
            out.append([clip])
    return out


def make_clips(
    clips: list[Clip], work: Callable[[list[Clip]], Iterator[str]], jobs: int | str, report: Report
) -> dict[str, str]:
    """Make them all.

    Args:
        clips: What is to do.
        work: Makes the clips of a pass, and reports of each what went wrong, "" for nothing; what processes can be
            handed. In this process it may raise what ends all.
        jobs: How many processes, or "ray".
        report: Called with a stage's name and the share done.

    Returns:
        What failed, by file, with the reason.
    """
    for folder in {clip.path.parent: None for clip in clips}:
        folder.mkdir(exist_ok=True, parents=True)
        begin({clip.path: clip.mark for clip in clips if clip.path.parent == folder})
    failed: dict[str, str] = {}
    for done, (clip, reason) in enumerate(_made(clips, work, jobs), 1):
        if reason:
            note(clip.path, "")  # nothing was made: what comes to lie there is another's
            whose = str(clip.character) if reason.startswith(f"{clip.character}: ") else str(clip.path)
            failed[whose] = reason.removeprefix(f"{whose}: ")
        else:
            note(clip.path, clip.mark)
            wrote(clip.path)
        report("clips", done / len(clips))
    for name, reason in failed.items():
        print(f"bunraku: failed: {name}: {' '.join(reason.split())}", file=sys.stderr)
    return failed


def _made(
    clips: list[Clip], work: Callable[[list[Clip]], Iterator[str]], jobs: int | str
) -> Iterator[tuple[Clip, str]]:
    if jobs == 1:
        for some in passes(clips):
            yield from zip(some, work(some), strict=True)
        return
    own = {_resolved(clip) if jobs == "ray" else clip: clip for clip in clips}
    for clip, reason in spread(_All(work), passes(list(own)), jobs, str):
        yield own[clip], reason


def _resolved(clip: Clip) -> Clip:
    """The same for workers that run in folders of their own."""
    return replace(clip, path=clip.path.resolve(), character=clip.character.resolve())


@dataclass(frozen=True)
class _All:
    """The work, done to its end before anything is reported."""

    work: Callable[[list[Clip]], Iterator[str]]

    def __call__(self, clips: list[Clip]) -> list[str]:
        return list(self.work(clips))
