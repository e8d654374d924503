"""`bunraku comfyui-nodes`: the node pack for ComfyUI as a folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.addons.packs import write_pack

__all__ = ["ComfyuiNodes"]


@dataclass(frozen=True)
class ComfyuiNodes:
    """Write the node pack for ComfyUI: a node that makes an animated file of a mesh and a sentence.

    It belongs into the custom nodes of ComfyUI. Start `bunraku studio`, and give the node the address that it prints.

    Example: bunraku comfyui-nodes -o ComfyUI/custom_nodes/bunraku
    """

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("bunraku-comfyui")
    """Folder to write."""
    overwrite: bool = False
    """Replace a pack that is there already and is another one."""

    def run(self) -> None:
        write_pack("comfyui", self.output, self.overwrite)
