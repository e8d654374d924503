"""Takes as files of other programs."""

from __future__ import annotations

import tempfile
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import OptionError
from bunraku.studio.tasks.task import Partly, Report
from bunraku.studio.workspace.clips import Dressed
from bunraku.studio.workspace.workspace import Workspace

__all__ = ["Export", "ExportClips"]

BODIES = (".bvh", ".vrma", ".vmd", ".npz")
"""Formats of the motion of a body, in which apparel has no place."""


@dataclass(frozen=True)
class Export:
    """A take as a file of another program."""

    character: str
    export: str
    file: str
    take: str
    fps: float = 30.0

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.io.registry import check_writer

        target = shop.folder_of("exports", self.export) / self.file
        check_writer(target)
        report("write", 0.1)
        take = shop.take(self.take, self.character)
        options = {} if target.suffix in (".npz", ".vmd") else {"fps": self.fps}
        if isinstance(take, Dressed):
            shown = take.points if take.bones is None else take.bones
            (take.body if target.suffix in BODIES else shown).save(target, **options)
        else:
            take.save(target, **options)
        return {"export": self.export, "bytes": target.stat().st_size}


@dataclass(frozen=True)
class ExportClips:
    """Several takes of a character as the clips of one file, or of a ZIP of as many as a program wants."""

    character: str
    export: str
    file: str
    takes: tuple[str, ...]
    names: tuple[str, ...]
    fps: float = 30.0
    preset: str = ""
    title: str = "clips"

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.io.presets import preset_named, save_for
        from bunraku.io.save_clips import save_clips

        target = shop.folder_of("exports", self.export) / self.file
        clips: dict[str, Animation | RigAnimation] = {}
        character: Character | None = None
        for number, (take, name) in enumerate(zip(self.takes, self.names, strict=True)):
            report("read", number / len(self.takes))
            found = shop.take(take, self.character)
            if isinstance(found, Dressed):
                raise OptionError(
                    "apparel that moves on its own has no place among several clips; download those alone"
                )
            character = character or found.character
            clips[name] = replace(found, character=character)  # each was read with a copy of it
        if self.preset:
            clips = _named(clips, shop, self.character, preset_named(self.preset).skeleton)
        if not self.preset:
            save_clips(clips, target, fps=self.fps)
        elif target.suffix == ".zip":
            with tempfile.TemporaryDirectory(dir=target.parent) as folder:
                named = Path(folder, f"{self.title}{preset_named(self.preset).suffix}")
                with zipfile.ZipFile(target, "w") as archive:
                    for file in save_for(self.preset, clips, named, fps=self.fps or None):
                        archive.write(file, file.name)
        else:
            save_for(self.preset, clips, target, fps=self.fps or None)
        return {"export": self.export, "bytes": target.stat().st_size}


def _named(
    clips: dict[str, Animation | RigAnimation], shop: Workspace, character: str, names: str
) -> dict[str, Animation | RigAnimation]:
    """Clips of a person by its handles, on a tree of joints with a program's names; others as they are."""
    from bunraku.retarget.engine_skeleton import carried, on_skeleton

    moved = {name: clip for name, clip in clips.items() if isinstance(clip, Animation)}
    body = shop.body(character) if len(moved) == len(clips) else None
    if body is None or not body.takes_skeleton:
        return clips
    skeleton = on_skeleton(body.anatomy, names)
    return {name: carried(clip, body.anatomy, skeleton) for name, clip in moved.items()}
