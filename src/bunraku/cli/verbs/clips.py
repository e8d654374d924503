"""`bunraku clips`: the clip library, listed, searched, and put on a character."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.cli.options.orientation import AxisOption, UnitOption, check_axes, stand_up
from bunraku.cli.output.alone import alone
from bunraku.cli.output.checks import check_input, written_path
from bunraku.cli.output.outputs import OutputOption, PreviewOption, check_outputs, save_all
from bunraku.cli.output.progress import Report, stages
from bunraku.core.request.limits import FPS, SECONDS
from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.clips import Clip
    from bunraku.core.animated import AnimatedCharacter

__all__ = ["Clips"]


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
        from bunraku.clips import search

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
        with alone(written_path(path) for path in (*outputs, *self.preview)), stages() as report:
            check_outputs(outputs, self.preview, inputs, overwrite=self.overwrite)
            save_all(self._animation(clip, report), outputs, self.preview, self.fps, report)
        print(f"{clip.name}: {clip.source.credit}; {clip.source.terms}", file=sys.stderr)

    def _animation(self, clip: Clip, report: Report) -> AnimatedCharacter:
        from bunraku.body.reference import reference_body
        from bunraku.core.animation import Animation
        from bunraku.io import load_character
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
