"""`bunraku blender-addon`: the add-on for Blender as one file."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.output.checks import check_output
from bunraku.cli.output.outputs import wrote
from bunraku.formats.files import atomic_write

__all__ = ["BlenderAddon"]


@dataclass(frozen=True)
class BlenderAddon:
    """Write the add-on for Blender: a panel with a sentence, which makes an action of the selected mesh.

    Install the file in Blender's preferences, start `bunraku studio`, and give the panel the address that it prints.

    Example: bunraku blender-addon -o bunraku_addon.py
    """

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("bunraku_addon.py")
    """File to write."""
    overwrite: bool = False
    """Replace a file that is there already and is another one."""

    def run(self) -> None:
        from bunraku.cli.output.ledger import check_free

        check_output(self.output, (".py",), [])
        data = (files("bunraku.studio") / "addon" / "bunraku_addon.py").read_bytes()
        if not (self.output.is_file() and self.output.read_bytes() == data):
            check_free([self.output], self.overwrite, ours=False)
        with atomic_write(self.output) as file:
            file.write(data)
        wrote(self.output)
