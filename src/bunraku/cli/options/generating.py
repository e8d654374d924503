"""The options that all verbs share that make motion from a sentence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import tyro

from bunraku.cli.options.orientation import AxisOption, UnitOption, check_axes
from bunraku.cli.output.checks import check_range
from bunraku.cli.output.outputs import OutputOption, PreviewOption, WithoutOption

__all__ = ["GeneratingOptions"]


@dataclass(frozen=True, kw_only=True)
class GeneratingOptions:
    """How a motion is drawn from a sentence, fitted to a character and written."""

    output: OutputOption = ()
    """File to write: .glb, .usd, .usdc, .usdz, .fbx (with Blender), .npz (the handle motion), .bvh or .vrma (what the
    humanoid skeleton does), .vmd (of MMD characters), .obj or .ply (a folder with one mesh a frame), .mp4, .webp, .gif
    or .png. May be given more than once.
    Default: a name made of the input's and the sentence, in this folder.
    """
    preview: PreviewOption = ()
    """Also make a video (.mp4, .webp, .gif) or a contact sheet (.png). May be given more than once."""
    seed: int = 0
    """The same seed and version give the same motion."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Sampling steps, 1 to 1000; more is slower. Default: 20."""
    guidance: Annotated[float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="")] = None
    """How closely to follow the sentence, 0 to 20. Default: 3.5."""
    fps: float = 30.0
    """Frames a second of the files, 1 to 120."""
    handles: Literal["predict", "rig"] = "predict"
    """Where the character's handles come from: "predict" finds them from the shape, "rig" takes the file's own bones,
    by their names.
    """
    overwrite: bool = False
    """Replace files that are there already and that Bunraku did not write, or made of something else."""
    up: AxisOption = "auto"
    """The axis that is up in the character's file. "auto" goes by the rule of the format, and by the shape where it has
    none.
    """
    front: AxisOption = "auto"
    """The axis that the character faces in its file."""
    unit: UnitOption = "auto"
    """The unit of lengths in the character's file. "auto" goes by the rule of the format, and by the height where it
    has none.
    """
    without: WithoutOption = ()

    anyway: bool = False
    """Go on where no movement of the sentence is understood; the network then makes some motion."""

    def check(self) -> None:
        """Raise OptionError unless a motion can be made with these."""
        check_range("--seed", self.seed, 0, 2**63 - 1)
        check_range("--steps", self.steps, 1, 1000)
        check_range("--guidance", self.guidance, 0, 20)
        check_range("--fps", self.fps, 1, 120)
        check_axes(self.up, self.front)

    @property
    def sampling(self) -> dict[str, Any]:
        """What `animate` and `edit` take of these."""
        return {"seed": self.seed, "steps": self.steps, "guidance": self.guidance, "anyway": self.anyway}
