"""`bunraku studio`, and the add-ons of Blender, ComfyUI and Godot, which call it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from bunraku.cli.manifest import check_free
from bunraku.cli.shared import check_folder, check_output, check_range, wrote
from bunraku.core.files import atomic_write, writing


@dataclass(frozen=True)
class Studio:
    """Open the studio: drop a character, type a sentence, watch it move, export it.

    The server is reached from this machine only, and nothing leaves it. What is made is kept in a folder for the next
    time.

    Example: bunraku studio
    """

    port: int = 8734
    """Port to listen at; the next free one where it is taken, any free one for 0."""
    folder: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Where characters, takes and projects are kept. Default: bunraku/studio in the user's data folder."""
    no_browser: bool = False
    """Only print the address."""
    host: str = "127.0.0.1"
    """Address to listen at. Any but this machine's own needs a password, in the variable BUNRAKU_STUDIO_PASSWORD."""

    def run(self) -> None:
        check_range("--port", self.port, 0, 65535)
        from bunraku.studio.server.serve import serve
        from bunraku.studio.store import default_folder

        serve(
            self.folder or default_folder(), port=self.port, host=self.host,
            password=os.environ.get("BUNRAKU_STUDIO_PASSWORD", ""), browser=not self.no_browser,
        )  # fmt: skip


@dataclass(frozen=True)
class _Addon:
    """A file or a folder among the studio's add-ons. Files that are there already and are the same are kept."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    overwrite: bool = False
    """Replace other files of these names."""

    name: ClassVar[str]

    def run(self) -> None:
        source, output = files("bunraku.studio").joinpath("addon", self.name), self.output
        if source.is_file():
            check_output(output, (Path(self.name).suffix,))
            contents = {output: source.read_bytes()}
        else:
            contents = {
                output / entry.name: entry.read_bytes()
                for entry in sorted(source.iterdir(), key=lambda entry: entry.name)
                if entry.is_file() and not entry.name.endswith(".pyc")
            }
            check_folder(output if output.parent.exists() else output.parent)
        other = [path for path, data in contents.items() if not (path.is_file() and path.read_bytes() == data)]
        check_free(other, self.overwrite, ours=False)
        for path, data in contents.items():
            with writing(path.parent, "folder"):
                path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(path) as file:
                file.write(data)
            wrote(path)


@dataclass(frozen=True)
class BlenderAddon(_Addon):
    """Write the add-on for Blender: a panel with a sentence, which makes an action of the selected mesh.

    Install the file in Blender's preferences, start `bunraku studio`, and give the panel the address that it prints.

    Example: bunraku blender-addon -o bunraku_addon.py
    """

    name = "bunraku_addon.py"
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("bunraku_addon.py")
    """File to write."""


@dataclass(frozen=True)
class ComfyuiNodes(_Addon):
    """Write the node pack for ComfyUI: a node that makes an animated file of a mesh and a sentence.

    It belongs into the custom nodes of ComfyUI. Start `bunraku studio`, and give the node the address that it prints.

    Example: bunraku comfyui-nodes -o ComfyUI/custom_nodes/bunraku
    """

    name = "comfyui"
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("bunraku-comfyui")
    """Folder to write."""


@dataclass(frozen=True)
class GodotAddon(_Addon):
    """Write the add-on for Godot 4: a panel that makes an animated scene of a mesh and a sentence.

    It belongs into the add-ons of a project; switch it on in Project Settings, Plugins. Start `bunraku studio`, and
    copy the address that it prints into the panel.

    Example: bunraku godot-addon -o game/addons/bunraku
    """

    name = "godot"
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("bunraku-godot")
    """Folder to write."""
