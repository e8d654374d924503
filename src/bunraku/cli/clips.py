"""`bunraku clips` and `bunraku samples`: the clips and characters that come with Bunraku."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.cli.manifest import check_free, exclusive_output
from bunraku.cli.options import AxisOption, UnitOption, check_axes, stand_up
from bunraku.cli.outputs import (
    OutputOption,
    PreviewOption,
    Report,
    check_folder,
    check_input,
    check_outputs,
    save_all,
    stages,
    written_path,
    wrote,
)
from bunraku.core.request import FPS, SECONDS
from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.core.animation import AnimatedCharacter
    from bunraku.generation.library import Clip

__all__ = ["Clips", "Samples"]


@dataclass(frozen=True)
class Clips:
    """List the clips of the library, find some by words, or put one on a character.

    Example: bunraku clips wave hello --character dragon.glb -o wave.glb
    """

    words: tyro.conf.Positional[tuple[str, ...]] = ()
    """What is looked for: a name, or words of what is done; all clips by default."""
    tag: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TAG"), tyro.conf.UseAppendAction] = ()
    """A tag that the clips have, such as dance. May be given more than once."""
    json: bool = False
    """Print JSON for programs."""
    character: Path | None = None
    """The character that the first of them is put on; without it, --output gets the motion of the reference body."""
    output: OutputOption = ()
    """File that the first of them is written to. May be given more than once. Default with --character:
    CHARACTER-CLIP.glb in this folder.
    """
    seconds: float | None = None
    """How long it is to last: one that loops is played on, others are held at their end. Default: its own length."""
    loop: bool = False
    """Write whole rounds of one that loops, so that its last frame goes on with its first."""
    fps: float = 30.0
    """Frames a second of the file, 1 to 240."""
    up: AxisOption = "auto"
    """The axis that is up in the character's file."""
    front: AxisOption = "auto"
    """The axis that the character faces in its file."""
    unit: UnitOption = "auto"
    """The unit of lengths in the character's file."""
    overwrite: bool = False
    """Replace files that are there already and that Bunraku did not write."""
    preview: PreviewOption = ()
    """Also make a video (.mp4, .webp, .gif) or a contact sheet (.png). May be given more than once."""

    def run(self) -> None:
        from bunraku.generation.library import search

        check_axes(self.up, self.front)
        SECONDS.check(self.seconds, "--seconds")
        FPS.check(self.fps, "--fps")
        text = " ".join(self.words)
        found = search(text, self.tag)
        named = [clip for clip in found if clip.name == text]
        if self.character is None and not self.output and not self.preview:
            self._print(found)
        elif not found:
            raise OptionError(f"no clip is found for '{text[:60]}'; `bunraku clips` lists all of them")
        else:
            self._write((named or found)[0])

    def _print(self, found: list[Clip]) -> None:
        if self.json:
            print(json.dumps([facts_of(clip) for clip in found], indent=2, ensure_ascii=False))
            return
        for clip in found:
            print(f"{clip.name:24} {clip.seconds:5.1f} s {'loop' if clip.loops else '    '}  {clip.sentence}")
        if not found:
            print("no clip is found; `bunraku clips` lists all of them", file=sys.stderr)

    def _write(self, clip: Clip) -> None:
        inputs = [] if self.character is None else [self.character]
        for path in inputs:
            check_input(path)
        stem = None if self.character is None else f"{self.character.stem}-{clip.name}"
        outputs = self.output or ((Path(f"{stem}.glb"),) if stem else ())
        with exclusive_output(written_path(path) for path in (*outputs, *self.preview)), stages() as report:
            check_outputs(outputs, self.preview, inputs, overwrite=self.overwrite)
            save_all(self._animation(clip, report), outputs, self.preview, self.fps, report)
        print(f"{clip.name}: {clip.source.credit}; {clip.source.terms}", file=sys.stderr)

    def _animation(self, clip: Clip, report: Report) -> AnimatedCharacter:
        from bunraku.core.animation import Animation
        from bunraku.core.body.reference import reference_body
        from bunraku.files import load_character
        from bunraku.pipelines.transfer import transfer

        if self.character is None:
            body, motion = reference_body(), clip.motion(self.seconds, self.loop)
            return Animation(body.character(), body.handles, motion, motion)
        character = stand_up(load_character(self.character, unit="m"), self.character, self.up, self.front, self.unit)
        return transfer(character, clip.motion(self.seconds, self.loop), fps=self.fps, progress=report)


def facts_of(clip: Clip) -> dict[str, object]:
    """A clip in values that JSON can say."""
    return {
        "name": clip.name, "sentence": clip.sentence, "seconds": clip.seconds, "loops": clip.loops,
        "tags": list(clip.tags), "credit": clip.source.credit, "terms": clip.source.terms,
    }  # fmt: skip


@dataclass(frozen=True)
class Samples:
    """Write the sample characters as GLB files.

    Example: bunraku samples person mushroom -o characters
    """

    names: tyro.conf.Positional[tuple[str, ...]] = ()
    """Which ones; all of them by default."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path(".")
    """Folder to write to, made when it is not there."""
    overwrite: bool = False
    """Replace other files that have a sample's name."""
    list: bool = False
    """Only print the names."""

    def run(self) -> None:
        from bunraku.files import sample_names

        known = tuple(sample_names())
        for name in self.names:
            if name not in known:
                raise OptionError(f"there is no sample '{name}'; there are {', '.join(known)}")
        if self.list:
            print("\n".join(known))
            return
        check_folder(self.output)

        outputs = {name: self.output / f"{name}.glb" for name in self.names or known}
        with exclusive_output(outputs.values()):
            self._write(outputs)

    def _write(self, outputs: dict[str, Path]) -> None:
        """Write the samples that are not there yet."""
        from bunraku.core.files import atomic_write, read_bounded
        from bunraku.files import sample_file

        todo = {name: read_bounded(sample_file(name)) for name in outputs}
        there = [name for name, path in outputs.items() if path.is_file() and path.read_bytes() == todo[name]]
        check_free([path for name, path in outputs.items() if name not in there], self.overwrite, ours=False)
        if there:
            print(f"{len(there)} of {len(todo)} samples are there already")
        for name, path in outputs.items():
            if name not in there:
                with atomic_write(path) as file:
                    file.write(todo[name])
                wrote(path)
