"""A file becomes a character of the studio: read, stood up, in metres, with handles, and what a page gets of it."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.character import Character, Handles
from bunraku.errors import CharacterError, OptionError
from bunraku.formats.files import MAX_BYTES
from bunraku.formats.gltf.turning import turned
from bunraku.handles.orientation import ResolvedAxes, resolve_axes
from bunraku.io import load_character
from bunraku.io.units import in_metres, resolve_unit

__all__ = ["MAX_VERTICES", "Settings", "found_out", "opened_character", "told"]

_log = logging.getLogger(__name__)
MAX_VERTICES = 1_000_000
"""A browser draws more only on a large machine."""
assert MAX_BYTES  # the bound of files on disk; uploads have a smaller one


@dataclass(frozen=True)
class Settings:
    """How a file is taken.

    Args:
        up, front: Axes of the file, or "auto".
        unit: Its unit, or "auto".
        handles: "predict" them from the shape, or take those of the file's "rig".
    """

    up: str = "auto"
    front: str = "auto"
    unit: str = "auto"
    handles: Literal["predict", "rig"] = "predict"


def opened_character(path: Path, settings: Settings) -> tuple[Character, dict[str, Any]]:
    """The character of a file in metres, standing along +Y and facing +Z, and what was taken for granted on the way.

    Raises:
        FormatError: The file cannot be read.
        CharacterError: It holds no usable mesh, or too many vertices.
        OptionError: The unit or the axes cannot be.
    """
    from bunraku.geometry.axes import axis_name

    for axis in (settings.up, settings.front):
        if axis != "auto":
            axis_name(axis)
    if settings.up != "auto" and settings.front != "auto" and settings.up[1] == settings.front[1]:
        raise OptionError("up and front lie along the same axis; choose two at a right angle")
    character = load_character(path, unit="m")
    if len(character.vertices) > MAX_VERTICES:
        raise CharacterError(
            f"{path.name}: {len(character.vertices):,} vertices are more than the studio shows ({MAX_VERTICES:,}); "
            "simplify the mesh, or use the command line"
        )
    found = resolve_axes(character, settings.up, settings.front)
    standing = turned(character, found.up, found.front)
    suffix = str(getattr(standing.source, "suffix", ""))
    unit = resolve_unit(standing.height, suffix, settings.unit)
    character, _ = in_metres(standing, settings.unit, "+y")
    return character, {"axes": _axes(found), "unit": {"unit": unit.unit, "likely": unit.likely, "note": unit.note}}


def _axes(found: ResolvedAxes) -> dict[str, Any]:
    """The axes that were taken, how sure that is, and what else it could be."""
    guess, taken = found.guess, (found.up, found.front)
    out: dict[str, Any] = {"up": found.up, "front": found.front, "sure": 1.0, "other": None}
    if guess is None:
        return out
    out["sure"] = round(guess.probability(*taken), 3)
    out["other"] = list((guess.up, guess.front) if taken != (guess.up, guess.front) else guess.next_best(*taken))
    return out


def _has_skeleton(character: Character) -> bool:
    """Whether the bones of the file are understood, so that they can be moved."""
    from bunraku.retarget.rig_parts import understood_rig

    try:
        return character.rig is not None and understood_rig(character) is not None
    except CharacterError:
        return False


def found_out(character: Character, anatomy: Anatomy, worn: Path, painted: bool = False) -> dict[str, Any]:
    """What a page shows of a character and is longer looked for: apparel, and where hands and feet are.

    Args:
        character: The character.
        anatomy: Of it.
        worn: The file that gets which vertices are apparel.
        painted: Whether somebody painted them, so that they are not what is found.

    Raises:
        FormatError: That cannot be written.
    """
    from bunraku.retarget.stages.pins import limb_ends
    from bunraku.studio.workspace.dressing import found_apparel, has_apparel
    from bunraku.studio.workspace.mask import save_worn

    try:
        mask = found_apparel(character, anatomy.handles)
    except Exception:  # clothes that nobody finds are no reason not to open a character
        _log.exception("apparel could not be looked for")
        mask = None
    if not worn.is_file() or not painted:
        save_worn(character, mask, worn)  # what is painted is not what was found
    ends = [
        {"part": end.part, "handle": end.handle, "point": np.round(end.point, 5).tolist()} for end in limb_ends(anatomy)
    ]
    return {"apparel": has_apparel(mask), "ends": ends}


def told(character: Character, handles: Handles) -> dict[str, Any]:
    """What a page shows of a character."""
    from bunraku.core.mmd_model import mmd_model
    from bunraku.handles.from_rig import rig_handles
    from bunraku.physics.from_file import apparel_rig

    try:
        usable = character.rig is not None and rig_handles(character) is not None
    except CharacterError:
        usable = False
    try:
        physics = apparel_rig(character) is not None
    except Exception:  # broken physics are no reason not to open a character
        physics = False
    low, high = character.vertices[character.surface].min(axis=0), character.vertices[character.surface].max(axis=0)
    used = np.flatnonzero(handles.weights.max(axis=0) > 0.01)
    return {
        "vertices": len(character.vertices),
        "faces": len(character.faces),
        "height": round(character.height, 4),
        "bounds": [low.astype(float).round(4).tolist(), high.astype(float).round(4).tolist()],
        "joints": 0 if character.rig is None else len(character.rig.names),
        "rig": usable,
        "physics": physics,
        "skeleton": _has_skeleton(character),
        "mmd": mmd_model(character) is not None,
        "roles": handles.played.tolist(),
        "positions": handles.positions.astype(float).round(5).tolist(),
        "used": used.tolist(),
    }
