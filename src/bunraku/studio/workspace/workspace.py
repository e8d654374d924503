"""What the worker works with: the latest characters in memory, takes from disk, and how they are put back."""

from __future__ import annotations

import json
import logging
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path
from typing import Any

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.character import Character, Handles
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import BunrakuError, OptionError
from bunraku.formats.files import atomic_write
from bunraku.pipelines.animator import Body
from bunraku.studio.workspace.clips import Dressed, Take, body_of, load_handles, load_take, packed_clip, save_take
from bunraku.studio.workspace.mask import painted_file
from bunraku.studio.workspace.opened import Settings, opened_character

__all__ = ["PREVIEWS", "Workspace"]

PREVIEWS = "clips"
"""The folder of a character that holds how clips of the library look on it."""
KEPT = 4
"""Characters that stay in memory."""


class Workspace:
    """The latest characters, and the files of all things.

    Args:
        folder: The studio's.
    """

    def __init__(self, folder: str):
        self.folder = Path(folder)
        self._open: OrderedDict[tuple[str, int], tuple[Character, Handles]] = OrderedDict()
        self._bodies: OrderedDict[str, Body] = OrderedDict()

    def warm_up(self) -> None:
        """Load the networks, so that the first user does not wait for them."""
        from bunraku.pipelines.animator import Animator
        from bunraku.pipelines.requests.request import Request, Sampling
        from bunraku.samples import sample_character

        try:
            Animator.shipped()(sample_character("person"), Request("walks", Sampling(2, steps=2, candidates=2)))
        except BunrakuError as error:  # it will be reported where it matters
            logging.getLogger(__name__).warning("%s", error)

    def folder_of(self, kind: str, name: str) -> Path:
        """The folder of a thing; names are those that the store gave."""
        return self.folder / kind / name

    def character(self, name: str) -> tuple[Character, Handles]:
        """A character that was opened, with its handles."""
        folder = self.folder_of("characters", name)
        handles_file = folder / "handles.npz"
        try:
            stamp = handles_file.stat().st_mtime_ns
            record = json.loads((folder / "record.json").read_text(encoding="utf-8"))
        except OSError:
            raise OptionError("this character is not open; open its file again") from None
        key = (name, stamp)
        if key not in self._open:
            character, _ = opened_character(folder / record["file"], Settings(**record["settings"]))
            self._open[key] = replace(character, name=record["name"][:60]), load_handles(handles_file)
            while len(self._open) > KEPT:
                self._open.popitem(last=False)
        self._open.move_to_end(key)
        return self._open[key]

    def painted(self, name: str) -> bool:
        """Whether somebody painted what of a character is hair and clothes."""
        folder = self.folder_of("characters", name)
        record = json.loads((folder / "record.json").read_text(encoding="utf-8"))
        return painted_file(folder / record["file"]).is_file()

    def body(self, name: str) -> Body:
        """A character that was opened, with what is known of its handles' anatomy worked out once."""
        character, handles = self.character(name)
        if name not in self._bodies or self._bodies[name].character is not character:
            anatomy = Anatomy.of(character, handles).measured()
            self._bodies[name] = Body(character, handles.features, anatomy)
            while len(self._bodies) > KEPT:
                self._bodies.popitem(last=False)
        return self._bodies[name]

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
                from bunraku.io import save_character

                save_character(shown.character, mesh, shown.handles)
        return {
            "clip": clip,
            "skin": skin,
            "fps": float(take.fps),
            "frames": len(shown.motion),
            "seconds": round(len(shown.motion) / take.fps, 4),
            "stiffness": take.stiffness if isinstance(take, Dressed) else None,
            "gravity": take.gravity if isinstance(take, Dressed) else None,
            "worn": take.motion if isinstance(take, Dressed) else None,
        }
