"""What commands that write share: checks before heavy work starts, progress, and the options of files."""

from __future__ import annotations

import hashlib
import logging
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Self, TypeVar

import tyro

from bunraku.cli.manifest import check_free, note_begun, note_done, note_written, unfinished
from bunraku.core.parallel import run_parallel
from bunraku.core.request import WHOLE, Limit, Progress
from bunraku.errors import FormatError, OptionError
from bunraku.language.prompts import check_prompt, split_name
from bunraku.pipelines.requests import Apparel
from bunraku.retarget.stages import Stages

if TYPE_CHECKING:
    from bunraku.core.animation import AnimatedCharacter
    from bunraku.files import Preset
    from bunraku.language.sentence import Sentence

LINE = 5.0
"""Seconds between two lines about a stage that goes on; chosen by eye."""
SHORT = 0.5
"""Stages that are over in less [s] get no line where lines are printed; chosen by eye."""


@contextmanager
def stages() -> Iterator[Progress]:
    """A callback that shows how far a run is: bars on a terminal, elsewhere a line for each stage that is over."""
    if not sys.stderr.isatty():
        yield _line_printer()
        return
    from rich.console import Console
    from rich.progress import BarColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    percent = TextColumn("{task.percentage:>3.0f}%")
    columns = (
        TextColumn("{task.description:<12}"), BarColumn(), percent, TimeElapsedColumn(), TimeRemainingColumn()
    )  # fmt: skip
    with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def report(stage: str, done: float) -> None:
            if stage not in tasks:
                for task in tasks.values():
                    bars.update(task, completed=1)
                tasks[stage] = bars.add_task(stage, total=1)
            bars.update(tasks[stage], completed=min(max(done, 0.0), 1.0))

        yield report


def _line_printer() -> Progress:
    started: dict[str, float] = {}
    finished: set[str] = set()
    told = time.perf_counter()

    def report(stage: str, done: float) -> None:
        nonlocal told
        now = time.perf_counter()
        took = now - started.setdefault(stage, now)
        if 0 < done < 1 and now - told >= LINE:
            told = now
            print(f"{stage}: {done:.0%}", file=sys.stderr)
        if done >= 1 and stage not in finished:
            finished.add(stage)
            if took >= SHORT:
                print(f"{stage}: {took:.1f} s", file=sys.stderr)

    return report


SEQUENCES = (".obj", ".ply")
"""Outputs that are folders with one mesh a frame."""
NEEDY = (".usd", ".usda", ".usdc", ".usdz")
"""Outputs that need an optional library."""


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


def check_sequence(prompt: str, seconds: float | None, force: bool, named: bool = False) -> Sentence:
    """The sentence of a prompt, or of several in a row, of a clip of some seconds; the name of a clip may stand before
    it where it is `named`. OptionError where the prompt is refused, which `force` prevents where it is not understood.
    """
    from bunraku.language.parse import parse

    WHOLE.check(seconds, "--seconds")
    if named:
        return replace(check_sequence(split_name(prompt)[1], seconds, force), prompt=prompt)
    if len(prompt) < 200 and Path(prompt).suffix and os.path.isfile(prompt):
        raise OptionError(
            f"'{prompt}' is a file where a sentence is expected; the character comes first, then what it does, and "
            "--prompts reads sentences from a file"
        )
    if not prompt.strip() or ";" not in prompt:
        check_prompt(prompt)
    return parse(prompt, seconds, force)


def check_input(path: Path) -> None:
    """Raise FormatError unless this is a plain file that can be opened, is not empty, and is not too large."""
    from bunraku.core import files
    from bunraku.files import sample_files

    if not path.exists() and path.parts[:1] in (("http:",), ("https:",)):
        raise FormatError(path, "files are read from this machine; download it first")
    if not path.exists() and str(path) in sample_files():
        raise FormatError(path, f"there is no such file; `bunraku samples {path} -o .` writes the sample")
    files.check_input(path)
    if not os.access(path, os.R_OK):
        raise FormatError(path, "you may not read this file; change its permissions")


def check_source(folder: Path | None, advice: str) -> None:
    """Raise FormatError unless this is a folder, or None; the message ends with the advice."""
    if folder is not None and not folder.is_dir():
        raise FormatError(folder, f"there is no such folder; {advice}")


def check_output(path: Path, suffixes: Iterable[str], inputs: Iterable[Path] = ()) -> None:
    """Raise FormatError unless a file of this name can be written, with one of the suffixes, and over none of the
    inputs.
    """
    allowed = list(suffixes)
    if path.suffix.lower() not in allowed:
        kind = f"'{path.suffix}'" if path.suffix else "a file without a suffix"
        raise FormatError(path, f"{kind} cannot be written here; end the name in {_listed(allowed)}")
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
    """Raise FormatError unless files can be made in this folder, or the folder in the one above it. What killed runs
    left half-done there is removed.

    Writing is tried: permissions say little on network drives, and nothing to root.
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


def slug(text: str, length: int = 40) -> str:
    """Words of a sentence as a part of a file name: "Walks forward, then waves!" -> "walks-forward-then-waves".

    A longer text is cut at a word and gets six letters that tell it from others with the same beginning.
    """
    words = re.findall(r"\w+", text.lower())
    joined, out = "-".join(words), ""
    if len(joined) <= length:
        return joined or "motion"
    mark = hashlib.sha256(joined.encode()).hexdigest()[:6]
    length -= len(mark) + 1
    for word in words:
        if out and len(out) + 1 + len(word) > length:
            break
        out = f"{out}-{word}" if out else word[:length]
    return f"{out}-{mark}"


def _listed(suffixes: list[str]) -> str:
    return suffixes[0] if len(suffixes) == 1 else f"{', '.join(suffixes[:-1])} or {suffixes[-1]}"


_log = logging.getLogger(__name__)


USUAL_FPS = 30.0
"""Frames a second where nothing else is said [1/s]."""
PREVIEWS = (".mp4", ".webp", ".gif", ".png")
OUTPUTS = (".glb", ".npz", ".bvh", ".vrma", ".vmd", *NEEDY, ".fbx", ".obj", ".ply", ".html", *PREVIEWS)

OutputOption = Annotated[tuple[Path, ...], tyro.conf.arg(aliases=["-o"]), tyro.conf.UseAppendAction]
PreviewOption = Annotated[
    tuple[Path, ...],
    tyro.conf.arg(help="Also make a video (.mp4, .webp, .gif) or a contact sheet (.png). May be given more than once."),
    tyro.conf.UseAppendAction,
]
OverwriteOption = Annotated[
    bool, tyro.conf.arg(help="Replace files that Bunraku did not write, or wrote from other inputs.")
]
FpsOption = Annotated[float, tyro.conf.arg(help="Frames a second of what is written, 1 to 240.")]
HandlesOption = Annotated[
    Literal["predict", "rig"],
    tyro.conf.arg(
        help='Where handles come from: "predict" finds them from the shape, "rig" takes the bones that the file '
        "brings, by their names."
    ),
]
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
    outputs: Sequence[Path], previews: Sequence[Path], inputs: Sequence[Path], suffixes: Sequence[str] = OUTPUTS, *,
    overwrite: bool,
) -> None:  # fmt: skip
    """Raise FormatError or OptionError unless all files can be written, with suffixes that each may have, over no
    input, and over no foreign file without `overwrite`.
    """
    for path in outputs:
        check_output(path, suffixes, inputs)
    for path in previews:
        check_output(path, PREVIEWS, inputs)
    check_different((*outputs, *previews))
    check_free(map(written_path, (*outputs, *previews)), overwrite)


@contextmanager
def written_files(note: Callable[[Path], str] = lambda path: "") -> Iterator[list[Path]]:
    """A list of files that are written: at the end each gets a line and is noted, even where a later one failed."""
    written: list[Path] = []
    try:
        yield written
    finally:
        for path in written:
            wrote(path, note(path))
        note_written(written)


def save_all(
    animation: AnimatedCharacter, outputs: Sequence[Path], previews: Sequence[Path], fps: float, report: Progress,
    options: Mapping[str, str] | None = None,
) -> None:  # fmt: skip
    """Write an animation and its previews, videos and contact sheets, and print what was written.

    Args:
        fps: Frames a second [1/s] of previews, and of files where `options` is None.
        options: Those of the files' formats; the animation then keeps its own rate.
    """
    with written_files() as written:
        for number, path in enumerate(outputs):
            report("write", number / len(outputs))
            rate = {} if path.suffix.lower() in (".npz", ".vmd") else {"fps": fps}
            written.append(_fitting(animation, path).save(path, **(rate if options is None else options)))
        report("write", 1.0)
        for path in previews:
            from bunraku.core.animation import Animation, PointAnimation
            from bunraku.core.files import check_output_folder
            from bunraku.render import save_preview

            check_output_folder(path)
            shown = (
                animation if isinstance(animation, PointAnimation)
                else Animation(animation.character, animation.handles, animation.motion)
            )  # fmt: skip
            written.append(
                save_preview(shown, path, fps=fps, progress=lambda done, total: report("preview", done / total))
            )


def _fitting(animation: AnimatedCharacter, path: Path) -> AnimatedCharacter:
    """The animation, or, where its apparel moves by itself and a file of this kind cannot hold that, the body alone."""
    from bunraku.core.animation import PointAnimation
    from bunraku.files import WRITERS

    if not isinstance(animation, PointAnimation) or path.suffix.lower() in WRITERS["points"]:
        return animation
    _log.warning("%s: files of this kind cannot hold apparel; this one holds the body's motion alone", path)
    return animation.animation


def save_clips_to(
    clips: Mapping[str, AnimatedCharacter], outputs: Sequence[Path], fps: float, add: bool, report: Progress,
    preset: Preset | None = None,
) -> None:  # fmt: skip
    """Write clips of one character, by their names, into each of several files, and print what was written. With `add`
    the clips of files that exist are kept. The rate of a preset holds where `fps` is the usual one.
    """
    from bunraku.files import save_clips, save_for

    names: dict[Path, list[str]] = {}
    with written_files(lambda path: ", ".join(names[path])) as written:
        for number, path in enumerate(outputs):
            report("write", number / len(outputs))
            if preset is None:
                names[save_clips(clips, path, fps=fps, add=add)] = list(clips)
            else:
                save_for(preset, clips, path, fps=None if fps == USUAL_FPS else fps)
                names |= preset.files(path, clips)
            written[:] = names
        report("write", 1.0)


@dataclass(frozen=True)
class Result:
    """One of many files that a run makes, the files that it is made of, and the fingerprint (`manifest.fingerprint`) of
    everything that it is made of.
    """

    path: Path
    inputs: tuple[Path, ...]
    mark: str = ""

    @property
    def written(self) -> Path:
        """What exists when it is done: the file, or the folder of a sequence of meshes."""
        return written_path(self.path)

    def resolved(self) -> Self:
        """The same for workers that run in folders of their own."""
        return replace(self, path=self.path.resolve(), inputs=tuple(path.resolve() for path in self.inputs))


AnyResult = TypeVar("AnyResult", bound=Result)
Work = Callable[[list[AnyResult]], Iterable[str]]
"""Makes the results of a batch and gives for each what went wrong, "" for nothing."""


def unfinished_results(results: Sequence[AnyResult], overwrite: bool, what: str) -> list[AnyResult]:
    """The results that still have to be made; a line says how many there are already, by `what` they are called.
    FormatError where something else is in the path of a result, unless that may be overwritten.
    """
    left: set[Path] = set()
    for folder in dict.fromkeys(result.written.parent for result in results):
        marks = {result.written: result.mark for result in results if result.written.parent == folder}
        left.update(unfinished(marks, overwrite))
    todo = [result for result in results if result.written in left]
    if len(todo) < len(results):
        print(f"{len(results) - len(todo)} of {len(results)} {what} are there already")
    return todo


def make_results(
    work: Work[AnyResult], batches: Sequence[list[AnyResult]], jobs: int | str, what: str, report: Progress
) -> int:
    """Make results, a line for each on standard output, or on standard error where it failed.

    Args:
        work: A function of a module, or a `functools.partial` of one. In this process it may raise what ends all.
        batches: What each of its calls makes, all of it unfinished.
        jobs: How many processes, or "ray" for a cluster, whose machines must see the same files.

    Returns:
        The exit status: 1 where a result failed.

    Raises:
        MissingExtraError: ray is not installed.
    """
    results = [result for batch in batches for result in batch]
    for folder in dict.fromkeys(result.written.parent for result in results):
        folder.mkdir(exist_ok=True, parents=True)
    note_begun({result.written: result.mark for result in results})
    failed: dict[str, str] = {}
    for number, (result, reason) in enumerate(run_results(work, batches, jobs), 1):
        if reason:
            note_done(result.written, "")  # nothing was made: a file that comes to lie there is another's
            culprit = next((path for path in result.inputs if reason.startswith(f"{path}: ")), result.path)
            failed[str(culprit)] = reason
        else:
            note_done(result.written, result.mark)
            wrote(result.written)
        report(what, number / len(results))
    say_failed(failed)
    return 1 if failed else 0


def say_failed(reasons: Mapping[str, str]) -> None:
    """Print a line on standard error for each file that failed."""
    for path, reason in reasons.items():
        print(f"bunraku: failed: {path}: {' '.join(reason.removeprefix(f'{path}: ').split())}", file=sys.stderr)


def run_results(
    work: Work[AnyResult], batches: Sequence[list[AnyResult]], jobs: int | str
) -> Iterator[tuple[AnyResult, str]]:
    """Each result with what went wrong, "" for nothing, as soon as it is done; arguments as of `make_results`."""
    if jobs == 1:
        for batch in batches:
            yield from zip(batch, work(batch), strict=True)
        return
    given = [[result.resolved() if jobs == "ray" else result for result in batch] for batch in batches]
    results = {
        there: here for row, batch in zip(given, batches, strict=True) for there, here in zip(row, batch, strict=True)
    }
    for result, reason in run_parallel(partial(_worked, work), given, jobs, str):
        yield results[result], reason


def _worked(work: Work[AnyResult], batch: list[AnyResult]) -> list[str]:
    return list(work(batch))


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
