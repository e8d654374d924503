"""`bunraku serve`: tools that other programs call."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from bunraku.errors import FormatError

__all__ = ["Serve"]


@dataclass(frozen=True)
class Serve:
    """Let other programs call Bunraku by the Model Context Protocol, over standard input and output: animate, transfer,
    rig, inspect, render and clips, each with a picture of what it made.

    All files lie in FOLDER or below it; nothing else is read or written, and nothing is replaced. What a program of
    yours starts it with: bunraku serve FOLDER

    Example: bunraku serve ~/characters
    """

    folder: tyro.conf.Positional[Path] = Path()
    """Where files are read and written."""

    def run(self) -> None:
        if not self.folder.is_dir():
            raise FormatError(self.folder, "this is no folder; name one that is there")
        from bunraku.serving.mcp_server import mcp_server

        mcp_server(self.folder).run("stdio")
