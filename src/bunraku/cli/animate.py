"""`bunraku animate`: a character and a sentence give an animation."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from bunraku.cli.checks import check_different, check_input, check_output, check_prompt, check_range, check_seconds, make_folder, slug
from bunraku.cli.orientation import AxisOption, check_axes, stand_up
from bunraku.cli.progress import stages
from bunraku.cli.report import wrote
from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.retarget.fit import Stages

__all__ = ["Animate"]

OUTPUTS = (".glb", ".npz", ".obj", ".ply")
PREVIEWS = (".mp4", ".webp", ".gif", ".png")


@dataclass(frozen=True)
class Animate:
    """Make a character do what a sentence says.

    The character is a .glb, .gltf, .vrm, .fbx, .obj, .ply or .stl file; it needs no rig. The animation is written as a GLB that
    keeps the mesh, materials and textures of the input, as an NPZ of the handle motion, or as a sequence of meshes.

    Example: bunraku animate dragon.glb "walks forward, then waves with the left hand" --seconds 6 -o wave.glb --preview wave.mp4
    """

    character: tyro.conf.Positional[Path]
    """The mesh to animate."""
    prompt: tyro.conf.Positional[str]
    """What it does, in English."""
    output: Annotated[tuple[Path, ...], tyro.conf.arg(aliases=["-o"]), tyro.conf.UseAppendAction] = ()
    """File to write: .glb, .npz (the handle motion), .obj or .ply (a folder with one mesh a frame). May be given more than once.
    Default: CHARACTER-PROMPT.glb in this folder."""
    preview: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Also make a video (.mp4, .webp, .gif) or a contact sheet (.png). May be given more than once."""
    seconds: float = 6.0
    """Length of the clip, 0.5 to 120."""
    seed: int = 0
    """The same seed and version give the same animation."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Sampling steps, 1 to 1000; more is slower. Default: 20."""
    guidance: Annotated[float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="")] = None
    """How closely to follow the sentence, 0 to 20. Default: 2.5."""
    fps: float = 30.0
    """Frames a second of the files, 1 to 120."""
    handles: Literal["predict", "rig"] = "predict"
    """Where the handles come from: "predict" finds them from the shape, "rig" takes the bones that the file brings, by their names."""
    up: AxisOption = "auto"
    """The axis that is up in the file. "auto" goes by the rule of the format, and by the shape where it has none."""
    front: AxisOption = "auto"
    """The axis that the character faces in the file."""
    without: Annotated[tuple[str, ...], tyro.conf.arg(metavar="STAGE"), tyro.conf.UseAppendAction] = ()
    """Leave out a stage that fits the motion to the character: rest-pose, attach or ground. May be given more than once."""

    def run(self) -> None:
        check_prompt(self.prompt)
        check_seconds(self.seconds)
        check_range("--seed", self.seed, 0, 2**63 - 1)
        check_range("--steps", self.steps, 1, 1000)
        check_range("--guidance", self.guidance, 0, 20)
        check_range("--fps", self.fps, 1, 120)
        check_axes(self.up, self.front)
        check_input(self.character)
        outputs = self.output or (Path(f"{self.character.stem}-{slug(self.prompt)}.glb"),)
        for path in outputs:
            check_output(path, OUTPUTS, [self.character])
        for path in self.preview:
            check_output(path, PREVIEWS, [self.character])
        check_different((*outputs, *self.preview))
        fitting = _stages(self.without)

        from bunraku.formats import load_character

        written: list[Path] = []
        try:
            with stages() as report:
                report("load", 0.0)
                character = stand_up(load_character(self.character), self.character, self.up, self.front)
                report("load", 1.0)

                from bunraku.pipeline import animate

                animation = animate(
                    character,
                    self.prompt,
                    seconds=self.seconds,
                    seed=self.seed,
                    steps=self.steps,
                    guidance=self.guidance,
                    handles=self.handles,
                    stages=fitting,
                    progress=report,
                )
                for number, path in enumerate(outputs):
                    report("write", number / len(outputs))
                    written.append(animation.save(path, **({} if path.suffix.lower() == ".npz" else {"fps": self.fps})))
                report("write", 1.0)
                for path in self.preview:
                    from bunraku.render import save_preview

                    make_folder(path)
                    written.append(save_preview(animation, path, fps=self.fps, progress=lambda done, total: report("preview", done / total)))
        finally:  # what is whole stays, so it is named, whatever became of the rest
            for path in written:
                wrote(path)


def _stages(without: tuple[str, ...]) -> Stages | None:
    """All stages of fitting but those named, or None for the default."""
    if not without:
        return None
    from bunraku.retarget.fit import Stages

    known = [field.name.replace("_", "-") for field in fields(Stages)]
    for name in without:
        if name not in known:
            raise OptionError(f"--without names no stage '{name}'; there are {', '.join(known)}")
    return Stages(**{name.replace("-", "_"): False for name in without})
