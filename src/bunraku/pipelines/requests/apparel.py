"""How apparel moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bunraku.core.request.constraint import Constraint
from bunraku.core.request.limits import GRAVITY, STIFFNESS
from bunraku.errors import OptionError

__all__ = ["APPAREL", "Apparel"]

APPAREL = ("auto", "none", "rigid", "simulate", "chains", "learn")
"""How apparel may move, beside a mask; "rigid" is another word for "none"."""
MASKS = (".npy", ".txt", ".ply", ".glb")


@dataclass(frozen=True)
class Apparel:
    """How hair and clothes move.

    Args:
        motion: "none" (or "rigid") moves them with the body; "simulate" by the rigid bodies or springs of an MMD or VRM
            file, or else by the bones of hair and clothes of a person's rig; "chains" by chains of bones that are laid
            over what a network finds on any mesh, and simulated; "learn" by a network; "auto" by the file's physics, or
            else its bones, or else chains where the mesh has apparel; or the file of a mask of what is to be
            learned.
        stiffness: How stiff apparel is, as a factor, 0.001 to 1000.
        gravity: How strongly what is simulated is drawn downwards, as a factor, 0 to 10.
    """

    motion: str = "none"
    stiffness: float = 1.0
    gravity: float = 1.0

    @property
    def moves(self) -> bool:
        """Whether apparel moves on its own by this, or may."""
        return self.motion not in ("none", "rigid")

    @property
    def learns(self) -> bool:
        """Whether a network moves apparel by this, whatever the file has."""
        return self.motion == "learn" or self.mask is not None

    @property
    def mask(self) -> Path | None:
        """The file of a mask, where one names what is apparel."""
        return None if self.motion in APPAREL else Path(self.motion)

    def check(self, dashes: str = "") -> None:
        """Whether apparel can move so.

        Args:
            dashes: What stands before the names of options in messages.

        Raises:
            OptionError: It cannot.
            MissingExtraError: What simulates is not installed.
        """
        from bunraku.physics.engine import check_engine

        if self.mask is not None and self.mask.suffix.lower() not in MASKS:
            raise OptionError(
                f"apparel moves by 'auto', 'none', 'simulate', 'chains' or 'learn', or is named by a mask "
                f"({', '.join(MASKS)}), not '{self.motion}'; choose one of these"
            )
        STIFFNESS.check(self.stiffness, f"{dashes}stiffness")
        GRAVITY.check(self.gravity, f"{dashes}gravity")
        if self.motion in ("simulate", "chains"):
            check_engine(f"apparel that moves by '{self.motion}'")

    def check_with(self, constraints: Sequence[Constraint], handles: bool = False, dashes: str = "") -> None:
        """Whether apparel that moves so goes together with what a motion must meet.

        Args:
            constraints: Those of a request.
            handles: Whether handles are given or requested.
            dashes: What stands before the names of options in messages.

        Raises:
            OptionError: It does not.
        """
        kinds = {one.kind for one in constraints}
        if self.motion == "simulate" and kinds & {"path", "pin"}:
            raise OptionError(
                f"paths and pins are for characters moved by handles; leave out {dashes}apparel simulate, or "
                f"{dashes}path and {dashes}pin"
            )
        if self.moves and kinds & {"loop", "after"}:
            moving = "simulated" if self.motion == "simulate" else "moving"
            raise OptionError(
                f"{moving} apparel starts from the rest pose, so it goes with neither {dashes}loop nor {dashes}after"
            )
        if self.motion == "simulate" and handles:
            raise OptionError(f"apparel is simulated on the bones of a character's rig; leave {dashes}handles out")
