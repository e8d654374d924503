"""`bunraku studio`: the page on the user's own machine."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.output.checks import check_range

__all__ = ["Studio"]


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
