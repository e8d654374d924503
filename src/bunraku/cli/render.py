"""`bunraku render`: a video or a picture of an animated file, a character or a motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from bunraku.cli import shared
from bunraku.cli.manifest import check_free, exclusive_output
from bunraku.cli.options import WhichOptions
from bunraku.core.request import FPS, Progress
from bunraku.errors import FormatError, OptionError

if TYPE_CHECKING:
    from bunraku.core.animation import Animation


@dataclass(frozen=True)
class Render:
    """Make a video or a picture of an animated file, a character or a motion.

    A GLB or FBX with a clip is played; .png gives a contact sheet of it. A character without a clip gives a still
    (.png). A handle motion (.npz) is played on the character that --character names.

    Example: bunraku render dragon-wave.glb -o dragon-wave.mp4 --fps 30
    """

    file: tyro.conf.Positional[Path]
    """An animated GLB or FBX, a character, or a handle motion (.npz)."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="PATH", help_behavior_hint="")] = None
    """File to write: .mp4, .webp, .gif or .png. Default: FILE.mp4 for what moves, FILE.png for what does not, in this
    folder.
    """
    character: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """The character that plays an .npz motion."""
    clip: str = "0"
    """Which clip of a file with several: its number or name."""
    fps: shared.FpsOption = 30.0
    size: tuple[int, int] = (640, 480)
    """Width and height of a video or a still in pixels."""
    color: Literal["texture", "handles"] = "texture"
    """The character's own colours, or one for each handle or joint."""
    overwrite: shared.OverwriteOption = False
    standing: tyro.conf.OmitArgPrefixes[WhichOptions] = field(default_factory=WhichOptions)
    """How the file of a character without a clip is read, or that of --character."""

    def run(self) -> None:
        self.standing.check()
        FPS.check(self.fps, "--fps")
        for side in self.size:
            shared.check_range("--size", side, 16, 4096)
        shared.check_input(self.file)
        motion = self.file.suffix.lower() == ".npz"
        if motion and self.character is None:
            raise OptionError(
                f"{self.file} is a motion without a mesh; name the character that plays it with --character"
            )
        if self.character is not None:
            if not motion:
                raise OptionError(f"--character is for .npz motions, and {self.file} is not one; leave it out")
            shared.check_input(self.character)
        if self.output is not None:
            shared.check_output(self.output, shared.PREVIEWS, [self.file])
            check_free([self.output], self.overwrite)

        with exclusive_output([self.output] if self.output else []), shared.stages() as report:
            report("load", 0.0)
            animation = self._motion(report) if motion else self._clip()
            report("load", 1.0)
            output = self.output or Path(f"{self.file.stem}.{'png' if animation is None else 'mp4'}")
            with exclusive_output([output]):
                shared.check_output(output, shared.PREVIEWS, [self.file])
                check_free([output], self.overwrite)
                with shared.written_files() as written:
                    self._draw(animation, output, report)
                    written.append(output)

    def _draw(self, animation: Animation | None, output: Path, report: Progress) -> None:
        if animation is None:
            self._still(output)
            return
        from bunraku.render import save_preview

        save_preview(
            animation,
            output,
            size=None if output.suffix.lower() == ".png" else self.size,
            fps=self.fps,
            color=self.color,
            progress=lambda done, total: report("preview", done / total),
        )

    def _motion(self, report: Progress) -> Animation:
        from bunraku.core.animation import Animation
        from bunraku.core.motion import HandleMotion
        from bunraku.files import read_motion
        from bunraku.pipelines.animate import rig

        assert self.character is not None
        motion = read_motion(self.file)
        if not isinstance(motion, HandleMotion):
            raise FormatError(
                self.file,
                "this is not handle motion, whatever its suffix says; write one with `bunraku animate -o motion.npz`",
            )
        character = self.standing.load(self.character)
        return Animation(character, rig(character, progress=report), motion)

    def _clip(self) -> Animation | None:
        from bunraku.files import load_animation, load_with_clips

        source = load_with_clips(self.file, self.fps).source
        if getattr(source, "document", None) is None or not source.document.items("animations"):
            return None
        return load_animation(self.file, self.clip, self.fps)

    def _still(self, output: Path) -> None:
        from bunraku.render import save_still

        if output.suffix.lower() != ".png":
            raise FormatError(
                self.file, f"it holds no animation, so there is nothing to put in a {output.suffix}; ask for a .png"
            )
        if self.color == "handles":
            raise OptionError("the handles of a character without a clip are shown by `bunraku rig --preview`")
        save_still(self.standing.load(self.file), output, size=self.size)
