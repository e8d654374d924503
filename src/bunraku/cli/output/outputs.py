"""What the verbs that make animations share: options of sampling, of fitting and of the files, and how these are
checked, written and reported.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.cli.output.checks import check_different, check_output, make_folder, written_path
from bunraku.cli.output.ledger import check_free, note_written
from bunraku.cli.output.progress import Report
from bunraku.errors import FormatError, OptionError
from bunraku.retarget.stages.switches import Stages

if TYPE_CHECKING:
    from bunraku.core.animated import AnimatedCharacter
    from bunraku.io.presets import Preset

_log = logging.getLogger(__name__)
__all__ = [
    "OutputOption",
    "PREVIEWS",
    "PreviewOption",
    "WithoutOption",
    "check_outputs",
    "check_stages",
    "fitting_stages",
    "save_all",
    "save_clips_to",
    "size_text",
    "wrote",
]


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
            from bunraku.core.animation import Animation
            from bunraku.core.point_animation import PointAnimation
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
    from bunraku.core.point_animation import PointAnimation
    from bunraku.io.registry import check_points_writer

    if not isinstance(animation, PointAnimation):
        return animation
    try:
        check_points_writer(path)
    except FormatError:
        _log.warning("%s: files of this kind have no place for apparel; it holds the body's motion alone", path)
        return animation.animation
    return animation


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
    from bunraku.io.presets import save_for
    from bunraku.io.save_clips import save_clips

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
