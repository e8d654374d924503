"""`bunraku animate`: a character and a sentence give an animation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from bunraku.cli.checks import check_input, check_sequence, slug
from bunraku.cli.orientation import AxisOption, check_axes, stand_up
from bunraku.cli.outputs import (
    GuidanceOption,
    OutputOption,
    PreviewOption,
    StepsOption,
    WithoutOption,
    check_outputs,
    check_sampling,
    fitting_stages,
    save_all,
)
from bunraku.cli.progress import stages
from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.core.animation import Animation
    from bunraku.core.character import Character, Handles
    from bunraku.core.motion import HandleMotion

__all__ = ["Animate"]


@dataclass(frozen=True)
class Animate:
    """Make a character do what a sentence says.

    The character is a .glb, .gltf, .vrm, .pmx, .pmd, .fbx, .obj, .ply or .stl file; it needs no rig. The animation is written as a GLB that
    keeps the mesh, materials and textures of the input, as an NPZ of the handle motion, or as a sequence of meshes.

    Several prompts in a row, parted by semicolons, blend into each other: "walks:4; jumps:2; waves:3". The numbers are seconds.

    Example: bunraku animate dragon.glb "walks forward, then waves with the left hand" --seconds 6 -o wave.glb --preview wave.mp4
    """

    character: tyro.conf.Positional[Path]
    """The mesh to animate."""
    prompt: tyro.conf.Positional[str] = ""
    """What it does, in English; or several prompts in a row with their seconds."""
    prompts: Path | None = None
    """A text file with one prompt a line, in place of PROMPT: each line gives a GLB in the folder that -o names. What is there already is
    left as it is, so a run that was stopped goes on."""
    output: OutputOption = ()
    """File to write: .glb, .usd, .usdc, .usdz, .fbx (with Blender), .npz (the handle motion), .bvh or .vrma (what the humanoid skeleton
    does), .vmd (of MMD characters), .obj or .ply (a folder with one mesh a frame), .mp4, .webp, .gif or .png. May be given more than once.
    Default: CHARACTER-PROMPT.glb in this folder."""
    preview: PreviewOption = ()
    """Also make a video (.mp4, .webp, .gif) or a contact sheet (.png). May be given more than once."""
    seconds: float = 6.0
    """Length of the clip, 0.5 to 120; prompts in a row without seconds of their own share it."""
    loop: bool = False
    """Make a loop: the clip ends in the pose that it starts in, at the same speed."""
    apparel: Literal["rigid", "simulate"] = "rigid"
    """How hair and clothes of MMD and VRM characters move: "rigid" with the body, or "simulate" by the physics of their file, on the
    bones of its own rig."""
    in_place: bool = False
    """Take the way over the ground out: the character walks on the spot."""
    after: Path | None = None
    """A .glb or .npz clip of Bunraku: start in its last pose."""
    seed: int = 0
    """The same seed and version give the same animation."""
    steps: StepsOption = None
    """Sampling steps, 1 to 1000; more is slower. Default: 20."""
    guidance: GuidanceOption = None
    """How closely to follow the sentence, 0 to 20. Default: 2.5."""
    fps: float = 30.0
    """Frames a second of the files, 1 to 120."""
    handles: Literal["predict", "rig"] = "predict"
    """Where the handles come from: "predict" finds them from the shape, "rig" takes the bones that the file brings, by their names."""
    up: AxisOption = "auto"
    """The axis that is up in the file. "auto" goes by the rule of the format, and by the shape where it has none."""
    front: AxisOption = "auto"
    """The axis that the character faces in the file."""
    without: WithoutOption = ()
    """Leave out a stage that fits the motion to the character: rest-pose, attach, shape, ground, feet, smooth or floor. May be repeated."""

    def run(self) -> None:
        prompts = self._prompts()
        check_sampling(self.seed, self.steps, self.guidance, self.fps)
        check_axes(self.up, self.front)
        check_input(self.character)
        if self.after is not None:
            check_input(self.after)
            if self.loop:
                raise OptionError("a loop ends where it starts, so --loop and --after do not go together; leave one out")
        if self.apparel == "simulate" and (self.loop or self.after is not None):
            raise OptionError("simulated apparel starts from the rest pose, so --apparel simulate goes with neither --loop nor --after")
        if self.apparel == "simulate" and self.handles != "predict":
            raise OptionError("--apparel simulate moves the bones of the character's rig; leave --handles out")
        fitting = fitting_stages(self.without, shape=True)
        if self.prompts is not None:
            from bunraku.cli.verbs.batch import animate_lines

            animate_lines(self, prompts, fitting)
            return
        outputs = self.output or (Path(f"{self.character.stem}-{slug(self.prompt)}.glb"),)
        inputs = [self.character] + ([self.after] if self.after else [])
        check_outputs(outputs, self.preview, inputs)

        from bunraku.io import load_character

        with stages() as report:
            report("load", 0.0)
            character = stand_up(load_character(self.character), self.character, self.up, self.front)
            report("load", 1.0)

            from bunraku.pipelines.animate import animate, rig

            how: dict[str, Any] = {
                "seconds": self.seconds, "seed": self.seed, "steps": self.steps, "guidance": self.guidance, "in_place": self.in_place,
                "stages": fitting, "progress": report,
            }  # fmt: skip
            if self.apparel == "simulate":
                save_all(animate(character, self.prompt, apparel="simulate", **how), outputs, self.preview, self.fps, report)
                return
            handles = rig(character, handles=self.handles, progress=report)
            animation = animate(
                character,
                self.prompt,
                handles=handles,
                loop=self.loop,
                after=None if self.after is None else _before(self.after, character, handles),
                **how,
            )
            save_all(animation, outputs, self.preview, self.fps, report)

    def _prompts(self) -> list[str]:
        """All prompts, checked."""
        if self.prompts is None:
            check_sequence(self.prompt, self.seconds)
            return [self.prompt]
        if self.prompt:
            raise OptionError("a prompt and --prompts are both given; leave one out")
        if self.preview or self.after or len(self.output) > 1:
            raise OptionError("--prompts makes one GLB a line in one folder (-o), without --preview and --after")
        from bunraku.cli.verbs.batch import read_lines

        return read_lines(self.prompts, self.seconds)


def _before(path: Path, character: Character, handles: Handles) -> HandleMotion | Animation:
    """The clip to start from: of this character if it was made for it, of the reference body otherwise."""
    from bunraku.io.clips import load_clip

    clip = load_clip(path)
    return clip.on(character, handles) or clip.of_the_reference_body()
