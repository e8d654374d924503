"""`bunraku edit` and `bunraku merge`: a clip with a part of it generated anew, and the clips of several files in
one.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.cli import shared
from bunraku.cli.manifest import exclusive_output
from bunraku.cli.options import EditSamplingOptions, GeneratingOptions, PinOption, WhichOptions, parse_pin
from bunraku.core.request import FPS, Progress
from bunraku.errors import OptionError
from bunraku.pipelines.requests import Constraints, Keep, Pose, Request
from bunraku.retarget.stages import Stages

if TYPE_CHECKING:
    from bunraku.core.animation import Animation


@dataclass(frozen=True)
class Edit(GeneratingOptions):
    """Keep chosen handles of a clip, or all but a span of it, and generate the rest from a sentence.

    The clip is a .glb or .npz file that Bunraku wrote. What is kept comes back exactly.

    Example: bunraku edit walk.glb "waves with both hands" --keep legs -o walk-wave.glb
    """

    sampling: tyro.conf.OmitArgPrefixes[EditSamplingOptions] = field(default_factory=EditSamplingOptions, kw_only=True)
    """How the motion is drawn."""
    standing: tyro.conf.OmitArgPrefixes[WhichOptions] = field(default_factory=WhichOptions, kw_only=True)
    """How the character's file is read."""
    clip: tyro.conf.Positional[Path]
    """The clip, .glb or .npz, as Bunraku wrote it."""
    prompt: tyro.conf.Positional[str]
    """What is done instead, in English (or in a language that the table of words has)."""
    keep: Annotated[tuple[str, ...], tyro.conf.arg(metavar="PART"), tyro.conf.UseAppendAction] = ()
    """What stays: root, legs, arms, left-arm, right-arm, left-leg, right-leg, upper-body, lower-body, head, torso,
    tail, wings, or a single handle such as left_wrist. May be given more than once.
    """
    span: Annotated[str, tyro.conf.arg(metavar="FROM:TO")] = ""
    """Seconds from and to which is generated, such as 1.0:3.0; all outside stays. Default: the whole clip."""
    pose: Annotated[tuple[float, ...], tyro.conf.arg(metavar="TIME"), tyro.conf.UseAppendAction] = ()
    """Seconds of a pose that stays; what is between such poses is generated. May be given more than once."""
    pin: PinOption = ()
    character: Path | None = None
    """The character that an .npz clip was made for; without it the clip is edited and given back as one of the
    reference body.
    """

    def run(self) -> None:
        from bunraku.core.body.layout import kept_handles

        request = self.request().with_parsed()
        if self.keep:
            kept_handles(self.keep)
        elif not self.span and not self.pose:
            raise OptionError(
                "nothing is kept of the clip; name what stays (--keep legs), the seconds that change (--span 1.0:3.0) "
                "or poses that stay (--pose 1.5)"
            )
        self.check()
        request.check("--", clip=True)
        inputs = [self.clip] + ([self.character] if self.character else [])
        for path in inputs:
            shared.check_input(path)
        outputs = self.output or (Path(f"{self.clip.stem}-{shared.slug(self.prompt)}{self.clip.suffix.lower()}"),)
        with exclusive_output(map(shared.written_path, (*outputs, *self.preview))), shared.stages() as report:
            shared.check_outputs(outputs, self.preview, inputs, overwrite=self.overwrite)
            report("load", 0.0)
            clip = self._animation(report)
            report("load", 1.0)

            from bunraku.pipelines.animate import edited
            from bunraku.pipelines.animator import Animator

            shared.save_all(edited(Animator.shipped(report), clip, request), outputs, self.preview, self.fps, report)

    def request(self) -> Request:
        """What is requested."""
        span = parse_span(self.span) if self.span else None
        stays = [Keep(self.keep, span)] if self.keep or span is not None else []
        pins = [parse_pin(pin) for pin in self.pin]
        return Request(
            self.prompt, self.sampling, Constraints((*stays, *map(Pose, self.pose), *pins)),
            stages=Stages().without(self.without, "--without"), force=self.force,
        )  # fmt: skip

    def _animation(self, report: Progress) -> Animation:
        from bunraku.core.animation import Animation
        from bunraku.core.body.reference import reference_body
        from bunraku.files import load_clip, load_clip_animation

        clip = load_clip(self.clip)
        if self.clip.suffix.lower() != ".npz":
            if self.character is not None:
                raise OptionError(f"--character is for .npz clips, and {self.clip} brings its own; leave it out")
            return load_clip_animation(self.clip)
        if self.character is None:
            body, motion = reference_body(), clip.of_the_reference_body()
            if not clip.is_of(body.handles):
                print(
                    f"{self.clip}: edited as a motion of the reference body; name its character with --character to "
                    "edit that",
                    file=sys.stderr,
                )
            return Animation(body.character(), body.handles, motion, motion)
        from bunraku.anatomy.anatomy import Anatomy
        from bunraku.pipelines.animate import rig
        from bunraku.pipelines.apply import apply_motion

        character = self.standing.load(self.character)
        handles = rig(character, handles=self.handles, progress=report)
        return clip.on(character, handles) or apply_motion(clip.of_the_reference_body(), Anatomy.of(character, handles))


def parse_span(text: str) -> tuple[float, float]:
    """Seconds of "1.0:3.0"; OptionError for other texts."""
    start, colon, end = text.partition(":")
    try:
        span = float(start), float(end)
        if colon and 0 <= span[0] < span[1] < math.inf:
            return span
    except ValueError:
        pass
    raise OptionError(f"--span is two seconds with a colon between, such as 1.0:3.0, not '{text}'")


@dataclass(frozen=True)
class Merge:
    """Join the clips of one character from several files in one GLB.

    The first file is written as it is, with the clips of the others after its own, on the bones of the same names.

    Example: bunraku merge idle.glb walk.glb attack.glb -o knight.glb
    """

    files: tyro.conf.Positional[tuple[Path, ...]]
    """Two or more GLB, glTF or VRM files of one character."""
    output: shared.OutputOption = ()
    """GLB to write. May be given more than once. Default: FIRST-merged.glb in this folder."""
    end_to_start: bool = False
    """Write all clips in a row as one clip; each starts where the one before ends."""
    fps: shared.FpsOption = 30.0
    overwrite: shared.OverwriteOption = False

    def run(self) -> None:
        FPS.check(self.fps, "--fps")
        if len(self.files) < (1 if self.end_to_start else 2):
            raise OptionError("name the files whose clips are joined, two or more; one is enough with --end-to-start")
        for path in self.files:
            shared.check_input(path)
        outputs = self.output or (Path(f"{self.files[0].stem}-merged.glb"),)
        with exclusive_output(outputs):
            shared.check_outputs(outputs, (), self.files, (".glb",), overwrite=self.overwrite)

            from bunraku.files import merge

            with shared.written_files() as written:
                for path in outputs:
                    written.append(merge(self.files, path, end_to_start=self.end_to_start, fps=self.fps))
