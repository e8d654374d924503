"""Options of sampling and of apparel: the dataclasses of a request, with what the command line shows of their types."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.request import Sampling

__all__ = ["ApparelOptions", "EditSamplingOptions", "SamplingOptions"]


@dataclass(frozen=True)
class SamplingOptions(Sampling):
    """`Sampling` on the command line."""

    steps: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Sampling steps, 1 to 1000; more is slower. Default: 4, distilled; 8 with --guidance."""
    guidance: Annotated[float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="")] = None
    """How closely to follow the sentence, 0 to 20. Default: 3.5."""


@dataclass(frozen=True)
class EditSamplingOptions(SamplingOptions):
    """`Sampling` of a clip that is edited: it has its length, and one motion is drawn."""

    seconds: tyro.conf.Suppress[float] = 6.0
    candidates: tyro.conf.Suppress[int] = 3


@dataclass(frozen=True)
class ApparelOptions(Apparel):
    """`Apparel` on the command line."""

    motion: Annotated[str, tyro.conf.arg(name="apparel", metavar="{auto,none,simulate,chains,learn,MASK}")] = "none"
    """How hair and clothes move: "none" with the body, "simulate" by the physics of an MMD or VRM file, or else by
    the bones of hair and clothes of a person's rig, "chains" by chains of bones that are laid over what a network finds
    on any mesh, "learn" by a network alone, "auto" by the first of physics, bones and chains that there is; or the file
    of a mask (.npy, .txt, painted .ply or .glb) of what is to be learned.
    """
