"""The worker's state: files opened as characters, the latest of them in memory, takes from disk."""

from __future__ import annotations

import json
import logging
from collections import OrderedDict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.corrected import joint_facts, piece_facts
from bunraku.anatomy.handles.orientation import resolve_axes
from bunraku.anatomy.scene import separated
from bunraku.core.animation import RigAnimation
from bunraku.core.body.corrections import Corrections
from bunraku.core.body.layout import handle_names
from bunraku.core.character import Character, Handles
from bunraku.core.files import atomic_write
from bunraku.core.request import to_json
from bunraku.errors import BunrakuError, CharacterError, OptionError
from bunraku.files import in_metres, load_character, resolve_unit, rotated
from bunraku.pipelines.animator import Body
from bunraku.pipelines.live import Live
from bunraku.studio.dressing import painted_file
from bunraku.studio.wire import Dressed, Take, body_of, load_handles, load_take, packed_clip, save_take

_log = logging.getLogger(__name__)
MAX_VERTICES = 1_000_000
"""Vertices that a browser draws on an ordinary machine; chosen by eye."""


@dataclass(frozen=True)
class Settings:
    """How a file is taken."""

    up: str = "auto"  # axes of the file, or "auto"
    front: str = "auto"  # axes of the file, or "auto"
    unit: str = "auto"  # its unit, or "auto"
    handles: Literal["predict", "rig"] = "predict"  # "predict" them from the shape, or take those of the file's "rig"

    def __post_init__(self) -> None:
        Corrections(self.up, self.front)  # refuses axes that do not go together


def opened_character(path: Path, settings: Settings) -> tuple[Character, dict[str, Any]]:
    """The character of a file in metres, standing along +Y and facing +Z, with the axes and the unit that were taken.

    Raises:
        FormatError: The file cannot be read.
        CharacterError: It holds no usable mesh, or too many vertices.
        OptionError: The unit or the axes cannot be.
    """
    character = load_character(path, unit="m")
    if len(character.vertices) > MAX_VERTICES:
        raise CharacterError(
            f"{path.name}: {len(character.vertices):,} vertices are more than the studio shows ({MAX_VERTICES:,}); "
            "simplify the mesh, or use the command line"
        )
    orientation = resolve_axes(character, settings.up, settings.front)
    standing = rotated(character, orientation.up, orientation.front)
    suffix = str(getattr(standing.source, "suffix", ""))
    unit = resolve_unit(standing.height, suffix, settings.unit)
    character, _ = separated(in_metres(standing, settings.unit, "+y")[0])
    other = None if orientation.other is None else list(orientation.other)
    axes = {"up": orientation.up, "front": orientation.front, "sure": round(orientation.sure, 3), "other": other}
    return character, {"axes": axes, "unit": {"unit": unit.unit, "likely": unit.likely, "note": unit.note}}


def _has_skeleton(character: Character) -> bool:
    """Whether the bones of the file are understood, so that they can be moved."""
    from bunraku.retarget.rig_parts import understood_rig

    try:
        return character.rig is not None and understood_rig(character) is not None
    except CharacterError:
        return False


def apparel_facts(character: Character, anatomy: Anatomy, worn: Path, painted: bool = False) -> dict[str, Any]:
    """Facts of a character that take longer to find: its apparel, whose mask goes into the file `worn`, unless a user
    painted it, and where hands and feet are.
    """
    from bunraku.apparel.parts import part_facts, parts_of
    from bunraku.retarget.pins import limb_ends
    from bunraku.studio.dressing import apparel_mask_of, found_mask, has_apparel, save_worn

    mask, numbers, kinds = None, None, []
    try:
        mask, numbers, kinds = apparel_mask_of(character), parts_of(character).number, part_facts(character)
    except Exception:  # a character opens even where its clothes cannot be found
        _log.exception("apparel could not be looked for")
    kept = found_mask(worn) if painted and worn.is_file() else None
    save_worn(character, mask if kept is None or len(kept) != len(character.vertices) else kept, worn, numbers)
    ends = [
        {"part": end.part, "handle": end.handle, "point": np.round(end.point, 5).tolist()} for end in limb_ends(anatomy)
    ]
    return {"apparel": has_apparel(mask), "ends": ends, "dress": kinds}


def character_facts(anatomy: Anatomy) -> dict[str, Any]:
    """What a page shows of a character."""
    from bunraku.anatomy.names.bone_names import rig_handles
    from bunraku.apparel.physics.rig import apparel_rig
    from bunraku.core.avatars import mmd_model

    character, handles = anatomy.character, anatomy.handles
    try:
        usable = character.rig is not None and rig_handles(character) is not None
    except CharacterError:
        usable = False
    try:
        physics = apparel_rig(character) is not None
    except Exception:  # a character opens even where its physics are broken
        physics = False
    low, high = character.vertices[character.surface].min(axis=0), character.vertices[character.surface].max(axis=0)
    return {
        "vertices": len(character.vertices), "faces": len(character.faces), "height": round(character.height, 4),
        "bounds": [low.astype(float).round(4).tolist(), high.astype(float).round(4).tolist()],
        "joints": 0 if character.rig is None else len(character.rig.names), "rig": usable, "physics": physics,
        "skeleton": _has_skeleton(character), "mmd": mmd_model(character) is not None,
        "roles": handles.played.tolist(), "positions": handles.positions.astype(float).round(5).tolist(),
        "used": np.flatnonzero(handles.weights.max(axis=0) > 0.01).tolist(), "body": corrected_facts(anatomy),
    }  # fmt: skip


def corrected_facts(anatomy: Anatomy) -> dict[str, Any]:
    """What a page shows of a body so that a person can correct it: `joints` with their positions [m] and parents,
    `parts`, and what is `said` already, as `core.body.corrections.Corrections` has it.
    """
    character, handles, joints = anatomy.character, anatomy.handles, anatomy.joints
    at, names = joint_facts(handles, joints), handle_names(handles.played)
    listed = [
        {"name": name, "parent": names[joints.parents[names.index(name)]] if name != names[0] else None, "point": point}
        for name, point in at.items()
    ]
    said = character.corrections or Corrections()
    return {"joints": listed, "parts": piece_facts(character, handles), "said": to_json(said)}


PREVIEWS = "clips"
"""The folder of a character that holds how clips of the library look on it."""
KEPT = 4
"""Characters that stay in memory."""


class Workspace:
    """The latest characters, and the files of all things in the studio's folder."""

    def __init__(self, folder: str):
        self.folder = Path(folder)
        self._open: OrderedDict[tuple[str, int], tuple[Character, Handles]] = OrderedDict()
        self._bodies: OrderedDict[str, Body] = OrderedDict()
        self._lives: OrderedDict[str, tuple[str, Live]] = OrderedDict()

    def warm_up(self) -> None:
        """Load the networks, so that the first job does not wait for them."""
        from bunraku.files import sample_character
        from bunraku.pipelines.animator import Animator
        from bunraku.pipelines.requests import Request, Sampling

        try:
            Animator.shipped()(sample_character("person"), Request("walks", Sampling(2, steps=2, candidates=2)))
        except BunrakuError as error:  # it will be reported where it matters
            logging.getLogger(__name__).warning("%s", error)

    def folder_of(self, kind: str, name: str) -> Path:
        """The folder of a thing; names are those that the store gave."""
        return self.folder / kind / name

    def character(self, name: str, read: Character | None = None) -> tuple[Character, Handles]:
        """A character that was opened, with its handles. `read` is what was read of its file a moment ago."""
        folder = self.folder_of("characters", name)
        handles_file = folder / "handles.npz"
        try:
            stamp = handles_file.stat().st_mtime_ns
            record = json.loads((folder / "record.json").read_text(encoding="utf-8"))
        except OSError:
            raise OptionError("this character is not open; open its file again") from None
        key = (name, stamp)
        if key not in self._open:
            if read is None:
                read, _ = opened_character(folder / record["file"], Settings(**record["settings"]))
            self._open[key] = replace(read, name=record["name"][:60]), load_handles(handles_file)
            while len(self._open) > KEPT:
                self._open.popitem(last=False)
        self._open.move_to_end(key)
        return self._open[key]

    def painted(self, name: str) -> bool:
        """Whether a user painted which vertices of a character are hair and clothes."""
        folder = self.folder_of("characters", name)
        record = json.loads((folder / "record.json").read_text(encoding="utf-8"))
        return painted_file(folder / record["file"]).is_file()

    def body(self, name: str) -> Body:
        """A character that was opened; what is found of its handles' anatomy is kept."""
        character, handles = self.character(name)
        if name not in self._bodies or self._bodies[name].character is not character:
            self._bodies[name] = Body(character, handles.features, Anatomy.of(character, handles))
            while len(self._bodies) > KEPT:
                self._bodies.popitem(last=False)
        return self._bodies[name]

    def live(self, session: str, owner: str, begins: bool) -> Live:
        """A character that never stops, by the name of its session; OptionError where it has ended."""
        if begins:
            self._lives[session] = owner, Live(self.body(owner), lead=0)
            while len(self._lives) > KEPT:
                self._lives.popitem(last=False)
        if self._lives.get(session, ("",))[0] != owner:
            raise OptionError("this session has ended; begin another one")
        self._lives.move_to_end(session)
        return self._lives[session][1]

    def take(self, name: str, owner: str) -> Take:
        """A take that is finished, of a character."""
        path = self.folder_of("takes", name) / "motion.npz"
        if not path.is_file():
            raise OptionError("that take is not finished, or is gone; choose another one")
        return load_take(path, *self.character(owner))

    def keep(self, take: Take, name: str, owner: str, draft: bool = False) -> dict[str, Any]:
        """Write a take's files; what its record learns."""
        folder = self.folder_of("takes", name)
        clip = "draft.bin" if draft else "clip.bin"
        shown = take.points if isinstance(take, Dressed) else take
        with atomic_write(folder / clip) as file:
            file.write(packed_clip(take))
        skin = "bones" if isinstance(body_of(take), RigAnimation) else "handles"
        if not draft:
            save_take(take, folder / "motion.npz")
            mesh = self.folder_of("characters", owner) / "bones.glb"
            if skin == "bones" and not mesh.is_file():
                from bunraku.files import save_character

                save_character(shown.character, mesh, shown.handles)
        return {
            "clip": clip, "skin": skin, "fps": float(take.fps), "frames": len(shown.motion),
            "seconds": round(len(shown.motion) / take.fps, 4),
            "stiffness": take.stiffness if isinstance(take, Dressed) else None,
            "gravity": take.gravity if isinstance(take, Dressed) else None,
            "worn": take.motion if isinstance(take, Dressed) else None,
        }  # fmt: skip
