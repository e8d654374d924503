"""A request for a motion that exists already: onto what it goes, at which rate, and how apparel moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from bunraku.core.request.limits import FPS
from bunraku.errors import OptionError
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.request import check_handles

if TYPE_CHECKING:
    from bunraku.core.character import Handles
    from bunraku.retarget.fit import Stages

__all__ = ["ONTO", "RATE", "TransferRequest"]

ONTO = ("auto", "handles", "rig")
"""What of a character a motion goes onto."""
RATE = 30.0
"""Frames a second [1/s] of what is transferred, unless another rate is requested."""


@dataclass(frozen=True, eq=False)
class TransferRequest:
    """How a motion is put on a character.

    Args:
        onto: "handles" moves the 30 handles of the character, "rig" the bones of its own rig, "auto" the rig of a
            humanoid that has one and handles otherwise.
        apparel: How hair and clothes move.
        stages: Which stages run; `pipelines.transfer.TRANSFER_STAGES` when None.
        handles: The character's handles, or how to make them: "predict" or "rig" (see `bunraku.rig`).
        fps: Frames a second of the result [1/s].
        names: The skeleton's joint by SMPL's name, for joints that are not found or found wrongly; "" for none.
        clip: Number or name of the clip of a file with several.
    """

    onto: Literal["auto", "handles", "rig"] = "auto"
    apparel: Apparel = field(default_factory=Apparel)
    stages: Stages | None = None
    handles: Handles | Literal["predict", "rig"] = "predict"
    fps: float = RATE
    names: Mapping[str, str] | None = None
    clip: int | str = 0

    def check(self, dashes: str = "") -> None:
        """Whether this can be requested.

        Args:
            dashes: What stands before the names of options in messages.

        Raises:
            OptionError: It cannot.
        """
        if self.onto not in ONTO:
            raise OptionError(
                f"a motion goes onto 'handles', 'rig' or 'auto', not '{self.onto}'; choose one of the three"
            )
        FPS.check(self.fps, f"{dashes}fps" if dashes else "")
        check_handles(self.handles)
        self.apparel.check(dashes)
        if self.apparel.motion == "simulate" and self.onto == "handles":
            raise OptionError(f"apparel is simulated on the bones of a character's rig; leave out {dashes}onto handles")
