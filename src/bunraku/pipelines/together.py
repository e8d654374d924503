"""Which options of `animate` go together."""

from __future__ import annotations

from bunraku.errors import OptionError

__all__ = ["check_together"]


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
    if apparel not in ("rigid", "simulate"):
        raise OptionError(f"apparel moves by 'rigid' or 'simulate', not '{apparel}'; choose one of the two")
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
    if apparel == "simulate" and (loop or after):
        raise OptionError(
            f"simulated apparel starts from the rest pose, so it goes with neither {dashes}loop nor {dashes}after"
        )
    if apparel == "simulate" and handles:
        raise OptionError(f"apparel is simulated on the bones of a character's rig; leave {dashes}handles out")
