"""`bunraku studio`, and the add-ons of Blender, ComfyUI and Godot, which call it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.manifest import check_free
from bunraku.cli.outputs import check_folder, check_output, check_range, wrote
from bunraku.core.files import atomic_write, writing

__all__ = ["BlenderAddon", "ComfyuiNodes", "GodotAddon", "Studio", "write_pack"]


@dataclass(frozen=True)
class Studio:
    """Open the studio: drop a character, type a sentence, watch it move, take it away.

    A page of this machine, with a server that only this machine reaches; nothing leaves it. What is made is kept in a
    folder and is there again the next time.

    Example: bunraku studio
    """

    port: int = 8734
    """Where it listens; the next free one where that is taken, any for 0."""
    folder: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Where characters, takes and projects are kept. Default: bunraku/studio in the user's data folder."""
    no_browser: bool = False
    """Only print the address."""
    host: str = "127.0.0.1"
    """Address to listen at. All but this machine's own needs a password, in the variable BUNRAKU_STUDIO_PASSWORD."""

    def run(self) -> None:
        check_range("--port", self.port, 0, 65535)
        from bunraku.studio.server.serve import serve
        from bunraku.studio.store import default_folder

        serve(
            self.folder or default_folder(), port=self.port, host=self.host,
            password=os.environ.get("BUNRAKU_STUDIO_PASSWORD", ""), browser=not self.no_browser,
        )  # fmt: skip


def write_pack(name: str, folder: Path, overwrite: bool) -> None:
    """Write the files of a pack; one that is there already and is the same is no reason to stop.

    Args:
        name: Its folder beside the studio's add-ons.
        folder: Where it goes.
        overwrite: Whether other files of these names are replaced.

    Raises:
        FormatError: A file is there and is another one, or cannot be written.
    """
    source = files("bunraku.studio").joinpath("addon", name)
    contents = {
        folder / one.name: one.read_bytes()
        for one in sorted(source.iterdir(), key=lambda one: one.name)
        if one.is_file() and not one.name.endswith(".pyc")
    }
    check_folder(folder if folder.parent.exists() else folder.parent)
    other = [path for path, data in contents.items() if not (path.is_file() and path.read_bytes() == data)]
    check_free(other, overwrite, ours=False)
    with writing(folder, "folder"):
        folder.mkdir(parents=True, exist_ok=True)
    for path, data in contents.items():
        with atomic_write(path) as file:
            file.write(data)
        wrote(path)


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
        from bunraku.cli.manifest import check_free

        check_output(self.output, (".py",), [])
        data = (files("bunraku.studio") / "addon" / "bunraku_addon.py").read_bytes()
        if not (self.output.is_file() and self.output.read_bytes() == data):
            check_free([self.output], self.overwrite, ours=False)
        with atomic_write(self.output) as file:
            file.write(data)
        wrote(self.output)


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
