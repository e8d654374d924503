"""Which options of `animate` and `transfer` go together."""

from __future__ import annotations

from pathlib import Path

from bunraku.errors import OptionError

__all__ = ["APPAREL", "check_apparel_option", "check_together", "moves_apparel"]

APPAREL = ("auto", "none", "rigid", "simulate", "learn")
"""How apparel may move, beside a mask; "rigid" is "none"."""
STIFFEST = 1000.0
_MASKS = (".npy", ".txt", ".ply", ".glb")


def moves_apparel(apparel: str) -> bool:
    """Whether apparel moves on its own by this, or may."""
    return apparel not in ("none", "rigid")


def check_apparel_option(apparel: str, stiffness: float = 1.0, *, dashes: str = "") -> None:
    """Whether apparel can move so.

    Args:
        apparel: One of `APPAREL`, or the file of a mask.
        stiffness: Factor on how stiff learned apparel is.
        dashes: What stands before the names of options in messages.

    Raises:
        OptionError: It cannot.
    """
    if apparel not in APPAREL and Path(apparel).suffix.lower() not in _MASKS:
        raise OptionError(
            f"apparel moves by 'auto', 'none', 'simulate' or 'learn', or is named by a mask ({', '.join(_MASKS)}), not "
            f"'{apparel}'; choose one of these"
        )
    if not 1 / STIFFEST <= stiffness <= STIFFEST:
        raise OptionError(f"{dashes}stiffness is a factor from {1 / STIFFEST:g} to {STIFFEST:g}, not {stiffness:g}")


def check_together(
    apparel: str,
    *,
    loop: bool = False,
    after: bool = False,
    handles: bool = False,
    path: bool = False,
    in_place: bool = False,
    pins: bool = False,
    dashes: str = "",
) -> None:
    """Raise OptionError where options of `animate` do not go together.

    Args:
        apparel: How apparel moves.
        loop: Whether a loop is made.
        after: Whether another clip is followed.
        handles: Whether handles are given or asked for.
        path: Whether the root follows a path.
        in_place: Whether the way over the ground is taken out.
        pins: Whether hands or feet are pinned.
        dashes: What stands before the names of options in messages.
    """
    check_apparel_option(apparel, dashes=dashes)
    if loop and after:
        raise OptionError(
            f"a loop ends where it starts, so it cannot follow another motion: {dashes}loop and {dashes}after do not "
            "go together"
        )
    if path and (loop or after or in_place):
        raise OptionError(
            f"a path says where the character goes, so it goes with none of {dashes}loop, {dashes}after and "
            f"{dashes}in{'-' if dashes else '_'}place"
        )
    if apparel == "simulate" and (path or pins):
        raise OptionError(
            f"paths and pins are for characters moved by handles; leave out {dashes}apparel simulate, or "
            f"{dashes}path and {dashes}pin"
        )
    if moves_apparel(apparel) and (loop or after):
        kind = "simulated" if apparel == "simulate" else "moving"
        raise OptionError(
            f"{kind} apparel starts from the rest pose, so it goes with neither {dashes}loop nor {dashes}after"
        )
    if apparel == "simulate" and handles:
        raise OptionError(f"apparel is simulated on the bones of a character's rig; leave {dashes}handles out")
