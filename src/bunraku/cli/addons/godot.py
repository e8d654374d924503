"""`bunraku godot-addon`: the add-on for Godot 4 as a folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.addons.packs import write_pack

__all__ = ["GodotAddon"]


@dataclass(frozen=True)
class GodotAddon:
    """Write the add-on for Godot 4: a panel that makes an animated scene of a mesh and a sentence.

    It belongs into the add-ons of a project; switch it on in Project Settings, Plugins. Start `bunraku studio`, and
    copy the address that it prints into the panel.

    Example: bunraku godot-addon -o game/addons/bunraku
    """

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("bunraku-godot")
    """Folder to write."""
    overwrite: bool = False
    """Replace an add-on that is there already and is another one."""

    def run(self) -> None:
        write_pack("godot", self.output, self.overwrite)
