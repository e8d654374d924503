"""What commands that write share: checks before heavy work starts, progress, and the options of files."""

from __future__ import annotations

import hashlib
import logging
import os
import re
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.cli.manifest import check_free, note_written
from bunraku.core.request import WHOLE, Limit
from bunraku.core.request import Progress as Report
from bunraku.errors import FormatError, OptionError
from bunraku.language.prompts import check_prompt, split_name
from bunraku.pipelines.requests import Apparel
from bunraku.retarget.stages import Stages

if TYPE_CHECKING:
    from bunraku.core.animation import AnimatedCharacter
    from bunraku.files import Preset
    from bunraku.language.sentence import Sentence

__all__ = [
    "OutputOption",
    "PREVIEWS",
    "PreviewOption",
    "Report",
    "WithoutOption",
    "check_different",
    "check_folder",
    "check_input",
    "check_mask",
    "check_output",
    "check_outputs",
    "check_range",
    "check_seconds",
    "check_sequence",
    "check_source",
    "check_stages",
    "check_written",
    "fitting_stages",
    "make_folder",
    "save_all",
    "save_clips_to",
    "size_text",
    "slug",
    "stages",
    "written_path",
    "wrote",
]


SHORT = 0.5
"""Stages that are over in less [s] are not worth a line."""


@contextmanager
def stages() -> Iterator[Report]:
    """A callback `(stage, share done from 0 to 1)` that shows where a run stands; each stage gets its own line."""
    if sys.stderr.isatty():
        with _bars() as report:
            yield report
    else:
        with _lines() as report:
            yield report


@contextmanager
def _bars() -> Iterator[Report]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def report(stage: str, done: float) -> None:
            if stage not in tasks:
                for task in tasks.values():
                    bars.update(task, completed=1)
                tasks[stage] = bars.add_task(stage, total=1)
            bars.update(tasks[stage], completed=min(max(done, 0.0), 1.0))

        yield report


@contextmanager
def _lines() -> Iterator[Report]:
    started: dict[str, float] = {}
    finished: set[str] = set()

    def report(stage: str, done: float) -> None:
        now = time.perf_counter()
        took = now - started.setdefault(stage, now)
        if done >= 1 and stage not in finished:
            finished.add(stage)
            if took >= SHORT:
                print(f"{stage}: {took:.1f} s", file=sys.stderr)

    yield report


SEQUENCES = (".obj", ".ply")
"""Outputs that are folders with one mesh a frame."""
NEEDY = (".usd", ".usda", ".usdc", ".usdz")
"""Outputs that need an optional library or program."""


def check_written(apparel: Apparel, outputs: Iterable[Path]) -> None:
    """Raise FormatError where apparel is to be learned and a file of its kind cannot hold what moves so."""
    from bunraku.files import check_writer

    if apparel.learns:
        for path in outputs:
            check_writer(path, points=True)


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
    from bunraku.core import files

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
        from bunraku.files import check_sequence

        check_sequence(path)
    check_folder(path.parent)
    if path.suffix.lower() in NEEDY:
        from bunraku.files import check_writer

        check_writer(path)


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
    from bunraku.core.files import remove_leftovers, temporary_prefix

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
    remove_leftovers(nearest)


def make_folder(path: Path) -> None:
    """Make the folder of an output where only its last level is missing.

    Raises:
        FormatError: It cannot be made.
    """
    from bunraku.core.files import check_output_folder

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


_log = logging.getLogger(__name__)


USUAL_FPS = 30.0
"""Frames a second where nothing else is said [1/s]."""
PREVIEWS = (".mp4", ".webp", ".gif", ".png")
OUTPUTS = (
    ".glb",
    ".npz",
    ".bvh",
    ".vrma",
    ".vmd",
    ".usd",
    ".usda",
    ".usdc",
    ".usdz",
    ".fbx",
    ".obj",
    ".ply",
    ".html",
    *PREVIEWS,
)

OutputOption = Annotated[tuple[Path, ...], tyro.conf.arg(aliases=["-o"]), tyro.conf.UseAppendAction]
PreviewOption = Annotated[tuple[Path, ...], tyro.conf.UseAppendAction]
_STAGES = tuple(field.name.replace("_", "-") for field in fields(Stages))
WithoutOption = Annotated[
    tuple[str, ...],
    tyro.conf.arg(
        metavar="STAGE",
        help=f"Leave out a stage that fits the motion to the character: {', '.join(_STAGES)}. May be repeated.",
    ),
    tyro.conf.UseAppendAction,
]


def check_outputs(
    outputs: Sequence[Path],
    previews: Sequence[Path],
    inputs: Sequence[Path],
    suffixes: Sequence[str] = OUTPUTS,
    *,
    overwrite: bool,
) -> None:
    """Raise FormatError or OptionError unless all files can be written.

    Args:
        outputs: The animation's.
        previews: Videos and contact sheets.
        inputs: Files that must not be overwritten.
        suffixes: Those that an output may have.
        overwrite: Whether files that Bunraku did not write may be replaced.
    """
    for path in outputs:
        check_output(path, suffixes, inputs)
    for path in previews:
        check_output(path, PREVIEWS, inputs)
    check_different((*outputs, *previews))
    check_free(map(written_path, (*outputs, *previews)), overwrite)


def save_all(
    animation: AnimatedCharacter,
    outputs: Sequence[Path],
    previews: Sequence[Path],
    fps: float,
    report: Report,
    options: Mapping[str, str] | None = None,
) -> None:
    """Write an animation and its previews, and name what was written, whatever became of the rest.

    Args:
        animation: What to write.
        outputs: The animation's files.
        previews: Videos and contact sheets.
        fps: Frames a second [1/s] of previews, and of files where `options` is None.
        report: Called with a stage's name and the share done.
        options: Those of the files' formats; the animation then keeps its own rate.
    """
    written: list[Path] = []
    try:
        for number, path in enumerate(outputs):
            report("write", number / len(outputs))
            rate = {} if path.suffix.lower() in (".npz", ".vmd") else {"fps": fps}
            written.append(_fitting(animation, path).save(path, **(rate if options is None else options)))
        report("write", 1.0)
        for path in previews:
            from bunraku.core.animation import Animation, PointAnimation
            from bunraku.render import save_preview

            make_folder(path)
            shown = (
                animation if isinstance(animation, PointAnimation)
                else Animation(animation.character, animation.handles, animation.motion)
            )  # fmt: skip
            written.append(
                save_preview(shown, path, fps=fps, progress=lambda done, total: report("preview", done / total))
            )
    finally:  # what is whole stays
        for path in written:
            wrote(path)
        note_written(written)


def _fitting(animation: AnimatedCharacter, path: Path) -> AnimatedCharacter:
    """The animation, or, where its apparel moves by itself and a file of this kind cannot hold that, the body alone."""
    from bunraku.core.animation import PointAnimation
    from bunraku.files import WRITERS

    if not isinstance(animation, PointAnimation) or path.suffix.lower() in WRITERS["points"]:
        return animation
    _log.warning("%s: files of this kind have no place for apparel; it holds the body's motion alone", path)
    return animation.animation


def save_clips_to(
    clips: Mapping[str, AnimatedCharacter],
    outputs: Sequence[Path],
    fps: float,
    add: bool,
    report: Report,
    preset: Preset | None = None,
) -> None:
    """Write clips of one character into each of some files, and name what was written, whatever became of the rest.

    Args:
        clips: By their names.
        outputs: The files.
        fps: Frames a second [1/s].
        add: Whether the clips of files that are there are kept.
        report: Called with a stage's name and the share done.
        preset: What the program wants that the files are for; its rate holds where `fps` is the usual one.
    """
    from bunraku.files import save_clips, save_for

    written: dict[Path, list[str]] = {}
    try:
        for number, path in enumerate(outputs):
            report("write", number / len(outputs))
            if preset is not None:
                save_for(preset, clips, path, fps=None if fps == USUAL_FPS else fps)
                written |= preset.files(path, clips)
                continue
            written[save_clips(clips, path, fps=fps, add=add)] = list(clips)
        report("write", 1.0)
    finally:  # what is whole stays
        for path, names in written.items():
            wrote(path, ", ".join(names))
        note_written(list(written))


def check_stages(without: tuple[str, ...]) -> None:
    """Raise OptionError unless all these are names of stages."""
    for name in without:
        if name not in _STAGES:
            raise OptionError(f"--without names no stage '{name}'; there are {', '.join(_STAGES)}")


def fitting_stages(without: tuple[str, ...], shape: bool = False) -> Stages | None:
    """The stages of fitting but those named, or None for the default; `shape` is one of them where motions are made."""
    check_stages(without)
    if not without:
        return None
    return replace(Stages(shape=shape), **{name.replace("-", "_"): False for name in without})


def wrote(path: Path, note: str = "") -> None:
    """Print a line that names a file, or the folder of a sequence, and its size."""
    files = [path] if path.is_file() else sorted(file for file in path.glob("*") if file.is_file())
    size = size_text(sum(file.stat().st_size for file in files))
    count = "" if path.is_file() else f"{len(files)} files, "
    print(f"wrote {path} ({count}{size}{', ' + note if note else ''})")


def size_text(size: int) -> str:
    """A number of bytes for people: 1536 -> "1.5 kB"."""
    value = float(size)
    for unit in ("bytes", "kB", "MB"):
        if value < 1000:
            return f"{value:.0f} {unit}" if unit == "bytes" else f"{value:.1f} {unit}"
        value /= 1000
    return f"{value:.1f} GB"
