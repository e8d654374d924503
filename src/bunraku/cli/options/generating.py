"""The options that all verbs share that make motion from a sentence."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import tyro

from bunraku.cli.options.orientation import AxisOption, UnitOption, check_axes
from bunraku.cli.options.sampling import SamplingOptions
from bunraku.cli.output.outputs import USUAL_FPS, OutputOption, PreviewOption, WithoutOption
from bunraku.core.request.limits import FPS

__all__ = ["GeneratingOptions"]


@dataclass(frozen=True, kw_only=True)
class GeneratingOptions:
    """How a motion is drawn from a sentence, fitted to a character and written."""

    output: OutputOption = ()
    """File to write: .glb, .usd, .usdc, .usdz, .fbx, .npz (the handle motion), .bvh or .vrma (what the
    humanoid skeleton does), .vmd (of MMD characters), .obj or .ply (a folder with one mesh a frame), .mp4, .webp, .gif
    or .png. May be given more than once.
    Default: a name made of the input's and the sentence, in this folder.
    """
    preview: PreviewOption = ()
    """Also make a video (.mp4, .webp, .gif) or a contact sheet (.png). May be given more than once."""
    sampling: tyro.conf.OmitArgPrefixes[SamplingOptions] = field(default_factory=SamplingOptions)
    """How the motion is drawn."""
    fps: float = USUAL_FPS
    """Frames a second of the files, 1 to 240."""
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

    force: bool = False
    """Go on where no movement of the sentence is understood; the network then makes some motion."""

    def check(self) -> None:
        """Raise OptionError unless a motion can be made with these."""
        self.sampling.check("--")
        FPS.check(self.fps, "--fps")
        check_axes(self.up, self.front)
