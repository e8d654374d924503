"""`bunraku comfyui-nodes`: the node pack for ComfyUI as a folder."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.output.checks import check_folder
from bunraku.cli.output.outputs import wrote
from bunraku.formats.files import atomic_write

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
        from bunraku.cli.output.ledger import check_free

        data = files("bunraku.studio").joinpath("addon", "comfyui", "__init__.py").read_bytes()
        check_folder(self.output.parent)
        target = self.output / "__init__.py"
        if not (target.is_file() and target.read_bytes() == data):
            check_free([target], self.overwrite, ours=False)
        self.output.mkdir(exist_ok=True)
        with atomic_write(target) as file:
            file.write(data)
        wrote(target)
