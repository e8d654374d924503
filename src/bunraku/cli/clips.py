"""`bunraku clips` and `bunraku samples`: the clips and characters that come with Bunraku."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.cli import shared
from bunraku.cli.manifest import check_free, exclusive_output
from bunraku.cli.options import WhichOptions
from bunraku.core.files import atomic_write
from bunraku.core.request import FPS, SECONDS, Progress
from bunraku.errors import OptionError
from bunraku.files import sample_bytes, sample_files

if TYPE_CHECKING:
    from bunraku.core.animation import AnimatedCharacter
    from bunraku.generation.library import Clip


@dataclass(frozen=True)
class Clips:
    """List the clips of the library, find some by words, or put one on a character.

    Example: bunraku clips wave hello --character dragon.glb -o wave.glb
    """

    words: tyro.conf.Positional[tuple[str, ...]] = ()
    """A name, or words that say what the clip shows; all clips by default."""
    tag: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TAG"), tyro.conf.UseAppendAction] = ()
    """A tag that the clips have, such as dance. May be given more than once."""
    json: bool = False
    """Print JSON for programs."""
    character: Path | None = None
    """Put the first clip that is found on this character; without it, --output gets the reference body's motion."""
    output: shared.OutputOption = ()
    """File to write the first clip to. May be given more than once. Default with --character:
    CHARACTER-CLIP.glb in this folder.
    """
    seconds: float | None = None
    """Length of the clip: one that loops is repeated, others are held at their end. Default: its own length."""
    loop: bool = False
    """Write full rounds of a clip that loops, so that its first frame follows its last."""
    fps: shared.FpsOption = 30.0
    overwrite: shared.OverwriteOption = False
    preview: shared.PreviewOption = ()
    standing: tyro.conf.OmitArgPrefixes[WhichOptions] = field(default_factory=WhichOptions)
    """How the character's file is read."""

    def run(self) -> None:
        from bunraku.generation.library import search

        self.standing.check()
        SECONDS.check(self.seconds, "--seconds")
        FPS.check(self.fps, "--fps")
        text = " ".join(self.words)
        clips = search(text, self.tag)
        named = [clip for clip in clips if clip.name == text]
        if self.character is None and not self.output and not self.preview:
            self._print(clips)
        elif not clips:
            raise OptionError(f"no clip is found for '{text[:60]}'; `bunraku clips` lists all of them")
        else:
            self._write((named or clips)[0])

    def _print(self, found: list[Clip]) -> None:
        if self.json:
            print(json.dumps([clip.facts for clip in found], indent=2, ensure_ascii=False))
            return
        for clip in found:
            print(f"{clip.name:24} {clip.seconds:5.1f} s {'loop' if clip.loops else '    '}  {clip.sentence}")
        if not found:
            print("no clip is found; `bunraku clips` lists all of them", file=sys.stderr)

    def _write(self, clip: Clip) -> None:
        inputs = [] if self.character is None else [self.character]
        for path in inputs:
            shared.check_input(path)
        stem = None if self.character is None else f"{self.character.stem}-{clip.name}"
        outputs = self.output or ((Path(f"{stem}.glb"),) if stem else ())
        with exclusive_output(map(shared.written_path, (*outputs, *self.preview))), shared.stages() as report:
            shared.check_outputs(outputs, self.preview, inputs, overwrite=self.overwrite)
            shared.save_all(self._animation(clip, report), outputs, self.preview, self.fps, report)
        print(f"{clip.name}: {clip.source.credit}; {clip.source.terms}", file=sys.stderr)

    def _animation(self, clip: Clip, report: Progress) -> AnimatedCharacter:
        from bunraku.core.animation import Animation
        from bunraku.core.body.reference import reference_body
        from bunraku.pipelines.transfer import transfer

        if self.character is None:
            body, motion = reference_body(), clip.motion(self.seconds, self.loop)
            return Animation(body.character(), body.handles, motion, motion)
        return transfer(
            self.standing.load(self.character), clip.motion(self.seconds, self.loop), fps=self.fps, progress=report
        )


@dataclass(frozen=True)
class Samples:
    """Write the sample characters as GLB files, and what else the docs use: a mesh without a skeleton, a rigged one, a
    VRM, a motion and ten sentences.

    Example: bunraku samples person mushroom -o characters
    """

    names: tyro.conf.Positional[tuple[str, ...]] = ()
    """Which ones; all of them by default."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path(".")
    """Folder to write to, made when it is missing; or the file of one sample, with the same suffix."""
    overwrite: shared.OverwriteOption = False
    list: bool = False
    """Only print the names."""

    def run(self) -> None:
        files = sample_files()
        for name in self.names:
            if name not in files:
                raise OptionError(f"there is no sample '{name}'; there are {', '.join(files)}")
        if self.list:
            print("\n".join(files))
            return
        names = self.names or tuple(files)
        one_file = bool(self.output.suffix) and not self.output.is_dir()
        if one_file:
            if len(names) > 1:
                raise OptionError(f"{len(names)} samples do not go into one file; name a folder, not {self.output}")
            shared.check_output(self.output, (Path(files[names[0]]).suffix,))
        else:
            shared.check_folder(self.output)
        paths = {name: self.output if one_file else self.output / files[name] for name in names}
        with exclusive_output(paths.values()):
            data = {name: sample_bytes(files[name]) for name in names}
            todo = [name for name in names if not (paths[name].is_file() and paths[name].read_bytes() == data[name])]
            check_free([paths[name] for name in todo], self.overwrite, ours=False)
            if len(todo) < len(names):
                print(f"{len(names) - len(todo)} of {len(names)} samples are there already")
            for name in todo:
                with atomic_write(paths[name]) as file:
                    file.write(data[name])
                shared.wrote(paths[name])
