"""Opening a character."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field
from typing import Any

from bunraku.core.character import Character
from bunraku.studio.tasks.task import Partly, Report
from bunraku.studio.workspace.clips import save_handles
from bunraku.studio.workspace.dressing import chains_of, told_chains
from bunraku.studio.workspace.mask import WORN
from bunraku.studio.workspace.opened import Settings, found_out, opened_character, told
from bunraku.studio.workspace.workspace import PREVIEWS, Workspace

__all__ = ["CHAINED", "FindOut", "LayChains", "Open"]

CHAINED = "chains.glb"
"""The mesh of a character with chains of bones for its apparel, and their springs in the extras."""


@dataclass(frozen=True)
class Open:
    """Open a character."""

    character: str
    file: str
    settings: Settings = field(default_factory=Settings)

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.io import save_character
        from bunraku.pipelines.animate import rig

        folder = shop.folder_of("characters", self.character)
        report("read", 0.1)
        character, taken = opened_character(folder / self.file, self.settings)
        report("handles", 0.3)
        handles = rig(character, handles=self.settings.handles)
        report("write", 0.8)
        save_character(character, folder / "mesh.glb", handles)
        for made in ("bones.glb", CHAINED):
            (folder / made).unlink(missing_ok=True)
        shutil.rmtree(folder / PREVIEWS, ignore_errors=True)
        save_handles(handles, folder / "handles.npz")
        return {**taken, **told(character, handles), "clips": _clips_of(character), "chains": []}


@dataclass(frozen=True)
class FindOut:
    """What is longer looked for of a character that is open already."""

    character: str

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        body = shop.body(self.character)
        report("look", 0.1)
        worn = shop.folder_of("characters", self.character) / WORN
        painted = shop.painted(self.character)
        return {**found_out(body.character, body.anatomy, worn, painted), "painted": painted}


@dataclass(frozen=True)
class LayChains:
    """Chains of bones over the hair and clothes of a character that is open, with springs for the page."""

    character: str

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.io import save_character
        from bunraku.physics.chains.avatars import vrm_avatar

        report("look", 0.1)
        body = shop.body(self.character)
        made, why = chains_of(body.anatomy)
        if made is None:
            reason = why.removeprefix(f"{body.character.name}: ").partition(";")[0]
            return {"chains": [], "unchained": f"{reason}; paint what is hair and clothes"}
        report("springs", 0.4)
        path = shop.folder_of("characters", self.character) / CHAINED
        save_character(made.character, path, rig=True, avatar=vrm_avatar(made))
        return {"chains": told_chains(made), "unchained": ""}


def _clips_of(character: Character) -> list[str]:
    """Names of the clips that the character's file brings."""
    from bunraku.formats.gltf.read import Source
    from bunraku.io.play import clip_names

    source = character.source
    return clip_names(source.document)[:50] if isinstance(source, Source) and character.rig is not None else []
